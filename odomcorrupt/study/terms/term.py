"""Terms: hypotheses of the selection about a missing part of the model.

A term has design-matrix columns at a working point of its shape, shape parameters that may be refined, and the size of
the family that it was selected from, which determines its penalty. Once included, it becomes an effect of the model.
Library effects and basis functions of one regressor are both terms, with the same attributes: `start`, the effect with
coefficients at their identity; `width` and `charged`, the numbers of coefficients and of numbers that the penalty
counts; `trials`, the size of the family; `unusual`, for a rare kind of robot, whose wheels do not turn its heading.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, TypeAlias, TypeVar

import numpy as np

from odomcorrupt.effects import registry
from odomcorrupt.effects.compensation import error_of
from odomcorrupt.effects.effect import amplitudes, choices, shapes
from odomcorrupt.effects.expression import UserEffect, user_effect
from odomcorrupt.effects.wheels import brings_track
from odomcorrupt.rng import stream
from odomcorrupt.study.estimate.drive_type import GAINS_OF_TURNS, drive_type_of, mountings
from odomcorrupt.study.estimate.problem import by_column
from odomcorrupt.study.estimate.regressors import drives_sideways
from odomcorrupt.study.io.recording import shared_frame
from odomcorrupt.study.terms.basis import COEFFICIENTS, VALUES, BasisFunction, evaluated
from odomcorrupt.study.terms.channels import Action, every_action, views

if TYPE_CHECKING:
    from collections.abc import Container, Iterator, Sequence

    from odomcorrupt.effects.effect import Effect, Motion
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.estimate.problem import Problem
    from odomcorrupt.study.io.recording import Recording

_KINDS = (len(VALUES.keys() - {"sideways_speed"}) + 2) * len(every_action())
"""Number of kinds of basis functions: regressors, place and heading, times actions. A robot that drives sideways has 13
kinds more, but not the 36 of two wheels with a track."""
_SIMPLEST = 2.0
"""Factor on the size of a family: half of its prior probability goes to its simplest member."""
_STEP = 0.4
"""First step of a shape search, as a fraction of a parameter's typical size."""
_LEAST_OPTIONAL = 0.1
"""Least value of an optional shape parameter in a search, as a fraction of its typical size."""
_NEARLY = 0.97
"""Squared correlation with a constant from which a function is one."""


@dataclass(frozen=True)
class LibraryTerm:
    """A library effect as a term; its shape parameters are all that are no amplitudes.

    start : the effect at its working point, with amplitudes at their identity
    trials : size of the family of shapes that the term is selected from
    """

    start: Effect
    trials: int = 1

    unusual = False

    @classmethod
    def family(cls, kind: type[Effect], motions: Sequence[Motion]) -> tuple[LibraryTerm, ...]:
        """Return terms of an effect at every shape to be tried; none if it cannot act, or only as a scale does."""
        scanned = tuple(kind.scan(motions))
        return tuple(cls(one, len(scanned)) for one in scanned if not (kind.reads_places and _is_global(one, motions)))

    @property
    def name(self) -> str:
        """Name of the effect."""
        return self.start.name

    @property
    def remembers(self) -> bool:
        """Whether the effect has memory, so that its columns require the whole motion."""
        return self.start.start(stream(0, 0, self.name)) is not None

    @property
    def width(self) -> int:
        """Number of amplitudes."""
        return len(amplitudes(self.start))

    @property
    def charged(self) -> int:
        """Number of all parameters, including those of the shape."""
        return self.width + len(shapes(self.start))

    @property
    def shape(self) -> Array:
        """Values (s,) of the shape parameters."""
        return np.array([getattr(self.start, p.name) for p in shapes(self.start)], dtype=np.float64)

    @property
    def steps(self) -> Array:
        """First steps (s,), in proportion to typical sizes."""
        return np.array([_STEP * p.typical for p in shapes(self.start)])

    def with_shape(self, shape: Sequence[float]) -> LibraryTerm:
        """Return the term at another shape."""
        lows = (
            (p, max(p.low, _LEAST_OPTIONAL * p.typical) if p.optional and p.low >= 0.0 else p.low)
            for p in shapes(self.start)
        )
        values = {p.name: float(min(max(v, low), p.high)) for (p, low), v in zip(lows, shape, strict=True)}
        return replace(self, start=replace(self.start, **values))  # type: ignore[type-var]  # effects are dataclasses

    def with_words(self, words: Sequence[str]) -> list[LibraryTerm]:
        """Return a term for every other option of each of these word-valued parameters, such as the heading source."""
        options = [(word, option) for word in words for option in choices(self.start).get(word, ())]
        return [
            replace(self, start=replace(self.start, **{word: option}))  # type: ignore[type-var]
            for word, option in options
            if getattr(self.start, word) != option
        ]

    def columns(self, problem: Problem) -> Array:
        """Return columns (K, 3, p), one for each amplitude."""
        return problem.columns(self.start)

    def effect(self, coefficients: Sequence[float]) -> Effect:
        """Return the effect with these amplitudes."""
        own = zip(amplitudes(self.start), coefficients, strict=True)
        values = {p.name: float(np.clip(v, p.low, p.high)) for p, v in own}
        return replace(self.start, **values)  # type: ignore[type-var]  # effects are dataclasses


@dataclass(frozen=True)
class BasisTerm:
    """A basis function of one regressor, with its action, as a term.

    function : the error as a function of the regressor
    action : the target of the error, and the motion that multiplies it
    """

    function: BasisFunction
    action: Action

    @cached_property
    def name(self) -> str:
        """Name of the effect: target and regressor."""
        return f"{self.action.target}_over_{self.function.regressor}"

    @property
    def start(self) -> UserEffect:
        """The effect with its coefficients at zero."""
        return self.effect([0.0] * self.width)

    @property
    def width(self) -> int:
        """Number of coefficients."""
        return self.function.width

    @property
    def charged(self) -> int:
        """Number of coefficients; shape parameters are counted by the size of the family."""
        return self.width

    @property
    def trials(self) -> int:
        """Size of the family times the number of all regressors and actions."""
        return int(_SIMPLEST * self.function.trials * _KINDS)

    @property
    def unusual(self) -> bool:
        """Whether the term assumes a heading that the wheels do not turn."""
        return self.action.heading == "gyro"

    @property
    def shape(self) -> Array:
        """Shape parameters (s,) of the function and, if the action has one, its direction."""
        toward = [self.action.toward] if self.action.turn else []
        return np.array([*self.function.shape, *toward], dtype=np.float64)

    @property
    def steps(self) -> Array:
        """First steps (s,)."""
        turn = [self.action.turn] if self.action.turn else []
        return np.array([*self.function.steps, *turn], dtype=np.float64)

    def with_shape(self, shape: Sequence[float]) -> BasisTerm:
        """Return the term at another shape."""
        own = tuple(shape[: len(self.function.shape)])
        function = self.function.with_shape(own) if self.function.with_shape is not None else self.function
        action = replace(self.action, toward=shape[-1]) if self.action.turn else self.action
        return BasisTerm(function, action)

    def where_driven(self, motions: Sequence[Motion]) -> BasisTerm:
        """Return a function of the heading as zero at headings that these motions do not show; others unchanged."""
        if self.function.within is None:
            return self
        theta = np.concatenate([m.theta for m in motions])
        moved = np.concatenate([np.abs(evaluated(self.action.move, m)) * m.dt_s for m in motions])
        return replace(self, function=self.function.within(theta, moved))

    def is_global(self, motions: Sequence[Motion]) -> bool:
        """Return whether the function is one constant nearly wherever the robot moved: the term of a global effect."""
        if self.width > 1 or self.function.text == COEFFICIENTS[0]:
            return False
        value = np.concatenate([self.function.parts(m)[0] for m in motions])
        weight = np.concatenate([evaluated(self.action.move, m) ** 2 * m.dt_s for m in motions])
        return bool((weight @ value) ** 2 > _NEARLY * weight.sum() * (weight @ value**2))

    def columns(self, problem: Problem) -> Array:
        """Return columns (K, 3, p), one for each coefficient."""
        errors = []
        for motion in problem.motions:
            seen = views(motion) if self.action.by_wheel else {"body": motion}
            rates = self.action.rates(seen, motion.track_m)
            parts = (np.array(self.function.parts(seen[view]))[:, :, None] * rate for view, rate in rates)
            errors.append(sum(parts) * motion.dt_s[:, None])
        return by_column(np.stack([problem.intervals.column(own) for own in np.concatenate(errors, axis=1)]))

    def effect(self, coefficients: Sequence[float]) -> UserEffect:
        """Return the expression as an effect with these coefficients."""
        named = dict(zip(COEFFICIENTS, map(float, coefficients), strict=False))
        words = {"heading": self.action.heading} if self.action.by_wheel else {}
        return user_effect(self.name, self.action.written(self.function.text), named, words=words)

    def expression(self, coefficients: Sequence[float]) -> str:
        """Return the expression with its coefficients filled in, for the user to edit."""
        text = self.function.text
        for name, value in zip(COEFFICIENTS, coefficients, strict=False):
            text = re.sub(rf"\b{name}\b", f"{float(value):.4g}", text)
        return self.action.written(text)


def _is_global(effect: Effect, motions: Sequence[Motion]) -> bool:
    """Return whether an effect of places or headings has one error per metre nearly wherever the robot moved."""
    unit = replace(effect, **{p.name: p.typical for p in amplitudes(effect)})  # type: ignore[type-var]
    rows = [np.column_stack((np.abs(m.v), error_of(unit, m))) * np.sqrt(m.dt_s)[:, None] for m in motions]
    gram = np.asarray(sum(own.T @ own for own in rows))
    return bool(np.sum(gram[0, 1:] ** 2) > _NEARLY * gram[0, 0] * np.trace(gram[1:, 1:]))


Term: TypeAlias = LibraryTerm | BasisTerm
T = TypeVar("T", LibraryTerm, BasisTerm, LibraryTerm | BasisTerm)


def neighbours(term: T, scale: float) -> Iterator[T]:
    """Yield the term with one shape parameter at a time decreased and increased by `scale` of its step."""
    for i, step in enumerate(term.steps):
        for sign in (-1.0, 1.0):
            shape = term.shape
            shape[i] += sign * scale * step
            yield term.with_shape(shape.tolist())


def library_families(
    recordings: Sequence[Recording], motions: Sequence[Motion], have: Container[str]
) -> list[tuple[LibraryTerm, ...]]:
    """Return every systematic library effect that a robot can have and that can be tested, at every shape.

    Clocks are excluded. Of aliases only one is tested and the others are reported as other readings; if that one is no
    effect of this drive type, its alias is tested. Effects of single wheels need a track, given or as a parameter,
    effects of places and headings a frame that all recordings share.

    motions : smooth motions of the recordings
    have : names of effects that are already in the model
    """
    drive = drive_type_of(recordings)
    track = not drive.steered and all(m.track_m is not None for m in motions)
    sideways = drive.name == "omni" or (drive.name != "differential" and drives_sideways(motions))
    placed = shared_frame(recordings) is not None
    families = []
    for name, kind in registry().items():
        # a lever arm has two parameters, so its one-parameter alias for steered robots is tested too; but not with an
        # antenna, which is likelier off the axle than the base frame is
        of_steered = drive.steered and kind.drives is not None and not drive.antenna
        alone = kind.aliased_with is None or of_steered or name == GAINS_OF_TURNS.get(drive.heading_source)
        wanted = kind.kind not in ("noise", "event") and not kind.clock and name not in have
        wanted = wanted and alone and drive.admits(kind)
        possible = (sideways or not kind.needs_sideways) and (track or not kind.needs_track or brings_track(kind))
        possible = possible and (placed or not kind.reads_places)
        # of a truth of the base itself, a lever arm is that of the odometry: a centre of turning, or of one wheel
        possible = possible and (name != "mount_yaw" or name in mountings(recordings))
        if wanted and possible:
            family = LibraryTerm.family(kind, motions)
            if source := drive.heading_source:
                family = tuple(t for t in family if getattr(t.start, "heading", source) == source)
            if drive.steered:  # its odometry does not compare two wheels: one travel turns the robot, too
                values = {"track": 0.0} if brings_track(kind) else {}
                tracked = (replace(t, start=replace(t.start, **values)) for t in family)  # type: ignore[type-var]
                family = tuple(dict.fromkeys(tracked))
                family = () if kind.needs_track else family
            families.append(family)
    return [family for family in families if family]
