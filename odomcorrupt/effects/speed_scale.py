"""Tyre radii that grow (or shrink) with speed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from odomcorrupt.effects.effect import About, Effect, Motion, State, TwistError, parameter, stacked
from odomcorrupt.effects.wheels import Rims, body_of, heading_choice, rims_of, turning


@dataclass(frozen=True, slots=True)
class SpeedScale(Effect):
    """f_wheel = k abs(u) u at rim speed u; without a track, the limit (k abs(v) v, 0, 2 k abs(v) omega).

    With a track, both radii grow alike in a turn on the spot, and the turn grows with them.
    """

    name = "speed_scale"
    odd = True
    summary = "the wheels' radius changes with their speed"
    about = About(
        equation="f_wheel = k abs(u) u for each wheel's rim speed u; no yaw with a gyro",
        typical="0.1 to 3 % per m/s (an estimate)",
        source="tyre growth, as in any text on tyres; sizes are engineering judgement",
        confused_with=("wheel_scale", "accel_slip", "wheelbase"),
        drive="the same straight slowly and fast",
    )

    k: float = parameter("s/m", "growth of the radius per rim speed", low=-0.1, high=0.1, typical=0.01)
    heading: str = heading_choice()

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f: a scale error proportional to the speed, per wheel."""
        if motion.track_m is None:
            speed = self.k * np.abs(motion.v)
            yaw = turning(self.heading, 2.0 * speed * motion.omega)
            return TwistError(stacked(speed * motion.v, 0.0, yaw, motion.v), state)
        right, left = rims_of(motion.v, motion.omega, motion.track_m)
        grown = Rims(self.k * np.abs(right) * right, self.k * np.abs(left) * left)
        return TwistError(body_of(grown, motion.track_m, self.heading), state)
