"""Fits from where a fit has come to: with other effects, and without those that later ones have made idle."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.effects.effect import parameters
from odomcorrupt.study.estimate.gauss_newton import Fit, believed_columns, fit
from odomcorrupt.study.estimate.random_process import WANDERING
from odomcorrupt.study.select.random_effects import remeasured

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.select.random_effects import RandomGain

__all__ = ["again", "settled", "without_idle_noise", "without_idlers"]

_DROP_NATS = 3.3
_ROUNDS, _ALIKE = 6, 0.03
_NOISE_PRICE = 6.0
"""Nats that a wandering gain is worth by chance, and as much as it has to gain to be named."""


def again(
    fitted: Fit,
    free_clocks: Sequence[tuple[bool, bool]],
    effects: Sequence[Effect],
    *,
    random: Sequence[Effect] | None = None,
    weights: Array | None = None,
) -> Fit:
    """Fit the same recordings again with these effects; with the wandering gains of before, and weights taken anew."""
    problem = fitted.problem
    return fit(
        problem.recordings,
        effects,
        clocks=problem.clocks,
        free_clocks=free_clocks,
        approach=problem.approach,
        start=fitted.noise.free,
        random=fitted.random if random is None else random,
        weights=weights,
    )


def settled(fitted: Fit, free_clocks: Sequence[tuple[bool, bool]], effect: Effect) -> tuple[Fit, Effect]:
    """Return a fit that believes a wandering gain, with both measured beside each other, and the gain."""
    for _ in range(_ROUNDS):
        # a clock that moves may win or lose an interval: columns are those of this fit
        new = remeasured(fitted, believed_columns(fitted.problem, free_clocks), effect)
        if _alike(new, effect):
            break
        random = [new if e is effect else e for e in fitted.random]
        fitted, effect = again(fitted, free_clocks, fitted.effects, random=random), new
    return fitted, effect


def _alike(one: Effect, other: Effect) -> bool:
    """Tell whether two effects of a kind have nearly the same parameters."""
    return all(np.isclose(getattr(one, p.name), getattr(other, p.name), rtol=_ALIKE) for p in parameters(one))


def without_idlers(fitted: Fit, free_clocks: Sequence[tuple[bool, bool]], keep: set[str]) -> Fit:
    """Drop effects that the later ones have made idle: a Wald test first, because refits cost time."""
    while fitted.effects:
        worth = {name: 0.5 * square for name, square in fitted.wald.items() if name not in keep}
        idlest = min(worth, key=worth.__getitem__, default=None)
        if idlest is None or worth[idlest] >= _DROP_NATS:
            return fitted
        fitted = again(fitted, free_clocks, [e for e in fitted.effects if e.name != idlest])
    return fitted


def without_idle_noise(
    noise: list[RandomGain], fitted: Fit, free_clocks: Sequence[tuple[bool, bool]]
) -> tuple[list[RandomGain], Fit]:
    """Drop wandering gains that a law has made idle."""
    if not fitted.random:
        return noise, fitted
    calm = again(fitted, free_clocks, fitted.effects, random=())
    if fitted.log_likelihood - calm.log_likelihood >= _DROP_NATS + _NOISE_PRICE * len(fitted.random):
        return noise, fitted
    return [gain for gain in noise if gain.effect.name not in WANDERING], calm
