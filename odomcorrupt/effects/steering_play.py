"""Play in the steering: between left and right the wheels keep their angle while the steering sensor moves."""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt
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
_AVERAGED_S = 2.0
"""Time over which the noise of the steering angle is averaged."""
_RANGE = 4.0
"""Range of a noise over its mean second difference: 8 standard deviations, and the mean is 1.95 of them."""


class _Noise:
    """Noise of single intervals in the odometry's steering angle, which must not cross the play.

    It is taken to be one of the heading that grows with the root of the way, as that of the ground.
    """

    __slots__ = ("_angle", "_change", "_mean")

    def __init__(self, angle: float | None = None, change: float = 0.0, mean: float = 0.0) -> None:
        self._angle, self._change, self._mean = angle, change, mean

    @property
    def state(self) -> tuple[float | None, float, float]:
        """The last angle and its change, rad/m, and the mean second difference times the root of the way."""
        return self._angle, self._change, self._mean

    def reach(self, way_m: float) -> float:
        """Return the angle, rad/m, by which noise alone steers back over an interval of this way."""
        return _RANGE * self._mean / sqrt(abs(way_m)) if way_m else 0.0

    def add(self, angle: float, way_m: float, dt_s: float) -> None:
        """Take in the angle, rad/m, of the next interval."""
        change = 0.0 if self._angle is None else angle - self._angle
        second = abs(change - self._change) * sqrt(abs(way_m))
        self._mean += min(dt_s / _AVERAGED_S, 1.0) * (second - self._mean)
        self._angle, self._change = angle, change


class _Linkage(NamedTuple):
    """State of the linkage.

    angle : last steering angle per distance between the axles, rad/m; None before the wheels rolled
    place : position of the linkage in its play, rad/m from the middle; for a true motion, in its elastic range
    side : 1 if the linkage pushes the wheels to the left, -1 to the right, 0 before it has moved
    last_s : end of the last increment, s
    noise : arguments of `_Noise`
    """

    angle: float | None = None
    place: float = 0.0
    side: float = 0.0
    last_s: float = 0.0
    noise: tuple[float | None, float, float] = (None, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class SteeringPlay(Effect):
    """f = (0, 0, v tan(L delta) / L - omega): the wheels' angle L delta follows the odometry's through the play.

    With L the distance between the axles; without it angles are assumed small. The wheels keep their angle until the
    linkage, which begins in the middle of the play, has crossed it. Corruption crosses the play at once when the clean
    robot begins to steer back by more than the noise of its path.
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
        "rad/m",
        "range of the odometry's steering angle that moves nothing, per distance between the axles",
        low=0.0,
        high=1.0,
        typical=0.05,
        step=0.02,
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
        before, place, noise = state.angle, state.place, _Noise(*state.noise)
        rows = zip(motion.v.tolist(), motion.omega.tolist(), motion.dt_s.tolist(), strict=True)
        for i, (v, omega, dt_s) in enumerate(rows):
            if abs(v) < CREEP_MPS:
                continue
            angle = steered(omega / v, self.axles)
            top = half + max(_ELASTIC * 2.0 * half, noise.reach(v * dt_s))
            place = min(max(place + angle - (angle if before is None else before), -top), top)
            followed = angle - min(max(place, -half), half)
            f[i], before = sign * v * (curvature_at(followed, self.axles) - curvature_at(angle, self.axles)), angle
            noise.add(angle, v * dt_s, dt_s)
        after = state._replace(angle=before, place=place, noise=noise.state)
        return TwistError(stacked(0.0, 0.0, f, f), after)

    def recorded(self, steps: Array, t_s: Array, track_m: float | None, state: State) -> Recorded:  # noqa: ARG002 - no wheels
        """Return the increments (n, 3) computed from the linkage that steers the wheels through these."""
        reported = steps.copy()
        before, place, side, last_s, last_noise = state
        noise = _Noise(*last_noise)
        rows = zip(steps[:, 0].tolist(), steps[:, 2].tolist(), t_s.tolist(), strict=True)
        for i, (ds, turn, now_s) in enumerate(rows):
            dt_s, last_s = now_s - last_s, now_s
            if dt_s < 0.0:  # time was reset
                before, place, side = None, 0.0, 0.0
            if not dt_s > 0.0 or abs(ds) < CREEP_MPS * dt_s:
                continue
            true = steered(turn / ds, self.axles)
            top = max(_ELASTIC * self.play, noise.reach(ds))
            place = min(max(place + true - (true if before is None else before), -top), top)
            side, before = float(np.sign(place)) or side, true
            moved = true + 0.5 * self.play * side
            reported[i, 2] += (curvature_at(moved, self.axles) - curvature_at(true, self.axles)) * ds
            noise.add(moved, ds, dt_s)  # of the reported angle, which correction knows
        return Recorded(reported, _Linkage(before, place, side, last_s, noise.state))
