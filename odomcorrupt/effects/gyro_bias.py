"""Constant error of the odometry's yaw rate, also at rest."""

from __future__ import annotations

from dataclasses import dataclass

from odomcorrupt.effects.effect import About, Effect, Motion, State, TwistError, parameter, stacked


@dataclass(frozen=True, slots=True)
class GyroBias(Effect):
    """f = (0, 0, -bias).

    Woodman 2007, An introduction to inertial navigation, section 3.2.1.
    """

    name = "gyro_bias"
    summary = "the yaw rate has a constant offset, also while standing"
    needs_gyro = True
    about = About(
        equation="f_yaw = -bias",
        typical="0.01 to 0.1 deg/s after zeroing a MEMS gyro, 1 deg/s raw",
        source="Woodman 2007, An introduction to inertial navigation",
        confused_with=("unequal_wheels", "gyro_bias_walk", "turn_asymmetry"),
        drive="stand still for a minute",
    )

    bias: float = parameter("rad/s", "odometry yaw rate minus the true one", low=-0.5, high=0.5, typical=0.003)

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f: the yaw error is proportional to time."""
        return TwistError(stacked(0.0, 0.0, -self.bias, motion.v), state)
