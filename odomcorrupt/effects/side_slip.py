"""Sideways slip of tyres in turns, growing with speed."""

from __future__ import annotations

from dataclasses import dataclass

from odomcorrupt.effects.effect import About, Effect, Motion, State, TwistError, parameter, stacked


@dataclass(frozen=True, slots=True)
class SideSlip(Effect):
    """f = (0, -k v omega, 0): a slip angle proportional to the lateral force m v omega.

    Rajamani, Vehicle Dynamics and Control, ch. 2 (linear tyre).
    """

    name = "side_slip"
    odd = True
    summary = "the robot slips outwards in turns, in proportion to speed times yaw rate"
    about = About(
        equation="f_across = -k v omega",
        typical="0.01 to 0.1 s (an estimate)",
        source="Rajamani, Vehicle Dynamics and Control (linear tyre)",
        confused_with=("icr_shift", "lever_arm", "mount_yaw"),
        drive="the same turn slowly and fast",
    )

    k: float = parameter("s", "sideways speed per speed and yaw rate", low=0.0, high=0.5, typical=0.03)

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f: a sideways error in turns."""
        return TwistError(stacked(0.0, -self.k * motion.v * motion.omega, 0.0, motion.v), state)
