"""Likelihood of the residuals as a function of the noise parameters, and its maximisation; linear terms are profiled.

The maximum is found by Newton steps with the average information, within a box and a trust region. The average of
observed and expected information needs no second derivatives and is never negative; near the maximum its steps are
nearly Newton's (Gilmour, Thompson & Cullis 1995, Biometrics 51, 1440). It changes slowly, so it is recomputed only
after a step whose gain differs from the predicted one.

The covariance of the residuals under a noise law is a weighted sum of fixed matrices, its variance components.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import blas, lapack

from odomcorrupt.errors import FitError
from odomcorrupt.model.motion_model import TruthNoise
from odomcorrupt.model.noise_laws import Coefficients, magnitudes
from odomcorrupt.study.estimate.banded import inverse_band
from odomcorrupt.study.estimate.whitener import (
    BAND,
    Whitener,
    band_of,
    factored,
    fixed_band,
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
_TRUTH_LOW = np.log(np.array([2e-5, 2e-5, 1e-6]))
_TRUTH_HIGH = np.log(np.array([1.0, 1.0, 0.3]))
_USUAL, _SPREAD = np.log(np.array([0.02, 0.01])), 0.7
"""Prior of a localisation's errors, m and rad: median, and standard deviation of its logarithm. Particle filters with
likelihood fields (as nav2_amcl) in two simulated rooms, with cells of 2.5 to 10 cm, 500 to 2000 particles, alphas of
0.05 to 0.2 and updates after 0.1 or 0.25 m, had errors of 1.3 to 4 cm and 0.4 to 1.4 deg; slam_toolbox has 1 cm (the
protocol of the benchmark of ordinary recordings). Without it a perfect localisation of a noisy robot may be as likely
as the reverse."""
_NO_RANDOM_WALK = 2e-6
_NATS, _PROFILE_NATS = 1e-4, 1e-3
"""Predicted gain of the next step, nats, below which the iteration ends; the second value is for profiles."""
_DEAD, _FAINT = 1e-4, 1e-3
"""Coefficient below which the likelihood has no gradient, and the value from which such a coefficient is restarted."""
_MOST_STEPS = 60
_FAR, _NEAREST = 3.0, 1e-3
"""Largest and smallest trust region, in logarithms."""
_AS_PROMISED = 0.2
"""Relative error of a step's predicted gain up to which the information matrix is kept."""
_RIDGE = 1e-6
_SWEEPS, _STILL = 40, 1e-3
_BENDS = (0.7, 3.0)
"""Bounds of the ratio of the curvature along a step to that of the information matrix."""


def prior_of_errors(free: Array) -> float:
    """Return the log prior (nats) of logarithms (2,) of a localisation's errors in position (m) and heading (rad)."""
    return -0.5 * float(np.sum(((free - _USUAL) / _SPREAD) ** 2))


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


@dataclass(frozen=True, slots=True)
class _Box:
    """Bounds (m,) of the maximisation; a parameter with equal bounds is held."""

    low: Array
    high: Array


class NoiseLikelihood:
    """Likelihood of residuals for given noise; the covariance is a weighted sum of bands that are computed once.

    Parameters
    ----------
    intervals : the residuals of K intervals
    components : contribution of each coefficient of the law to their covariance
    columns : (K, 3, m)
        Columns of free linear parameters.
    weights : (K,)
        Robust factors on each interval's covariance.
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
        # arrays for LAPACK are in Fortran order, bands included
        self._stacked = by_column(np.concatenate((intervals.residual[:, :, None], columns), axis=2))
        bands = [band_of(*odometry_piece(intervals, part * weights[:, None, None])) for part in components.parts()]
        bands += [band_of(*piece) for piece in truth_pieces(intervals)]
        self._bands = np.stack([band.T for band in bands]).reshape(len(bands), -1)
        self._floor = np.asfortranarray(fixed_band(intervals))
        self._rho = rho_of(intervals)
        self._localised = bool(intervals.localised.all())

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
        white = factored(self._sum(self._shares(free)) + self._floor, self._rho)
        k = Coefficients(**dict(zip(NAMES, map(float, coefficients), strict=True)))
        nothing = np.zeros(0)
        blank = NoiseFit(
            coefficients=k,
            truth=truth,
            log_likelihood=0.0,
            theta=nothing,
            theta_covariance=nothing,
            weights=self._weights,
            innovations=nothing,
            whitener=white,
            free=free,
        )
        return estimated(blank, white, self._stacked)

    def posterior(self, noise: NoiseFit) -> float:
        """Return the log posterior of a fit, nats: its log likelihood plus the log prior of a localisation's errors."""
        return noise.log_likelihood + (prior_of_errors(noise.free[-3:-1]) if self._localised else 0.0)

    def _usual(self, free: Array) -> Array:
        """Return the prior median (m,) of the noise parameters; those without a prior keep their value."""
        usual = free.copy()
        if self._localised:
            usual[-3:-1] = _USUAL
        return usual

    def maximise(self, free: Array, *, fixed: int | None = None) -> NoiseFit:
        """Return the fit of largest posterior from a start (m,); less precise with one held (for a profile)."""
        active = len(self._components.active)
        low = np.concatenate((np.full(active, _LOW), _TRUTH_LOW))
        high = np.concatenate((np.full(active, _HIGH), _TRUTH_HIGH))
        if not self._headings:
            low[active + 1] = high[active + 1] = np.log(UNKNOWN_RAD)
        if self._rho is not None or self._localised:  # mean-reverting errors do not accumulate
            high[-1] = low[-1]
        if fixed is not None:
            low[fixed] = high[fixed] = free[fixed]
        return self._ascend(np.clip(free, low, high), _Box(low, high), _NATS if fixed is None else _PROFILE_NATS)

    def restart(self, done: NoiseFit) -> NoiseFit:
        """Return the better of a maximum and the one reached from a start without near-zero coefficients.

        Noise of travel, of turns and a random walk of the truth are aliased at constant speed, and early steps may
        reduce a coefficient to where the likelihood has no gradient.
        """
        if not np.any(done.free[: len(self._components.active)] < np.log(_DEAD)):
            return done
        start = self.revived(done.free)
        start[-1] = _TRUTH_LOW[-1]
        return max(done, self.maximise(start), key=self.posterior)

    def revived(self, free: Array) -> Array:
        """Return noise (m,) with near-zero coefficients raised to where the likelihood has a gradient."""
        active = len(self._components.active)
        coefficients, truth = free[:active], free[active:]
        lively = np.where(coefficients < np.log(_DEAD), np.log(_FAINT), coefficients)
        return np.concatenate((lively, np.maximum(truth, np.log(_DEAD))))

    def slope(self, done: NoiseFit, movable: NDArray[np.int64]) -> Array:
        """Return the gradient (m,) of the log posterior in the movable parameters, with the columns held.

        With p = V^-1 r, it is half of p' dV p - trace(V^-1 dV), plus the prior's; dV is inside the band.
        """
        factor = done.whitener.factor
        pull, _ = lapack.dtbtrs(factor, done.innovations, uplo="L", trans="T")
        lever = -inverse_band(factor)
        for below in range(BAND + 1):
            count = len(pull) - below
            lever[below, :count] += pull[below:] * pull[:count]
        # entries below the diagonal also count for those above it
        lever[0] *= 0.5
        by_band = self._bands @ np.ascontiguousarray(lever.T).ravel()
        prior = (self._usual(done.free) - done.free) / _SPREAD**2
        return (self._share_slopes(done.free) @ by_band + prior)[movable]

    def information(self, done: NoiseFit, movable: NDArray[np.int64]) -> Array:
        """Return the average information (m, m) of the movable parameters.

        Gilmour, Thompson & Cullis 1995, Biometrics 51, eq. 5: half of (dV p)' P (dV p), with p = P r.
        """
        white = done.whitener
        pull, _ = lapack.dtbtrs(white.factor, done.innovations, uplo="L", trans="T")
        changes = self._share_slopes(done.free)[movable] @ self._bands
        rows = self._floor.shape[::-1]
        pushes = np.empty((len(pull), len(movable)), order="F")
        for i, change in enumerate(changes):
            pushes[:, i] = blas.dsbmv(BAND, 1.0, change.reshape(rows).T, pull, lower=1)
        pushes = white.solved(pushes)
        information: Array = 0.5 * pushes.T @ pushes
        if self._localised:
            sizes = np.isin(movable, len(done.free) - np.array([3, 2]))
            information += np.diag(sizes / _SPREAD**2)
        return information

    def _ascend(self, begin: Array, box: _Box, enough: float) -> NoiseFit:
        """Return the maximum reached from `begin`; ends when the next step's predicted gain is below `enough` nats."""
        movable = np.flatnonzero(box.low < box.high)
        done, reach, bend = self.evaluate(begin), _FAR, 1.0
        slope, information, fresh = (self.slope(done, movable), self.information(done, movable), True)
        for _ in range(_MOST_STEPS):
            here = done.free[movable]
            room = (np.maximum(box.low[movable] - here, -reach), np.minimum(box.high[movable] - here, reach))
            step = _best_step(slope, bend * information, *room)
            promise = float(slope @ step - 0.5 * bend * step @ information @ step)
            if promise < enough:
                # the information is fresh, or its last prediction was right
                break
            free = done.free.copy()
            free[movable] += step
            new = self.evaluate(np.clip(free, box.low, box.high))
            gain = self.posterior(new) - self.posterior(done)
            if gain > 0.0:
                done, before, slope = new, slope, self.slope(new, movable)
                reach = min(2.0 * reach, _FAR)
                # outliers make the curvature at the maximum larger than the average information
                bend = float(np.clip((before - slope) @ step / (step @ information @ step), *_BENDS))
                if abs(gain - promise) < _AS_PROMISED * promise:
                    fresh = False
                    continue
            elif fresh:
                reach = 0.3 * min(reach, float(np.abs(step).max()))
                if reach < _NEAREST:
                    break
                continue
            information, fresh = self.information(done, movable), True
        return done

    def _shares(self, free: Array) -> Array:
        """Return the weight of every band."""
        coefficients, truth = self._unpack(free)
        return np.concatenate((self._components.shares(coefficients), truth_weights(truth)))

    def _share_slopes(self, free: Array) -> Array:
        """Return the derivatives (m, bands) of every band's weight by every parameter."""
        coefficients, truth = self._unpack(free)
        own, of_truth = self._components.share_slopes(coefficients), truth_weights(truth)
        slopes = np.zeros((len(own) + len(of_truth), own.shape[1] + len(of_truth)))
        slopes[: len(own), : own.shape[1]] = own
        slopes[len(own) :, own.shape[1] :] = 2.0 * np.diag(of_truth)
        return slopes

    def _sum(self, shares: Array) -> Array:
        """Return the weighted sum of the bands."""
        return (shares @ self._bands).reshape(self._floor.shape[::-1]).T

    def _unpack(self, free: Array) -> tuple[Array, TruthNoise]:
        """Return coefficients (8,) and truth noise; a coefficient at its lower bound is exactly zero."""
        active = self._components.active
        coefficients = np.zeros(len(NAMES))
        log_k = free[: len(active)]
        coefficients[active] = np.where(log_k > _LOW + 0.1, np.exp(log_k), 0.0)
        xy, yaw, random_walk = np.exp(free[len(active) :])
        return coefficients, TruthNoise(
            float(xy), float(yaw), float(random_walk) if random_walk > _NO_RANDOM_WALK else 0.0
        )


def _best_step(slope: Array, information: Array, low: Array, high: Array) -> Array:
    """Return the step (m,) to the maximum of a quadratic within bounds that contain zero."""
    whole = information + _RIDGE * np.eye(len(slope))
    step = np.linalg.solve(whole, slope)
    inside: Array = np.clip(step, low, high)
    if np.array_equal(inside, step):
        return inside
    # coordinate descent: maximise over each parameter with the others held
    for _ in range(_SWEEPS):
        before = inside.copy()
        for i in range(len(slope)):
            inside[i] += (slope[i] - whole[i] @ inside) / whole[i, i]
            inside[i] = min(max(inside[i], low[i]), high[i])
        if np.abs(inside - before).max() < _STILL:
            break
    return inside


def by_column(columns: Array) -> Array:
    """Return columns (K, 3, c) as (3 K, c), each contiguous in memory."""
    return np.asfortranarray(columns.reshape(-1, columns.shape[2]))


def estimated(noise: NoiseFit, white: Whitener, stacked: Array) -> NoiseFit:
    """Return a fit with its linear part re-estimated; `stacked` (3 K, 1 + m) is the residual and the columns."""
    whitened = white.whitened(stacked)
    r, b = whitened[:, 0], whitened[:, 1:]
    theta, covariance = np.zeros(b.shape[1]), np.zeros((b.shape[1], b.shape[1]))
    if b.shape[1]:
        covariance = pseudo_inverse(b.T @ b)
        theta = covariance @ (b.T @ r)
        r = r - b @ theta
    return replace(
        noise,
        log_likelihood=white.log_likelihood(r),
        theta=theta,
        theta_covariance=covariance,
        innovations=r,
        whitener=white,
    )


def pseudo_inverse(normal: Array) -> Array:
    """Return the pseudo-inverse of a normal matrix, scaled for mixed units; aliased columns share their estimate.

    Rows and columns of a parameter on which no data depend are zero: its estimate does not move.
    """
    length = np.sqrt(np.diag(normal))
    scale = np.divide(1.0, length, out=np.zeros_like(length), where=length > 0.0)
    both = np.outer(scale, scale)
    return np.linalg.pinv(normal * both, rcond=1e-10, hermitian=True) * both
