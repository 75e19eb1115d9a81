"""How a model's own standard errors widen what chance may make of its NEES.

A model that was fitted to ten minutes of driving knows its coefficients to some per cent. A test that took them for
exact would reject a right model for that alone.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from odomcorrupt.effects.effect import amplitudes
from odomcorrupt.model.noise_laws import Variances, magnitudes

if TYPE_CHECKING:
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.model.motion_model import MotionModel
    from odomcorrupt.study.estimate.intervals import Intervals
    from odomcorrupt.study.estimate.problem import Problem
    from odomcorrupt.study.estimate.windows import WindowErrors

__all__ = ["ParameterUncertainty", "uncertainty_of"]

_LEAST = 0.05
"""A variance cannot be drawn below this part of what the model says."""


class Drawn(NamedTuple):
    """Factors on the mean NEES (draws,), and mean squared offsets per degree of freedom (draws,)."""

    scale: Array
    offset: Array


@dataclass(frozen=True, slots=True)
class ParameterUncertainty:
    """What one standard error of each number does to windows.

    scale : (p,) relative change of the mean NEES per standard error of each coefficient
    gram : (q, q) mean normalised square and product, per degree of freedom, of what the effects' errors do
    """

    scale: Array
    gram: Array

    def draw(self, rng: np.random.Generator, draws: int) -> Drawn:
        """Return what numbers within their errors would do."""
        scale = 1.0 + rng.standard_normal((draws, len(self.scale))) @ self.scale
        by = rng.standard_normal((draws, len(self.gram)))
        return Drawn(np.maximum(scale, _LEAST), np.maximum(np.einsum("di,ij,dj->d", by, self.gram, by), 0.0))


def uncertainty_of(
    model: MotionModel, windows: Intervals, errors: WindowErrors, problem: Problem, *, inflate: float
) -> ParameterUncertainty:
    """Return how uncertain the model is about these windows; a model without standard errors is taken at its word.

    inflate : factor on the standard errors, for a model that was refitted on less than it says
    """
    count = errors.error.shape[1]
    k, law = model.noise.coefficients, model.noise.law
    steps = problem.steps
    moved = magnitudes(law, steps)
    scales = []
    for name in k.__slots__:
        error = inflate * model.standard_errors.get(name, 0.0)
        if error > 0.0:
            bounds = getattr(k, name) + error, max(getattr(k, name) - error, 0.0)
            more, less = (law.rule(replace(k, **{name: value}), *moved) for value in bounds)
            parts = (getattr(more, part) - getattr(less, part) for part in Variances.__slots__)
            change = windows.spread(law, Variances(*parts), steps)
            relative = np.linalg.solve(errors.covariance, change[:, :count, :count] / 2.0)
            scales.append(float(np.trace(relative, axis1=1, axis2=2).mean() / count))
    columns = _effect_errors(model, replace(problem, nodes=windows), inflate)[:, :count]
    solved = np.linalg.solve(errors.covariance, columns)
    gram = np.einsum("nci,ncj->ij", columns, solved) / (len(errors) * count)
    return ParameterUncertainty(np.array(scales), gram)


def _effect_errors(model: MotionModel, problem: Problem, inflate: float) -> Array:
    """Return (n, 3, q): what one standard error of each of the effects' parameters does at the windows' ends."""
    columns = [np.zeros((len(problem.nodes), 3, 0))]
    for effect in problem.effects:
        own = problem.columns(effect)
        errors = [model.standard_errors.get(f"{effect.name}.{p.name}", 0.0) for p in amplitudes(effect)]
        columns.append(own * np.array(errors) * inflate)
    joined: Array = np.concatenate(columns, axis=2)
    return joined
