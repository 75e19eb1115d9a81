"""Shape search: the member of a family of terms with the largest gain; approximate for all, exact for the best.

Thousands of terms are screened by approximate gains: a drive is thinned to a few increments of every interval, and a
term is represented by its mean over them. A family then costs one whitening per channel, not one per member. Reported
scores of a term always come from its exact columns.

Places, thresholds and correlation times are nonlinear parameters. Families are evaluated on grids. From the best
member, coordinate steps of decreasing size lead to the nearest maximum. Once a term is in the model, a simplex varies
all its shape parameters jointly, because the likelihood may have ridges.
"""

from __future__ import annotations

from dataclasses import fields, replace
from functools import cached_property
from itertools import groupby
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from scipy.optimize import minimize

from odomcorrupt.effects.compensation import error_of
from odomcorrupt.effects.effect import amplitudes
from odomcorrupt.errors import EffectError
from odomcorrupt.study.estimate.drive_type import is_holonomic
from odomcorrupt.study.estimate.problem import by_column
from odomcorrupt.study.io.recording import shared_frame
from odomcorrupt.study.select.evidence import project_out
from odomcorrupt.study.terms.basis import basis_functions, evaluated
from odomcorrupt.study.terms.channels import actions_on, views
from odomcorrupt.study.terms.term import BasisTerm, LibraryTerm, T, Term, neighbours

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from odomcorrupt.effects.effect import Effect, Motion
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.estimate.gauss_newton import Fit
    from odomcorrupt.study.estimate.problem import Problem
    from odomcorrupt.study.select.decisions import Decisions
    from odomcorrupt.study.select.evidence import Projection
    from odomcorrupt.study.terms.basis import BasisFunction
    from odomcorrupt.study.terms.channels import Action

_SAMPLES = 5
"""Number of increments kept of each interval."""
_MEAN = np.tile(np.eye(3) / _SAMPLES, (_SAMPLES, 1))
"""Matrix (3 samples, 3) that converts rows of rates of several samples to their means."""
_KEPT = 20
"""Number of basis functions of each regressor and action that are whitened."""


class Screened(NamedTuple):
    """A basis function with its action, and its approximate gain before the penalty, nats."""

    term: BasisTerm
    nats: float


class CoarseDesign:
    """Approximate columns of terms on the K intervals of a problem, from the mean of each term over every interval.

    The design does not depend on the model, and remains valid for an unchanged problem.
    """

    def __init__(self, problem: Problem) -> None:
        self._intervals, self._motions = problem.intervals, problem.motions
        self._placed = shared_frame(problem.recordings) is not None
        self._sideways = is_holonomic(problem.recordings, problem.motions)
        self._means: dict[tuple[str, frozenset[str], str], Array] = {}
        self._units: dict[Action, list[tuple[str, Array]]] = {}
        self._reaching: dict[frozenset[str], list[BasisFunction]] = {}

    @cached_property
    def functions(self) -> list[BasisFunction]:
        """All basis functions that are tried on this drive."""
        return basis_functions(self._motions, placed=self._placed, sideways=self._sideways)

    @property
    def actions(self) -> list[Action]:
        """All actions that these motions allow and that are tried with any basis function."""
        return [a for a in actions_on(self._motions, sideways=self._sideways) if self.reaching(a)]

    def reaching(self, action: Action) -> list[BasisFunction]:
        """Return the basis functions that are tried with an action."""
        reaches = action.reaches
        if reaches not in self._reaching:
            self._reaching[reaches] = [f for f in self.functions if not reaches.isdisjoint(f.reaches)]
        return self._reaching[reaches]

    def columns(self, terms: Sequence[Term]) -> Array:
        """Return the approximate change (K, 3, P) of the residuals per unit of each coefficient of each term."""
        parts = []
        for (kind, action), group in groupby(terms, key=lambda t: (type(t), getattr(t, "action", None))):
            if kind is BasisTerm and action is not None:
                functions = [term.function for term in group if isinstance(term, BasisTerm)]
                parts.append(
                    self.acting(action, [self.means(functions, v, action.move) for v, _ in self.units(action)])
                )
            else:
                parts += [self._library(term) for term in group if isinstance(term, LibraryTerm)]
        return by_column(np.concatenate([part.transpose(2, 0, 1) for part in parts]))

    def acting(self, action: Action, means: Sequence[Array]) -> Array:
        """Return columns (K, 3, P) of functions from their means (K, P), one array for each unit of an action."""
        units = self.units(action)
        return by_column(np.asarray(sum(u * mean.T[:, :, None] for (_, u), mean in zip(units, means, strict=True))))

    def units(self, action: Action) -> list[tuple[str, Array]]:
        """Return the views (body or wheel) of an action, each with the change (K, 3) of residuals per unit error."""
        if action not in self._units:
            track_m = self._motions[0].track_m
            moved = [(m.dt_s, action.rates(v, track_m)) for m, v in zip(self._motions, self._whole, strict=True)]
            self._units[action] = [
                (view, self._intervals.column(np.concatenate([dt_s[:, None] * rates[i][1] for dt_s, rates in moved])))
                for i, (view, _) in enumerate(moved[0][1])
            ]
        return self._units[action]

    def means_of_all(self, view: str, action: Action) -> Array:
        """Return the means (K, P) of all basis functions that are tried with an action."""
        move = {"omega": "omega", "vy": "vy", "abs(vy)": "vy"}.get(action.move, "v")
        key = (view, action.reaches, move)
        if key not in self._means:
            self._means[key] = self.means(self.reaching(action), view, move)
        return self._means[key]

    def means(self, functions: Sequence[BasisFunction], view: str, move: str) -> Array:
        """Return the means (K, P) of functions over the intervals, weighted by the motion of each sample."""
        seen, count = self._seen[view], len(self._intervals)
        weight = np.abs(evaluated(move, seen)).reshape(count, -1) + 1e-9
        weight = weight / weight.sum(axis=1, keepdims=True)
        parts = [part for function in functions for part in function.parts(seen)]
        means = np.empty((len(parts), count))
        for own, part in zip(means, parts, strict=True):
            np.einsum("ks,ks->k", weight, part.reshape(count, -1), out=own)
        return means.T

    def _library(self, term: LibraryTerm) -> Array:
        """Return approximate columns (K, 3, p) of a memoryless effect, zero if it cannot act."""
        columns = []
        for p in amplitudes(term.start):
            acting = replace(term.start, **{p.name: p.identity + p.step})  # type: ignore[type-var]  # effects are dataclasses
            try:
                rate = error_of(acting, self._thinned).reshape(len(self._intervals), 3 * _SAMPLES) @ _MEAN
            except EffectError:  # the effect acts on single wheels, and the track is unknown
                rate = np.zeros((len(self._intervals), 3))
            rate *= -1.0 / p.step
            columns.append(sum(held * rate[:, [i]] for i, held in enumerate(self._held)))
        return by_column(np.stack(columns))

    @cached_property
    def _thinned(self) -> Motion:
        """`_SAMPLES` evenly spread increments of each of the K intervals, as one motion."""
        intervals, first = self._intervals, self._motions[0]
        last = np.append(intervals.first[1:], len(intervals.source)) - 1
        steps = np.linspace(intervals.first, last, _SAMPLES).round().astype(np.int64).T.ravel()
        chosen = intervals.source[steps]
        names = [f.name for f in fields(first) if isinstance(getattr(first, f.name), np.ndarray)]
        arrays: dict[str, Any] = {n: np.concatenate([getattr(m, n) for m in self._motions])[chosen] for n in names}
        return replace(first, **arrays)

    @cached_property
    def _seen(self) -> dict[str, Motion]:
        return views(self._thinned)

    @cached_property
    def _whole(self) -> list[dict[str, Motion]]:
        return [views(m) for m in self._motions]

    @cached_property
    def _held(self) -> list[Array]:
        """Changes (K, 3) of the residuals by a constant rate of one in each channel."""
        dt_s = np.concatenate([m.dt_s for m in self._motions])
        return [self._intervals.column(dt_s[:, None] * unit) for unit in np.eye(3)]


def coarse_gains(fit: Fit, rest: Projection, columns: Array, counts: Sequence[int]) -> Array:
    """Return the gains (J,), nats, of groups of adjacent approximate columns (K, 3, P) on the residual of a fit.

    counts : (J,) number of columns of each group
    """
    raw = fit.noise.whitener.whiten(columns)
    own = np.einsum("ij,ij->j", raw, raw)
    white, first = rest.of(raw), _first_of(counts)
    score, length = white.T @ rest.residual, np.einsum("ij,ij->j", white, white)
    kept = length > 1e-3 * np.maximum(own, 1e-300)
    single = np.where(kept, score**2 / np.maximum(length, 1e-300), 0.0)
    gains: Array = 0.5 * np.add.reduceat(single, first[:-1])
    for i in np.flatnonzero(np.diff(first) > 1):
        group = slice(first[i], first[i + 1])
        normal = white[:, group].T @ white[:, group]
        if kept[group].all() and np.linalg.cond(normal) < 1e6:
            gains[i] = 0.5 * score[group] @ np.linalg.solve(normal, score[group])
    return gains


def promising_terms(fit: Fit, rest: Projection, design: CoarseDesign) -> list[Screened]:
    """Return the best basis functions of every regressor for every action, with their approximate gains."""
    found: list[Screened] = []
    pull = fit.noise.whitener.pulled(rest.residual)
    for action in design.actions:
        functions = design.reaching(action)
        means = [design.means_of_all(view, action) for view, _ in design.units(action)]
        kept = _best_apart(fit, design, action, means, pull)
        first = _first_of([function.width for function in functions])
        columns = np.concatenate([np.arange(first[i], first[i + 1]) for i in kept])
        counts = [functions[i].width for i in kept]
        gains = coarse_gains(fit, rest, design.acting(action, [mean[:, columns] for mean in means]), counts)
        found += [Screened(BasisTerm(functions[i], action), float(g)) for i, g in zip(kept, gains, strict=True)]
    return found


def _best_apart(fit: Fit, design: CoarseDesign, action: Action, means: Sequence[Array], pull: Array) -> list[int]:
    """Return the indices of functions to whiten: the best of each regressor if intervals were independent.

    Only the normalisation assumes independence; the scores are exact, from one back-substitution for all functions.
    """
    functions = design.reaching(action)
    units = [unit for _, unit in design.units(action)]
    score = sum(np.einsum("ki,ki->k", unit, pull) @ mean for unit, mean in zip(units, means, strict=True))
    white = [fit.noise.whitener.whiten(unit).reshape(-1, 3) for unit in units]
    length = sum(
        np.einsum("k,kj,kj->j", np.einsum("ki,ki->k", w, x), m, n)
        for w, m in zip(white, means, strict=True)
        for x, n in zip(white, means, strict=True)
    )
    apart = np.asarray(score) ** 2 / np.maximum(np.asarray(length), 1e-300)
    gains = 0.5 * np.add.reduceat(apart, _first_of([function.width for function in functions])[:-1])
    kept = list[int]()
    for regressor in dict.fromkeys(function.regressor for function in functions):
        own = [i for i, f in enumerate(functions) if f.regressor == regressor]
        kept += sorted(own, key=lambda i: -gains[i])[:_KEPT]
    return kept


def _first_of(counts: Sequence[int]) -> NDArray[np.int64]:
    """Return the index of the first column of each group, and the number of columns at the end."""
    return np.concatenate(([0], np.cumsum(counts))).astype(np.int64)


_WIDE, _COARSE = (4.0, 2.0), (1.0, 0.5, 0.25, 0.125)
"""Scales of the steps of a shape search; wide ones for places, whose gain changes only when an edge reaches another
part of the path."""
_PLACE = 3
"""Number of shape parameters from which on a basis function is one of a place."""
_SIMPLEX = 0.25
"""Scale of the first simplex."""
_MOST_STEPS, _WORTH_NATS = 12, 0.1  # largest number of steps at each scale; least gain of a step
_NEAR, _WORTH = 0.03, 0.05
"""Size of the simplex, as a fraction of the first steps, and difference in nats at which it ends."""


class ShapeSearch:
    """Searches over shapes of terms beside the model of a fit.

    design : approximate columns, if already computed for this problem
    """

    def __init__(self, fit: Fit, decisions: Decisions, design: CoarseDesign | None = None) -> None:
        self._fit, self._decisions, self._rest = fit, decisions, project_out(fit)
        self._design = CoarseDesign(fit.problem) if design is None else design
        self._gains: dict[Term, float] = {}
        self._coarse_gains: dict[Effect, float] = {}

    def gain(self, term: Term) -> float:
        """Return the gain of a term at its shape, nats, from exact columns; 0 if it cannot act."""
        if term not in self._gains:
            try:
                white = self._fit.noise.whitener.whiten(term.columns(self._fit.problem))
            except EffectError:  # the term acts on single wheels, and the track is unknown
                return 0.0
            self._gains[term] = self._rest.gain(white)
        return self._gains[term]

    def coarse_gains(self, terms: Sequence[Term]) -> Array:
        """Return the approximate gains (J,) of terms at their shapes, nats."""
        of_library = [term for term in terms if isinstance(term, LibraryTerm)]
        if len(of_library) < len(terms):
            return self._gains_of(terms)
        known = self._coarse_gains
        if new := {term.start: term for term in of_library if term.start not in known}:
            known.update(zip(new, self._gains_of(list(new.values())).tolist(), strict=True))
        return np.array([known[term.start] for term in of_library])

    def _gains_of(self, terms: Sequence[Term]) -> Array:
        return coarse_gains(self._fit, self._rest, self._design.columns(terms), [term.width for term in terms])

    def located(self, family: Sequence[LibraryTerm]) -> list[LibraryTerm]:
        """Return the member of a family with the largest gain for each source of the heading, its shape refined.

        Shapes are compared and refined with approximate columns, except those of effects with memory.
        """
        found = []
        for members in (family, *zip(*(term.with_words(("heading",)) for term in family), strict=True)):
            begin: Sequence[LibraryTerm] = members
            if not members[0].remembers and len(members) > 1:
                begin = [self.climb(members[int(np.argmax(self.coarse_gains(members)))])]
            found.append(max(begin, key=self.gain))
        return found

    def promising(self) -> list[Screened]:
        """Return the best basis functions of every regressor and action, on the grid of their families.

        Rectangles are too many to try everywhere; they are tried around the best disc, if its gain is large.
        """
        found = promising_terms(self._fit, self._rest, self._design)
        disc = max((s for s in found if s.term.function.related), key=lambda s: s.nats, default=None)
        decisions = self._decisions
        most = max((s.nats for s in found), default=0.0)
        least = max(decisions.related_nats, decisions.related_share * most)
        if disc is None or disc.nats < least:
            return found
        place = self.climb(disc.term)
        actions = [place.action, *(a for a in self._design.actions if "both" in a.reaches)]
        related = []
        for function in place.function.related:
            tried = [BasisTerm(function, action) for action in actions]
            turned = self.climb(tried[int(np.argmax(self.coarse_gains(tried)))])
            related.append(Screened(turned, float(self.coarse_gains([turned])[0])))
        return [*found, max(related, key=lambda s: s.nats)]

    def climb(self, term: T) -> T:
        """Return the term at the nearest maximum of the approximate gain; unchanged if it is an effect with memory."""
        if not len(term.shape) or (isinstance(term, LibraryTerm) and term.remembers):
            return term
        wide = _WIDE if isinstance(term, BasisTerm) and len(term.shape) >= _PLACE else ()
        (nats,) = self.coarse_gains([term])
        for scale in wide + _COARSE:
            for _ in range(_MOST_STEPS):
                near: list[T] = list(neighbours(term, scale))
                gains = self.coarse_gains(near)
                best = int(np.argmax(gains))
                if not gains[best] > nats + _WORTH_NATS:
                    break
                term, nats = near[best], gains[best]
        return term

    def maximise(self, term: T) -> T:
        """Return the term at the nearest maximum over all shape parameters jointly, from exact columns.

        By a simplex, as edges have no gradient (Nelder and Mead 1965, Computer Journal 7, 308).
        """
        if not len(term.shape):
            return term
        start, steps, none = term.shape, _SIMPLEX * term.steps, np.zeros(len(term.shape))

        def moved(by: Array) -> T:
            return term.with_shape((start + steps * by).tolist())

        simplex = np.vstack((none, np.eye(len(none))))
        options = {"initial_simplex": simplex, "xatol": _NEAR, "fatol": _WORTH}
        return moved(minimize(lambda by: -self.gain(moved(by)), none, method="Nelder-Mead", options=options).x)
