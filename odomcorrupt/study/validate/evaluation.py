"""Evaluation of a model on a stretch of a recording: residuals, their predicted covariance and likelihood."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.effects.random_processes import autoregression
from odomcorrupt.study.estimate.noise_likelihood import VarianceComponents, fit_noise
from odomcorrupt.study.estimate.problem import Problem, pose_problem
from odomcorrupt.study.estimate.random_process import CORRELATED_NOISE, widened
from odomcorrupt.study.estimate.robust_errors import BLOCK_S
from odomcorrupt.study.estimate.whitener import FLOOR, Whitener, interval_covariance, whitener
from odomcorrupt.study.estimate.windows import WindowErrors, distance_windows, position_windows
from odomcorrupt.study.io.headings import UNKNOWN_RAD
from odomcorrupt.study.validate.calibration import Horizon, ParameterUncertainty, horizon_of, uncertainty_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.effects.effect import Effect, Motion, RandomCoefficient
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.model.motion_model import MotionModel, TruthNoise
    from odomcorrupt.study.estimate.config import Approach
    from odomcorrupt.study.estimate.intervals import Intervals
    from odomcorrupt.study.estimate.windows import PositionWindows
    from odomcorrupt.study.io.recording import Recording


def random_covariance(random: Sequence[Effect], windows: Intervals, motion: Motion) -> Array:
    """Return the covariance (K, 3, 3) from random gains on each window of one run.

    A gain g is a Markov process: Cov(g_i, g_j) is Var(g_i) times the product of the factors kept from i to j. With c_i
    the effect of step i at the window's end, the sum over all pairs therefore takes one backward pass.
    """
    parts = [_of_gain(gain, windows, motion) for effect in random for gain in effect.gains(motion)]
    return np.asarray(sum(parts, np.zeros((len(windows), 3, 3))))


def _of_gain(gain: RandomCoefficient, windows: Intervals, motion: Motion) -> Array:
    moved = windows.carried(gain.f * motion.dt_s[:, None])
    variance = autoregression(gain.start, gain.keep**2, gain.kick)[windows.source]
    # what each step moves together with those after it in its window, of which the gain keeps a part
    keeps = np.append((gain.keep[windows.source] ** windows.share)[1:], 0.0)
    keeps[windows.first[1:] - 1] = 0.0
    with_later = np.stack([autoregression(0.0, keeps[::-1], row[::-1])[::-1] for row in moved])
    both = moved[:, None] * (with_later - 0.5 * moved)[None]
    outer = variance * (both + np.swapaxes(both, 0, 1))
    return np.ascontiguousarray(np.moveaxis(np.add.reduceat(outer, windows.first, axis=2), 2, 0))


_MIN_NATS_PER_INTERVAL = 0.3
"""A recording's truth gets its own noise if that explains this much more per interval; noise half as large again does
so if it is most of the residual."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Evaluation:
    """Evaluation of one model on one stretch of a recording.

    recording : with corrected clock
    left : the recording with the model's effects removed from the odometry
    truth : noise of the truth, as it affects the ends of windows
    q : (K, 3, 3) covariance of the residuals from the model's noise
    innovations : (3 K,) whitened residuals
    interval_nats : (K,) log likelihood of each interval given the preceding ones
    interval_metres : (K,) travel of the raw odometry, the same for all models
    inflation : factor of the model's standard errors, above 1 if it was refitted without this fold
    """

    recording: Recording
    left: Recording
    model: MotionModel
    truth: TruthNoise
    problem: Problem
    whitener: Whitener
    q: Array
    innovations: Array
    interval_nats: Array
    interval_metres: Array
    inflation: float

    @property
    def refitted(self) -> bool:
        """Whether the model was refitted without this fold."""
        return self.inflation > 1.0

    @property
    def headed(self) -> bool:
        """Whether the truth measured headings."""
        return self.recording.headed

    @property
    def covariance(self) -> Array:
        """Predicted marginal covariance (K, 3, 3) of each residual."""
        return interval_covariance(self.problem.intervals, self.q, self.truth)

    @property
    def sized_nats(self) -> Array:
        """Log likelihood (K,) of each interval with the noise of each measured axis rescaled to this stretch.

        The level of noise differs between drives; this score compares the models of the motion only.
        """
        square = self.innovations.reshape(-1, 3)[:, self.recording.axes] ** 2
        size = np.maximum(square.mean(axis=0), 1e-12)
        return self.interval_nats + 0.5 * np.sum(square * (1.0 - 1.0 / size) - np.log(size), axis=1)

    def chains(self) -> list[Array]:
        """Return the innovations as uninterrupted chains (m, c), with c the axes measured by the truth."""
        rows = self.innovations.reshape(-1, 3)[:, self.recording.axes]
        return np.split(rows, np.flatnonzero(~self.problem.intervals.linked)[1:])

    def windows(self, distance_m: float) -> tuple[WindowErrors, ParameterUncertainty] | None:
        """Return errors after a path length with the model's uncertainty of them; None without measured positions."""
        if not self.recording.positioned:
            return None
        windows = distance_windows(self.left, distance_m)
        if not len(windows):
            return None
        positions = None if self.headed else position_windows(self.left, windows)
        errors = self.errors_of(windows, positions)
        count = errors.error.shape[1]
        random, motion = _random_effects(self.model), self.problem.motions[0]
        more = random_covariance(random, windows, motion)[:, :count, :count]
        errors = replace(errors, covariance=errors.covariance + more)
        spread = uncertainty_of(self.model, windows, errors, self.problem, inflate=self.inflation, positions=positions)
        return errors, spread

    def errors_of(self, windows: Intervals, positions: PositionWindows | None = None) -> WindowErrors:
        """Return the errors of windows of `left` with their covariance from the noise of odometry and truth.

        A truth without headings leaves yaw out: its headings come from the odometry.

        positions : for a truth of positions only, the windows with the headings estimated at their starts
        """
        if positions is None and not self.headed:
            positions = position_windows(self.left, windows)
        law, k, steps = self.model.noise.law, self.model.noise.coefficients, self.problem.steps
        if positions is not None:
            total = positions.covariance(law, k, steps) + positions.of_truth(self.truth)
            total[:, [0, 1, 2], [0, 1, 2]] += FLOOR
        else:
            total = interval_covariance(windows, windows.covariance(law, k, steps), self.truth)
        count = 3 if self.headed else 2
        return WindowErrors(windows.residual[:, :count], total[:, :count, :count])


def evaluate_stretch(
    recording: Recording, model: MotionModel, approach: Approach, *, inflation: float = 1.0
) -> Evaluation:
    """Return the evaluation of a model on a recording with corrected clock.

    Effects of places that were learned in another frame are left out.

    inflation : see `Evaluation`
    """
    model = model.in_frame(recording.frame)
    effects = (*model.effects, *model.setup.effects)
    problem = pose_problem([recording], effects, approach=approach)
    intervals = problem.intervals
    q = intervals.covariance(model.noise.law, model.noise.coefficients, problem.steps)
    headed = recording.headed
    stated = model.setup.truth
    truth = stated if stated is not None and inflation > 1.0 else _own_truth(problem, q, model)
    band = _whitener(problem, q, truth)
    random = [effect for effect in model.effects if effect.name in CORRELATED_NOISE]
    white = widened(band, problem, random)
    innovations = white.whiten(intervals.residual)
    own = np.log(white.factor[0]) + 0.5 * innovations**2 + 0.5 * np.log(2.0 * np.pi)
    # A random coefficient acts over the whole run: spread its contribution over all intervals.
    own += (white.log_det - band.log_det) / own.size
    left = problem.left[0]
    raw = problem.at(()).intervals
    return Evaluation(
        recording=recording,
        left=left,
        model=model,
        truth=truth if headed else replace(truth, yaw_rad=float(left.heading_error_rad or 0.0)),
        problem=replace(problem, smoothers=(), left=()),  # only refits need them
        whitener=white,
        q=q + random_covariance(_random_effects(model), intervals, problem.motions[0]),
        innovations=innovations,
        interval_nats=-own.reshape(-1, 3).sum(axis=1),
        interval_metres=raw.distance_m,
        inflation=inflation,
    )


def horizons_of(pieces: Sequence[Evaluation], distances_m: Sequence[float]) -> tuple[Horizon, ...]:
    """Return the calibration by path length, for lengths with enough windows."""
    found = []
    for distance in distances_m:
        parts = [w for piece in pieces if (w := piece.windows(distance)) is not None]
        horizon = horizon_of(distance, parts) if parts else None
        if horizon is not None:
            found.append(horizon)
    return tuple(found)


def _random_effects(model: MotionModel) -> list[Effect]:
    """Return the random effects that remain after the odometry is restored."""
    return [effect for effect in model.effects if effect.kind == "noise" and not effect.restorable]


def _own_truth(problem: Problem, q: Array, model: MotionModel) -> TruthNoise:
    """Return the noise of a recording's truth if the model states none, or one that differs clearly from it.

    Noise of a truth is no property of the robot: a model may be fitted to motion capture and evaluated on AMCL. It must
    not absorb the robot's errors either. It is therefore fitted beside noise of the odometry, without outliers.

    q : (K, 3, 3) covariance of the residuals from the model's noise
    """
    intervals, stated = problem.intervals, model.setup.truth
    components = VarianceComponents(model.noise.law, intervals, problem.steps)
    none = np.zeros((len(intervals), 3, 0))
    own = fit_noise(intervals, components, none, headings=problem.headings, bursts=True)
    if stated is None:
        return own.truth

    def nats(truth: TruthNoise) -> float:
        white = _whitener(problem, q * own.weights[:, None, None], truth)
        return white.log_likelihood(white.whiten(intervals.residual))

    return own.truth if nats(own.truth) - nats(stated) > _MIN_NATS_PER_INTERVAL * len(intervals) else stated


def _whitener(problem: Problem, q: Array, truth: TruthNoise) -> Whitener:
    return whitener(problem.intervals, q, truth if problem.headings else replace(truth, yaw_rad=UNKNOWN_RAD))


@dataclass(frozen=True, slots=True)
class LogScore:
    """Log likelihood per metre, and its gain over the first model on the same blocks, with standard errors."""

    per_m: float
    error: float
    gain_per_m: float
    gain_error: float
    blocks: int


def log_score_of(pieces: Sequence[Evaluation], first: Sequence[Evaluation]) -> LogScore:
    """Return the nats per metre of evaluated pieces, and their paired difference from those of the first model."""
    metres = _blocks(pieces, [piece.interval_metres for piece in pieces])
    ratio, error = _ratio(_blocks(pieces, [piece.interval_nats for piece in pieces]), metres)
    gain, gain_error = _ratio(block_differences(pieces, first, sized=False), metres)
    return LogScore(ratio, error, gain, gain_error, len(metres))


def block_differences(pieces: Sequence[Evaluation], others: Sequence[Evaluation], *, sized: bool) -> Array:
    """Return the difference (b,) in log likelihood, nats, of evaluations of the same recordings, in blocks of time.

    sized : whether to rescale the noise to each recording, see `Evaluation.sized_nats`
    """
    nats = [[one.sized_nats if sized else one.interval_nats for one in each] for each in (pieces, others)]
    return _blocks(pieces, [own - other for own, other in zip(*nats, strict=True)])


def _blocks(pieces: Sequence[Evaluation], values: Sequence[Array]) -> Array:
    """Return sums (b,) over blocks of time of values (K,) of the intervals of each piece."""
    sums = []
    for piece, own in zip(pieces, values, strict=True):
        end_s = piece.problem.intervals.end_s
        sums.append(np.bincount(((end_s - end_s[0]) / BLOCK_S).astype(np.int64), own))
    return np.concatenate(sums)


def _ratio(values: Array, metres: Array) -> tuple[float, float]:
    """Return sum over metres and its standard error by the ratio estimator over b blocks (Cochran, 1977, ch. 6)."""
    total, count = float(metres.sum()), len(metres)
    if total <= 0.0:
        return float("nan"), float("nan")
    ratio = float(values.sum()) / total
    if count < 2:
        return ratio, float("nan")
    left = values - ratio * metres
    return ratio, float(np.sqrt(count / (count - 1.0) * float(left @ left))) / total
