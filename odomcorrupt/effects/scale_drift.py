"""Wheel radii that change during a drive, with temperature or pressure."""

from __future__ import annotations

from dataclasses import dataclass

from odomcorrupt.effects.effect import About, Effect, Motion, State, TwistError, parameter, stacked
from odomcorrupt.effects.wheels import heading_choice, turning


@dataclass(frozen=True, slots=True)
class ScaleDrift(Effect):
    """f = rate t (v, vy, omega), t since the first odometry stamp."""

    name = "scale_drift"
    odd = True
    summary = "the scale of distance and turn changes with time"
    about = About(
        equation="f = rate t (v, vy, omega); rate t (v, vy, 0) with a gyro",
        typical="1 to 2 % over a long drive with a leaking tyre; 0.3 % per 10 K of tyre temperature (an estimate)",
        source="the idea: time-varying radii in Kuemmerle, Grisetti & Burgard 2011; sizes are engineering judgement",
        confused_with=("wheel_scale", "region_slip", "clock_skew"),
        drive="repeat one loop for half an hour and more",
    )

    rate: float = parameter("1/s", "growth of the true radius per second", low=-1e-3, high=1e-3, typical=1e-5)
    heading: str = heading_choice()

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f: a scale error that grows with time."""
        scale = self.rate * motion.t_s
        yaw = turning(self.heading, scale * motion.omega)
        return TwistError(stacked(scale * motion.v, scale * motion.vy, yaw, motion.v), state)
