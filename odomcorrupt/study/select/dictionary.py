"""Terms that compete in one round of the selection, and their evidence on one linearisation of the model.

Everything that can be in a model is a term: clocks, library effects at their best shapes, and basis functions of one
regressor. Their columns are whitened once with the noise and the robust weights of the current fit. What belongs to the
model in any case (given effects, clocks that are far off) is projected out of all of them.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from operator import itemgetter
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from scipy.optimize import brentq

from odomcorrupt.effects.compensation import error_of
from odomcorrupt.effects.effect import amplitudes, choices
from odomcorrupt.effects.ground import RegionSlip
from odomcorrupt.errors import EffectError
from odomcorrupt.study.estimate.gauss_newton import orthonormal, prior_deviations
from odomcorrupt.study.estimate.robust_errors import block_of
from odomcorrupt.study.io.clock import as_rows, clock_leaders, led
from odomcorrupt.study.io.recording import ranks_of
from odomcorrupt.study.select.decisions import penalty
from odomcorrupt.study.select.evidence import FOLDS, Evidence
from odomcorrupt.study.select.periodic import flat_spots
from odomcorrupt.study.select.shape_search import CoarseDesign, ShapeSearch
from odomcorrupt.study.terms.basis import rectangle_of
from odomcorrupt.study.terms.term import BasisTerm, LibraryTerm, library_families

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from numpy.typing import NDArray

    from odomcorrupt.effects.effect import Effect, Parameter
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.estimate.gauss_newton import Fit
    from odomcorrupt.study.estimate.problem import Problem
    from odomcorrupt.study.io.clock import Clock
    from odomcorrupt.study.select.decisions import Decisions

_OF_ITS_KIND = 2
"""Number of basis functions of each regressor and channel that compete: a step and a hinge, or two places."""
_CLOCKS = {"time_offset": 0.03, "clock_skew": 1e-4}
"""Clock terms, and the prior standard deviation of an offset, s, and of a rate; see effects.md, section 4."""
_OF_GYRO = frozenset({"gyro_bias", "gyro_scale"})
"""Effects of a gyro: a robot that has one takes its heading from a gyro."""
_SURELY = 3.0
"""Standard errors by which a coefficient is surely larger than a size."""


@dataclass(frozen=True)
class ClockTerm:
    """Offset or rate of the clocks that may be right: one number for each clock.

    which : indices of the columns of `Problem.clock_columns`
    """

    name: str
    which: tuple[int, ...]

    trials = 1

    @property
    def width(self) -> int:
        """Number of clocks."""
        return len(self.which)

    def columns(self, problem: Problem) -> Array:
        """Return columns (K, 3, p), one for each clock."""
        return problem.clock_columns()[:, :, list(self.which)]


Competing: TypeAlias = LibraryTerm | BasisTerm | ClockTerm


@dataclass(frozen=True, slots=True, eq=False)
class ClockChoice:
    """Clocks of R recordings in the selection: (R, 2), offset and rate.

    optional : numbers that are terms: departures of leading clocks (see `clock_leaders`) from their base
    base : what stamps are corrected by in any case
    """

    optional: NDArray[np.bool_]
    base: Array

    def terms(self) -> list[ClockTerm]:
        """Return the clock terms, none for numbers that are not optional."""
        found = [(name, 2 * np.flatnonzero(self.optional[:, i]) + i) for i, name in enumerate(_CLOCKS)]
        return [ClockTerm(name, tuple(which.tolist())) for name, which in found if len(which)]

    def free(self, names: Sequence[str], leaders: Sequence[int]) -> list[tuple[bool, bool]]:
        """Return whether offset and rate of each recording are free in a model with these clock terms."""
        free = (self.optional & [name in names for name in _CLOCKS])[list(leaders)]
        return [(bool(offset), bool(rate)) for offset, rate in free]


@dataclass(slots=True)
class Dictionary:
    """Terms found so far, kept from round to round, because a shape may suit a later model.

    library, basis : terms by their effects and by their texts
    recurring : whether there are several drives, on which a function of time may recur; that of one drive is no term
    bounds : first-order bounds of the amplitudes of library terms, by their effects
    design : approximate columns of the first problem with the present clocks
    """

    decisions: Decisions
    recurring: bool = True
    library: dict[Effect, LibraryTerm] = field(default_factory=dict)
    basis: dict[object, BasisTerm] = field(default_factory=dict)
    bounds: dict[Effect, Array] = field(default_factory=dict)
    design: tuple[tuple[Clock, ...], CoarseDesign] | None = None

    def extend(self, fit: Fit) -> None:
        """Add the best shapes of every library effect, and the best basis functions, on the residual of a fit."""
        if self.design is None or self.design[0] != fit.problem.clocks:
            self.design = fit.problem.clocks, CoarseDesign(fit.problem)
        search = ShapeSearch(fit, self.decisions, self.design[1])
        for family in families(fit):
            for best in search.located(family):
                shapes = [best]
                if search.gain(best) > self.decisions.related_nats and (forms := best.start.related()):
                    # forms of one place, too many to be tried at every shape, are compared at their best shapes
                    related = [replace(best, start=form) for form in forms]
                    shapes = [search.maximise(one) for one in (best, max(map(search.climb, related), key=search.gain))]
                self._add(*shapes)
        count, kinds = len(fit.problem.intervals), dict[tuple[str, str], list[tuple[float, BasisTerm]]]()
        found = [(s.nats - penalty(s.term, count, self.decisions), s.term) for s in search.promising()]
        for nats, term in sorted(found, key=itemgetter(0), reverse=True):
            kind = kinds.setdefault((term.function.regressor, term.action.channel), [])
            if nats > -self.decisions.basis_nats and len(kind) < 2 * _OF_ITS_KIND:
                moved = search.climb(term)
                kind.append((search.gain(moved) - penalty(moved, count, self.decisions), moved))
        for climbed in kinds.values():
            for _, term in sorted(climbed, key=itemgetter(0), reverse=True)[:_OF_ITS_KIND]:
                driven = term.where_driven(fit.problem.motions)
                if driven.is_global(fit.problem.motions):
                    continue
                self.basis.setdefault(_key(driven), driven)
                self._add(*(search.maximise(patch) for patch in _patch_of(driven, fit)))

    def _add(self, *terms: LibraryTerm) -> None:
        """Add library terms, each with every other option of its word-valued parameters but the heading."""
        for term in terms:
            words = [word for word in choices(term.start) if word != "heading"]
            for one in (term, *term.with_words(words)):
                self.library.setdefault(one.start, one)

    def bounds_of(self, effect: Effect, fit: Fit) -> Array:
        """Return the first-order estimates (p, 2) that correspond to the amplitudes of an effect at their bounds.

        The error may be non-linear in a parameter. A robot whose track is a quarter of the nominal one turns four times
        as far as its odometry: three times the reported turn is missing, so the first-order estimate is 3.
        """
        if effect not in self.bounds:
            rooms = [(p, bound - p.identity) for p in amplitudes(effect) for bound in (p.low, p.high)]
            sizes = [max(_first_order(fit, effect, p, room), abs(room)) if room else 0.0 for p, room in rooms]
            self.bounds[effect] = np.copysign(sizes, [room for _, room in rooms]).reshape(-1, 2)
        return self.bounds[effect]

    def beside(self, present: Sequence[LibraryTerm | BasisTerm]) -> list[LibraryTerm | BasisTerm]:
        """Return terms of a model, then all others."""
        own = {_key(t) for t in present}
        others: list[LibraryTerm | BasisTerm] = [*self.library.values()]
        others += [t for t in self.basis.values() if self.recurring or t.function.regressor != "time"]
        return [*present, *(t for t in others if _key(t) not in own)]


def _key(term: LibraryTerm | BasisTerm) -> object:
    """Return what identifies a term: its effect at the identity, or its text and action."""
    return term.start if isinstance(term, LibraryTerm) else (term.name, term.function.text, term.action)


def families(fit: Fit) -> list[tuple[LibraryTerm, ...]]:
    """Return the systematic effects that the robot can have and the model lacks, each as a family of shapes."""
    problem = fit.problem
    have = {effect.name for effect in fit.effects}
    found = library_families(problem.recordings, problem.motions, have)
    return found if "flat_spot" in have else [*found, *flat_spots(fit)]


def _patch_of(term: BasisTerm, fit: Fit) -> list[LibraryTerm]:
    """Return the patch of floor with the strip or rectangle of a basis function of the place; none for others.

    A grid of discs hardly leads to a strip that the path crosses far apart.
    """
    rectangle = rectangle_of(term.function)
    if rectangle is None or not (term.action.by_wheel or term.action.channel == "along"):
        return []
    angle, x, y, half, side = rectangle
    patch = RegionSlip.in_rectangle(angle, (x, y), half, side, fit.problem.motions)
    if term.action.by_wheel:
        patch = replace(patch, contact="wheels", heading=term.action.heading)
    return [LibraryTerm(patch, max(len(RegionSlip.scan(fit.problem.motions)), 1))]


def linearised(
    fit: Fit,
    present: Sequence[Effect],
    terms: Sequence[LibraryTerm | BasisTerm],
    clocks: ClockChoice,
    dictionary: Dictionary,
) -> tuple[list[Competing], Evidence]:
    """Return the terms whose columns exist, those of the model first, and their evidence on the linearisation of a fit.

    The evidence is beside what the fit has in any case.

    present : effects of the fit that compete, whose terms are the first ones
    terms : the terms of `present`, then all others
    clocks : those that compete; others that are free are in the model in any case
    """
    problem, whiten = fit.problem, fit.noise.whitener.whiten
    residual = fit.noise.innovations.copy()
    used: list[Competing] = []
    columns: list[Array] = []
    for effect in present:
        # at the current size, because a column may depend on it; then the sum is the residual without these effects
        columns.append(problem.columns(effect))
        residual += whiten(columns[-1]) @ np.array([getattr(effect, p.name) - p.identity for p in amplitudes(effect)])
    used += terms[: len(present)]
    free = led(np.array(fit.free_clocks), clock_leaders(problem.recordings))
    away = ((as_rows(problem.clocks) - clocks.base) * free).ravel()
    for term in clocks.terms():
        columns.append(term.columns(problem))
        used.append(term)
        residual += whiten(columns[-1]) @ away[list(term.which)]
    for other in terms[len(present) :]:
        try:
            columns.append(other.columns(problem))
        except EffectError:  # it acts on single wheels, and the track is unknown
            continue
        used.append(other)
    kept = [problem.columns(effect) for effect in fit.effects if effect not in present]
    kept.append(problem.clock_columns()[:, :, (free & ~clocks.optional).ravel()])
    white = whiten(np.concatenate(columns, axis=2))
    whole = np.einsum("ij,ij->j", white, white)
    basis = orthonormal(whiten(np.concatenate(kept, axis=2)))
    white -= basis @ (basis.T @ white)
    residual -= basis @ (basis.T @ residual)
    # whole recordings if there are enough of them, else blocks
    rank = ranks_of(problem.recordings)
    fold = np.repeat((rank[problem.run] if len(rank) >= FOLDS else block_of(problem)) % FOLDS, 3)
    gram = np.stack([white[fold == k].T @ white[fold == k] for k in range(FOLDS)])
    score = np.stack([white[fold == k].T @ residual[fold == k] for k in range(FOLDS)])
    first = np.concatenate(([0], np.cumsum([part.shape[2] for part in columns]))).astype(np.int64)
    numbers: dict[str, int] = {}
    length = np.maximum(np.einsum("fii->i", gram), 1e-300)
    unit, alone = length / len(problem.intervals), np.abs(score.sum(axis=0)) / length - _SURELY / np.sqrt(length)
    parts = [slice(first[i], first[i + 1]) for i in range(len(used))]
    priors = [_prior(t, fit, dictionary, unit[o], alone[o]) for t, o in zip(used, parts, strict=True)]
    precision, low, high = (np.concatenate(part) for part in zip(*priors, strict=True))
    names = [effect.name for effect in fit.effects]
    return used, Evidence(
        first=first,
        gram=gram,
        score=score,
        whole=whole,
        precision=precision,
        low=low,
        high=high,
        cost=np.array([cost_of(t, dictionary.decisions, names) for t in used]),
        group=np.array([numbers.setdefault(t.name, len(numbers)) for t in used]),
        limited=np.array([isinstance(t, BasisTerm) for t in used]),
        most=dictionary.decisions.max_dependences,
    )


def _prior(term: Competing, fit: Fit, dictionary: Dictionary, unit: Array, alone: Array) -> tuple[Array, Array, Array]:
    """Return the prior precision (p,) of the coefficients of a term, and their bounds (p,) to first order.

    An amplitude is normal about its identity, with a standard deviation of twice its typical size: without it, large
    terms that cancel each other on one drive would explain its noise. It is larger if the term alone is surely larger
    (empirical Bayes). A basis function has a unit information prior (Kass & Wasserman 1995).

    unit, alone : (p,) precision of unit information; least size of each coefficient with no other term in the model
    """
    free = np.full(term.width, np.inf)
    if isinstance(term, ClockTerm):
        return np.maximum(_CLOCKS[term.name], alone) ** -2, -free, free
    if isinstance(term, BasisTerm):
        return unit, -free, free
    low, high = dictionary.bounds_of(term.start, fit).T
    deviation = np.maximum(prior_deviations([term.start]), alone)
    return deviation**-2, low, high


def started(fit: Fit, effect: Effect, estimate: Sequence[float]) -> Effect:
    """Return an effect at a first-order estimate, from which a fit can start.

    An estimate beyond a bound is that of an error that is not linear in the parameter: the value whose error is as
    large is found.
    """
    values = {}
    for p, estimated in zip(amplitudes(effect), estimate, strict=True):
        values[p.name] = p.identity + estimated
        most = (p.low if estimated < 0.0 else p.high) - p.identity
        if abs(estimated) > abs(most):

            def over(change: float, p: Parameter = p, size: float = abs(estimated)) -> float:
                return _first_order(fit, effect, p, change) - size

            values[p.name] = p.identity + (brentq(over, 0.0, most, xtol=1e-6) if over(most) > 0.0 else most)
    return replace(effect, **values)  # type: ignore[type-var]  # effects are dataclasses


def _first_order(fit: Fit, effect: Effect, p: Parameter, change: float) -> float:
    """Return the size of the first-order estimate for a change of a parameter from its identity."""

    def size(value: float) -> float:
        acting = replace(effect, **{p.name: value})  # type: ignore[type-var]  # effects are dataclasses
        return float(np.sqrt(sum(np.sum(error_of(acting, m) ** 2) for m in fit.problem.motions)))

    slope = size(p.identity + np.copysign(p.step, change)) / p.step
    return size(p.identity + change) / slope if slope > 0.0 else 0.0


def cost_of(term: Competing, decisions: Decisions, names: Iterable[str]) -> float:
    """Return the gain on left-out data at which a term breaks even, nats: the negative logarithm of its prior odds.

    names : effects of the model; beside the bias or the scale error of a gyro, the heading usually comes from it
    """
    if isinstance(term, ClockTerm):
        return decisions.clock_nats
    unusual = 0
    if isinstance(term, LibraryTerm):
        usual = {word: options[0] for word, options in choices(term.start).items()}
        usual["heading"] = "wheels" if _OF_GYRO.isdisjoint(names) else "gyro"
        unusual = sum(getattr(term.start, word, value) != value for word, value in usual.items()) + term.width - 1
    basis = decisions.basis_nats if isinstance(term, BasisTerm) else 0.0
    return decisions.term_nats + penalty(term, 1, decisions) + decisions.unusual_shape_nats * unusual + basis
