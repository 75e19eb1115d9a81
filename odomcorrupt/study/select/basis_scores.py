"""Which law of the unknown explains most of what is left: all tried quickly, the best of each kind exactly.

For the quick look a law is averaged over each interval between nodes, so that a thousand laws cost a few whitenings;
what is told of a law comes from its exact columns.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import groupby, islice
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.study.select.basis import VALUES
from odomcorrupt.study.select.basis_columns import LawColumns
from odomcorrupt.study.select.channels import every_action
from odomcorrupt.study.select.closed_loop import may_be_steering
from odomcorrupt.study.select.periodic import waves
from odomcorrupt.study.select.score import score_columns
from odomcorrupt.study.select.screening import QuickLook, Tried

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.effects.user import UserEffect
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.estimate.gauss_newton import Fit
    from odomcorrupt.study.select.basis import Law
    from odomcorrupt.study.select.basis_samples import LawSamples
    from odomcorrupt.study.select.channels import Action
    from odomcorrupt.study.select.score import ColumnScore

__all__ = ["ScoredLaw", "best_laws", "law_price", "likeliest"]

_KINDS = (len(VALUES) + 2) * len(every_action())
"""Drivers, and what laws act on: any of these might have come first."""
_LEVEL = 0.01
_MOST_PART = 0.5
"""Of the way or the turn, the largest part that an error may be: what moves by itself is no error of moving."""
_NEARLY = 0.7
"""Part of the best one's nats that laws have to gain to be tried beside it."""
_MOST_STARTS = 40
"""Laws of one driver and channel among which starts are looked for."""
_GYRO_NATS = 4.0
"""What wheels that do not turn the odometry have to explain on top: such robots are the fewer."""
_LEAST_NATS = 3.0
"""By how much a law must gain more than its price in the quick look to be worth an exact one."""


@dataclass(frozen=True, slots=True)
class ScoredLaw:
    """A law, where it acts, and what the residual says about it.

    price : nats that it must gain, see `law_price`
    nats : log likelihood it gains, less that
    p : probability of such a score anywhere among the laws without any dependence
    others : laws of the same driver and channel that do nearly as well, so that only a fit can tell
    """

    law: Law
    action: Action
    score: ColumnScore
    price: float
    nats: float
    p: float
    others: tuple[ScoredLaw, ...] = ()

    @property
    def effect(self) -> UserEffect:
        """The law as an effect, with its estimated numbers."""
        return self.law.effect(self.action, self.score.estimate.tolist())

    @property
    def expression(self) -> str:
        """The law with its numbers filled in."""
        return self.law.expression(self.action, self.score.estimate.tolist())


def law_price(law: Law, action: Action, count: int) -> float:
    """Return the nats that a law must gain on so many intervals: for its numbers, and for all that it was chosen from.

    Half of the odds of a family go to its plainest member.
    """
    unusual = _GYRO_NATS if action.heading == "gyro" else 0.0
    return float(0.5 * len(law.parts) * np.log(count) + np.log(2.0 * law.trials * _KINDS)) + unusual


def best_laws(laws: Sequence[ScoredLaw]) -> list[ScoredLaw]:
    """Return those of the likeliest laws that explain more than chance does, the plainest first."""
    found = []
    for law in laws:
        score, nats = law.score, 0.5 * law.score.statistic / law.score.inflation - law.price
        if score.separable and nats > 0.0 and law.p < _LEVEL and score.held_out_nats > score.held_out_error:
            found.append(replace(law, nats=nats))
    return sorted(found, key=lambda s: s.nats, reverse=True)


def likeliest(fit: Fit, believed: Array, samples: LawSamples | None = None) -> list[ScoredLaw]:
    """Return the best law of each driver and channel, scored exactly, whether or not chance would do as well.

    Parameters
    ----------
    fit : the fitted model
    believed : (K, 3, q)
        Columns of what is believed already.
    samples
        Those of the same problem, where it is asked more than once.

    """
    count = len(fit.problem.nodes)
    look = QuickLook(fit, believed, samples)
    tried = look.everything() + [Tried(law, action, nats) for law, action, nats in waves(fit, believed)]
    worth = sorted(
        ((_kind(t), t.nats - law_price(t.law, t.action, count), t) for t in tried), key=lambda w: (w[0], -w[1])
    )
    chosen: list[Tried] = []
    for _, group in groupby(worth, key=lambda w: w[0]):
        ranked = [t for _, nats, t in islice(group, _MOST_STARTS) if nats > _LEAST_NATS]
        chosen += look.forms(ranked) if ranked else []
    exact = LawColumns(fit.problem)
    groups = [exact.of(t.law, t.action) for t in chosen]
    scores = score_columns(fit, groups, believed) if groups else []
    found: dict[tuple[str, str], list[ScoredLaw]] = {}
    for t, score, columns in zip(chosen, scores, groups, strict=True):
        if t.action.move == "omega" and may_be_steering(fit, columns, score.estimate):
            continue
        if not _possible(fit, t, score.estimate):
            continue
        price = law_price(t.law, t.action, count)
        p = score.p * 2.0 * t.law.trials * _KINDS / len(chosen)
        scored = ScoredLaw(t.law, t.action, score, price, 0.5 * score.statistic - price, p)
        found.setdefault(_kind(t), []).append(scored)
    return [_with_others(kind) for kind in found.values()]


def _possible(fit: Fit, tried: Tried, estimate: Array) -> bool:
    """Tell whether a law that is a part of the way or of the turn is nowhere too large a part of it."""
    part_of_itself = tried.action.move == "omega" or (tried.action.move != "1" and tried.action.target != "yaw")
    if not part_of_itself or tried.law.wavelength_m:
        return True
    return all(
        np.abs(sum(k * part(m) for k, part in zip(estimate, tried.law.parts, strict=True))).max() < _MOST_PART
        for m in fit.problem.motions
    )


def _with_others(scored: Sequence[ScoredLaw]) -> ScoredLaw:
    """Return the best of a kind, with those that come near it."""
    best = max(scored, key=lambda s: s.nats)
    return replace(best, others=tuple(s for s in scored if s is not best and s.nats > _NEARLY * best.nats))


def _kind(tried: Tried) -> tuple[str, str]:
    return tried.law.driver, tried.action.channel
