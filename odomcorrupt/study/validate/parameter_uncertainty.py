"""How a model's own standard errors, and a truth that is roughly known, widen what chance may make of its NEES.

A model that was fitted to ten minutes of driving knows its coefficients to some per cent. A test that took them for
exact would reject a right model for that alone. So it is with errors of a localisation, whose laws are approximate:
errors over a metre are nearly all its own, and say nothing of the robot.
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

__all__ = ["LOCALISED", "ParameterUncertainty", "uncertainty_of"]

LOCALISED = 0.25
"""Relative standard deviation of the variance of a localisation's errors over windows of one length, beside their fit:
of nine right models, beside simulated AMCLs, the NEES over 1 to 5 m scattered by 0.3, where chance alone makes 0.15."""
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
    truth : (c,) relative standard deviation of each channel's square for what is not known of the truth's errors
    """

    scale: Array
    gram: Array
    truth: Array

    @property
    def certain(self) -> bool:
        """Whether every number is taken at its word."""
        return not (len(self.scale) or self.gram.any() or self.truth.any())

    def draw(self, rng: np.random.Generator, draws: int, spread: float) -> Drawn:
        """Return what numbers within their errors would do; spread is that of the truth, relative."""
        scale = 1.0 + rng.standard_normal((draws, len(self.scale))) @ self.scale
        scale *= self.drawn_truth(rng, draws, spread)
        by = rng.standard_normal((draws, len(self.gram)))
        return Drawn(np.maximum(scale, _LEAST), np.maximum(np.einsum("di,ij,dj->d", by, self.gram, by), 0.0))

    @staticmethod
    def drawn_truth(rng: np.random.Generator, draws: int, spread: float) -> Array:
        """Return factors (draws,) on a square, log-normal of this relative standard deviation; 1 where it is 0."""
        return np.exp(spread * rng.standard_normal(draws)) if spread > 0.0 else np.ones(draws)


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
    return ParameterUncertainty(np.array(scales), gram, _truth_spread(model, windows, errors, problem))


def _truth_spread(model: MotionModel, windows: Intervals, errors: WindowErrors, problem: Problem) -> Array:
    """Return the relative standard deviation (c,) of squares that a roughly known truth makes: by its share in them."""
    count = errors.error.shape[1]
    if not any(r.localised for r in problem.recordings):
        return np.zeros(count)
    own = windows.covariance(model.noise.law, model.noise.coefficients, problem.steps)[:, :count, :count]
    odometry, total = (np.einsum("nii->i", part) for part in (own, errors.covariance))
    spread: Array = LOCALISED * (1.0 - odometry / total)
    return spread


def _effect_errors(model: MotionModel, problem: Problem, inflate: float) -> Array:
    """Return (n, 3, q): what one standard error of each of the effects' parameters does at the windows' ends."""
    columns = [np.zeros((len(problem.nodes), 3, 0))]
    for effect in problem.effects:
        own = problem.columns(effect)
        errors = [model.standard_errors.get(f"{effect.name}.{p.name}", 0.0) for p in amplitudes(effect)]
        columns.append(own * np.array(errors) * inflate)
    joined: Array = np.concatenate(columns, axis=2)
    return joined
