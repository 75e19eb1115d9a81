"""Both wheel radii larger or smaller than nominal."""

from __future__ import annotations

from dataclasses import dataclass

from odomcorrupt.effects.effect import About, Effect, Motion, State, TwistError, parameter, stacked
from odomcorrupt.effects.wheels import heading_choice, turning


@dataclass(frozen=True, slots=True)
class WheelScale(Effect):
    """f = (e v, e vy, e omega): distance and turn are wrong by the same factor.

    Borenstein & Feng 1996, IEEE T-RA 12(6), E_s.
    """

    name = "wheel_scale"
    odd = True
    summary = "the wheels' true radius differs from the nominal one"
    about = About(
        equation="f = e (v, vy, omega); e (v, vy, 0) with a gyro",
        typical="0.2 to 2 %; inflatable tyres up to 3 %",
        source="Borenstein & Feng 1996, IEEE T-RA 12(6), E_s",
        confused_with=("speed_scale", "scale_drift", "lost_increments", "lever_arm"),
        drive="straights and turns, at two speeds",
    )

    e: float = parameter("", "true over nominal wheel radius, minus one", low=-0.8, high=4.0, typical=0.01)
    heading: str = heading_choice()

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f, proportional to the whole twist."""
        yaw = turning(self.heading, self.e * motion.omega)
        return TwistError(stacked(self.e * motion.v, self.e * motion.vy, yaw, motion.v), state)
