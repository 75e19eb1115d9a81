"""Which member of a family of shapes explains most: all are looked at at a glance, the best few closely and refined."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from operator import itemgetter
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.effects.effect import amplitudes, choices, parameters
from odomcorrupt.errors import EffectError
from odomcorrupt.study.select.nelder_mead import hilltop
from odomcorrupt.study.select.score import left_over
from odomcorrupt.study.select.subsample import Glance

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.effects.effect import Effect, Parameter
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.estimate.gauss_newton import Fit

__all__ = ["UNUSUAL_NATS", "Members"]

UNUSUAL_NATS = 4.0
"""What a word other than the usual one, a heading from a gyro, has to explain on top."""
_AT_A_GLANCE, _REFINEMENTS = (0.4, 0.2, 0.1), (0.1, 0.05, 0.02)
"""Steps of shapes, in parts of their typical sizes: first about, then exactly."""
_SIMPLEX = 0.1
"""How far the last look goes at first, in parts of typical sizes."""
_WORTH_NATS = 0.2
_LARGE = 12
"""Of a larger family so many are looked at exactly."""
_STARTS, _PLAIN = 4, 60.0
"""From how many members the search goes on where the best explains so much (chi-square): hills have neighbours.
What explains less does not show its finer features either."""


class Members:
    """What the members of families explain of what the believed columns (K, 3, q) of a fit leave."""

    def __init__(self, fit: Fit, believed: Array) -> None:
        self._fit, self._left = fit, left_over(fit, believed)

    @cached_property
    def _glance(self) -> Glance:
        return Glance(self._fit.problem)

    def best(self, family: Sequence[Effect]) -> Effect:
        """Return the shape that explains most, of a family at its identities.

        A parameter that is a word keeps its first one, unless another explains plainly more. Where the heading comes
        from matters to the place as well, and each source has the whole family; other words are tried where the best
        one stands, if it explains plainly.
        """
        if len(family) == 1 and not choices(family[0]):
            return family[0]
        usual = self._highest(family)
        unusual = [
            self._highest(others) for others in zip(*(_said_otherwise(e, ("heading",)) for e in family), strict=True)
        ]
        most, best = max([usual, *((nats - UNUSUAL_NATS, other) for nats, other in unusual)], key=itemgetter(0))
        words = [word for word in choices(best) if word != "heading"] if most > _PLAIN else []
        touches = [self._refined(self._climbed(other)) for other in _said_otherwise(best, words)]
        return max([(most, best), *((nats - UNUSUAL_NATS, other) for nats, other in touches)], key=itemgetter(0))[1]

    def topmost(self, effect: Effect) -> Effect:
        """Return an effect of the best shape near this one's, which has one: worth its time once it is believed."""
        shapes = [p for p in parameters(effect) if not p.amplitude]

        def shaped(values: Array) -> Effect:
            return replace(effect, **{p.name: _bounded(v, p) for p, v in zip(shapes, values, strict=True)})  # type: ignore[type-var]

        start, steps = np.array([(getattr(effect, p.name), _SIMPLEX * p.typical) for p in shapes]).T
        return shaped(hilltop(lambda values: self._gain(shaped(values)), start, steps))

    def _highest(self, family: Sequence[Effect]) -> tuple[float, Effect]:
        """Return the chi-square and the member of the highest hill; of a large family, of those that may be on it."""
        if len(family) > _LARGE and len(amplitudes(family[0])) == 1:
            about = self._about(family)
            family = [family[i] for i in np.argsort(-about, kind="stable")[:_LARGE]]
        ranked = sorted(((self._gain(member), member) for member in family), reverse=True, key=itemgetter(0))
        starts = _starts([member for _, member in ranked], ranked[0][0])
        return max((self._refined(self._climbed(start)) for start in starts), key=itemgetter(0))

    def _gain(self, effect: Effect) -> float:
        """Return the chi-square that an effect explains."""
        try:
            column = self._left.of(self._fit.noise.whitener.whiten(self._fit.problem.columns(effect)))
        except EffectError:  # it acts on single wheels, and nobody knows where they are
            return 0.0
        if not column.any():
            return 0.0
        return float((column @ np.linalg.lstsq(column, self._left.residual, rcond=None)[0]) @ self._left.residual)

    def _about(self, family: Sequence[Effect]) -> Array:
        """Return about the chi-square (J,) that each effect of one amplitude explains."""
        try:
            columns = self._left.of(self._fit.noise.whitener.whiten(self._glance.columns(family)))
        except EffectError:
            return np.zeros(len(family))
        score, length = columns.T @ self._left.residual, np.einsum("ij,ij->j", columns, columns)
        about: Array = score**2 / np.maximum(length, 1e-300)
        return about

    def _climbed(self, effect: Effect) -> Effect:
        """Return the effect about at the top of the hill on which this one stands."""
        shapes = [p for p in parameters(effect) if not p.amplitude]
        if not shapes or len(amplitudes(effect)) != 1:
            return effect
        for fraction in _AT_A_GLANCE:
            while True:
                near = [effect, *(moved for p in shapes for moved in _beside(effect, p, fraction))]
                about = self._about(near)
                best = int(np.argmax(about))
                if about[best] <= about[0] + _WORTH_NATS:
                    break
                effect = near[best]
        return effect

    def _refined(self, effect: Effect) -> tuple[float, Effect]:
        """Return the chi-square and the effect at the top of the hill on which this one stands."""
        shapes = [p for p in parameters(effect) if not p.amplitude]
        best, most = effect, self._gain(effect)
        for fraction in _REFINEMENTS:
            better = True
            while better:
                better = False
                for p in shapes:
                    for moved in _beside(best, p, fraction):
                        if (new := self._gain(moved)) > most + _WORTH_NATS:
                            best, most, better = moved, new, True
        return most, best


def _starts(ranked: Sequence[Effect], most: float) -> list[Effect]:
    """Return members to refine, the best first: one, or where they explain plainly, some that differ in shape."""
    chosen = [ranked[0]]
    shapes = [p for p in parameters(ranked[0]) if not p.amplitude]
    for member in ranked[1:]:
        if most < _PLAIN or len(chosen) == _STARTS:
            break
        far = [any(abs(getattr(member, p.name) - getattr(c, p.name)) > 0.4 * p.typical for p in shapes) for c in chosen]
        if all(far):
            chosen.append(member)
    return chosen


def _beside(effect: Effect, p: Parameter, fraction: float) -> list[Effect]:
    """Return the effect with one number of its shape a step down and up."""
    values = [_bounded(getattr(effect, p.name) + s * fraction * p.typical, p) for s in (-1.0, 1.0)]
    return [replace(effect, **{p.name: value}) for value in values]  # type: ignore[type-var]  # effects are dataclasses


def _bounded(value: float, p: Parameter) -> float:
    return float(np.clip(value, p.low, p.high))


def _said_otherwise(effect: Effect, words: Sequence[str]) -> list[Effect]:
    """Return the effect with each of these words of its replaced by each other one that it may be."""
    options = [(word, option) for word in words for option in choices(effect).get(word, ())]
    return [
        replace(effect, **{word: option})  # type: ignore[type-var]  # effects are dataclasses
        for word, option in options
        if getattr(effect, word) != option
    ]
