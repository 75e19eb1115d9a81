"""Heavy tails: whether the odd ones among the innovations are what sums of Student's t look like, and of which degree.

The noise law draws once per increment and a node interval sums many of them, so its tails are lighter than those of a
draw: the density of such a sum is the Fourier transform of the characteristic function of t (Hurst 1995; see Kotz and
Nadarajah 2004, Multivariate t Distributions, section 2.3), taken to the power of how many there are.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.special import gammaln, kve

from odomcorrupt.effects import effect_from_values
from odomcorrupt.study.estimate.config import NODE_S
from odomcorrupt.study.estimate.outliers import during, odd_steps, single_events
from odomcorrupt.study.estimate.whitener import interval_covariance

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.estimate.gauss_newton import Fit

__all__ = ["heavy_tails", "log_density_of_sums"]

_FEWEST = 3
"""Lasting events below which a few large steps may be anything."""
_MOSTLY = 0.5
_INVERSE_DOFS = np.linspace(0.05, 0.45, 17)
_WIDTHS = np.geomspace(0.3, 1.1, 27)
_NAMED_NATS = 10.0
_ARM_M = 0.2
"""How far wheels are from the middle, about: a turn on the spot moves them, too."""
_STILL_M, _USUAL = 1e-3, 0.2
_STRONG = 3.0
"""How many times its median an effect acts at most where tails are measured beside it."""
_RANGE, _SIZE = 120.0, 1 << 14


def heavy_tails(fit: Fit) -> tuple[Effect, float] | None:
    """Return heavy tails and the nats by which they beat normal noise, where events lie on both sides; or None."""
    if (
        fit.problem.approach.spacing_s > NODE_S
    ):  # a truth good to centimetres jumps and floats, and has tails of its own
        return None
    odd_ones = odd_steps(fit)
    lasting = sum(event.lasting for event in odd_ones)
    # where most of what stands out comes back, it is the truth that errs
    if lasting < _FEWEST or lasting < _MOSTLY * len(odd_ones):
        return None
    driven = _driven(fit) & _beside_effects(fit) & ~during(fit, single_events(fit))
    channels = _of_odometry(fit, driven)
    if not channels:
        return None
    # what a robust fit took as wider is shown as it was
    odd = fit.noise.innovations.reshape(-1, 3) * np.sqrt(fit.noise.weights)[:, None]
    used = odd[driven][:, channels]
    draws = max(round(len(fit.problem.nodes.source) / len(fit.problem.nodes)), 1)
    nats = np.array([_likelihood(used, inverse_dof, draws) for inverse_dof in _INVERSE_DOFS])
    variance = used.var(axis=0)
    normal = -0.5 * len(used) * float(np.sum(np.log(2.0 * np.pi * variance) + 1.0))
    best = int(np.argmax(nats))
    gain = float(nats[best]) - normal - 0.5 * float(np.log(used.size))
    if gain < _NAMED_NATS:
        return None
    return effect_from_values("heavy_tails", {"inverse_dof": float(_INVERSE_DOFS[best])}), gain


def _of_odometry(fit: Fit, driven: NDArray[np.bool_]) -> list[int]:
    """Return the channels in which most of the noise is odometry's: of the others' tails the truth's are as likely."""
    nodes = fit.problem.nodes
    q = nodes.covariance(fit.problem.approach.law, fit.noise.coefficients, fit.problem.steps)
    share = np.einsum("kii->ki", q) / np.einsum("kii->ki", interval_covariance(nodes, q, fit.noise.truth))
    usual = np.median(share[driven], axis=0) if driven.any() else np.zeros(3)
    return [c for c in range(3 if fit.problem.headings else 2) if usual[c] > _MOSTLY]


def _driven(fit: Fit) -> NDArray[np.bool_]:
    """Return in which intervals (K,) the robot moved as it usually does.

    Who stands draws nothing: beside a perfect truth his zeros would make all that moves look heavy.
    """
    steps = fit.problem.nodes.odometry_step
    travel = np.hypot(steps[:, 0], steps[:, 1]) + _ARM_M * np.abs(steps[:, 2])
    moving = travel > _STILL_M
    driven: NDArray[np.bool_] = travel > _USUAL * np.median(travel[moving]) if moving.any() else moving
    return driven


def _beside_effects(fit: Fit) -> NDArray[np.bool_]:
    """Return in which intervals (K,) the effects of the model do no more than they usually do.

    Tails are independent of them, and what stands out where a lag or slip acts most is what its form leaves of it.
    """
    if not fit.effects:
        return np.ones(len(fit.problem.nodes), dtype=bool)
    explained = np.sum([fit.problem.explained(effect) for effect in fit.effects], axis=0)
    size = np.linalg.norm(fit.noise.whitener.whiten(explained).reshape(-1, 3), axis=1)
    beside: NDArray[np.bool_] = size <= _STRONG * np.median(size)
    return beside


def _likelihood(values: Array, inverse_dof: float, draws: int) -> float:
    """Return the log likelihood of columns (K, c), each of the width that suits it best."""
    grid, density = log_density_of_sums(inverse_dof, draws)
    total = 0.0
    for column in values.T:
        widths = _WIDTHS * column.std()
        total += max(float(np.interp(column / w, grid, density).sum() - len(column) * np.log(w)) for w in widths)
    return total


def log_density_of_sums(inverse_dof: float, draws: int) -> tuple[Array, Array]:
    """Return places and the log density there of sums of so many draws of t, scaled to variance 1."""
    dof = 1.0 / inverse_dof
    step = 2.0 * _RANGE / _SIZE
    u = np.abs(2.0 * np.pi * np.fft.fftfreq(_SIZE, step)) * np.sqrt((dof - 2.0) / draws)
    inner = np.maximum(u, 1e-9)
    half = dof / 2.0
    # log of K_half(u) u^half / (Gamma(half) 2^(half - 1)), with the exponential taken out of K
    log_phi = np.log(kve(half, inner)) - inner + half * np.log(inner) - gammaln(half) - (half - 1.0) * np.log(2.0)
    density = np.fft.fftshift(np.real(np.fft.ifft(np.exp(draws * np.minimum(log_phi, 0.0))))) / step
    # what rounding leaves of the far tail is no density
    places = np.asarray((np.arange(_SIZE) - _SIZE // 2) * step, dtype=np.float64)
    return places, np.log(np.maximum(density, 1e-12))
