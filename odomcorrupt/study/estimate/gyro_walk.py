"""Level of the random walk of a gyro's bias, where a gyro is the only truth.

It is a variance component, estimated by restricted maximum likelihood with a prior (Patterson & Thompson 1971,
Biometrika 58, 545). Wheels at rest do not turn, so the rests of a drive show the bias itself; in motion, the walk is
what varies slowly in the difference of wheels and gyro, beside effects of turns.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import eigh, orth

from odomcorrupt.effects import registry
from odomcorrupt.study.estimate.noise_likelihood import VarianceComponents, fit_noise
from odomcorrupt.study.estimate.problem import pose_problem
from odomcorrupt.study.estimate.truth_bias import SHARED, USUAL_WALK, bias_roots, bias_steps

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.study.estimate.config import Approach
    from odomcorrupt.study.io.recording import Recording

_WALKS = np.geomspace(3e-6, 3e-3, 121)
_SPREAD = 1.0
"""Standard deviation of the logarithm of the level, around `USUAL_WALK`: MEMS gyros have 1e-5 to 5e-4."""
_BESIDE = ("wheelbase", "unequal_wheels", "turn_asymmetry")
"""Effects that are free during the estimate."""


def with_bias_walks(recordings: Sequence[Recording], approach: Approach) -> list[Recording]:
    """Return the recordings; those with a gyro as their truth get the random walk of its bias."""
    return [r if r.positioned else replace(r, turn_bias_walk=_walk_of(r, approach)) for r in recordings]


def _walk_of(recording: Recording, approach: Approach) -> float:
    """Return the most likely random walk of the bias of a recording's gyro, rad/s/sqrt(s)."""
    problem, kinds = pose_problem([recording], approach=approach), registry()
    start, steps = bias_steps(problem)
    effects = [problem.columns(kinds[name]()) for name in _BESIDE]
    beside = np.concatenate((*effects, bias_roots(problem)[:, :, :SHARED], start), axis=2)
    components = VarianceComponents(approach.law, problem.intervals, problem.steps)
    # with the walk free, it is not fitted as noise of each interval
    white = fit_noise(
        problem.intervals, components, np.concatenate((beside, steps), axis=2), headings=problem.headings
    ).whitener
    known = orth(white.whiten(beside))
    root, residual = (x - known @ (known.T @ x) for x in map(white.whiten, (steps, problem.intervals.residual)))
    strength, turned = eigh(root.T @ root)
    score = (turned.T @ (root.T @ residual)) ** 2
    square = _WALKS[:, None] ** 2
    nats = 0.5 * np.sum(square * score / (1.0 + square * strength) - np.log1p(square * strength), axis=1)
    nats -= 0.5 * (np.log(_WALKS / USUAL_WALK) / _SPREAD) ** 2
    return float(_WALKS[np.argmax(nats)])
