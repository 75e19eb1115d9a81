"""Which law of the unknown explains most of what is left: all tried quickly, the best of each kind exactly.

For the quick look a law is averaged over each interval between nodes, so that a thousand laws cost a few whitenings;
what is told of a law comes from its exact columns.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from itertools import groupby
from typing import TYPE_CHECKING, Any

import numpy as np

from odomcorrupt.study.search.laws import CHANNELS, MOVES, VALUES, laws, moves_of
from odomcorrupt.study.search.periodic import waves
from odomcorrupt.study.search.score import left_over, score_columns

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from odomcorrupt.effects.effect import Motion
    from odomcorrupt.effects.user import UserEffect
    from odomcorrupt.pose import Array
    from odomcorrupt.study.fitting.gauss_newton import Fit
    from odomcorrupt.study.likelihood.nodes import Nodes
    from odomcorrupt.study.search.laws import Law
    from odomcorrupt.study.search.score import ColumnScore

__all__ = ["ScoredLaw", "best_laws", "law_price", "most_nats"]

_KINDS = (len(VALUES) + 2) * sum(len(moves_of(channel)) for channel in CHANNELS)
"""Drivers times channels times what moves: any of these might have come first."""
_LEVEL = 0.01
_SAMPLES = 5
"""Increments of each interval that the quick look sees."""
_LEAST_NATS = 3.0
"""By how much a law must gain more than its price in the quick look to be worth an exact one."""


@dataclass(frozen=True, slots=True)
class ScoredLaw:
    """A law of a channel, and what the residual says about it.

    price : nats that it must gain, see `law_price`
    nats : log likelihood it gains, less that
    p : probability of such a score anywhere among the laws without any dependence
    """

    law: Law
    channel: str
    move: str
    score: ColumnScore
    price: float
    nats: float
    p: float

    @property
    def effect(self) -> UserEffect:
        """The law as an effect, with its estimated numbers."""
        return self.law.effect(self.channel, self.move, self.score.estimate.tolist())

    @property
    def expression(self) -> str:
        """The law with its numbers filled in."""
        return self.law.expression(self.channel, self.move, self.score.estimate.tolist())


def law_price(law: Law, count: int) -> float:
    """Return the nats that a law must gain on so many intervals: for its numbers, and for all that it was chosen from.

    Half of the odds of a family go to its plainest member.
    """
    return float(0.5 * len(law.parts) * np.log(count) + np.log(2.0 * law.trials * _KINDS))


def best_laws(fit: Fit, believed: Array) -> list[ScoredLaw]:
    """Return the best law of each driver and channel that explains more than chance does, the plainest first.

    Parameters
    ----------
    fit : the fitted model
    believed : (K, 3, q)
        Columns of what is believed already.

    """
    found = []
    for law in _likeliest(fit, believed):
        score, nats = law.score, 0.5 * law.score.statistic / law.score.inflation - law.price
        if score.separable and nats > 0.0 and law.p < _LEVEL and score.held_out_nats > score.held_out_error:
            found.append(replace(law, nats=nats))
    return sorted(found, key=lambda s: s.nats, reverse=True)


def most_nats(fit: Fit, believed: Array) -> float:
    """Return what the best of all laws gains less its price, without gates; 0 where none is worth a look."""
    return max((law.nats for law in _likeliest(fit, believed)), default=0.0)


def _likeliest(fit: Fit, believed: Array) -> list[ScoredLaw]:
    """Return the best law of each driver and channel, scored exactly."""
    tried = _quick(fit, believed, laws(fit.problem.motions)) + _quick_waves(fit, believed)
    tried.sort(key=lambda t: (t[0].driver, t[1], -t[3]))
    best = [next(group) for _, group in groupby(tried, key=lambda t: (t[0].driver, t[1]))]
    chosen = [t for t in best if t[3] > _LEAST_NATS]
    groups = [exact_columns(fit, law, channel, move) for law, channel, move, _ in chosen]
    scores = score_columns(fit, groups, believed) if groups else []
    found = []
    for (law, channel, move, _), score in zip(chosen, scores, strict=True):
        price = law_price(law, len(fit.problem.nodes))
        p = score.p * 2.0 * law.trials * _KINDS / len(chosen)
        found.append(ScoredLaw(law, channel, move, score, price, 0.5 * score.statistic - price, p))
    return found


def exact_columns(fit: Fit, law: Law, channel: str, move: str) -> Array:
    """Return (K, 3, p): what a unit of each number of a law does to the residuals."""
    motions, nodes = fit.problem.motions, fit.problem.nodes
    moved = _joined(motions, move)
    values = [np.concatenate([part(m) for m in motions]) for part in law.parts]
    return np.stack([nodes.column(_error(channel, moved * value)) for value in values], axis=2)


def _quick(fit: Fit, believed: Array, tried: Sequence[Law]) -> list[tuple[Law, str, str, float]]:
    """Return every law, channel and move with the nats it gains, about, less its price."""
    motions, nodes = fit.problem.motions, fit.problem.nodes
    whiten, left = fit.noise.whitener.whiten, left_over(fit, believed)
    seen = _sampled(nodes, motions)
    values = np.stack([part(seen) for law in tried for part in law.parts], axis=1)
    first = np.concatenate(([0], np.cumsum([len(law.parts) for law in tried]))).astype(np.int64)
    price = np.array([law_price(law, len(nodes)) for law in tried])
    means = {move: _means(values, np.abs(MOVES[move](seen)), len(nodes)) for move in ("v", "omega")}
    found = []
    for channel in CHANNELS:
        for move in moves_of(channel):
            plain = nodes.column(_error(channel, _joined(motions, move)))
            mean = means["omega" if move == "omega" else "v"]
            white = whiten(plain[:, :, None] * mean[:, None, :])
            own = np.einsum("ij,ij->j", white, white)
            gains = _gains(left.of(white), own, left.residual, first)
            found += [(law, channel, move, float(g)) for law, g in zip(tried, gains - price, strict=True)]
    return found


def _gains(white: Array, own: Array, r: Array, first: NDArray[np.int64]) -> Array:
    """Return half the chi-square of each group of one or two neighbouring columns."""
    score, length = white.T @ r, np.einsum("ij,ij->j", white, white)
    kept = length > 1e-3 * np.maximum(own, 1e-300)
    single = np.where(kept, score**2 / np.maximum(length, 1e-300), 0.0)
    gains = 0.5 * np.add.reduceat(single, first[:-1])
    for i in np.flatnonzero(np.diff(first) == 2):
        pair = slice(first[i], first[i] + 2)
        normal = white[:, pair].T @ white[:, pair]
        if kept[pair].all() and np.linalg.cond(normal) < 1e6:
            gains[i] = 0.5 * score[pair] @ np.linalg.solve(normal, score[pair])
    return gains


def _sampled(nodes: Nodes, motions: Sequence[Motion]) -> Motion:
    """Return `_SAMPLES` increments of every interval, evenly spread, as one motion."""
    last = np.append(nodes.first[1:], len(nodes.source)) - 1
    steps = np.linspace(nodes.first, last, _SAMPLES).round().astype(np.int64).T.ravel()
    chosen = nodes.source[steps]
    first = motions[0]
    names = [f.name for f in fields(first) if isinstance(getattr(first, f.name), np.ndarray)]
    arrays: dict[str, Any] = {n: np.concatenate([getattr(m, n) for m in motions])[chosen] for n in names}
    return replace(first, **arrays)


def _means(values: Array, weight: Array, count: int) -> Array:
    """Return the means (K, J) over the intervals of values (K S, J), weighted by how far each sample moves."""
    weight = weight.reshape(count, -1) + 1e-9
    weight = weight / weight.sum(axis=1, keepdims=True)
    means: Array = np.einsum("ks,ksj->kj", weight, values.reshape(count, -1, values.shape[1]))
    return means


def _quick_waves(fit: Fit, believed: Array) -> list[tuple[Law, str, str, float]]:
    count = len(fit.problem.nodes)
    return [(law, channel, "v", nats - law_price(law, count)) for law, channel, nats in waves(fit, believed)]


def _joined(motions: Sequence[Motion], move: str) -> Array:
    """Return travel or turn (n0,) of every increment of all runs."""
    return np.concatenate([MOVES[move](m) * m.dt_s for m in motions])


def _error(channel: str, size: Array) -> Array:
    """Return errors (n0, 3) of increments, odometry minus truth, in one channel."""
    error = np.zeros((len(size), 3))
    error[:, CHANNELS.index(channel)] = -size
    return error
