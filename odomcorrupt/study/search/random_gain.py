"""Gains that wander: correlated noise, which deterministic effects are easily mistaken for.

A gain g(t) on travel, on turn, or a bias of the yaw rate is a random process with a prior covariance over time; its
marginal likelihood is a sum over eigenvalues, so all amplitudes of one correlation time cost one decomposition
(Rasmussen & Williams 2006, Gaussian Processes for Machine Learning, eq. 5.8, on whitened data).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import eigh

from odomcorrupt.study.fitting.random_process import processes, rooted, unit_column
from odomcorrupt.study.search.score import left_over

if TYPE_CHECKING:
    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.pose import Array
    from odomcorrupt.study.fitting.gauss_newton import Fit
    from odomcorrupt.study.fitting.random_process import Process

__all__ = ["NAMED_NATS", "RandomGain", "random_gains"]

NAMED_NATS = 6.0
"""Correlated noise gains at most 3.4 nats on clean data; more than this is a finding."""


@dataclass(frozen=True, slots=True)
class RandomGain:
    """A wandering gain.

    effect : what it is called and its parameters: gauss_markov or gyro_bias_walk
    nats : log likelihood it gains, less what its parameters would gain by chance
    """

    effect: Effect
    nats: float


def random_gains(fit: Fit, believed: Array) -> list[RandomGain]:
    """Return the wandering gains that the residual of a fit shows, the plainest first.

    Parameters
    ----------
    fit : the fitted model
    believed : (K, 3, q)
        Columns of what is believed already.

    """
    price = float(np.log(len(fit.problem.nodes)))
    have = {(e.name, getattr(e, "channel", "")) for e in fit.random}
    found = []
    for process in processes():
        design = rooted(fit.problem, process)
        nats, scale = _evidence(fit, believed, design, process)
        effect = process.kind(**{process.scale: scale, **process.fixed})
        if nats - price > NAMED_NATS and (effect.name, getattr(effect, "channel", "")) not in have:
            found.append(RandomGain(effect, nats - price))
    return sorted(found, key=lambda g: g.nats, reverse=True)


def _evidence(fit: Fit, believed: Array, design: Array, process: Process) -> tuple[float, float]:
    """Return the nats that the best scale of a process gains, and that scale."""
    if process.tau is None:
        # a walk starts anywhere: the constant is not its business
        believed = np.concatenate((believed, unit_column(fit.problem, process)[:, :, None]), axis=2)
    left = left_over(fit, believed)
    white, r = left.of(fit.noise.whitener.whiten(design)), left.residual
    strength, vectors = eigh(white.T @ white)
    strength = np.maximum(strength, 0.0)
    score = (vectors.T @ (white.T @ r)) ** 2
    scales = np.geomspace(1e-6, 0.3, 121)
    q = scales[:, None] ** 2
    gains = 0.5 * np.sum(q * score / (1.0 + q * strength) - np.log1p(q * strength), axis=1)
    best = int(np.argmax(gains))
    return float(gains[best]), float(scales[best])
