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
_STEERED = 4.0
"""Second difference over the mean beyond which it is no noise: steering begins or ends, or play is crossed."""


class _Linkage(NamedTuple):
    """State of the linkage.

    angle : last steering angle per distance between the axles, rad/m; None before the wheels rolled
    place : position of the linkage in its play, rad/m from the middle; for a true motion, in its elastic range
    side : 1 if the linkage pushes the wheels to the left, -1 to the right, 0 before it has moved
    last_s : end of the last increment, s
    reported : last angle that the odometry reported, rad/m
    change : of that angle, rad/m
    unseen : travel back from that side of which the samples show nothing, rad/m, by noise or between them
    noise : mean second difference of that angle times the root of the way: a noise of the heading, as of the ground
    """

    angle: float | None = None
    place: float = 0.0
    side: float = 0.0
    last_s: float = 0.0
    reported: float | None = None
    change: float = 0.0
    unseen: float = 0.0
    noise: float = 0.0


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
        rolls = np.abs(motion.v) >= CREEP_MPS
        if not rolls.any():
            return TwistError(stacked(0.0, 0.0, f, f), state)
        v, dt_s = motion.v[rolls], motion.dt_s[rolls]
        angle, root = steered(motion.omega[rolls] / v, self.axles), np.sqrt(np.abs(v * dt_s))
        changes = np.diff(angle, prepend=angle[0] if state.angle is None else state.angle)
        second = np.abs(np.diff(changes, prepend=state.change)) * root
        gains = np.minimum(dt_s / _AVERAGED_S, 1.0)
        place, side, noise, unseen = state.place, state.side, state.noise, state.unseen
        before, places, elastic = state.change, [], _ELASTIC * abs(self.play)
        rows = zip(*(column.tolist() for column in (changes, second, root, gains)), strict=True)
        for change, rough, per_way, gain in rows:
            reach = max(elastic, _RANGE * noise / per_way if per_way else 0.0)
            top = half + reach
            place = min(max(place + change, -top), top)
            if abs(place) == top:
                side, unseen = float(np.sign(place)), max(reach, abs(change), abs(before))
            before = change
            noise = _averaged(noise, rough, elastic * per_way, gain)
            places.append(_linkage(place, side, half, unseen))
        followed = angle - np.array(places)
        f[rolls] = sign * v * (curvature_at(followed, self.axles) - curvature_at(angle, self.axles))
        last = float(angle[-1])
        after = state._replace(
            angle=last, place=place, side=side, unseen=unseen, reported=last, change=float(changes[-1]), noise=noise
        )
        return TwistError(stacked(0.0, 0.0, f, f), after)

    def recorded(self, steps: Array, t_s: Array, track_m: float | None, state: State) -> Recorded:  # noqa: ARG002 - no wheels
        """Return the increments (n, 3) computed from the linkage that steers the wheels through these."""
        ds = steps[:, 0]
        true = steered(np.divide(steps[:, 2], ds, out=np.zeros_like(ds), where=ds != 0.0), self.axles)
        moved, elastic = true.copy(), _ELASTIC * self.play
        before, place, side, last_s, reported, change, _, noise = state
        for i, (way, angle, now_s) in enumerate(zip(ds.tolist(), true.tolist(), t_s.tolist(), strict=True)):
            dt_s, last_s = now_s - last_s, now_s
            if dt_s < 0.0:  # time was reset
                before, place, side = None, 0.0, 0.0
            if not dt_s > 0.0 or abs(way) < CREEP_MPS * dt_s:
                continue
            root = sqrt(abs(way))
            top = max(elastic, _RANGE / root * noise)
            place = min(max(place + angle - (angle if before is None else before), -top), top)
            side, before = float(np.sign(place)) or side, angle
            # the noise is that of the reported angle, which correction knows
            earlier, moved[i] = reported, angle + 0.5 * self.play * side
            reported, last = float(moved[i]), change
            change = 0.0 if earlier is None else reported - earlier
            noise = _averaged(noise, abs(change - last) * root, elastic * root, min(dt_s / _AVERAGED_S, 1.0))
        turned = steps.copy()
        turned[:, 2] += (curvature_at(moved, self.axles) - curvature_at(true, self.axles)) * ds
        return Recorded(turned, _Linkage(before, place, side, last_s, reported, change, 0.0, noise))


def _averaged(noise: float, rough: float, least: float, gain: float) -> float:
    """Return the mean noise after a second difference, without those of steering; `least` ones always count."""
    return noise + gain * (min(rough, max(_STEERED * noise, least)) - noise)


def _linkage(place: float, side: float, half: float, unseen: float) -> float:
    """Return the linkage's place in its play on the way back from a side, of which `unseen` is not in its place."""
    if side and half:
        place = side * half + (place - side * half) / (1.0 - 0.5 * min(unseen / half, 1.0))
    return min(max(place, -half), half)
