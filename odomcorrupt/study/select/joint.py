"""Selection of a model: rounds of one linearisation, a joint search over all terms, and one non-linear refit."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.effects import registry
from odomcorrupt.effects.compensation import error_of
from odomcorrupt.effects.effect import amplitudes, choices
from odomcorrupt.errors import EffectError, FitError
from odomcorrupt.study.estimate.clocks import find_clocks, levelled
from odomcorrupt.study.estimate.config import choose_approach
from odomcorrupt.study.estimate.correlation_length import with_correlation_lengths
from odomcorrupt.study.estimate.extrinsics import mounting_of
from odomcorrupt.study.estimate.gauss_newton import Fit, fit, orthonormal
from odomcorrupt.study.estimate.gyro_walk import with_bias_walks
from odomcorrupt.study.estimate.random_process import CORRELATED_NOISE
from odomcorrupt.study.estimate.robust_errors import block_of
from odomcorrupt.study.io.clock import Clock, clock_leaders
from odomcorrupt.study.select.candidates import library
from odomcorrupt.study.select.decisions import DECISIONS, Decisions, penalty
from odomcorrupt.study.select.elimination import drop_term
from odomcorrupt.study.select.evidence import FOLDS, Evidence, Search
from odomcorrupt.study.select.periodic import waves
from odomcorrupt.study.select.random_effects import random_coefficients
from odomcorrupt.study.select.screening import CoarseDesign
from odomcorrupt.study.select.shape_search import ShapeSearch
from odomcorrupt.effects.region_slip import RegionSlip
from odomcorrupt.study.terms.basis.place import rectangle_of
from odomcorrupt.study.terms.term import BasisTerm, LibraryTerm

ROUNDS = 5
TYPICAL = 2.0
ANY = 3.0
BASIS = 3.0
CLEAR = 1.5
LARGE_CLOCK_S = 0.025
CLOCK_PRIOR = {"time_offset": 0.03, "clock_skew": 1e-4}
TRIES = 3
KINDS = 2  # basis functions of each regressor and channel


@dataclass(frozen=True)
class ClockTerm:
    """Offset or rate of the clocks that are optional."""

    name: str
    which: tuple[int, ...]

    @property
    def width(self):
        return len(self.which)

    def columns(self, problem):
        return problem.clock_columns()[:, :, list(self.which)]


@dataclass
class Selection:
    fit: Fit
    given: set[str]
    held: np.ndarray  # (R, 2) clocks that are free in any case
    optional: np.ndarray  # (R, 2) of leaders
    decisions: Decisions
    pool: dict = field(default_factory=dict)
    clock_on: tuple[str, ...] = ()
    search: Search | None = None
    terms: list = field(default_factory=list)
    log: list = field(default_factory=list)


def selected(s: Selection):
    return [e for e in s.fit.effects if e.name not in s.given]


def propose(s: Selection) -> list:
    """Terms of this round: those present, clocks, the pool, and shapes that are best beside the current model."""
    f = s.fit
    present = selected(s)
    terms = [LibraryTerm.of(e, f.problem.motions) if e.name in registry() else s.pool[e.name] for e in present]
    for i, name in enumerate(("time_offset", "clock_skew")):
        which = tuple(int(2 * r + i) for r in np.flatnonzero(s.optional[:, i]))
        if which:
            terms.append(ClockTerm(name, which))
    search = ShapeSearch(f, s.decisions, CoarseDesign(f.problem))
    for family in library(f):
        term = search.located(family).term
        if term.related() and search.gain(term) > s.decisions.related_nats:
            s.pool.setdefault(term.start, term)
            term = search.best(family)
        for one in (term, *term.with_words(tuple(choices(term.start)))):
            s.pool.setdefault(one.start, one)
    count = len(f.problem.intervals)
    kinds: dict = {}
    worth = [(b.nats - penalty(b.term, count, s.decisions), i, b.term) for i, b in enumerate([*search.promising(), *waves(f)])]
    for nats, _, term in sorted(worth, key=lambda w: (-w[0], w[1])):
        kind = (term.function.regressor, term.action.channel)
        if nats > -6.0 and kinds.get(kind, 0) < KINDS:
            kinds[kind] = kinds.get(kind, 0) + 1
            moved = search.climb(term)
            s.pool.setdefault((moved.name, moved.function.text, moved.action), moved)
            patch = patch_of(moved, f)
            if patch is not None:
                s.pool.setdefault(patch.start, patch)
    seen = {getattr(t, "start", None) for t in terms if isinstance(t, LibraryTerm)}
    terms += [t for k, t in s.pool.items() if not isinstance(k, str) and not (isinstance(t, LibraryTerm) and t.start in seen)]
    return terms


def patch_of(term: BasisTerm, f: Fit):
    """The patch of floor with the strip or rectangle of a basis function."""
    rectangle = rectangle_of(term.function)
    if rectangle is None or term.action.channel == "yaw" and not term.action.by_wheel:
        return None
    angle, x, y, half, side = rectangle
    patch = RegionSlip.in_rectangle(angle, (x, y), half, side, f.problem.motions)
    if term.action.by_wheel:
        patch = replace(patch, contact="wheels", heading=term.action.heading)
    return LibraryTerm(patch, max(len(RegionSlip.scan(f.problem.motions)), 1))


def linearised(s: Selection, terms):
    """Evidence of the terms on the current linearisation."""
    f, problem = s.fit, s.fit.problem
    white = f.noise.whitener.whiten
    r = f.noise.innovations.copy()
    for e in selected(s):
        r += white(problem.columns(e)) @ np.array([getattr(e, p.name) - p.identity for p in amplitudes(e)])
    free = np.array(f.free_clocks)
    clocks = problem.clock_columns() if s.optional.any() or s.held.any() else None
    leaders = clock_leaders(problem.recordings)
    at = [(i, k) for i in sorted(set(leaders)) for k in (0, 1) if s.optional[i, k] and free[i, k]]
    if at:
        value = np.array([problem.clocks[i].offset_s if k == 0 else problem.clocks[i].rate for i, k in at])
        r += white(clocks[:, :, [2 * i + k for i, k in at]]) @ value
    fixed = [problem.columns(e) for e in f.effects if e.name in s.given]
    held = [2 * i + k for i in sorted(set(leaders)) for k in (0, 1) if s.held[i, k]]
    if held:
        fixed.append(clocks[:, :, held])
    basis = orthonormal(white(np.concatenate(fixed, axis=2))) if fixed else np.zeros((len(r), 0))
    used, parts = [], []
    now = dict(zip(terms, selected(s), strict=False))  # terms of the model begin, in the order of its effects
    for t in terms:
        try:
            c = problem.columns(now[t]) if t in now else t.columns(problem)
        except EffectError:
            continue
        used.append(t)
        parts.append(c)
    width = [p.shape[2] for p in parts]
    W = white(np.concatenate(parts, axis=2))
    W -= basis @ (basis.T @ W)
    r -= basis @ (basis.T @ r)
    block = np.repeat(block_of(problem), 3)
    fold = np.unique(block, return_inverse=True)[1] % FOLDS
    gram = np.stack([W[fold == k].T @ W[fold == k] for k in range(FOLDS)])
    score = np.stack([W[fold == k].T @ r[fold == k] for k in range(FOLDS)])
    first = np.concatenate(([0], np.cumsum(width)))
    count = len(problem.intervals)
    diag = np.einsum("fii->i", gram)
    precision, low, high, cost, group = [], [], [], [], []
    numbers: dict = {}
    for i, t in enumerate(used):
        own = slice(first[i], first[i + 1])
        group.append(numbers.setdefault(t.name, len(numbers)))
        if isinstance(t, ClockTerm):
            precision += [1.0 / CLOCK_PRIOR[t.name] ** 2] * t.width
            low += [-np.inf] * t.width
            high += [np.inf] * t.width
            cost.append(ANY - 1.0)
        elif isinstance(t, BasisTerm):
            precision += list(np.maximum(diag[own], 1e-12) / count)
            low += [-np.inf] * t.width
            high += [np.inf] * t.width
            cost.append(penalty(t, 1, s.decisions) + ANY + BASIS)
        else:
            for p in amplitudes(t.start):
                precision.append(1.0 / (TYPICAL * p.typical) ** 2)
                low.append(room(f, t.start, p, p.low - p.identity))
                high.append(room(f, t.start, p, p.high - p.identity))
            words = sum(getattr(t.start, w) != o[0] for w, o in choices(t.start).items())
            gyro = getattr(t.start, "heading", "") == "gyro"
            cost.append(penalty(t, 1, s.decisions) + ANY + 2.0 * words + 2.0 * gyro)
    evidence = Evidence(
        first=first, gram=gram, score=score, precision=np.array(precision), low=np.array(low), high=np.array(high),
        cost=np.array(cost), group=np.array(group), limited=np.array([isinstance(t, BasisTerm) for t in used]),
    )
    return used, evidence


def room(f: Fit, effect, p, bound: float) -> float:
    """First-order estimate that corresponds to a parameter at its bound."""
    if bound == 0.0 or not np.isfinite(bound):
        return bound * 1.0
    def size(value):
        acting = replace(effect, **{p.name: value})
        try:
            return float(np.sqrt(sum(np.sum(error_of(acting, m) ** 2) for m in f.problem.motions)))
        except EffectError:
            return 0.0
    slope = size(p.identity + np.copysign(p.step, bound)) / p.step
    return float(np.copysign(max(size(p.identity + bound) / slope, abs(bound)) if slope > 0 else abs(bound), bound))


def refit(s: Selection, used, evidence, subset):
    theta = evidence.estimate(subset)
    effects, on, k = [e for e in s.fit.effects if e.name in s.given], [], 0
    now = {e.name: e for e in s.fit.effects}
    for i in subset:
        t, own = used[i], theta[k : k + used[i].width]
        k += used[i].width
        if isinstance(t, ClockTerm):
            on.append(t.name)
            continue
        if isinstance(t, BasisTerm):
            s.pool[t.name] = t
            effects.append(t.effect(own.tolist()))
        else:
            effects.append(t.effect([p.identity + float(x) for p, x in zip(amplitudes(t.start), own, strict=True)]))
    leaders = clock_leaders(s.fit.problem.recordings)
    free, clocks = [], []
    for i, c in enumerate(s.fit.problem.clocks):
        lead = leaders[i]
        o = s.held[lead, 0] or (s.optional[lead, 0] and "time_offset" in on)
        q = s.held[lead, 1] or (s.optional[lead, 1] and "clock_skew" in on)
        free.append((bool(o), bool(q)))
        clocks.append(Clock(c.offset_s if o else 0.0, c.rate if q else 0.0))
    trial = s.fit.refit(effects, clocks=clocks, free_clocks=free, weights_of=s.fit)
    return tuple(on), trial


def shaped(s: Selection, f: Fit, done: set) -> Fit:
    """Fit with the shapes of its effects at the maximum, where a refit gains."""
    for e in list(f.effects):
        if e.name in s.given or e.name in done:
            continue
        term = LibraryTerm.of(e, f.problem.motions) if e.name in registry() else s.pool[e.name]
        if not len(term.shape):
            continue
        done.add(e.name)
        moved = ShapeSearch(drop_term(f, e), s.decisions).maximise(term)
        if np.array_equal(moved.shape, term.shape):
            continue
        now = next((x for x in f.effects if x.name == e.name), None)
        if now is None:
            continue
        values = [getattr(now, p.name) for p in amplitudes(now)]
        try:
            other = f.refit([moved.effect(values) if x is now else x for x in f.effects], weights_of=f)
        except (FitError, EffectError):
            continue
        if other.log_likelihood > f.log_likelihood + s.decisions.reshape_nats:
            if isinstance(moved, BasisTerm):
                s.pool[moved.name] = moved
            f = other.refit()
    return f


def rounds(s: Selection) -> None:
    done: set = set()
    for _ in range(ROUNDS):
        terms = propose(s)
        used, evidence = linearised(s, terms)
        now = {e.name for e in selected(s)}
        start = tuple(
            i for i, t in enumerate(used)
            if (isinstance(t, ClockTerm) and t.name in s.clock_on) or (i < len(now) and t.name in now)
        )
        search = Search.of(evidence, start)
        s.search, s.terms = search, used
        accepted = False
        for _ in range(TRIES):
            best = search.clear_parts(CLEAR)
            key = tuple(sorted(used[i].name for i in best))
            s.log.append((key, round(search.seen[best], 1)))
            if set(best) == set(start):
                break
            more = search.seen[best] - search.seen.get(start, 0.0)
            try:
                on, trial = refit(s, used, evidence, best)
                paid = evidence.cost[list(best)].sum() - evidence.cost[list(start)].sum()
                real = trial.log_likelihood - s.fit.log_likelihood - paid
            except (FitError, EffectError) as error:
                s.log.append(str(error))
                real = -np.inf
            s.log.append((round(more, 1), round(real, 1)))
            if real > 0.0 or (len(best) < len(start) and real > -3.0):
                accepted = True
                break
            search.seen[best] = -np.inf
            tabu = frozenset(used[i].name for i in best)
            for other in search.seen:
                if frozenset(used[i].name for i in other) == tabu:
                    search.seen[other] = -np.inf
        if not accepted:
            break
        s.clock_on = on
        s.fit = shaped(s, trial.refit(), done)


def joint_learn(recordings, start=(), *, decisions=DECISIONS):
    start = (*start, *mounting_of(recordings, start))
    approach = choose_approach(recordings)
    recordings = with_bias_walks(with_correlation_lengths(recordings, approach), approach)
    found = find_clocks(recordings, approach)
    recordings = levelled(recordings, found)
    span = [float(r.truth_s[-1] - r.truth_s[0]) for r in recordings]
    large = np.array(
        [
            [f[0] and abs(c.offset_s) > LARGE_CLOCK_S, f[1] and abs(c.rate) * t > LARGE_CLOCK_S]
            for c, f, t in zip(found.clocks, found.free, span, strict=True)
        ]
    )
    free = np.array(found.free, dtype=bool)
    leaders = np.array(clock_leaders(recordings))
    own = (leaders == np.arange(len(leaders)))[:, None]
    held, optional = large & own, free & ~large & own
    clocks = [Clock(c.offset_s if h[0] else 0.0, c.rate if h[1] else 0.0) for c, h in zip(found.clocks, large, strict=True)]
    first = fit(
        recordings, [e for e in start if e.kind != "noise"], clocks=clocks,
        free_clocks=[(bool(a), bool(b)) for a, b in large], approach=approach,
        random=[e for e in start if e.name in CORRELATED_NOISE],
    )
    s = Selection(first, {e.name for e in start}, held, optional, decisions)
    for _ in range(3):
        rounds(s)
        if len(s.fit.random) >= decisions.max_correlated:
            break
        noise = random_coefficients(s.fit, decisions, last=True)
        if not noise:
            break
        s.log.append(("noise", noise[0].effect.name, round(noise[0].nats, 1)))
        s.fit = s.fit.refit(random=(*s.fit.random, noise[0].effect))
    return s
