"""Over which way the errors of a localisation fade, by likelihood.

Errors of a localisation depend on what it sees from a place: along the way they are alike for a metre or some, and in
the long run they stay as large as they are. Noise of the odometry adds up. Both are estimated together, for one length
after the other: how the difference grows with the way tells them apart.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from odomcorrupt.effects import registry
from odomcorrupt.study.estimate.intervals import memory_over
from odomcorrupt.study.estimate.noise_likelihood import NoiseFit, NoiseLikelihood
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
"""Length over which errors of a localisation are alike: usual, and the standard deviation of its logarithm. Of particle
filters (simulated as for `noise_likelihood`) the correlation falls to 1/e after 1 to 2.5 m, of scan matchers sooner."""
_NONE_M = 0.3
"""What no correlation between poses at least 1.5 m of driving apart counts as."""
_FIELD_NATS = 2.0
"""By how much a field by place, which has two numbers more, has to explain the errors better than a process."""
_BESIDE = ("wheel_scale", "wheelbase", "unequal_wheels", "gyro_bias")
"""Free meanwhile: what a robot has wrong adds up over the way, too."""


def with_correlation_lengths(recordings: Sequence[Recording], approach: Approach) -> list[Recording]:
    """Return recordings of which each that has a localisation for a truth knows how its errors are alike."""
    return [
        _with_own(r, approach)
        if r.localised and r.headed and r.truth.covariance is None and r.truth_correlation_m is None
        else r
        for r in recordings
    ]


def _with_own(recording: Recording, approach: Approach) -> Recording:
    """Return a recording with its likeliest correlation length, and a field by place where that explains more."""
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
    """A fit of the noise, and how likely it is with the priors of a localisation's errors, nats."""

    noise: NoiseFit
    nats: float


def _fitted(problem: Problem, components: VarianceComponents, columns: Array, length_m: float) -> _Fitted:
    """Return the fit of the noise of largest likelihood if the truth's errors fade over a way."""
    nodes = replace(problem.nodes, memory=memory_over(problem.nodes.way_m, length_m))
    likelihood = NoiseLikelihood(nodes, components, columns, np.ones(len(nodes)))
    best = likelihood.evaluate(likelihood.maximise(likelihood.initial_guess()))
    apart = np.log(max(length_m, _NONE_M) / _USUAL_M) / _SPREAD
    return _Fitted(best, likelihood.posterior(best) - 0.5 * float(apart) ** 2)
