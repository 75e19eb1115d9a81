"""Warnings about odometry and truth that look odd but may be intended."""

from __future__ import annotations

import re
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.errors import RecordingError
from odomcorrupt.geometry.se2 import between, wrap
from odomcorrupt.study.io.motion_windows import Look, moving, travel_of

if TYPE_CHECKING:
    from odomcorrupt.study.io.feedback import Feedback
    from odomcorrupt.study.io.raw_trajectory import Samples

_FUSED = re.compile(r"filter|fused|ekf|ukf|amcl|slam|locali[sz]ation|global")
_WORLD = frozenset({"map", "world", "earth", "utm"})
_SAME = 1e-6  # m and rad; steps that differ by less are equal
_SAME_M = 2e-3  # m and rad; paths that differ by less are the same
_MOVES = 1e-4
_MIN_STEPS = 10
_SHRINKS = 0.7  # ratio of successive variances
_MOSTLY, _NEARLY_ALL = 0.6, 0.9
"""Fractions of motions back and ahead along the heading that identify courses; an unrelated drive has one half."""


def check_identity(odometry: Samples, truth: Samples) -> list[str]:
    """Return a warning on a truth that mostly repeats or equals the odometry, or its turns; refuse a copy of it.

    A copy has the odometry's stamps or number of messages; exact poses of a simulator have another rate.

    Raises
    ------
    RecordingError
        If the truth is a copy of the odometry, or of its travel.
    """
    inside, origin = truth.within(odometry), int(odometry.stamps_ns[0])
    path = odometry.trajectory().at(truth.seconds_since(origin)[inside], origin)
    real = truth.trajectory().xyt[inside]
    step, own = between(real[:-1], real[1:]), between(path[:-1], path[1:])
    step[:, 2], own[:, 2] = wrap(step[:, 2]), wrap(own[:, 2])
    if not truth.headed:
        step, own = (np.linalg.norm(np.diff(x[:, :2], axis=0), axis=1)[:, None] for x in (real, path))
    moving = np.abs(own).max(axis=1) > _MOVES
    if moving.sum() < _MIN_STEPS:
        return []
    same = np.abs(step - own).max(axis=1)[moving] < (_SAME if truth.headed else 3.0 * _SAME)
    share = float(same.mean())
    apart = between(real[:1], real) - between(path[:1], path)
    apart[:, 2] = wrap(apart[:, 2])
    within = float(np.abs(apart).max()) < _SAME_M
    one, other = odometry.stamps_ns[odometry.within(truth)], truth.stamps_ns[truth.within(odometry)]
    copied = np.isin(other, one).mean() > 0.9 or abs(len(other) - len(one)) < 0.01 * len(one) + 2
    if (share > 0.99 or (share > 0.5 and within)) and copied:
        raise RecordingError(
            f"{truth.place}: repeats {odometry.name} ({np.sum(same)} of {len(same)} steps are equal): it is the "
            "same odometry; name a truth that does not come from it"
        )
    if within:
        what = "a simulation without errors of odometry, or a truth made from this odometry"
        return [f"{truth.name}: equals {odometry.name} to within {_SAME_M * 1e3:g} mm over the whole drive: {what}"]
    if share > 0.5:
        what = "localisation on top of it, or a simulation without noise"
        return [f"{truth.name}: {share:.0%} of its steps are those of the odometry: {what}"]
    if truth.headed:
        _check_travel(odometry, truth)
    if _FUSED.search(truth.name.lower()):
        what = "it is a localisation by its name, which may have used this odometry and repeat its errors"
        return [f"{truth.name}: {what}"]
    turning = np.abs(own[:, -1]) > _MOVES
    apart = np.abs(step - own)[turning]
    same = apart[:, -1] < _SAME
    if not truth.headed or len(same) < _MIN_STEPS or same.mean() <= 0.5 or apart[:, :2].max(axis=1).mean() <= _SAME:
        return []
    what = "they were made from it, so that errors of heading cannot be seen"
    return [f"{truth.name}: {same.mean():.0%} of its headings turn exactly as the odometry does: {what}"]


_WINDOW_S = 0.5
_LAG_STEPS_S = (1.0, 0.02, 0.002, 0.0002)
"""Largest lag of a copied travel, and steps of the search for it."""
_NO_SENSOR_M, _NO_SENSOR = 1e-4, 5e-4
"""Usual difference of travel in half a second, m and relative to the travel, that no sensor reaches: in 15 recordings
by others it is 0.2 mm and more."""
_ROUGH_M, _AS_ROUGH = 1e-6, 0.3
"""Noise of odometry's steps, m, of which less is rounding of a smooth simulation; that of the truth relative to it."""


def _check_travel(odometry: Samples, truth: Samples) -> None:
    """Refuse a truth whose travel is the odometry's with its noise, at whatever lag and rate.

    Filters that take speed from the wheels and heading from a gyro have slip, ticks and noise of the wheels in their
    travel. Exact poses of a simulator may agree as well, but they are smooth where the odometry has ticks.
    """
    if truth.covariance is not None or truth.relative:
        return
    own, real = (travel_of(path, int(odometry.stamps_ns[0])) for path in (odometry, truth))
    steps_m = [np.diff(path.sums[:, 0]) for path in (own, real)]
    rough_m, truly_m = (float(np.median(np.abs(np.diff(x, n=2)[moving(x)[2:]]))) / np.sqrt(20.0) for x in steps_m)
    if rough_m < _ROUGH_M or truly_m < _AS_ROUGH * rough_m:
        return
    first, last = max(own.t_s[0] + 1.0, real.t_s[0]), min(own.t_s[-1] - 1.0 - _WINDOW_S, real.t_s[-1])
    starts = np.arange(first, last, _WINDOW_S)
    own_m = own.within(starts, _WINDOW_S)[:, 0]
    starts, own_m = starts[moving(own_m)], own_m[moving(own_m)]
    if len(starts) < 2 * _MIN_STEPS:
        return

    def off_m(lag_s: float) -> float:
        return float(np.median(np.abs(real.within(starts + lag_s, _WINDOW_S)[:, 0] - own_m)))

    lag_s = 0.0
    for reach_s, step_s in pairwise(_LAG_STEPS_S):
        lag_s = min(np.arange(lag_s - reach_s, lag_s + reach_s, step_s).tolist(), key=off_m)
    found_m, gone_m = off_m(lag_s), float(np.median(np.abs(own_m)))
    if found_m < min(_NO_SENSOR_M, _NO_SENSOR * gone_m):
        raise RecordingError(
            f"{truth.place}: repeats the travel of {odometry.name} with its noise and slip (usually to "
            f"{found_m * 1e3:.2g} mm in {gone_m * 1e3:.0f}): a filter that takes its speed from these wheels, so that "
            "errors of travel cannot be seen; name a truth that does not come from them"
        )


def without_course(odometry: Samples, truth: Samples) -> Samples:
    """Return the truth without headings if these are the direction of travel.

    A receiver with one antenna reports its course over ground: reversed when backing up, and arbitrary at rest.
    """
    if not truth.headed or truth.relative:
        return truth
    here, there, (starts, others) = Look((odometry, truth)).motions
    forwards = there[:, 0] > 0.5 * np.abs(here[:, 0])
    back, ahead = (forwards[moving(here[:, 0], side)] for side in (-1, 1))
    ahead_m, aside_m, _ = np.abs(there).sum(axis=0)
    enough = min(len(back), len(ahead)) >= 2 * _MIN_STEPS and aside_m < 0.5 * ahead_m
    if not enough or back.mean() <= _MOSTLY or ahead.mean() <= _NEARLY_ALL:
        return truth
    # a course turns by half a turn, unlike the odometry's heading, around where that begins or ends to back up
    origin, moves = int(odometry.stamps_ns[0]), moving(here[:, 0])
    turned = [
        np.interp(t_s[moves], path.seconds_since(origin), np.unwrap(path.yaw_rad))
        for path, t_s in ((odometry, starts), (truth, others))
    ]
    around = np.flatnonzero(np.diff(here[moves, 0] < 0.0)) + np.array(((-_MIN_STEPS,), (_MIN_STEPS,)))
    before, after = (turned[1] - turned[0])[np.clip(around, 0, moves.sum() - 1)]
    if np.median(np.cos(after - before)) > 0.0:
        return truth
    return truth.without_headings().noted(
        "its headings point to where it moves, also when the robot backs up: taken as positions alone"
    )


def filter_warnings(odometry: Samples, feedback: Feedback) -> list[str]:
    """Return a warning if the odometry appears to be corrected by other sensors, as no motion model describes."""
    signs = []
    last = odometry.frame.rsplit("/", 1)[-1]
    if last in _WORLD:
        signs.append(f"its frame is {odometry.frame}")
    if _FUSED.search(odometry.name.lower()):
        signs.append("its name")
    if len(own := odometry.variance_m2) >= _MIN_STEPS and (shrinks := int(np.sum(own[1:] < _SHRINKS * own[:-1]))):
        signs.append(f"its covariance shrinks {shrinks} times")
    if feedback.per_s:
        faded = f"fade by {1.0 - np.exp(-feedback.per_s):.0%} a second, as those of"
        compass = f"of heading {faded} a compass or of a yaw error that depends on the heading"
        signs.append(f"its errors {compass if feedback.of_headings else f'{faded} a filter that receives poses'}")
    if not signs:
        return []
    what = "a motion model describes odometry that no other sensor has corrected"
    if feedback.corrections:
        what = (
            f"{feedback.corrections} sudden steps towards such poses were removed, as `correct` does with the model; "
            "the learned model is that of the odometry between them, including lags of its filter"
        )
    elif feedback.per_s:
        what += (
            ": of scales, biases and noise only the part that persists after a correction can be estimated (clocks and "
            "lags are unaffected); record wheel-only odometry for the rest"
        )
    return [f"{odometry.name}: looks like a filter's output, not like wheel odometry ({', '.join(signs)}); {what}"]
