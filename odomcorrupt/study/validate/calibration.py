"""Calibration of predicted errors by path length: NEES with bounds valid for fitted models, coverage, and CRPS.

A model fitted to ten minutes of driving has coefficients accurate to some per cent; a test that took them as exact
would reject a correct model. The error models of a localisation are approximate, too: over a metre, errors are nearly
all the localisation's and contain no information on the robot.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.effects import registry
from odomcorrupt.effects.effect import amplitudes
from odomcorrupt.study.estimate.windows import WindowErrors

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.model.motion_model import MotionModel
    from odomcorrupt.study.estimate.intervals import Intervals
    from odomcorrupt.study.estimate.problem import Problem
    from odomcorrupt.study.estimate.windows import PositionWindows

LOCALISED = 0.25
"""Relative standard deviation of the variance of a localisation's errors over windows of one length, in addition to
its fit: the NEES over 1 to 5 m of nine correct models beside simulated AMCLs scattered by 0.3; chance explains 0.15."""
_MIN_VARIANCE = 0.05
"""Lower limit of a drawn variance, relative to the model's."""


@dataclass(frozen=True, slots=True)
class ParameterUncertainty:
    """Sensitivity of window errors to one standard error of each parameter.

    scale : (p,) relative change of the mean NEES per standard error of each coefficient
    gram : (q, q) mean normalised products, per degree of freedom, of the errors per standard error of the effects and
        of the clock's offset
    truth : (c,) relative standard deviation of each channel's square from the truth's approximate noise model
    """

    scale: Array
    gram: Array
    truth: Array


def uncertainty_of(
    model: MotionModel,
    windows: Intervals,
    errors: WindowErrors,
    problem: Problem,
    *,
    inflate: float,
    positions: PositionWindows | None = None,
) -> ParameterUncertainty:
    """Return the uncertainty of a model and of the recording's clock on these windows; without errors, both are exact.

    inflate : factor on the standard errors, for a model refitted on fewer data
    positions : as in `Evaluation.errors_of`
    """
    count = errors.error.shape[1]
    k, law = model.noise.coefficients, model.noise.law
    steps = problem.steps
    scales = []
    for name in k.__slots__:
        error = inflate * model.standard_errors.get(name, 0.0)
        if error > 0.0:
            bounds = getattr(k, name) + error, max(getattr(k, name) - error, 0.0)
            own = (positions or windows).covariance
            more, less = (own(law, replace(k, **{name: value}), steps) for value in bounds)
            change = more - less
            relative = np.linalg.solve(errors.covariance, change[:, :count, :count] / 2.0)
            scales.append(float(np.trace(relative, axis1=1, axis2=2).mean() / count))
    at_ends = replace(problem, intervals=windows)
    parts = [np.zeros((len(windows), 3, 0))]
    for effect in problem.effects:
        sizes = [model.standard_errors.get(f"{effect.name}.{p.name}", 0.0) for p in amplitudes(effect)]
        parts.append(at_ends.columns(effect) * np.array(sizes) * inflate)
    (recording,) = problem.recordings
    parts.append(at_ends.columns(registry()["time_offset"]()) * recording.stamp_error_s)
    columns = np.concatenate(parts, axis=2)[:, :count]
    solved = np.linalg.solve(errors.covariance, columns)
    gram = np.einsum("nci,ncj->ij", columns, solved) / (len(errors) * count)
    truth = np.zeros(count)
    if any(r.localised for r in problem.recordings):  # by its share of the covariance
        odometry = windows.covariance(law, k, steps)[:, :count, :count]
        truth = LOCALISED * (1.0 - np.einsum("nii->i", odometry) / np.einsum("nii->i", errors.covariance))
    return ParameterUncertainty(np.array(scales), gram, truth)


HORIZONS_M = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)
CURVE_M = (0.5, 1.0, 2.0, 3.0, 5.0, 7.0, 10.0, 15.0, 20.0, 30.0, 50.0, 70.0, 100.0)
_MIN_WINDOWS = 3
"""Fewest windows for a statement."""
_DRAWS = 20_000
_SEED = 1_950_128


@dataclass(frozen=True, slots=True, kw_only=True)
class Horizon:
    """Odometry errors (odometry minus truth) over non-overlapping windows of one path length.

    measured, expected : (3,) root mean square along, across (m) and yaw (rad); NaN yaw if the truth has no headings
    bias : (3,) mean error
    excess_p : (3,) two-sided p-value of each channel's measured mean square under the model
    position_measured, position_expected : root mean square of the position error, m
    nees : mean normalised squared error per degree of freedom; its expectation is 1 for a correct model
    nees_bounds : 95 % interval of such means by chance, widened by the model's standard errors; beside a localisation
        the lower bound is 0
    nees_p : two-sided p-value of `nees`
    coverage_50, coverage_90 : (3,) fraction of the errors inside the model's 50 and 90 % intervals
    crps : (3,) mean continuous ranked probability score, m and rad
    """

    distance_m: float
    windows: int
    measured: Array
    expected: Array
    bias: Array
    excess_p: Array
    position_measured: float
    position_expected: float
    nees: float
    nees_bounds: tuple[float, float]
    nees_p: float
    coverage_50: Array
    coverage_90: Array
    crps: Array


def horizon_of(distance_m: float, parts: Sequence[tuple[WindowErrors, ParameterUncertainty]]) -> Horizon | None:
    """Return the calibration over windows of one path length, pooled over pieces; None if there are too few windows."""
    if sum(len(errors) for errors, _ in parts) < _MIN_WINDOWS:
        return None
    count = min(errors.error.shape[1] for errors, _ in parts)
    both = WindowErrors(
        np.concatenate([errors.error[:, :count] for errors, _ in parts]),
        np.concatenate([errors.covariance[:, :count, :count] for errors, _ in parts]),
    )
    nees = float(both.nees.mean() / count)
    rng = np.random.default_rng(_SEED)
    sums = [_squares(own, rng, len(part) * count, float(own.truth.mean())) for part, own in parts]
    # under the model and its parameter uncertainty
    means = np.sort(np.sum(sums, axis=0) / (sum(len(part) for part, _ in parts) * count))
    low, high = np.quantile(means, [0.025, 0.975])
    below = int(np.searchsorted(means, nees, side="right"))
    above = len(means) - int(np.searchsorted(means, nees, side="left"))
    if any(uncertainty.truth.any() for _, uncertainty in parts):
        # Beside a localisation the robot's noise is only bounded above: smaller errors do not contradict the model.
        low, below = 0.0, len(means)
    tail = min(below, above)
    position = np.hypot(both.measured[0], both.measured[1]), np.hypot(both.expected[0], both.expected[1])
    return Horizon(
        distance_m=distance_m,
        windows=len(both),
        measured=_three(both.measured),
        expected=_three(both.expected),
        bias=_three(both.error.mean(axis=0)),
        excess_p=_three(_excess(both, parts)),
        position_measured=float(position[0]),
        position_expected=float(position[1]),
        nees=nees,
        nees_bounds=(float(low), float(high)),
        # Count the observation as one of the draws: the p-value is then valid and never zero.
        nees_p=min(1.0, 2.0 * (tail + 1.0) / (len(means) + 1.0)),
        coverage_50=_three(both.coverage(0.5)),
        coverage_90=_three(both.coverage(0.9)),
        crps=_three(both.crps),
    )


def _squares(uncertainty: ParameterUncertainty, rng: np.random.Generator, freedom: int, spread: float) -> Array:
    """Return draws of the sum of normalised squares of one part under the model, within the parameters' errors.

    freedom : number of squares; spread : their relative standard deviation from errors of the truth
    """
    scale = 1.0 + rng.standard_normal((_DRAWS, len(uncertainty.scale))) @ uncertainty.scale
    if spread > 0.0:
        scale *= np.exp(spread * rng.standard_normal(_DRAWS))
    scale = np.maximum(scale, _MIN_VARIANCE)
    by = rng.standard_normal((_DRAWS, len(uncertainty.gram)))
    offset = freedom * np.maximum(np.sum((by @ uncertainty.gram) * by, axis=1), 0.0)
    return scale * rng.noncentral_chisquare(freedom, offset)


def _excess(errors: WindowErrors, parts: Sequence[tuple[WindowErrors, ParameterUncertainty]]) -> Array:
    """Return the two-sided p-value of each channel's sum of squares, including the parameters' uncertainty."""
    square = np.sum((errors.error / errors.deviation) ** 2, axis=0)
    rng = np.random.default_rng(_SEED)
    above = np.zeros(len(square))
    for i, own in enumerate(square):
        drawn = sum(_squares(uncertainty, rng, len(part), float(uncertainty.truth[i])) for part, uncertainty in parts)
        above[i] = (np.sum(drawn >= own) + 1.0) / (_DRAWS + 1.0)
    below = 1.0 if any(uncertainty.truth.any() for _, uncertainty in parts) else 1.0 - above + 1.0 / _DRAWS
    return np.minimum(1.0, 2.0 * np.minimum(above, below))


def _three(values: Array) -> Array:
    return np.concatenate((values, np.full(3 - len(values), np.nan)))
