"""Fits from where a fit has come to: with other effects, and without those that later ones have made idle."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.effects.effect import parameters
from odomcorrupt.study.estimate.random_process import WANDERING
from odomcorrupt.study.select.random_effects import remeasured

if TYPE_CHECKING:
    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.study.estimate.gauss_newton import Fit
    from odomcorrupt.study.select.random_effects import RandomGain

__all__ = ["backward_eliminate", "eliminate_random", "iterate"]

_DROP_NATS = 3.3
_ROUNDS, _ALIKE = 6, 0.03
_NOISE_PRICE = 6.0
"""Nats that a wandering gain is worth by chance, and as much as it has to gain to be named."""


def iterate(fitted: Fit, effect: Effect) -> tuple[Fit, Effect]:
    """Return a fit that believes a wandering gain, with both measured beside each other, and the gain."""
    for _ in range(_ROUNDS):
        # a clock that moves may win or lose an interval: columns are those of this fit
        new = remeasured(fitted, fitted.design_matrix(), effect)
        if _alike(new, effect):
            break
        random = [new if e is effect else e for e in fitted.random]
        fitted, effect = fitted.refit(random=random), new
    return fitted, effect


def _alike(one: Effect, other: Effect) -> bool:
    """Tell whether two effects of a kind have nearly the same parameters."""
    return all(np.isclose(getattr(one, p.name), getattr(other, p.name), rtol=_ALIKE) for p in parameters(one))


def backward_eliminate(fitted: Fit, keep: set[str]) -> Fit:
    """Drop effects that the later ones have made idle: a Wald test first, because refits cost time."""
    while fitted.effects:
        worth = {name: 0.5 * square for name, square in fitted.wald.items() if name not in keep}
        idlest = min(worth, key=worth.__getitem__, default=None)
        if idlest is None or worth[idlest] >= _DROP_NATS:
            return fitted
        fitted = fitted.refit([e for e in fitted.effects if e.name != idlest])
    return fitted


def eliminate_random(noise: list[RandomGain], fitted: Fit) -> tuple[list[RandomGain], Fit]:
    """Drop wandering gains that a law has made idle."""
    if not fitted.random:
        return noise, fitted
    calm = fitted.refit(random=())
    if fitted.log_likelihood - calm.log_likelihood >= _DROP_NATS + _NOISE_PRICE * len(fitted.random):
        return noise, fitted
    return [gain for gain in noise if gain.effect.name not in WANDERING], calm
