"""Correlation length of a localisation's errors along the path, by maximum likelihood.

The errors of a localisation depend on the view from a place: they are correlated over a metre or so of path and do not
grow with it. Noise of the odometry accumulates. Both are estimated together for each candidate length; they differ in
how odometry minus truth grows with the path.

Lasting steps (a push, a lift) are found first. The poses before and after each moment are carried to that moment by the
odometry. The difference of their medians is the step at that moment. Medians suppress a localisation's errors
(centimetres) and its short jumps. A step is compared with those at all other moments of the drive, which contain only
errors of odometry and localisation.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.stats import chi2, f

from odomcorrupt.effects import effect_from_values, registry
from odomcorrupt.geometry.se2 import between, compose, wrap
from odomcorrupt.study.estimate.clocks import SETUP_LEVEL
from odomcorrupt.study.estimate.intervals import memory_over
from odomcorrupt.study.estimate.noise_likelihood import NoiseLikelihood, VarianceComponents
from odomcorrupt.study.estimate.problem import pose_problem
from odomcorrupt.study.estimate.regressors import drives_sideways
from odomcorrupt.study.io.recording import PoseStep

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.estimate.config import Approach
    from odomcorrupt.study.estimate.problem import Problem
    from odomcorrupt.study.io.recording import Recording

_SHORT_S, _LONG_S = 8.0, 12.0
"""Durations of the poses before and after a step, seconds. Moments are searched with the short one. A step found there
has to be significant for the long one, too, and of about the same size: drift grows with the duration, and a short jump
of the localisation disappears."""
_REMAINS = 0.75
"""Least part of the step with short sides that the one with long sides confirms; 0.9 and more of pushes, 0.3 to 0.65 of
short jumps (simulated)."""
_LASTS_S, _LONGEST_S = 4.0, 20.0
"""Time allowed for an event, and largest time without poses during it, seconds."""
_FEW, _MOST = 5, 5
"""Least number of poses on each side; largest number of steps in a drive, because more are not single events."""
_LEVEL = 0.01
"""Probability of reporting any step in a drive without one; and level of the second test, of one moment."""
_EFFICIENCY = 0.37
"""Efficiency of the median absolute value as an estimate of the standard deviation of normal data."""
_UPPER = 0.9
"""Quantile that, besides the median, determines the usual size, so that long tails enlarge it."""
_EDGE = 0.25
"""Largest fraction of a step that may have happened at the last pose before it (1 minus this: at the first after)."""
_ROUNDS, _HUBER = 20, 1.5
_LEAST, _LEAST_SPREAD = 1e-6, 1e-3
"""Least usual size, m or rad, and least ratio of its quantiles to those of normal data: only rounding errors are left
if simulated odometry equals its localisation."""


class _Steps(NamedTuple):
    """Steps at n moments: times (n,), truth minus odometry (n, 3), usual size (3,), p-values (n,) of single moments."""

    start_s: Array
    apart: Array
    usual: Array
    p: Array


def with_pose_steps(recording: Recording) -> Recording:
    """Return a recording with the lasting steps between its odometry and its localisation, in order of time."""
    inside = recording.within_odometry
    t_s, truth = recording.truth_s[inside], recording.truth.xyt[inside]
    own = recording.odometry.at(t_s, recording.origin_ns)
    found: list[PoseStep] = []
    while len(found) <= _MOST:
        if (step := _largest(t_s, truth, own, found)) is None:
            return replace(recording, pose_steps=tuple(sorted(found, key=lambda one: one.start_s)))
        found.append(step)
    return recording


def _largest(t_s: Array, truth: Array, own: Array, found: list[PoseStep]) -> PoseStep | None:
    """Return the most significant step apart from those already found; None if there is none."""
    short, long = (_steps(t_s, truth, own, side_s, found) for side_s in (_SHORT_S, _LONG_S))
    if not (len(short.start_s) and len(long.start_s)):
        return None
    nearest = np.abs(long.start_s[:, None] - short.start_s).argmin(axis=1)
    moments = float(t_s[-1] - t_s[0]) / _LASTS_S
    chance = np.maximum(long.p, moments * short.p[nearest])
    one, other = short.apart[nearest] / short.usual, long.apart / short.usual
    chance[np.sum(one * other, axis=1) < _REMAINS * np.sum(one**2, axis=1)] = 1.0
    best = int(np.argmin(chance))
    if chance[best] > _LEVEL:
        return None
    apart = long.apart[best]
    before, after = _edges(t_s, truth, own, float(long.start_s[best]), long.usual, apart)
    # Poses after the step were carried past it, to the pose `at`. If the robot was turned, its description depends on
    # the place, and that at the middle of its two edges is meant.
    at = own[np.searchsorted(t_s, long.start_s[best])]
    way = between(at, compose(own[before], between(own[before], own[after]) / 2.0))
    apart = np.append(between(way, compose(apart, way))[:2], apart[2])
    return PoseStep(
        start_s=float(t_s[before]),
        end_s=float(t_s[after]),
        apart=(float(apart[0]), float(apart[1]), float(apart[2])),
        place_xy=(float(truth[before, 0]), float(truth[before, 1])),
    )


def _edges(t_s: Array, truth: Array, own: Array, start_s: float, usual: Array, apart: Array) -> tuple[int, int]:
    """Return the indices of the last pose before a step and of the first pose after it, see `_EDGE`."""
    near = np.flatnonzero(np.abs(t_s - start_s - _LASTS_S / 2.0) < _LASTS_S / 2.0 + _SHORT_S)
    at = int(np.searchsorted(t_s, start_s))
    before = _carried(truth[near][t_s[near] <= start_s], own[near][t_s[near] <= start_s], own[at])
    moved = between(before, compose(truth[near], between(own[near], np.broadcast_to(own[at], own[near].shape))))
    moved[:, 2] = wrap(moved[:, 2])
    passed = (moved / usual) @ (apart / usual) / np.sum((apart / usual) ** 2)
    middle = min(int(np.argmin(np.cumsum(passed - 0.5))), len(near) - 2)
    first = np.flatnonzero(passed[: middle + 1] < _EDGE)
    last = np.flatnonzero(passed[middle + 1 :] > 1.0 - _EDGE)
    return int(near[first[-1] if len(first) else 0]), int(near[middle + 1 + last[0] if len(last) else -1])


def _steps(t_s: Array, truth: Array, own: Array, side_s: float, found: list[PoseStep]) -> _Steps:
    """Return the steps at each pose with enough poses on both sides, away from steps already found."""
    rows, motions = [], []
    for i in range(len(t_s)):
        j = max(int(np.searchsorted(t_s, t_s[i] + _LASTS_S)), i + 1)
        first = int(np.searchsorted(t_s, t_s[i] - side_s))
        if j >= len(t_s) or t_s[j] - t_s[i] > _LONGEST_S:
            continue
        last = int(np.searchsorted(t_s, t_s[j] + side_s, side="right"))
        if i + 1 - first < _FEW or last - j < _FEW or t_s[i] - side_s < t_s[0] or t_s[j] + side_s > t_s[-1]:
            continue
        if any(t_s[first] < one.end_s and t_s[last - 1] > one.start_s for one in found):
            continue
        sides = np.arange(first, i + 1), np.arange(j, last)
        before, after = (_carried(truth[side], own[side], own[i]) for side in sides)
        here, there = (between(own[i], own[side]).mean(axis=0) for side in sides)
        apart = between(before, after)
        apart[2] = wrap(apart[2])
        rows.append((t_s[i], *apart))
        motions.append((*(there - here), t_s[sides[1]].mean() - t_s[sides[0]].mean()))
    if len(rows) < 2 * _FEW:
        return _Steps(np.zeros(0), np.zeros((0, 3)), np.ones(3), np.zeros(0))
    table = np.array(rows)
    rest = _without_drift(table[:, 1:], np.array(motions))
    usual = np.maximum(1.4826 * np.median(np.abs(rest), axis=0), _LEAST)
    square = np.sum((rest / usual) ** 2, axis=1)
    spread = max(_LEAST_SPREAD, *(float(np.quantile(square, q) / chi2.ppf(q, 3)) for q in (0.5, _UPPER)))
    searched_s = float(t_s[-1] - t_s[0])
    p = f.sf(square / spread / 3.0, 3.0, _EFFICIENCY * searched_s / (side_s + _LASTS_S))
    return _Steps(table[:, 0], rest, usual, p)


def _carried(truth: Array, own: Array, to: Array) -> Array:
    """Return the median pose (3,) of truth poses (n, 3), each carried to the odometry pose `to` by the odometry."""
    poses = compose(truth, between(own, np.broadcast_to(to, own.shape)))
    poses[:, 2] = poses[0, 2] + wrap(poses[:, 2] - poses[0, 2])
    return np.median(poses, axis=0)


def _without_drift(apart: Array, motions: Array) -> Array:
    """Return steps (n, 3) minus their robust (Huber) regression on the motion and the time between both sides."""
    rest = np.empty_like(apart)
    for c in range(3):
        weights: NDArray[np.float64] = np.ones(len(apart))
        for _ in range(_ROUNDS):
            root = np.sqrt(weights)
            theta = np.linalg.lstsq(motions * root[:, None], apart[:, c] * root, rcond=None)[0]
            rest[:, c] = apart[:, c] - motions @ theta
            usual = 1.4826 * np.median(np.abs(rest[:, c])) + 1e-9
            weights = 1.0 / np.maximum(1.0, np.abs(rest[:, c]) / (_HUBER * usual))
    return rest


_LENGTHS_M = (0.0, 0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0, 5.6, 8.0)
_USUAL_M, _SPREAD = 1.5, 0.7
"""Prior of the correlation length: median, and standard deviation of its logarithm. The correlation of particle
filters (simulated as for `noise_likelihood`) falls to 1/e after 1 to 2.5 m, that of scan matchers sooner."""
_NONE_M = 0.3
"""Length that stands for uncorrelated errors in the prior; the poses compared are at least 1.5 m of driving apart."""
_BESIDE = ("wheel_scale", "wheelbase", "unequal_wheels", "gyro_bias")
"""Effects that are free during the estimate: systematic odometry errors accumulate along the path, too."""
_ASKEW = ("icr_shift", "side_slip")
"""Effects, besides `slope`, that resemble a constant error of the headings, free during its test."""


def with_correlation_lengths(recordings: Sequence[Recording], approach: Approach) -> list[Recording]:
    """Return the recordings; those with a localisation as their truth get its correlation length.

    Single events are left out of the estimate and of all intervals, see `pose_steps`. A constant error of its headings
    is removed first.
    """
    return [
        _with_own(_with_right_headings(with_pose_steps(r), approach), approach)
        if r.localised and r.headed and r.truth.covariance is None and r.truth_correlation_m is None
        else r
        for r in recordings
    ]


def _with_right_headings(recording: Recording, approach: Approach) -> Recording:
    """Return a recording without a significant constant error of its truth's headings against its own positions.

    It comes from a laser mounted askew, or from drift of a map. Each window of an error after 10 s begins with it.
    """
    problem = pose_problem([recording], approach=approach)
    if not recording.of_base or drives_sideways(problem.motions):
        return recording  # estimated as a mounting yaw, or like an effect of such robots
    kinds = registry()
    askew = [kinds["mount_yaw"](), *(kinds[name]() for name in _ASKEW)]
    askew += [effect_from_values("slope", {"direction": angle}) for angle in (0.0, np.pi / 2.0)]
    columns = np.concatenate([problem.columns(effect) for effect in askew] + [_columns_beside(problem)], axis=2)
    components = VarianceComponents(approach.law, problem.intervals, problem.steps)
    likelihood = _likelihood(problem, components, columns, _USUAL_M)
    noise = likelihood.maximise(likelihood.initial_guess())
    yaw_rad, error_rad = float(noise.theta[0]), float(np.sqrt(noise.theta_covariance[0, 0]))
    if not yaw_rad**2 > chi2.isf(SETUP_LEVEL, 1) * error_rad**2:
        return recording
    said = (
        f"headings of the truth are {np.degrees(yaw_rad):.2f} +- {np.degrees(error_rad):.2f} deg off the direction of "
        "its own positions (a laser mounted askew, or drift of the map): corrected"
    )
    truth = replace(recording.truth, xyt=recording.truth.xyt - (0.0, 0.0, yaw_rad))
    return replace(recording, truth=truth, notes=(*recording.notes, said))


def _columns_beside(problem: Problem) -> Array:
    """Return the columns (K, 3, q) of the effects `_BESIDE` and of the clocks."""
    kinds = registry()
    return np.concatenate([problem.columns(kinds[name]()) for name in _BESIDE] + [problem.clock_columns()], axis=2)


def _with_own(recording: Recording, approach: Approach) -> Recording:
    """Return a recording with the most likely correlation length."""
    problem = pose_problem([recording], approach=approach)
    columns = _columns_beside(problem)
    components = VarianceComponents(approach.law, problem.intervals, problem.steps)
    nats: dict[float, float] = {}
    for length_m in _LENGTHS_M:
        likelihood = _likelihood(problem, components, columns, length_m)
        apart = np.log(max(length_m, _NONE_M) / _USUAL_M) / _SPREAD
        best = likelihood.maximise(likelihood.initial_guess())
        nats[length_m] = likelihood.posterior(best) - 0.5 * float(apart) ** 2
    return replace(recording, truth_correlation_m=max(nats, key=nats.__getitem__))


def _likelihood(problem: Problem, components: VarianceComponents, columns: Array, length_m: float) -> NoiseLikelihood:
    """Return the likelihood of the noise for a given correlation length of the truth's errors along the path."""
    intervals = replace(problem.intervals, memory=memory_over(problem.intervals.way_m, length_m))
    return NoiseLikelihood(intervals, components, columns, np.ones(len(intervals)))
