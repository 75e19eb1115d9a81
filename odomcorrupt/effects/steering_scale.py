"""Steering angle that differs from its sensor's by a factor."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

import numpy as np

from odomcorrupt.drive_types import STEERED
from odomcorrupt.effects.effect import About, Effect, Motion, State, TwistError, parameter, stacked
from odomcorrupt.effects.steering import axles_parameter, driven_choice, on_every_axle_distance, steepness, turned_front

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.geometry.se2 import Array

_SMALL = 1e-6


@dataclass(frozen=True, slots=True)
class SteeringScale(Effect):
    """f = (0, 0, e omega delta (1 + tan^2 delta) / tan delta): the bicycle's yaw rate with an angle delta (1 + e).

    With L the distance between the axles, tan delta = L omega / v; without it delta is assumed small, f = e omega.
    With driven = front the velocity (v, L omega) of the steered wheel, whose travel is measured, is turned by e delta
    instead. At small angles a relative error -e of L is equivalent. Rajamani, Vehicle Dynamics and Control, ch. 2
    (kinematic bicycle).
    """

    name = "steering_scale"
    summary = "the steering ratio of a car or tricycle is off, or the distance between its axles"
    drives = STEERED
    unsteered = "wheelbase"
    about = About(
        equation="f_yaw = e omega; more in tight curves where the angles are large (axles); "
        "f_along = -e delta axles omega if the steered wheel is driven",
        typical="1 to 10 %: a nominal steering ratio, a servo's gain, an axle distance taken from a drawing",
        source="Rajamani, Vehicle Dynamics and Control, chapter 2 (kinematic bicycle model)",
        confused_with=("turn_asymmetry", "side_slip", "speed_scale"),
        drive="curves of several radii to both sides, at two speeds",
    )

    e: float = parameter(
        "", "true over nominal steering angle, minus one; as well nominal over true axle distance, minus one",
        low=-0.8, high=4.0, typical=0.03,
    )  # fmt: skip
    axles: float = axles_parameter()
    driven: str = driven_choice()

    @classmethod
    def scan(cls, motions: Sequence[Motion]) -> tuple[Self, ...]:
        """Return the effect for small steering angles, and for large ones."""
        return on_every_axle_distance(cls(), motions)

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f: every turn has the same scale error."""
        if self.driven == "front" and self.axles:
            sideways = self.axles * motion.omega
            delta = np.arctan2(sideways * np.sign(motion.v), np.abs(motion.v))
            return TwistError(turned_front(motion.v, motion.omega, self.e * delta / self.axles, self.axles), state)
        return TwistError(stacked(0.0, 0.0, self.e * self._steep(motion) * motion.omega, motion.v), state)

    def _steep(self, motion: Motion) -> Array:
        """Return the factor (n,) delta (1 + tan^2 delta) / tan delta; 1 at small angles."""
        tangent = np.maximum(steepness(motion.v, motion.omega, self.axles), _SMALL)
        return np.arctan(tangent) * (1.0 + tangent**2) / tangent
