"""Whether a known effect that was believed is really what the data say, or only the nearest name to a law of its own.

The effect is put back into the residual, whitened as the model with it says, and every law tries to explain it better.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.effects.effect import amplitudes
from odomcorrupt.study.estimate.gauss_newton import design_matrix
from odomcorrupt.study.select.basis_columns import LawColumns
from odomcorrupt.study.select.basis_scores import likeliest
from odomcorrupt.study.select.candidates import price
from odomcorrupt.study.select.dependence import unknown_dependences
from odomcorrupt.study.select.score import left_over, score_columns

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.estimate.gauss_newton import Fit
    from odomcorrupt.study.select.basis_samples import LawSamples
    from odomcorrupt.study.select.basis_scores import ScoredLaw
    from odomcorrupt.study.select.dependence import Unknown

__all__ = ["ALTERNATIVE_NATS", "CHALLENGE_NATS", "Rivalry", "drop_term", "rivalry"]

ALTERNATIVE_NATS = 3.0
"""Effects that explain the data this nearly as well are alternatives: the data cannot tell them apart."""
CHALLENGE_NATS = 8.0
"""By how much a law has to explain more than a known effect, both less their prices: names are the likelier before."""
_COPY = 0.985
"""Part of an effect's work that a law does which is nothing else; laws that were causes of their own did up to 0.96."""


def drop_term(fit: Fit, effect: Effect) -> tuple[Fit, Array]:
    """Return the fit with what one effect explains back in its innovations, and the columns of what else is believed.

    To first order, and with the noise as it is with the effect.
    """
    explained = fit.problem.columns(effect) @ np.array([getattr(effect, p.name) for p in amplitudes(effect)])
    noise = replace(fit.noise, innovations=fit.noise.innovations + fit.noise.whitener.whiten(explained))
    others = tuple(e for e in fit.effects if e is not effect)
    return replace(fit, noise=noise), design_matrix(replace(fit.problem, effects=others), fit.free_clocks)


@dataclass(frozen=True, slots=True, eq=False)
class Rivalry:
    """A known effect of a fit against the laws that might stand in its place.

    nats, price : what the effect gains less its price, and that price
    laws : the likeliest law of each driver and channel, without gates and without what only copies the effect
    """

    bare: Fit
    believed: Array
    nats: float
    price: float
    laws: list[ScoredLaw]

    @property
    def margin(self) -> float:
        """By how many nats the effect explains more than the best law would, both less their prices."""
        return self.nats - max((law.nats for law in self.laws), default=0.0)

    def better_laws(self) -> list[tuple[Unknown, ScoredLaw]]:
        """Return the dependence whose law explains plainly more than the effect, and those nearly as plain."""
        if self.margin > -CHALLENGE_NATS:
            return []
        found = unknown_dependences(self.bare, self.believed, self.laws)
        better = [(one, one.law) for one in found if one.law is not None]
        least = self.nats + CHALLENGE_NATS
        better = [(one, law) for one, law in better if 0.5 * law.score.statistic - law.price > least]
        return [(one, law) for one, law in better if one.nats > better[0][0].nats - ALTERNATIVE_NATS]


def rivalry(fit: Fit, effect: Effect, samples: LawSamples) -> Rivalry:
    """Put an effect of a fit to the test against every law."""
    bare, believed = drop_term(fit, effect)
    (own,) = score_columns(bare, [fit.problem.columns(effect)], believed)
    worth = price(effect, max(len(type(effect).scan(fit.problem.motions)), 1), len(fit.problem.nodes))
    nats = 0.5 * own.statistic - worth
    laws = likeliest(bare, believed, samples)
    # who explains far less needs no closer look
    far = [law for law in laws if law.nats < nats - CHALLENGE_NATS]
    near = [law for law in laws if law.nats >= nats - CHALLENGE_NATS]
    return Rivalry(bare, believed, nats, worth, [*far, *_no_copies(bare, believed, effect, near)])


def _no_copies(bare: Fit, believed: Array, effect: Effect, laws: Sequence[ScoredLaw]) -> list[ScoredLaw]:
    """Return the laws that do something else than an effect: a fringe of it that fits by chance is no other cause."""
    if not laws:
        return []
    left, whiten, columns = left_over(bare, believed), bare.noise.whitener.whiten, LawColumns(bare.problem)
    own = left.of(whiten(bare.problem.columns(effect)))
    own = own @ np.linalg.lstsq(own, left.residual, rcond=None)[0]
    bases = [np.linalg.qr(left.of(whiten(columns.of(law.law, law.action))))[0] for law in laws]
    shares = [float(np.sum((basis.T @ own) ** 2)) / max(float(own @ own), 1e-300) for basis in bases]
    return [law for law, share in zip(laws, shares, strict=True) if share <= _COPY]
