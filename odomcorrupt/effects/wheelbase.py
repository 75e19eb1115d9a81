"""Effective track that is wider or narrower than nominal."""

from __future__ import annotations

from dataclasses import dataclass

from odomcorrupt.drive_types import PIVOTING
from odomcorrupt.effects.effect import About, Effect, Motion, State, TwistError, parameter, stacked


@dataclass(frozen=True, slots=True)
class Wheelbase(Effect):
    """f = (0, 0, -e / (1 + e) omega).

    Borenstein & Feng 1996, IEEE T-RA 12(6), E_b = 1 + e; skid-steered robots: Mandow & Martinez 2007, 1.3 to 2.
    """

    name = "wheelbase"
    summary = "the true distance between the wheels differs from the nominal track"
    drives = PIVOTING
    about = About(
        equation="f_yaw = -e / (1 + e) omega",
        typical="0.5 to 5 % with wide tyres; factors of 1.3 to 2 when skid-steering",
        source="Borenstein & Feng 1996, IEEE T-RA 12(6), E_b",
        confused_with=("gyro_scale", "turn_asymmetry", "speed_scale"),
        drive="turn on the spot both ways; only the source of the heading separates the two",
    )

    e: float = parameter("", "true over nominal track, minus one", low=-0.8, high=4.0, typical=0.015)

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f: every turn has the same scale error."""
        return TwistError(stacked(0.0, 0.0, -self.e / (1.0 + self.e) * motion.omega, motion.v), state)
