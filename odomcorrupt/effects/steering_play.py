"""Play in the steering: between left and right the wheels keep their angle while the steering sensor moves."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple, Self

import numpy as np

from odomcorrupt.drive_types import STEERED
from odomcorrupt.effects.effect import About, Effect, Motion, Recorded, State, TwistError, parameter, stacked
from odomcorrupt.effects.steering import CREEP_MPS, axles_parameter, curvature_at, on_every_axle_distance, steered

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.random import Generator

    from odomcorrupt.geometry.se2 import Array

_ELASTIC = 0.05
"""Elastic range before the play opens, as a fraction of the play, so that jitter of the steering does not cross it."""


class _Linkage(NamedTuple):
    """State of the linkage.

    angle : last steering angle per distance between the axles, rad/m; None before the wheels rolled
    place : position of the linkage in its play, rad/m from the middle; for a true motion, in its elastic range
    side : 1 if the linkage pushes the wheels to the left, -1 to the right, 0 before it has moved
    last_s : end of the last increment, s
    """

    angle: float | None = None
    place: float = 0.0
    side: float = 0.0
    last_s: float = 0.0


@dataclass(frozen=True, slots=True)
class SteeringPlay(Effect):
    """f = (0, 0, v tan(L delta) / L - omega): delta is the play operator applied to the odometry's atan(L omega / v) / L.

    With L the distance between the axles; without it angles are assumed small, and the play is one of the curvature. The wheels keep their angle until the linkage, which begins in the middle of the play, has crossed it. Corruption
    crosses the play at once when the clean robot begins to steer back.
    """

    name = "steering_play"
    odd = True
    layer = "record"
    summary = "the steering linkage of a car or tricycle has play: its wheels follow only when it is crossed"
    drives = STEERED
    about = About(
        equation="f_yaw = v k - omega; the steering angle of the true curvature k held within +- play / 2 of the "
        "odometry's; play as the curvature of small angles",
        typical="0.5 to 3 degrees at the wheels: 0.03 to 0.2 rad/m on 0.3 m between the axles (an estimate)",
        source="the play operator, as in Visintin 1994, Differential Models of Hysteresis; Rajamani, Vehicle Dynamics "
        "and Control, chapter 2 (kinematic bicycle model)",
        confused_with=("steering_lag", "steering_offset", "turn_asymmetry"),
        drive="curves to both sides in turns, fast and slowly, and straights that begin from either side",
    )

    play: float = parameter(
        "rad/m", "range of the odometry's steering angle that moves nothing, per distance between the axles", low=0.0, high=1.0, typical=0.05, step=0.02
    )
    axles: float = axles_parameter()

    @classmethod
    def scan(cls, motions: Sequence[Motion]) -> tuple[Self, ...]:
        """Return the effect for small steering angles, and for large ones."""
        return on_every_axle_distance(cls(), motions)

    def start(self, rng: Generator) -> State:  # noqa: ARG002 - nothing is drawn
        """Return a linkage in the middle of its play."""
        return _Linkage()

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f: the turn lost in the play; for play < 0, needed for slopes, the opposite."""
        f, sign, half = np.zeros(len(motion)), float(np.sign(self.play)), 0.5 * abs(self.play)
        top = half + _ELASTIC * abs(self.play)
        before, place = state.angle, state.place
        for i, (v, omega) in enumerate(zip(motion.v.tolist(), motion.omega.tolist(), strict=True)):
            if abs(v) < CREEP_MPS:
                continue
            angle = steered(omega / v, self.axles)
            place = min(max(place + angle - (angle if before is None else before), -top), top)
            followed = angle - min(max(place, -half), half)
            f[i], before = sign * v * (curvature_at(followed, self.axles) - curvature_at(angle, self.axles)), angle
        return TwistError(stacked(0.0, 0.0, f, f), state._replace(angle=before, place=place))

    def recorded(self, steps: Array, t_s: Array, track_m: float | None, state: State) -> Recorded:  # noqa: ARG002 - no wheels
        """Return the increments (n, 3) computed from the linkage that steers the wheels through these."""
        reported, top = steps.copy(), _ELASTIC * self.play
        before, place, side, last_s = state
        rows = zip(steps[:, 0].tolist(), steps[:, 2].tolist(), t_s.tolist(), strict=True)
        for i, (ds, turn, now_s) in enumerate(rows):
            dt_s, last_s = now_s - last_s, now_s
            if dt_s < 0.0:  # time was reset
                before, place, side = None, 0.0, 0.0
            if not dt_s > 0.0 or abs(ds) < CREEP_MPS * dt_s:
                continue
            true = steered(turn / ds, self.axles)
            place = min(max(place + true - (true if before is None else before), -top), top)
            side, before = float(np.sign(place)) or side, true
            moved = true + 0.5 * self.play * side
            reported[i, 2] += (curvature_at(moved, self.axles) - curvature_at(true, self.axles)) * ds
        return Recorded(reported, _Linkage(before, place, side, last_s))
