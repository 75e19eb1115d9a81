"""Maximum-likelihood fit of the noise coefficients and of the truth noise; linear terms are profiled.

The maximum is found by Newton steps with the average information, within a box and a trust region. The average of
observed and expected information needs no second derivatives and is never negative; near the maximum its steps are
nearly Newton's (Gilmour, Thompson & Cullis 1995, Biometrics 51, 1440).

The covariance of the residuals under a noise law is a weighted sum of fixed matrices, its variance components.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from itertools import combinations
from typing import TYPE_CHECKING, Self

import numpy as np
from scipy.linalg import blas, block_diag
from scipy.optimize import lsq_linear
from scipy.stats import chi2

from odomcorrupt.errors import FitError
from odomcorrupt.model.motion_model import TruthNoise
from odomcorrupt.model.noise_laws import Coefficients, magnitudes
from odomcorrupt.study.estimate.whitener import (
    BAND,
    Whitener,
    band_factor,
    band_of,
    band_solve,
    factored,
    fixed_band,
    half_log_det,
    odometry_piece,
    rho_of,
    truth_pieces,
    truth_weights,
)
from odomcorrupt.study.io.headings import UNKNOWN_RAD

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array, Increments
    from odomcorrupt.model.noise_laws import Law
    from odomcorrupt.study.estimate.intervals import Intervals


NAMES = ("rot_rot", "rot_trans", "trans_trans", "trans_rot", "across_trans", "end_trans", "end_rot", "rot_time")
"""Coefficients that can be fitted; white noise on twists is not among them, because the truth's noise hides it."""
_OVER_TIME = NAMES.index("rot_time")
_PROBE = (np.array([0.3]), np.array([0.7]), np.array([0.2]))
"""Magnitudes of a test step on which each coefficient, and each interaction of a pair, has an effect if it has any."""


class VarianceComponents:
    """Covariances (K, 3, 3) of the residuals under a noise law, one per coefficient and per interacting pair.

    A law is homogeneous in its coefficients, of degree 1 or 2, and can be split by polarisation. It is the same law
    that corruption uses. With `gyro_noise`, the angle random walk of a gyro, which depends on time, is one more.
    """

    def __init__(self, law: Law, intervals: Intervals, steps: Increments, *, gyro_noise: bool = False) -> None:
        def of(*ones: int) -> Coefficients:
            return Coefficients(**{name: float(i in ones) for i, name in enumerate(NAMES)})

        def rows(*ones: int, on: tuple[Array, ...]) -> Array:
            v = law.rule(of(*ones), *on)
            return np.stack((v.rot1, v.trans, v.across, v.rot2))

        seen = magnitudes(law, steps)
        # noise grows with motion: the largest magnitudes show whether a coefficient has any effect
        most = tuple(np.array([m.max(initial=0.0)]) for m in seen)
        self.active = [i for i in range(len(NAMES)) if rows(i, on=most).any()]
        """Indices of the coefficients that have an effect under this law on this drive."""
        self.unseen = [i for i in range(len(NAMES)) if i not in self.active and rows(i, on=_PROBE).any()]
        """Indices of the coefficients that have an effect under this law, but not on this drive."""
        self._single = {i: intervals.spread(law, law.rule(of(i), *seen), steps) for i in self.active}
        self._pairs: list[tuple[int, int, Array]] = []
        for i, j in combinations(self.active, 2) if law.degree == 2 else ():
            alone, both = rows(i, on=_PROBE) + rows(j, on=_PROBE), rows(i, j, on=_PROBE)
            # most pairs do not interact, and propagating their noise to the nodes is expensive
            if np.abs(both - alone).max() > 1e-12 * np.abs(both).max():
                cross = intervals.spread(law, law.rule(of(i, j), *seen), steps) - self._single[i] - self._single[j]
                self._pairs.append((i, j, cross))
        if gyro_noise:
            self._single[_OVER_TIME] = intervals.over_time(law)
            self.active.append(_OVER_TIME)
        self._degrees = np.array([2 if i == _OVER_TIME else law.degree for i in self.active])

    def parts(self) -> list[Array]:
        """Return the matrices (K, 3, 3), in the order of the weights of `shares`."""
        return [self._single[i] for i in self.active] + [cross for _, _, cross in self._pairs]

    def shares(self, coefficients: Array) -> Array:
        """Return the weights of `parts` for the coefficients (8,) in the order of `NAMES`."""
        single = coefficients[self.active] ** self._degrees
        pairs = [coefficients[i] * coefficients[j] for i, j, _ in self._pairs]
        return np.concatenate((single, pairs))

    def share_slopes(self, coefficients: Array) -> Array:
        """Return the derivatives (a, parts) of `shares` by the logarithms of the a active coefficients."""
        of_pairs = [[coefficients[i] * coefficients[j] * (k in (i, j)) for i, j, _ in self._pairs] for k in self.active]
        single = np.diag(self._degrees * coefficients[self.active] ** self._degrees)
        return np.concatenate((single, np.reshape(of_pairs, (len(self.active), len(self._pairs)))), axis=1)


LOWEST = 1e-5
"""Lower bound of the coefficients, treated as zero."""
HIGHEST = 10.0
_LOW, _HIGH = np.log(LOWEST), np.log(HIGHEST)
TRUTH_BOUNDS = np.log([(2e-5, 1.0), (2e-5, 1.0), (1e-6, 0.3)])
"""Logarithms of the bounds of a truth's noise, in the order of `TruthNoise`."""
_USUAL, _SPREAD = np.log(np.array([0.02, 0.01])), 0.7
"""Prior of a localisation's errors, m and rad: median, and standard deviation of its logarithm. Particle filters with
likelihood fields (as nav2_amcl) in two simulated rooms, with cells of 2.5 to 10 cm, 500 to 2000 particles, alphas of
0.05 to 0.2 and updates after 0.1 or 0.25 m, had errors of 1.3 to 4 cm and 0.4 to 1.4 deg; slam_toolbox has 1 cm (the
protocol of the benchmark of ordinary recordings). Without it a perfect localisation of a noisy robot may be as likely
as the reverse."""
_NO_RANDOM_WALK = 2e-6
_NATS, _PROFILE_NATS = 1e-4, 1e-3
"""Predicted gain of the next step, nats, below which the iteration ends; the second value is for profiles."""
DEAD, _FAINT = 1e-4, 1e-3
"""Coefficient below which the likelihood has no gradient, and the value from which such a coefficient is restarted."""
_MOST_STEPS = 60
_FAR, _NEAREST = 3.0, 1e-3
"""Largest and smallest trust region, in logarithms."""
_DIFFERENCE = 1e-5
"""Step of the log determinant's difference, in logarithms; the maximum moves by half of it."""
_RIDGE = 1e-6


@dataclass(frozen=True, slots=True, kw_only=True)
class NoiseFit:
    """Fitted noise with its log likelihood (nats).

    theta, theta_covariance : estimates of the free columns' parameters (q,), and their covariance (q, q)
    weights : (K,) factor on each interval's covariance; above 1 for outliers of a robust fit
    innovations : (3 K,) whitened residuals without the fitted columns
    free : (m,) logarithms of the fitted noise parameters, to start the next fit from
    """

    coefficients: Coefficients
    truth: TruthNoise
    log_likelihood: float
    theta: Array
    theta_covariance: Array
    weights: Array
    innovations: Array
    whitener: Whitener
    free: Array

    @classmethod
    def estimated(
        cls,
        white: Whitener,
        stacked: Array,
        *,
        coefficients: Coefficients,
        truth: TruthNoise,
        weights: Array,
        free: Array,
    ) -> Self:
        """Return the fit with given noise: columns by generalised least squares.

        stacked : (3 K, 1 + q) residual and columns, each contiguous in memory
        """
        whitened = white.whitened(stacked)
        r, b = whitened[:, 0], whitened[:, 1:]
        covariance = pseudo_inverse(b.T @ b)
        theta = covariance @ (b.T @ r)
        r = r - b @ theta
        return cls(
            coefficients=coefficients,
            truth=truth,
            log_likelihood=white.log_likelihood(r),
            theta=theta,
            theta_covariance=covariance,
            weights=weights,
            innovations=r,
            whitener=white,
            free=free,
        )

    def with_covariance(self, white: Whitener, stacked: Array) -> Self:
        """Return the fit with another covariance of the same noise; `stacked` as in `estimated`."""
        return self.estimated(
            white, stacked, coefficients=self.coefficients, truth=self.truth, weights=self.weights, free=self.free
        )


class NoiseLikelihood:
    """Likelihood of residuals for given noise; the covariance is a weighted sum of bands that are computed once.

    intervals : the residuals of K intervals
    components : contribution of each coefficient of the law to their covariance
    columns : (K, 3, m) of free linear parameters
    weights : (K,) robust factors on each interval's covariance
    headings : whether the truth has headings; if not, its heading noise is held at a large constant
    """

    def __init__(
        self,
        intervals: Intervals,
        components: VarianceComponents,
        columns: Array,
        weights: Array,
        *,
        headings: bool = True,
    ) -> None:
        if not components.active:
            raise FitError("the odometry never moves; a noise law has nothing to act on")
        self._intervals, self._components, self._weights, self._headings = intervals, components, weights, headings
        self._stacked = with_residual(intervals, columns)
        bands = [band_of(*odometry_piece(intervals, part * weights[:, None, None])) for part in components.parts()]
        bands += [band_of(*piece) for piece in truth_pieces(intervals)]
        self._bands = np.stack([band.T for band in bands]).reshape(len(bands), -1)
        self._floor = np.asfortranarray(fixed_band(intervals))
        self._rho = rho_of(intervals)
        self._localised = bool(intervals.localised.all())
        self._precision = np.zeros(len(components.active) + 3)
        if self._localised:
            self._precision[-3:-1] = _SPREAD**-2.0

    def initial_guess(self) -> Array:
        """Return noise parameters (m,) with which truth and odometry each explain part of the residual."""
        scale = np.median(np.abs(self._intervals.residual), axis=0)
        truth = np.clip(np.array([scale[:2].mean() / 2.0, scale[2] / 2.0, 1e-4]), 1e-4, 0.1)
        if not self._headings:
            truth[1] = UNKNOWN_RAD
        return np.concatenate((np.full(len(self._components.active), np.log(0.02)), np.log(truth)))

    def evaluate(self, free: Array) -> NoiseFit:
        """Return the fit at given noise parameters, with columns estimated by generalised least squares."""
        coefficients, truth = self._unpack(free)
        k = Coefficients(**dict(zip(NAMES, map(float, coefficients), strict=True)))
        white = factored(self._covariance(free), self._rho)
        return NoiseFit.estimated(white, self._stacked, coefficients=k, truth=truth, weights=self._weights, free=free)

    def posterior(self, noise: NoiseFit) -> float:
        """Return the log posterior of a fit, nats: its log likelihood plus the log prior of a localisation's errors."""
        if not self._localised:
            return noise.log_likelihood
        return noise.log_likelihood - 0.5 * float(np.sum(((noise.free[-3:-1] - _USUAL) / _SPREAD) ** 2))

    def maximise(self, free: Array, *, fixed: int | None = None) -> NoiseFit:
        """Return the fit of largest posterior from a start (m,); less precise with one held (for a profile)."""
        active = len(self._components.active)
        low, high = np.concatenate((np.tile((_LOW, _HIGH), (active, 1)), TRUTH_BOUNDS)).T.copy()
        if not self._headings:
            low[active + 1] = high[active + 1] = np.log(UNKNOWN_RAD)
        if self._rho is not None or self._localised:  # mean-reverting errors do not accumulate
            high[-1] = low[-1]
        if fixed is not None:
            low[fixed] = high[fixed] = free[fixed]
        return self._ascend(np.clip(free, low, high), low, high, _NATS if fixed is None else _PROFILE_NATS)

    def revived(self, free: Array) -> Array:
        """Return noise (m,) with near-zero coefficients raised to where the likelihood has a gradient.

        Noise of travel, of turns and a random walk of the truth are aliased at constant speed, and early steps may
        reduce a coefficient to where the likelihood has no gradient.
        """
        active = len(self._components.active)
        coefficients, truth = free[:active], free[active:]
        lively = np.where(coefficients < np.log(DEAD), np.log(_FAINT), coefficients)
        return np.concatenate((lively, np.maximum(truth, np.log(DEAD))))

    def derivatives(self, done: NoiseFit, movable: NDArray[np.int64]) -> tuple[Array, Array]:
        """Return slope (m,) and average information (m, m) of the log posterior in the movable parameters.

        With the columns held and p = V^-1 r, the slope of the log likelihood is half of p' dV p, less the change of
        half the log determinant. The information is half of (dV p)' P (dV p) (Gilmour, Thompson & Cullis 1995, eq. 5).
        """
        factor, whole = done.whitener.factor, self._covariance(done.free)
        pull = band_solve(factor, done.innovations[:, None], transposed=True)[:, 0]
        coefficients, truth = self._unpack(done.free)
        slopes = block_diag(self._components.share_slopes(coefficients), 2.0 * np.diag(truth_weights(truth)))
        changes = slopes[movable] @ self._bands
        growth, pushes = np.empty(len(movable)), np.empty((len(pull), len(movable)), order="F")
        for i, change in enumerate(changes):
            band = change.reshape(whole.shape[::-1]).T
            growth[i] = half_log_det(band_factor(whole + _DIFFERENCE * band)) - done.whitener.log_det
            pushes[:, i] = blas.dsbmv(BAND, 1.0, band, pull, lower=1)
        white = band_solve(factor, pushes)
        usual = np.zeros(len(done.free))
        usual[-3:-1] = _USUAL
        prior = (self._precision * (usual - done.free))[movable]
        slope: Array = 0.5 * pull @ pushes - growth / _DIFFERENCE + prior
        information: Array = 0.5 * white.T @ white + np.diag(self._precision[movable])
        return slope, information

    def _ascend(self, begin: Array, low: Array, high: Array, enough: float) -> NoiseFit:
        """Return the maximum reached from `begin` (m,) between bounds (m,); equal bounds hold a parameter.

        Ends when the next step's predicted gain is below `enough` nats.
        """
        movable = np.flatnonzero(low < high)
        done, reach = self.evaluate(begin), _FAR
        slope, information = self.derivatives(done, movable)
        for _ in range(_MOST_STEPS):
            here = done.free[movable]
            room = np.maximum(low[movable] - here, -reach), np.minimum(high[movable] - here, reach)
            step = _best_step(slope, information, *room)
            if float(slope @ step - 0.5 * step @ information @ step) < enough:
                break
            free = done.free.copy()
            free[movable] += step
            try:
                new = self.evaluate(np.clip(free, low, high))
            except FitError:  # the covariance is singular to rounding that far away
                new = done
            if self.posterior(new) > self.posterior(done):
                done, reach = new, min(2.0 * reach, _FAR)
                slope, information = self.derivatives(done, movable)
            else:
                reach = 0.3 * min(reach, float(np.abs(step).max()))
                if reach < _NEAREST:
                    break
        return done

    def _covariance(self, free: Array) -> Array:
        """Return the band (6, 3 K) of the covariance."""
        coefficients, truth = self._unpack(free)
        shares = np.concatenate((self._components.shares(coefficients), truth_weights(truth)))
        return (shares @ self._bands).reshape(self._floor.shape[::-1]).T + self._floor

    def _unpack(self, free: Array) -> tuple[Array, TruthNoise]:
        """Return coefficients (8,) and truth noise; a coefficient at its lower bound is exactly zero."""
        active = self._components.active
        coefficients = np.zeros(len(NAMES))
        log_k = free[: len(active)]
        coefficients[active] = np.where(log_k > _LOW + 0.1, np.exp(log_k), 0.0)
        xy, yaw, random_walk = np.exp(free[len(active) :])
        walks = float(random_walk) if random_walk > _NO_RANDOM_WALK else 0.0
        return coefficients, TruthNoise(float(xy), float(yaw), walks)


def _best_step(slope: Array, information: Array, low: Array, high: Array) -> Array:
    """Return the step (m,) to the maximum of a quadratic within bounds that contain zero."""
    whole = information + _RIDGE * np.eye(len(slope))
    step: Array = np.linalg.solve(whole, slope).astype(np.float64, copy=False)
    if np.all((low <= step) & (step <= high)):
        return step
    root = np.linalg.cholesky(whole)
    bounded: Array = lsq_linear(root.T, np.linalg.solve(root, slope), (low, high), method="bvls").x
    return bounded


def with_residual(intervals: Intervals, columns: Array) -> Array:
    """Return the residuals and columns (K, 3, c) as (3 K, 1 + c), each contiguous in memory, as LAPACK needs them."""
    both = np.concatenate((intervals.residual[:, :, None], columns), axis=2)
    return np.asfortranarray(both.reshape(-1, both.shape[2]))


def pseudo_inverse(normal: Array) -> Array:
    """Return the pseudo-inverse of a normal matrix, scaled for mixed units; aliased columns share their estimate.

    Rows and columns of a parameter on which no data depend are zero: its estimate does not move.
    """
    length = np.sqrt(np.diag(normal))
    scale = np.divide(1.0, length, out=np.zeros_like(length), where=length > 0.0)
    both = np.outer(scale, scale)
    return np.linalg.pinv(normal * both, rcond=1e-10, hermitian=True) * both


_ROBUST_ROUNDS = 5
_CHANCE, _SIGNAL = 0.002, 0.05
"""Fraction of outliers, or probability of the largest, that chance explains; fraction up to which none are signal."""
ODD = 2e-4
"""Probability that an ordinary step is an outlier by chance, so small that trimming adds no bias."""


def outliers(square: Array) -> NDArray[np.bool_]:
    """Return a mask (K,) of the intervals that are outliers; none if chance explains their number and size.

    square : (K,) sums of three squared innovations. The largest of K normal triples exceeds its limit in one fit of
        500, so a single jump of the truth is an outlier in a recording of any length
    """
    odd: NDArray[np.bool_] = square > chi2.isf(ODD, 3)
    by_chance = odd.mean() < _CHANCE and not (square > chi2.isf(_CHANCE / len(square), 3)).any()
    return np.zeros_like(odd) if by_chance else odd


def fit_noise(
    intervals: Intervals,
    components: VarianceComponents,
    columns: Array,
    *,
    headings: bool = True,
    start: Array | None = None,
    weights: Array | None = None,
    bursts: bool = False,
) -> NoiseFit:
    """Return maximum-likelihood coefficients and truth noise; columns (K, 3, q) are free linear terms throughout.

    Intervals with innovations too large for chance get a larger covariance, which never shrinks again, and the fit is
    repeated: slips and gross errors of the truth are then not fitted as noise. If there are more than a few per cent of
    them and most point the same way, they are signal, and the fit without weights is returned.

    headings : whether the truth has headings; if not, its heading noise is held at a large constant
    start : (m,) noise of an earlier fit, see `NoiseFit.free`; default: an initial guess
    weights : (K,) robust weights to keep, so that likelihoods can be compared; default: estimated
    bursts : whether the model has slip bursts; then any number of outliers is accepted
    """
    weighted = partial(NoiseLikelihood, intervals, components, columns, headings=headings)
    likelihood = weighted(np.ones(len(intervals)) if weights is None else weights)
    guess = likelihood.initial_guess()
    if start is None or len(start) != len(guess):
        start = guess
    elif weights is None:
        # a coefficient that fell to zero while effects were still wrong may be non-zero now
        start = likelihood.revived(start)
    done = plain = likelihood.maximise(start)
    if weights is not None:
        return plain
    for _ in range(_ROBUST_ROUNDS):
        square = np.sum(done.innovations.reshape(-1, 3) ** 2, axis=1)
        if not (worse := outliers(square)).any():
            break
        likelihood = weighted(np.where(worse, done.weights * square / 3.0, done.weights))
        done = likelihood.maximise(likelihood.revived(done.free))
    odd = done.innovations.reshape(-1, 3)[done.weights > 1.0]
    common = np.sum(odd / np.linalg.norm(odd, axis=1)[:, None], axis=0)
    signal = len(odd) > _SIGNAL * len(intervals) and common @ common > 0.5 * len(odd) ** 2
    return plain if signal and not bursts else done
