"""Gains that wander: correlated noise, which deterministic effects are easily mistaken for.

A gain g(t) on travel, on turn, or a bias of the yaw rate is a random process with a prior covariance over time; its
marginal likelihood is a sum over eigenvalues, so all amplitudes of one correlation time cost one decomposition
(Rasmussen & Williams 2006, Gaussian Processes for Machine Learning, eq. 5.8, on whitened data).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import eigh

from odomcorrupt.effects.effect import parameters
from odomcorrupt.study.estimate.random_process import (
    FINELY,
    bias_of,
    processes,
    processes_like,
    rooted,
    unit_column,
    with_random,
    without_random,
)
from odomcorrupt.study.select.score import left_over

if TYPE_CHECKING:
    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.estimate.gauss_newton import Fit
    from odomcorrupt.study.estimate.random_process import Process

__all__ = ["COMING_BACK_NATS", "NAMED_NATS", "RandomGain", "random_gains", "remeasured"]

_LEAST_SCALE = 1e-6
NAMED_NATS = 6.0
"""Correlated noise gains at most 3.4 nats on clean data; more than this is a finding."""
COMING_BACK_NATS = 25.0
"""What a bias that comes back has to gain: headings of a truth by SLAM err alike for seconds, and gain up to 20."""


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
    log_count = float(np.log(len(fit.problem.nodes)))
    have = {(e.name, getattr(e, "channel", "")) for e in fit.random}
    found: dict[tuple[str, str], tuple[RandomGain, float]] = {}
    for process in processes():
        # a walk is rough at every scale: with few knots it would lose to a bias that comes back
        design = rooted(fit.problem, process, FINELY) if process.tau is None else rooted(fit.problem, process)
        nats, scale = _evidence(fit, believed, design, process)
        effect = process.kind(**{process.scale: scale, **process.fixed})
        gain = RandomGain(effect, nats - 0.5 * process.numbers * log_count)
        key = (effect.name, getattr(effect, "channel", ""))
        if key not in found or gain.nats > found[key][0].nats:
            found[key] = gain, COMING_BACK_NATS if process.comes_back else NAMED_NATS
    named = [gain for key, (gain, least) in found.items() if gain.nats > least and key not in have]
    return sorted(named, key=lambda g: g.nats, reverse=True)


def remeasured(fit: Fit, believed: Array, effect: Effect) -> Effect:
    """Return a wandering gain that a fit believes, its parameters measured anew beside the noise of the fit."""
    others = [e for e in fit.random if e is not effect]
    noise = with_random(without_random(fit.noise, fit.problem, believed), fit.problem, believed, others)
    bare = replace(fit, noise=noise, random=tuple(others))
    best = max(
        (
            (_evidence(bare, believed, rooted(fit.problem, process, FINELY), process), process)
            for process in processes_like(effect, beside=True)
        ),
        key=lambda found: found[0][0],
    )
    (_, scale), process = best
    return process.kind(**{process.scale: scale, **process.fixed})


def _evidence(fit: Fit, believed: Array, design: Array, process: Process) -> tuple[float, float]:
    """Return the nats that the best scale of a process gains, and that scale."""
    if process.unit is bias_of:
        # about what a bias wanders, and where a walk starts, is not its business
        believed = np.concatenate((believed, unit_column(fit.problem, process)[:, :, None]), axis=2)
    left = left_over(fit, believed)
    white, r = left.of(fit.noise.whitener.whiten(design)), left.residual
    strength, vectors = eigh(white.T @ white)
    strength = np.maximum(strength, 0.0)
    score = (vectors.T @ (white.T @ r)) ** 2
    (most,) = (p.high for p in parameters(process.kind) if p.name == process.scale)
    scales = np.geomspace(_LEAST_SCALE, most, 121)
    for _ in range(2):
        q = scales[:, None] ** 2
        gains = 0.5 * np.sum(q * score / (1.0 + q * strength) - np.log1p(q * strength), axis=1)
        best = int(np.argmax(gains))
        nats, scale = float(gains[best]), float(scales[best])
        scales = np.geomspace(0.9 * scale, min(1.1 * scale, most), 21)
    return nats, scale
