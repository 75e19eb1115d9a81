"""A term: one hypothesis about what the model lacks, as the selection sees it.

A term has columns in the design matrix at a working point of its shape, a shape that may be refined, a size of the
family it was selected from (which its penalty charges), and it becomes an effect of the model when it is included. The
effects of the library and basis functions of one regressor are both terms; nothing in the selection asks which it is
except where the two differ in fact.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Protocol, Self, TypeVar

import numpy as np

from odomcorrupt.effects.effect import amplitudes, choices, shapes
from odomcorrupt.effects.user import UserEffect, user_effect
from odomcorrupt.rng import stream
from odomcorrupt.study.terms.basis import COEFFICIENTS, VALUES, BasisFunction
from odomcorrupt.study.terms.channels import Action, every_action, views

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from odomcorrupt.effects.effect import Effect, Motion
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.estimate.problem import Problem

T = TypeVar("T", bound="Term")

__all__ = ["BasisTerm", "LibraryTerm", "Term", "neighbours"]

_KINDS = (len(VALUES) + 2) * len(every_action())
"""Regressors, places and headings among them, times what they act on: a basis function is one of all these."""
_PLAINEST = 2.0
"""Half of the prior odds of a family of basis functions go to its plainest member."""
_STEP = 0.4
"""First step of a shape search, in parts of a parameter's typical size."""
_LEAST_OPTIONAL = 0.1
"""What an optional shape parameter is at least once it is there, in parts of its typical size."""
_SEVERAL_MAXIMA = 3
"""From so many numbers in its shape (a place) on, a basis function is likely to have several maxima."""


class Term(Protocol):
    """What the selection needs to know of a hypothesis."""

    @property
    def name(self) -> str:
        """Name of the effect that it becomes."""

    @property
    def start(self) -> Effect:
        """The effect that it becomes, its coefficients at their identity."""

    @property
    def width(self) -> int:
        """How many coefficients it has, a column each."""

    @property
    def charged(self) -> int:
        """How many of its numbers the penalty charges."""

    @property
    def trials(self) -> int:
        """How many members of its family it is selected from."""

    @property
    def unusual(self) -> bool:
        """Whether it says something of the robot that few robots are: a heading that the wheels do not turn."""

    @property
    def several_maxima(self) -> bool:
        """Whether the likelihood over its shape is likely to have several maxima."""

    @property
    def shape(self) -> Array:
        """Its shape parameters (s,); there may be none."""

    @property
    def steps(self) -> Array:
        """First step (s,) of a search over each of them."""

    def with_shape(self, shape: Sequence[float]) -> Self:
        """Return the term with other shape parameters, kept within their bounds."""

    def columns(self, problem: Problem) -> Array:
        """Return (K, 3, p): what a unit of each of its coefficients does to the residuals."""

    def effect(self, coefficients: Sequence[float]) -> Effect:
        """Return the effect of the model with these coefficients (p,), kept within their bounds."""

    def share(self, coefficients: Sequence[float], motions: Sequence[Motion]) -> float:
        """Return the largest part of the robot's own motion that the term would be; 0 where it is no part of it."""


def neighbours(term: T, scale: float) -> Iterator[T]:
    """Yield the term with one number of its shape a step of this scale down or up."""
    for i, step in enumerate(term.steps):
        for sign in (-1.0, 1.0):
            shape = term.shape.copy()
            shape[i] += sign * scale * step
            yield term.with_shape(shape.tolist())


@dataclass(frozen=True)
class LibraryTerm:
    """A registered effect as a term; its shape parameters are those that are no amplitudes.

    start : the effect at its working point, amplitudes at their identity
    trials : size of the family of shapes that it is selected from
    """

    start: Effect
    trials: int = 1

    unusual = False
    several_maxima = True

    @classmethod
    def family(cls, kind: type[Effect], motions: Sequence[Motion]) -> tuple[LibraryTerm, ...]:
        """Return a kind of effect at every shape worth trying on these motions; none where it cannot act."""
        scanned = tuple(kind.scan(motions))
        return tuple(cls(effect, len(scanned)) for effect in scanned)

    @classmethod
    def of(cls, effect: Effect, motions: Sequence[Motion]) -> LibraryTerm:
        """Return the term of an effect that a model has, at the effect's shape."""
        at_identity = replace(effect, **{p.name: p.identity for p in amplitudes(effect)})  # type: ignore[type-var]
        return cls(at_identity, max(len(type(effect).scan(motions)), 1))

    @property
    def name(self) -> str:
        """Name of the effect."""
        return self.start.name

    @property
    def remembers(self) -> bool:
        """Whether what it does depends on the motion before, so that its columns need all of it."""
        return self.start.start(stream(0, 0, self.name)) is not None

    @property
    def width(self) -> int:
        """How many amplitudes it has."""
        return len(amplitudes(self.start))

    @property
    def charged(self) -> int:
        """All parameters, those of the shape among them."""
        return self.width + len(shapes(self.start))

    @property
    def shape(self) -> Array:
        """Values (s,) of the parameters that are no amplitudes."""
        return np.array([getattr(self.start, p.name) for p in shapes(self.start)])

    @property
    def steps(self) -> Array:
        """First steps (s,), in proportion to typical sizes."""
        return np.array([_STEP * p.typical for p in shapes(self.start)])

    def with_shape(self, shape: Sequence[float]) -> LibraryTerm:
        """Return the term at another shape."""
        lows = ((p, _LEAST_OPTIONAL * p.typical if p.optional else p.low) for p in shapes(self.start))
        values = {p.name: float(np.clip(v, low, p.high)) for (p, low), v in zip(lows, shape, strict=True)}
        return replace(self, start=replace(self.start, **values))  # type: ignore[type-var]  # effects are dataclasses

    def with_words(self, words: Sequence[str]) -> list[LibraryTerm]:
        """Return the terms in which each of these words (a source of the heading, say) is each other one it may be."""
        options = [(word, option) for word in words for option in choices(self.start).get(word, ())]
        return [
            replace(self, start=replace(self.start, **{word: option}))  # type: ignore[type-var]
            for word, option in options
            if getattr(self.start, word) != option
        ]

    def columns(self, problem: Problem) -> Array:
        """Return (K, 3, p), a column for each amplitude."""
        return problem.columns(self.start)

    def effect(self, coefficients: Sequence[float]) -> Effect:
        """Return the effect with these amplitudes."""
        own = zip(amplitudes(self.start), coefficients, strict=True)
        values = {p.name: float(np.clip(v, p.low, p.high)) for p, v in own}
        return replace(self.start, **values)  # type: ignore[type-var]  # effects are dataclasses

    def share(self, coefficients: Sequence[float], motions: Sequence[Motion]) -> float:  # noqa: ARG002 - of the protocol
        """Return 0: what is possible for an effect of the library is said by its parameters' bounds."""
        return 0.0


@dataclass(frozen=True)
class BasisTerm:
    """A basis function of one regressor, acting somewhere, as a term.

    function : how the error depends on the regressor
    action : on what it acts, and what it multiplies
    """

    function: BasisFunction
    action: Action

    @cached_property
    def name(self) -> str:
        """Name of the effect: what it acts on and what it depends on."""
        return f"{self.action.target}_over_{self.function.regressor}"

    @property
    def start(self) -> UserEffect:
        """The effect with its coefficients at zero."""
        return self.effect([0.0] * self.width)

    @property
    def width(self) -> int:
        """How many coefficients it has."""
        return len(self.function.parts)

    @property
    def charged(self) -> int:
        """Its coefficients; its shape is charged by the family that it is selected from."""
        return self.width

    @property
    def trials(self) -> int:
        """Size of its family, times all regressors and actions that might have come first."""
        return int(_PLAINEST * self.function.trials * _KINDS)

    @property
    def unusual(self) -> bool:
        """Whether it needs a heading that the wheels do not turn."""
        return self.action.heading == "gyro"

    @property
    def several_maxima(self) -> bool:
        """Whether it is a place."""
        return len(self.shape) >= _SEVERAL_MAXIMA

    @property
    def shape(self) -> Array:
        """Shape of the function (s,), and the direction of the action, if it has one."""
        return np.array([*self.function.shape, *self._toward], dtype=np.float64)

    @property
    def steps(self) -> Array:
        """First steps (s,)."""
        return np.array([*self.function.steps, *(self.action.turn for _ in self._toward)], dtype=np.float64)

    @property
    def _toward(self) -> tuple[float, ...]:
        return (self.action.toward,) if self.action.turn else ()

    def with_shape(self, shape: Sequence[float]) -> BasisTerm:
        """Return the term at another shape."""
        own = tuple(shape[: len(self.function.shape)])
        function = self.function.with_shape(own) if self.function.with_shape is not None else self.function
        action = replace(self.action, toward=shape[-1]) if self.action.turn else self.action
        return BasisTerm(function, action)

    def columns(self, problem: Problem) -> Array:
        """Return (K, 3, p), a column for each coefficient."""
        errors: list[list[Array]] = [[] for _ in self.function.parts]
        for motion in problem.motions:
            seen = views(motion) if self.action.by_wheel else {"body": motion}
            rates = self.action.rates(seen, motion.track_m)
            for error, part in zip(errors, self.function.parts, strict=True):
                error.append(np.asarray(sum((part(seen[v]) * motion.dt_s)[:, None] * rate for v, rate in rates)))
        return np.stack([problem.nodes.column(np.concatenate(error)) for error in errors]).transpose(1, 2, 0)

    def effect(self, coefficients: Sequence[float]) -> UserEffect:
        """Return the expression as an effect with these coefficients."""
        named = dict(zip(COEFFICIENTS, map(float, coefficients), strict=False))
        words = {"heading": self.action.heading} if self.action.by_wheel else {}
        return user_effect(self.name, self.action.written(self.function.text), named, words=words)

    def expression(self, coefficients: Sequence[float]) -> str:
        """Return the expression with its coefficients filled in, ready to be edited."""
        text = self.function.text
        for name, value in zip(COEFFICIENTS, coefficients, strict=False):
            text = text.replace(f"{name} *", f"{float(value):.4g} *")
        return self.action.written(text)

    def share(self, coefficients: Sequence[float], motions: Sequence[Motion]) -> float:
        """Return the largest part of the travel or of the turn that the error would be, where it is a part of it."""
        of_turn = self.action.move == "omega"
        of_travel = self.action.move != "1" and self.action.target != "yaw"
        if not (of_turn or of_travel) or self.function.wavelength_m:
            return 0.0
        parts = self.function.parts
        return max(
            float(np.abs(sum(k * part(m) for k, part in zip(coefficients, parts, strict=True))).max()) for m in motions
        )
