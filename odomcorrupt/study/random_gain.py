"""Gains that wander: correlated noise, which deterministic effects are easily mistaken for.

A gain g(t) on travel, on turn, or a bias of the yaw rate is a random process with a prior covariance over time; its
marginal likelihood is a sum over eigenvalues, so all amplitudes of one correlation time cost one decomposition
(Rasmussen & Williams 2006, Gaussian Processes for Machine Learning, eq. 5.8, on whitened data).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import cholesky, eigh

from odomcorrupt.effects import registry
from odomcorrupt.effects.effect import stacked
from odomcorrupt.study.noise_fit import estimated

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from odomcorrupt.effects.effect import Effect, Motion
    from odomcorrupt.pose import Array
    from odomcorrupt.study.fit import Fit
    from odomcorrupt.study.noise_fit import NoiseFit
    from odomcorrupt.study.problem import Problem

__all__ = ["NAMED_NATS", "WANDERING", "RandomGain", "random_gains", "with_random"]

NAMED_NATS = 6.0
"""Correlated noise gains at most 3.4 nats on clean data; more than this is a finding."""
WANDERING = ("gauss_markov", "gyro_bias_walk")
"""Random effects that a fit can believe."""
_TAUS_S = (2.0, 5.0, 15.0, 40.0)
_MOST_KNOTS = 240
_WALK_S = 20.0
_BREAK_S = 1e3


@dataclass(frozen=True, slots=True)
class RandomGain:
    """A wandering gain.

    effect : what it is called and its parameters: gauss_markov or gyro_bias_walk
    nats : log likelihood it gains, less what its parameters would gain by chance
    """

    effect: Effect
    nats: float


@dataclass(frozen=True, slots=True)
class _Process:
    """A gain as a Gaussian process: what a unit of it does, and its correlation time; None: a walk of unit density."""

    kind: type[Effect]
    fixed: dict[str, str | float]
    scale: str
    unit: Callable[[Motion], Array]
    tau: float | None


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
    for process in _processes():
        design = _rooted(fit.problem, process)
        nats, scale = _evidence(fit, believed, design, process)
        effect = process.kind(**{process.scale: scale, **process.fixed})
        if nats - price > NAMED_NATS and (effect.name, getattr(effect, "channel", "")) not in have:
            found.append(RandomGain(effect, nats - price))
    return sorted(found, key=lambda g: g.nats, reverse=True)


def with_random(noise: NoiseFit, problem: Problem, columns: Array, random: Sequence[Effect]) -> NoiseFit:
    """Return a fit of noise with wandering gains in its covariance, everything linear estimated anew."""
    if not random:
        return noise
    white = noise.whitener
    designs = []
    for effect in random:
        process = next(p for p in _processes(effect) if p.kind is type(effect) and _same(p, effect))
        designs.append(getattr(effect, process.scale) * white.whiten(_rooted(problem, process)))
    directions, size, _ = np.linalg.svd(np.concatenate(designs, axis=1), full_matrices=False)
    growth = 1.0 + size**2
    wider = replace(
        white,
        directions=directions,
        shrink=1.0 / np.sqrt(growth),
        log_det=white.log_det + 0.5 * float(np.log(growth).sum()),
    )
    return estimated(noise, wider, np.concatenate((problem.nodes.residual[:, :, None], columns), axis=2))


def _processes(like: Effect | None = None) -> list[_Process]:
    """Return the processes to try, or with the correlation time of an effect that is believed."""
    taus = _TAUS_S if like is None else (getattr(like, "tau", _TAUS_S[0]),)
    kinds = registry()
    markov = [
        _Process(kinds["gauss_markov"], {"tau": tau, "channel": channel}, "sigma", unit, tau)
        for channel, unit in (("along", _along), ("yaw", _turn))
        for tau in taus
    ]
    return [*markov, _Process(kinds["gyro_bias_walk"], {}, "density", _bias, None)]


def _same(process: _Process, effect: Effect) -> bool:
    return all(getattr(effect, name) == value for name, value in process.fixed.items())


def _along(motion: Motion) -> Array:
    return stacked(motion.v, 0.0, 0.0, motion.v)


def _turn(motion: Motion) -> Array:
    return stacked(0.0, 0.0, motion.omega, motion.v)


def _bias(motion: Motion) -> Array:
    return stacked(0.0, 0.0, 1.0, motion.v)


def _unit_column(problem: Problem, process: _Process) -> Array:
    return problem.nodes.column(np.concatenate([-process.unit(m) * m.dt_s[:, None] for m in problem.motions]))


def _rooted(problem: Problem, process: _Process) -> Array:
    """Return columns (K, 3, m) whose independent standard normal factors make the process, at scale 1."""
    nodes = problem.nodes
    # runs lie far apart: what wandered in one says nothing about the next
    time = nodes.end_s + problem.run * (float(nodes.end_s.max()) + 1e4)
    tau = process.tau
    gaps = np.diff(time)
    step = max((_WALK_S if tau is None else tau) / 2.0, float(gaps[gaps < _BREAK_S].sum()) / _MOST_KNOTS)
    cells = np.unique(np.floor(time / step))
    knots = np.unique(np.concatenate((cells, cells + 1.0))) * step
    hats = np.maximum(1.0 - np.abs(time[:, None] - knots) / step, 0.0)
    prior = np.exp(-np.abs(knots[:, None] - knots) / tau) if tau is not None else _walk(knots)
    root = cholesky(prior + 1e-9 * np.eye(len(knots)) * np.trace(prior) / len(knots), lower=True)
    rooted: Array = _unit_column(problem, process)[:, :, None] * (hats @ root)[:, None, :]
    return rooted


def _evidence(fit: Fit, believed: Array, design: Array, process: _Process) -> tuple[float, float]:
    """Return the nats that the best scale of a process gains, and that scale."""
    whiten = fit.noise.whitener.whiten
    white, r = whiten(design), fit.noise.innovations
    if process.tau is None:
        # a walk starts anywhere: the constant is not its business
        believed = np.concatenate((believed, _unit_column(fit.problem, process)[:, :, None]), axis=2)
    if believed.shape[2]:
        basis = np.linalg.qr(whiten(believed))[0]
        white = white - basis @ (basis.T @ white)
        r = r - basis @ (basis.T @ r)
    strength, vectors = eigh(white.T @ white)
    strength = np.maximum(strength, 0.0)
    score = (vectors.T @ (white.T @ r)) ** 2
    scales = np.geomspace(1e-6, 0.3, 121)
    q = scales[:, None] ** 2
    gains = 0.5 * np.sum(q * score / (1.0 + q * strength) - np.log1p(q * strength), axis=1)
    best = int(np.argmax(gains))
    return float(gains[best]), float(scales[best])


def _walk(knots: Array) -> Array:
    """Return the covariance of a random walk of unit density, anew after every long break."""
    start = np.concatenate(([True], np.diff(knots) > _BREAK_S))
    begin = knots[np.maximum.accumulate(np.where(start, np.arange(len(knots)), 0))]
    since = knots - begin + 1.0
    shared: Array = np.minimum(since[:, None], since) * (begin[:, None] == begin)
    return shared
