"""Tyre radii that grow (or shrink) with speed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.effects.effect import About, Effect, Motion, State, TwistError, choice, parameter, stacked
from odomcorrupt.effects.wheels import Rims, body_of, heading_choice, rims_of, turning

if TYPE_CHECKING:
    from odomcorrupt.geometry.se2 import Array


@dataclass(frozen=True, slots=True)
class SpeedScale(Effect):
    """f_wheel = k abs(u)^n u at rim speed u, n = 1 or 2; without a track, the limit k abs(v)^n (v, 0, (n + 1) omega).

    With a track, both radii change alike in a turn on the spot, and the turn changes with them.
    """

    name = "speed_scale"
    odd = True
    summary = "the wheels' radius changes with their speed"
    about = About(
        equation="f_wheel = k abs(u) u for each wheel's rim speed u (power = square: k u^3); no yaw with a gyro",
        typical="0.1 to 3 % per m/s; square: by centrifugal force or drag, -3 % at full speed (an estimate)",
        source="tyre growth and slip, as in any text on tyres; sizes are engineering judgement",
        confused_with=("wheel_scale", "accel_slip", "wheelbase"),
        drive="the same straight slowly and fast",
    )

    k: float = parameter(
        "s/m", "growth of the radius per rim speed; square: at 1 m/s", low=-0.1, high=0.1, typical=0.01
    )
    heading: str = heading_choice()
    power: str = choice("how the growth depends on the rim speed", "linear", "square")

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f: a scale error that grows with the speed, per wheel."""
        if motion.track_m is None:
            scale = self._scale(motion.v)
            yaw = turning(self.heading, (2.0 if self.power == "linear" else 3.0) * scale * motion.omega)
            return TwistError(stacked(scale * motion.v, 0.0, yaw, motion.v), state)
        grown = Rims(*(self._scale(u) * u for u in rims_of(motion.v, motion.omega, motion.track_m)))
        return TwistError(body_of(grown, motion.track_m, self.heading), state)

    def _scale(self, u: Array) -> Array:
        """Return the relative change (n,) of the radius at rim speeds u (n,)."""
        return self.k * (np.abs(u) if self.power == "linear" else u**2)
