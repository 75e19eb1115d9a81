"""Gyro scale error: every turn is reported too large or too small."""

from __future__ import annotations

from dataclasses import dataclass

from odomcorrupt.effects.effect import About, Effect, Motion, State, TwistError, parameter, stacked


@dataclass(frozen=True, slots=True)
class GyroScale(Effect):
    """f = (0, 0, -e / (1 + e) omega): kinematically the same as a wrong wheelbase."""

    name = "gyro_scale"
    summary = "the yaw rate has a wrong gain"
    needs_gyro = True
    aliased_with = "wheelbase"
    about = About(
        equation="f_yaw = -e / (1 + e) omega",
        typical="0.1 to 3 % for an uncalibrated MEMS gyro",
        source="Woodman 2007, An introduction to inertial navigation (calibration errors)",
        confused_with=("wheelbase", "turn_asymmetry"),
        drive="turn on the spot both ways; only the source of the heading separates the two",
    )

    e: float = parameter("", "odometry yaw rate over the true one, minus one", low=-0.8, high=4.0, typical=0.01)

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f: every turn has the same scale error."""
        return TwistError(stacked(0.0, 0.0, -self.e / (1.0 + self.e) * motion.omega, motion.v), state)
