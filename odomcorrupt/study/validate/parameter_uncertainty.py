"""Effect on the NEES of a model's standard errors and of approximate noise models of the truth.

A model fitted to ten minutes of driving has coefficients accurate to some per cent; a test that took them as exact
would reject a correct model. The error models of a localisation are approximate, too: over a metre, errors are nearly
all the localisation's and contain no information on the robot.
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
"""Relative standard deviation of the variance of a localisation's errors over windows of one length, in addition to
its fit: the NEES over 1 to 5 m of nine correct models beside simulated AMCLs scattered by 0.3; chance explains 0.15."""
_MIN_VARIANCE = 0.05
"""Lower limit of a drawn variance, relative to the model's."""


class Drawn(NamedTuple):
    """Factors on the mean NEES (draws,), and mean squared offsets per degree of freedom (draws,)."""

    scale: Array
    offset: Array


@dataclass(frozen=True, slots=True)
class ParameterUncertainty:
    """Sensitivity of window errors to one standard error of each parameter.

    scale : (p,) relative change of the mean NEES per standard error of each coefficient
    gram : (q, q) mean normalised products, per degree of freedom, of the effects' errors per standard error
    truth : (c,) relative standard deviation of each channel's square from the truth's approximate noise model
    """

    scale: Array
    gram: Array
    truth: Array

    @property
    def certain(self) -> bool:
        """Whether all parameters count as exact."""
        return not (len(self.scale) or self.gram.any() or self.truth.any())

    def draw(self, rng: np.random.Generator, draws: int, spread: float) -> Drawn:
        """Return draws of the NEES's scale and offset within the parameters' errors; spread as in `drawn_truth`."""
        scale = 1.0 + rng.standard_normal((draws, len(self.scale))) @ self.scale
        scale *= self.drawn_truth(rng, draws, spread)
        by = rng.standard_normal((draws, len(self.gram)))
        return Drawn(np.maximum(scale, _MIN_VARIANCE), np.maximum(np.einsum("di,ij,dj->d", by, self.gram, by), 0.0))

    @staticmethod
    def drawn_truth(rng: np.random.Generator, draws: int, spread: float) -> Array:
        """Return log-normal factors (draws,) on a square with relative standard deviation `spread`; 1 for 0."""
        return np.exp(spread * rng.standard_normal(draws)) if spread > 0.0 else np.ones(draws)


def uncertainty_of(
    model: MotionModel, windows: Intervals, errors: WindowErrors, problem: Problem, *, inflate: float
) -> ParameterUncertainty:
    """Return the model's uncertainty on these windows; a model without standard errors counts as exact.

    inflate : factor on the standard errors, for a model refitted on fewer data
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
            parts = (getattr(more, part) - getattr(less, part) for part in Variances._fields)
            change = windows.spread(law, Variances(*parts), steps)
            relative = np.linalg.solve(errors.covariance, change[:, :count, :count] / 2.0)
            scales.append(float(np.trace(relative, axis1=1, axis2=2).mean() / count))
    columns = _effect_errors(model, replace(problem, nodes=windows), inflate)[:, :count]
    solved = np.linalg.solve(errors.covariance, columns)
    gram = np.einsum("nci,ncj->ij", columns, solved) / (len(errors) * count)
    return ParameterUncertainty(np.array(scales), gram, _truth_spread(model, windows, errors, problem))


def _truth_spread(model: MotionModel, windows: Intervals, errors: WindowErrors, problem: Problem) -> Array:
    """Return the relative standard deviation (c,) of squares from the truth's noise, by its share of the covariance."""
    count = errors.error.shape[1]
    if not any(r.localised for r in problem.recordings):
        return np.zeros(count)
    own = windows.covariance(model.noise.law, model.noise.coefficients, problem.steps)[:, :count, :count]
    odometry, total = (np.einsum("nii->i", part) for part in (own, errors.covariance))
    spread: Array = LOCALISED * (1.0 - odometry / total)
    return spread


def _effect_errors(model: MotionModel, problem: Problem, inflate: float) -> Array:
    """Return the errors (n, 3, q) at the windows' ends for one standard error of each parameter of the effects."""
    columns = [np.zeros((len(problem.nodes), 3, 0))]
    for effect in problem.effects:
        own = problem.columns(effect)
        errors = [model.standard_errors.get(f"{effect.name}.{p.name}", 0.0) for p in amplitudes(effect)]
        columns.append(own * np.array(errors) * inflate)
    joined: Array = np.concatenate(columns, axis=2)
    return joined
