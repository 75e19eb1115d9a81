"""Test for heavy-tailed noise: whether innovations are sums of Student's t draws, and of which degrees of freedom.

The noise law draws once per increment. An interval sums many draws, so its tails are lighter than those of one draw.
The density of the sum is the Fourier transform of the characteristic function of t (Hurst 1995; see Kotz and Nadarajah
2004, Multivariate t Distributions, section 2.3), raised to the power of the number of draws.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.special import gammaln, kve

from odomcorrupt.effects import effect_from_values
from odomcorrupt.study.estimate.config import INTERVAL_S
from odomcorrupt.study.estimate.outliers import during, odd_steps, single_events
from odomcorrupt.study.estimate.whitener import interval_covariance

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.estimate.gauss_newton import Fit

_MOSTLY = 0.5
_INVERSE_DOFS = np.linspace(0.05, 0.45, 17)
_WIDTHS = np.geomspace(0.3, 1.1, 27)
_NAMED_NATS = 10.0
_ARM_M = 0.2
"""Approximate distance of the wheels from the robot's centre, m: counts a turn on the spot as wheel travel."""
_STILL_M, _USUAL = 1e-3, 0.2
_RANGE, _SIZE = 120.0, 1 << 14


def heavy_tails(fit: Fit) -> tuple[Effect, float] | None:
    """Return the heavy_tails effect and its log-likelihood gain over normal noise in nats, or None if not supported."""
    if (
        fit.problem.approach.spacing_s > INTERVAL_S
    ):  # a truth with errors of centimetres jumps and drifts: it has heavy tails itself
        return None
    odd_ones = odd_steps(fit)
    lasting = sum(event.lasting for event in odd_ones)
    # if most outliers are reversed later, they are errors of the truth
    if not lasting or lasting < _MOSTLY * len(odd_ones):
        return None
    driven = _driven(fit) & ~during(fit, single_events(fit))
    channels = _of_odometry(fit, driven)
    if not channels:
        return None
    # undo the robust weights, which down-weighted the outliers
    odd = fit.noise.innovations.reshape(-1, 3) * np.sqrt(fit.noise.weights)[:, None]
    used = odd[driven][:, channels]
    draws = max(round(len(fit.problem.intervals.source) / len(fit.problem.intervals)), 1)
    nats = np.array([_likelihood(used, inverse_dof, draws) for inverse_dof in _INVERSE_DOFS])
    variance = used.var(axis=0)
    normal = -0.5 * len(used) * float(np.sum(np.log(2.0 * np.pi * variance) + 1.0))
    best = int(np.argmax(nats))
    gain = float(nats[best]) - normal - 0.5 * float(np.log(used.size))
    if gain < _NAMED_NATS:
        return None
    return effect_from_values("heavy_tails", {"inverse_dof": float(_INVERSE_DOFS[best])}), gain


def _of_odometry(fit: Fit, driven: NDArray[np.bool_]) -> list[int]:
    """Return the channels in which odometry has most of the noise; elsewhere tails may belong to the truth.

    Noise within the remainder of an effect (see `Effect.remainder`) is that remainder: it differs between speeds, so
    that all of it together has heavy tails. The noise across is that of the heading.
    """
    if not driven.any():
        return []
    intervals = fit.problem.intervals
    q = intervals.covariance(fit.problem.approach.law, fit.noise.coefficients, fit.problem.steps)
    own = np.einsum("kii->ki", q)
    usual = np.median((own / np.einsum("kii->ki", interval_covariance(intervals, q, fit.noise.truth)))[driven], axis=0)
    speed = np.sqrt(np.mean(own[driven] / (intervals.end_s - intervals.start_s)[driven, None] ** 2, axis=0))
    along, yaw = np.sum([(0.0, 0.0), *(effect.remainder for effect in fit.effects)], axis=0)
    explained = speed[[0, 2, 2]] <= (along, yaw, yaw)
    return [c for c in range(3 if fit.problem.headings else 2) if usual[c] > _MOSTLY and not explained[c]]


def _driven(fit: Fit) -> NDArray[np.bool_]:
    """Return a mask (K,) of intervals in which the robot moved a usual distance.

    A robot at rest has no noise: with a perfect truth, its zeros would make all moving intervals look heavy-tailed.
    """
    steps = fit.problem.intervals.odometry_step
    travel = np.hypot(steps[:, 0], steps[:, 1]) + _ARM_M * np.abs(steps[:, 2])
    moving = travel > _STILL_M
    return travel > _USUAL * np.median(travel[moving]) if moving.any() else moving


def _likelihood(values: Array, inverse_dof: float, draws: int) -> float:
    """Return the log likelihood of columns (K, c), each with its best-fitting width."""
    grid, density = log_density_of_sums(inverse_dof, draws)
    total = 0.0
    for column in values.T:
        widths = _WIDTHS * column.std()
        total += max(float(np.interp(column / w, grid, density).sum() - len(column) * np.log(w)) for w in widths)
    return total


def log_density_of_sums(inverse_dof: float, draws: int) -> tuple[Array, Array]:
    """Return a grid (n,) and the log density (n,) on it of a sum of `draws` Student's t draws, scaled to variance 1."""
    dof = 1.0 / inverse_dof
    step = 2.0 * _RANGE / _SIZE
    u = np.abs(2.0 * np.pi * np.fft.fftfreq(_SIZE, step)) * np.sqrt((dof - 2.0) / draws)
    inner = np.maximum(u, 1e-9)
    half = dof / 2.0
    # log of K_half(u) u^half / (Gamma(half) 2^(half - 1)), with the exponential taken out of K
    log_phi = np.log(kve(half, inner)) - inner + half * np.log(inner) - gammaln(half) - (half - 1.0) * np.log(2.0)
    density = np.fft.fftshift(np.real(np.fft.ifft(np.exp(draws * np.minimum(log_phi, 0.0))))) / step
    # far tail: below the rounding error of the transform, so limited from below
    places = np.asarray((np.arange(_SIZE) - _SIZE // 2) * step, dtype=np.float64)
    return places, np.log(np.maximum(density, 1e-12))
