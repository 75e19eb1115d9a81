"""The odometry's yaw rate is off by a constant, also at rest."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from odomcorrupt.effects.effect import About, Effect, Kind, Motion, State, TwistError, parameter, stacked


@dataclass(frozen=True, slots=True)
class GyroBias(Effect):
    """f = (0, 0, -bias).

    Woodman 2007, An introduction to inertial navigation, section 3.2.1.
    """

    name: ClassVar[str] = "gyro_bias"
    kind: ClassVar[Kind] = "effect"
    summary: ClassVar[str] = "the yaw rate has a constant offset, also while standing"
    needs_gyro: ClassVar[bool] = True
    about: ClassVar[About | None] = About(
        equation="f_yaw = -bias",
        typical="0.01 to 0.1 deg/s after zeroing a MEMS gyro, 1 deg/s raw",
        source="Woodman 2007, An introduction to inertial navigation",
        confused_with=("unequal_wheels", "gyro_bias_walk", "turn_asymmetry"),
        drive="stand still for a minute",
    )

    bias: float = parameter("rad/s", "odometry yaw rate minus the true one", low=-0.5, high=0.5, typical=0.003)

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f: the yaw error goes with time."""
        return TwistError(stacked(0.0, 0.0, -self.bias, motion.v), state)
