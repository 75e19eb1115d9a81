"""Correlation length of a localisation's errors along the path, by maximum likelihood.

The errors of a localisation depend on the view from a place: they are correlated over a metre or so of path and do not
grow with it. Noise of the odometry accumulates. Both are estimated together for each candidate length; they differ in
how odometry minus truth grows with the path.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from odomcorrupt.effects import registry
from odomcorrupt.study.estimate.intervals import memory_over
from odomcorrupt.study.estimate.noise_likelihood import NoiseFit, NoiseLikelihood
from odomcorrupt.study.estimate.pose_steps import with_pose_steps
from odomcorrupt.study.estimate.problem import pose_problem
from odomcorrupt.study.estimate.truth_field import field_of
from odomcorrupt.study.estimate.variance_components import VarianceComponents

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.estimate.config import Approach
    from odomcorrupt.study.estimate.problem import Problem
    from odomcorrupt.study.io.recording import Recording

__all__ = ["with_correlation_lengths"]

_LENGTHS_M = (0.0, 0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0, 5.6, 8.0)
_USUAL_M, _SPREAD = 1.5, 0.7
"""Prior of the correlation length: median, and standard deviation of its logarithm. The correlation of particle
filters (simulated as for `noise_likelihood`) falls to 1/e after 1 to 2.5 m, that of scan matchers sooner."""
_NONE_M = 0.3
"""Length that stands for uncorrelated errors in the prior; the poses compared are at least 1.5 m of driving apart."""
_FIELD_NATS = 2.0
"""Log-likelihood gain that a spatial field, with two more parameters, needs over a process along the path."""
_BESIDE = ("wheel_scale", "wheelbase", "unequal_wheels", "gyro_bias")
"""Effects that are free during the estimate: systematic odometry errors accumulate along the path, too."""


def with_correlation_lengths(recordings: Sequence[Recording], approach: Approach) -> list[Recording]:
    """Return the recordings; those with a localisation as their truth get its correlation length or spatial field.

    Single events are left out of the estimate and of all intervals, see `pose_steps`.
    """
    return [
        _with_own(with_pose_steps(r), approach)
        if r.localised and r.headed and r.truth.covariance is None and r.truth_correlation_m is None
        else r
        for r in recordings
    ]


def _with_own(recording: Recording, approach: Approach) -> Recording:
    """Return a recording with the most likely correlation length, and a spatial field if that is more likely still."""
    problem = pose_problem([recording], approach=approach)
    kinds = registry()
    columns = np.concatenate([problem.columns(kinds[name]()) for name in _BESIDE] + [problem.clock_columns()], axis=2)
    components = VarianceComponents(approach.law, problem.nodes, problem.steps)
    fits = {length: _fitted(problem, components, columns, length) for length in _LENGTHS_M}
    length, (best, nats_of_process) = max(fits.items(), key=lambda one: one[1].nats)
    q = problem.nodes.covariance(approach.law, best.coefficients, problem.steps)
    field, nats = field_of(problem, q, columns)
    constant = 1.5 * len(problem.nodes) * float(np.log(2.0 * np.pi))
    more = nats - constant - nats_of_process
    return replace(recording, truth_correlation_m=length, truth_field=field if more > _FIELD_NATS else None)


class _Fitted(NamedTuple):
    """A noise fit and its log posterior in nats, with the priors of a localisation's errors."""

    noise: NoiseFit
    nats: float


def _fitted(problem: Problem, components: VarianceComponents, columns: Array, length_m: float) -> _Fitted:
    """Return the maximum-likelihood noise for a given correlation length of the truth's errors along the path."""
    nodes = replace(problem.nodes, memory=memory_over(problem.nodes.way_m, length_m))
    likelihood = NoiseLikelihood(nodes, components, columns, np.ones(len(nodes)))
    best = likelihood.evaluate(likelihood.maximise(likelihood.initial_guess()))
    apart = np.log(max(length_m, _NONE_M) / _USUAL_M) / _SPREAD
    return _Fitted(best, likelihood.posterior(best) - 0.5 * float(apart) ** 2)
