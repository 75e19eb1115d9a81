"""Correlation length of a localisation's errors along the path, by maximum likelihood.

The errors of a localisation depend on the view from a place: they are correlated over a metre or so of path and do not
grow with it. Noise of the odometry accumulates. Both are estimated together for each candidate length; they differ in
how odometry minus truth grows with the path.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.stats import chi2

from odomcorrupt.effects import effect_from_values, registry
from odomcorrupt.study.estimate.clocks import SETUP_LEVEL
from odomcorrupt.study.estimate.intervals import memory_over
from odomcorrupt.study.estimate.noise_likelihood import NoiseLikelihood, VarianceComponents
from odomcorrupt.study.estimate.problem import pose_problem
from odomcorrupt.study.estimate.regressors import drives_sideways

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.estimate.config import Approach
    from odomcorrupt.study.estimate.problem import Problem
    from odomcorrupt.study.io.recording import Recording

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

    A constant error of its headings is removed first.
    """
    return [
        _with_own(_with_right_headings(r, approach), approach)
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
