"""Over which way the errors of a localisation fade, by likelihood.

Errors of a localisation depend on what it sees from a place: along the way they are alike for a metre or some, and in
the long run they stay as large as they are. Noise of the odometry adds up. Both are estimated together, for one length
after the other: how the difference grows with the way tells them apart.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.effects import registry
from odomcorrupt.errors import FitError
from odomcorrupt.study.estimate.intervals import memory_over
from odomcorrupt.study.estimate.noise_likelihood import NoiseLikelihood
from odomcorrupt.study.estimate.problem import pose_problem
from odomcorrupt.study.estimate.variance_components import VarianceComponents

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.study.estimate.config import Approach
    from odomcorrupt.study.estimate.problem import Problem
    from odomcorrupt.study.io.recording import Recording

__all__ = ["with_correlation_lengths"]

_LENGTHS_M = (0.0, 0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0, 5.6, 8.0)
_BESIDE = ("wheel_scale", "wheelbase", "unequal_wheels", "gyro_bias")
"""Free meanwhile: what a robot has wrong adds up over the way, too."""


def with_correlation_lengths(recordings: Sequence[Recording], approach: Approach) -> list[Recording]:
    """Return recordings of which each that has a localisation for a truth knows over which way its errors fade."""
    return [
        replace(r, truth_correlation_m=_length(r, approach))
        if r.localised and r.headed and r.truth.covariance is None and r.truth_correlation_m is None
        else r
        for r in recordings
    ]


def _length(recording: Recording, approach: Approach) -> float:
    """Return the length (m) of largest likelihood; 0 where the errors at two nodes are independent."""
    problem = pose_problem([recording], approach=approach)
    return max(_LENGTHS_M, key=lambda length: _likelihood(problem, length))


def _likelihood(problem: Problem, length_m: float) -> float:
    """Return the largest log likelihood (nats) of residuals if the truth's errors fade over a way."""
    nodes = replace(problem.nodes, memory=memory_over(problem.nodes.way_m, length_m))
    kinds = registry()
    columns = np.concatenate([problem.columns(kinds[name]()) for name in _BESIDE] + [problem.clock_columns()], axis=2)
    components = VarianceComponents(problem.approach.law, nodes, problem.steps)
    likelihood = NoiseLikelihood(nodes, components, columns, np.ones(len(nodes)))
    try:
        return likelihood.evaluate(likelihood.maximise(likelihood.initial_guess())).log_likelihood
    except FitError:
        return -np.inf
