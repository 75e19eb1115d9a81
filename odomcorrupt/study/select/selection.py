"""Selection of a model, in rounds of one linearisation, one search over sets of terms, and one non-linear refit.

    fit -> dictionary of terms -> columns, whitened once -> held-out evidence of sets -> the best set, refitted

Rounds end when the best set is that of the model. Then a random process may be included, and the rounds go on with its
covariance in the whitening: what only imitated it leaves the model, what it had hidden enters.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from operator import itemgetter
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from odomcorrupt.effects import registry
from odomcorrupt.effects.effect import amplitudes
from odomcorrupt.errors import EffectError, FitError
from odomcorrupt.study.estimate.clocks import find_clocks, levelled, mounting_of, with_rounding
from odomcorrupt.study.estimate.config import choose_approach
from odomcorrupt.study.estimate.correlation_length import with_correlation_lengths
from odomcorrupt.study.estimate.gauss_newton import Fit, fit
from odomcorrupt.study.estimate.random_process import CORRELATED_NOISE
from odomcorrupt.study.estimate.robust_errors import with_robust_errors
from odomcorrupt.study.estimate.truth_bias import with_bias_walks
from odomcorrupt.study.estimate.windows import drift_of, ten_second_error
from odomcorrupt.study.io.clock import Clock, as_rows, clock_leaders, led
from odomcorrupt.study.io.encoders import encoder_effects, hides_losses, restore_lost
from odomcorrupt.study.select.candidates import Dependence, dependence_of, drop_term, score_terms, tested_candidates
from odomcorrupt.study.select.contribution import is_exact
from odomcorrupt.study.select.decisions import DECISIONS, Decisions
from odomcorrupt.study.select.dictionary import (
    ClockChoice,
    ClockTerm,
    Competing,
    Dictionary,
    cost_of,
    linearised,
    started,
)
from odomcorrupt.study.select.evidence import Evidence, Search, Subset
from odomcorrupt.study.select.heterogeneity import disagreements
from odomcorrupt.study.select.random_effects import (
    DetectedRandomEffect,
    eliminate_random,
    iterate,
    outlier_effects,
    random_coefficients,
)
from odomcorrupt.study.select.result import Learned, Step
from odomcorrupt.study.select.shape_search import ShapeSearch
from odomcorrupt.study.terms.term import BasisTerm, LibraryTerm

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from numpy.typing import NDArray

    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.estimate.clocks import Clocks
    from odomcorrupt.study.io.recording import Recording
    from odomcorrupt.study.select.candidates import Candidate

Watch: TypeAlias = "Callable[[str, float], None]"
"""Called before each stage of a study with its name and the fraction of the work done."""
_ROUNDS, _TRIES = 8, 5
"""Largest number of rounds, and of sets that are refitted in a round."""
_TRUST = 0.8
"""Least gain of a refit relative to that of the linearisation."""
_SPANS_S = (10.0, 60.0)
"""Times over which a term has a size: the error of a heading shows late, above all of a slow robot."""


def stages(watch: Watch | None = None) -> Callable[[str], None]:
    """Return the function that reports the start of a stage; the fraction done never falls, and never reaches one."""
    left = 1.0

    def begin(stage: str) -> None:
        nonlocal left
        if watch is not None:
            watch(stage, 1.0 - left)
        left *= 0.85  # the number of stages to come is unknown

    return begin


def learn(
    recordings: Sequence[Recording],
    start: Sequence[Effect] = (),
    *,
    law_name: str = "diffusion",
    decisions: Decisions = DECISIONS,
    begin: Callable[[str], None] | None = None,
) -> Learned:
    """Return the model selected from recordings of one robot, beginning with the given effects.

    start : effects that are in the model from the beginning and are not dropped
    law_name : the noise law, see `odomcorrupt.model.noise_laws`
    """
    begin = begin or stages()
    begin("clocks")
    start = (*start, *mounting_of(recordings, start))
    as_given, encoders = recordings, encoder_effects(recordings[0])
    recordings = [restore_lost(recording, encoders) for recording in recordings]
    if encoders and drift_of(recordings).rmse > drift_of(as_given).rmse:  # what looks like losses are coarse ticks
        recordings, encoders = as_given, [effect for effect in encoders if not effect.restorable]
    approach = choose_approach(recordings, law_name)
    recordings = with_bias_walks(with_correlation_lengths(recordings, approach), approach)
    clocks = find_clocks(recordings, approach)
    recordings = levelled(recordings, clocks)
    found, leaders = as_rows(clocks.clocks), clock_leaders(recordings)
    far = np.abs(found) * [(1.0, float(r.truth_s[-1] - r.truth_s[0])) for r in recordings] > decisions.far_clock_s
    # an effect that all drives share would look like the same clock in each
    held = far & (len(set(leaders)) > 1)
    choice = ClockChoice(led(np.array(clocks.free).reshape(-1, 2), leaders), np.where(held, found, 0.0))
    first = fit(
        recordings,
        [e for e in start if e.kind != "noise"],
        clocks=[Clock(*own) for own in np.where(far, found, 0.0).tolist()],
        free_clocks=[(bool(offset), bool(rate)) for offset, rate in far & ~held],
        approach=approach,
        random=[e for e in start if e.name in CORRELATED_NOISE],
    )
    noise = [DetectedRandomEffect(e, decisions.counted_nats) for e in encoders]
    selection = _Selection(first, {e.name for e in start}, choice, decisions, begin, noise)
    if not is_exact(ten_second_error(first), first.problem.motions, decisions.practical):
        selection.run()
    return replace(selection.result(clocks), hides_losses=hides_losses(as_given[0]))


@dataclass(slots=True)
class _Selection:
    """State of a selection in progress.

    fit, noise : the current model, and its random effects
    given : names of effects that are not dropped
    clocks : those that may be terms, and what stamps are corrected by beforehand
    dictionary, terms : all terms so far, and those of the effects in the model by name
    at : the fit that was linearised last
    competing, evidence, search, chosen : terms on that linearisation, their evidence, the search in it, and its own set
    """

    fit: Fit
    given: set[str]
    clocks: ClockChoice
    decisions: Decisions
    begin: Callable[[str], None]
    noise: list[DetectedRandomEffect]
    dictionary: Dictionary = field(init=False)
    terms: dict[str, LibraryTerm | BasisTerm] = field(default_factory=dict)
    at: Fit | None = None
    competing: list[Competing] = field(init=False)
    evidence: Evidence = field(init=False)
    search: Search = field(init=False)
    chosen: Subset = ()

    def __post_init__(self) -> None:
        self.dictionary = Dictionary(self.decisions, len(set(clock_leaders(self.fit.problem.recordings))) > 1)

    def run(self) -> None:
        """Select terms and random processes in turn until neither changes."""
        self._compare_clock_with_lag()
        self._select()
        if self._contradicts_physics():
            self.fit, self.terms = self.fit.refit([e for e in self.fit.effects if e.name in self.given]), {}
            return
        self._compare_with_process()
        while self._include_process():
            self._select()
        self.noise, self.fit = eliminate_random(self.noise, self.fit, self.decisions)
        others = [one.effect for one in self.noise if one.effect.name != "quantization"]  # ticks have no tails
        tails = not (others or any(isinstance(term, BasisTerm) for term in self.terms.values()))
        outliers = outlier_effects(self.fit, self.decisions, tails=tails)
        self.noise += outliers
        if (far := self.clocks.base != 0.0).any():
            free = far | np.array(self.fit.free_clocks)
            self.fit = self.fit.refit(free_clocks=[(bool(offset), bool(rate)) for offset, rate in free])
        effects = [effect.continued(self.fit.problem.motions) for effect in self.fit.effects]
        bursts = [one.effect for one in outliers if one.effect.name == "slip_burst"]
        if bursts or effects != list(self.fit.effects):
            # the error of bursts is an effect, and not noise of every step
            self.fit = self.fit.refit((*effects, *bursts))

    def _compare_clock_with_lag(self) -> None:
        """Replace the offset of a clock by a lag of all speeds, the same to first order, if that is likelier."""
        lag, (clock, *others) = LibraryTerm(registry()["motor_lag"]()), self.fit.problem.clocks
        offset, rate = self.fit.free_clocks[0]
        if others or not offset or clock.offset_s >= 0.0 or lag.name in self.given:
            return
        late, clocks = lag.effect([-clock.offset_s]), [replace(clock, offset_s=0.0)]
        fit = self.fit.refit((*self.fit.effects, late), clocks=clocks, free_clocks=[(False, rate)], weights_of=self.fit)
        least = cost_of(lag, self.decisions, ()) - self.decisions.clock_nats
        if fit.log_likelihood - self.fit.log_likelihood > least:
            self.fit, self.terms = fit.refit(), {lag.name: lag}

    def _contradicts_physics(self) -> bool:
        """Return whether one effect gains more than the whole model, but only with a sign that physics forbids."""
        low, high = (np.where(b, b, far) for b, far in ((self.evidence.low, -np.inf), (self.evidence.high, np.inf)))
        others = [j for j, t in enumerate(self.competing) if j not in self.chosen and isinstance(t, LibraryTerm)]
        one = [self.chosen, *((j,) for j in others if self.competing[j].name not in self.decisions.commanded)]
        score = replace(self.evidence, low=low, high=high).gains(one).score
        forbidden = ~np.isfinite(self.evidence.gains(one).score)
        return bool(np.isfinite(score[0]) and np.any(score[forbidden] > score[0] + self.decisions.replacement_nats))

    def _select(self) -> None:
        """Take rounds until the best set of terms is that of the model."""
        for _ in range(_ROUNDS):
            self.begin("search: effects")
            self._linearise()
            self.begin("search: refits")
            if not self._refit_best():
                break
        self._drop_misfits()

    def _linearise(self) -> None:
        """Compute the evidence of all terms beside the current model, and search for the best set."""
        if self.at is self.fit:
            return
        self.at = self.fit
        self.dictionary.extend(self.fit)
        present = [effect for effect in self.fit.effects if effect.name not in self.given]
        own = [self.terms[e.name] for e in present]
        terms = self.dictionary.beside(own)
        self.competing, self.evidence = linearised(self.fit, present, terms, self.clocks, self.dictionary)
        free = np.ravel(self.fit.free_clocks)
        ticking = [i for i, t in enumerate(self.competing) if isinstance(t, ClockTerm) and free[list(t.which)].any()]
        self.chosen = (*range(len(present)), *ticking)
        self.search = Search.of(self.evidence, self.chosen)

    def _exclude(self, terms: NDArray[np.bool_]) -> None:
        """Search without some terms (J,), unless they are in the model."""
        terms[list(self.chosen)] = False
        self.evidence = replace(self.evidence, cost=np.where(terms, np.inf, self.evidence.cost))
        self.search = Search.of(self.evidence, self.chosen)

    def _refit_best(self) -> bool:
        """Refit the model with the best set of terms whose refit gains as well; return whether the model changed."""
        for _ in range(_TRIES):
            best = self.search.clear_parts(self.decisions.clear_errors)
            if set(best) == set(self.chosen):
                return False
            more = float(-np.diff(self.evidence.gains([best, self.chosen]).score)[0])
            least = self.evidence.cost[list(best)].sum() - self.evidence.cost[list(self.chosen)].sum()
            if len(set(best) - set(self.chosen)) > 1 and np.isfinite(more):
                least = max(least, _TRUST * more)
            if self._gains_in_refit(best, least):
                return True
            if misleading := self._misleading(best, more):
                self._exclude(np.isin(self.evidence.group, self.evidence.group[misleading]))
            else:
                self.search.refuse(best)
        return False

    def _gains_in_refit(self, subset: Subset, least: float) -> bool:
        """Replace the model by its refit with a set of terms, if that gains `least` nats with the same weights."""
        before = self.terms
        try:
            larger = settled = self._refitted(subset)
            if larger.log_likelihood - self.fit.log_likelihood > least:
                self.terms = {t.name: t for i in subset if not isinstance(t := self.competing[i], ClockTerm)}
                settled = self._with_shapes(larger.refit())
                larger = settled.refit(weights_of=self.fit)  # with its own weights it may have diverged
        except (FitError, EffectError):
            larger = settled = self.fit
        if settled is self.fit or larger.log_likelihood - self.fit.log_likelihood <= least:
            self.terms = before
            return False
        self.fit = settled
        return True

    def _misleading(self, subset: Subset, more: float) -> list[int]:
        """Return the new terms of a set whose error, removed from the odometry, is not nearly what their columns say.

        Columns are functions of the true motion, an error is removed by what the odometry reports: near rest, and where
        ticks are coarse, a sign or a curvature of the one is noise in the other.
        """
        problem, whiten, found = self.fit.problem, self.fit.noise.whitener.whiten, list[int]()
        for i, own, effect in self._estimates(subset):
            if i in self.chosen or effect is None:
                continue
            removed = problem.at((*(e for e in self.fit.effects if e.name != effect.name), effect)).intervals.residual
            linear = self.competing[i].columns(problem) @ own
            both = whiten(np.stack((linear, problem.intervals.residual - removed - linear), axis=2))
            size, error = np.einsum("ij,ij->j", both, both)
            if error > 0.25 * size or 0.0 < more < error:  # by half of its length, or by more than the set gains
                found.append(i)
        return found

    def _estimates(self, subset: Subset) -> Iterator[tuple[int, Array, Effect | None]]:
        """Yield the terms of a set, their first-order estimates, and effects of these sizes; None for clocks."""
        ends = np.cumsum([self.competing[i].width for i in subset])
        for i, own in zip(subset, np.split(self.evidence.estimate(subset), ends), strict=False):
            term, sizes = self.competing[i], own.tolist()
            if isinstance(term, LibraryTerm):
                yield i, own, started(self.fit, term.start, sizes)
            else:
                yield i, own, term.effect(sizes) if isinstance(term, BasisTerm) else None

    def _refitted(self, subset: Subset) -> Fit:
        """Return the refit with a set of terms, started at their linear estimates, with the same weights."""
        found = [*self._estimates(subset)]
        names = [self.competing[i].name for i, _, effect in found if effect is None]
        effects = [e for e in self.fit.effects if e.name in self.given]
        effects += [effect for _, _, effect in found if effect is not None]
        free = self.clocks.free(names, clock_leaders(self.fit.problem.recordings))
        now = np.where(free, as_rows(self.fit.problem.clocks), self.clocks.base)
        clocks = [Clock(*own) for own in now.tolist()]
        return self.fit.refit(effects, clocks=clocks, free_clocks=free, weights_of=self.fit)

    def _with_shapes(self, fitted: Fit) -> Fit:
        """Return a fit with the shape of each of its terms at the maximum of the likelihood, beside all others."""
        for effect in fitted.effects:
            term = self.terms.get(effect.name)
            if term is None or not len(term.shape):
                continue
            own = fitted.by_name[effect.name]
            moved = ShapeSearch(drop_term(fitted, own), self.decisions).maximise(term)
            if np.allclose(moved.shape, term.shape, rtol=1e-3):
                continue
            shaped = moved.effect([getattr(own, p.name) for p in amplitudes(own)])
            try:
                other = fitted.refit([shaped if e is own else e for e in fitted.effects], weights_of=fitted)
            except FitError:  # too far off to start from
                continue
            if other.log_likelihood > fitted.log_likelihood + self.decisions.reshape_nats:
                fitted, self.terms[effect.name] = other.refit(), moved
        return fitted

    def _drop_misfits(self) -> None:
        """Drop slight terms without which other shapes of the others fit as well, or that have no practical size.

        In the search shapes are held and columns are linear: a slight error of a large effect's shape, or the square
        of its size, is explained by a further term.
        """
        gains, whole = self._gains(), self.fit
        least = self.decisions.practical.share * sum(gains.values())
        slight = sorted((more, i) for i, more in gains.items() if more < least and self.competing[i].name in self.terms)
        for _, i in slight:
            kept, before, name = dict(self.terms), self.fit, self.competing[i].name
            del self.terms[name]
            others = [e for e in self.fit.effects if e.name != name]
            self.fit = self._with_shapes(self.fit.refit(others, weights_of=self.fit))
            compared = before.refit(weights_of=before), self.fit.refit(weights_of=before)
            gained = compared[0].log_likelihood - compared[1].log_likelihood > self.evidence.cost[i]
            if gained and self._is_worse(self.fit, whole):
                self.terms, self.fit = kept, before

    def _is_worse(self, fit: Fit, than: Fit) -> bool:
        """Return whether the error after 10 s or after a minute is larger by what is of practical size."""
        most = 1.0 + self.decisions.practical.share
        return any(ten_second_error(fit, s) > most * ten_second_error(than, s) for s in _SPANS_S)

    def _gains(self) -> dict[int, float]:
        """Return the gain of each term of the model beside the others minus its cost, by its index, nats."""
        return {i: float(folds.sum() - self.evidence.cost[i]) for i, folds in self._held_out().items()}

    def _held_out(self) -> dict[int, Array]:
        """Return the gain (F,) of each term of the model beside the others on each left-out fold, by its index."""
        without = [tuple(j for j in self.chosen if j != i) for i in self.chosen]
        folds = self.evidence.gains([self.chosen, *without]).folds
        return dict(zip(self.chosen, folds[0] - folds[1:], strict=True))

    def _compare_with_process(self) -> None:
        """Replace several terms of the model of one drive by a random process if that is likelier, costs included.

        The course of a bias over one drive is also a sum of several effects; over several drives it does not recur. So
        the selection is repeated beside a process, from the term with the largest gain alone.
        """
        before, terms, noise = self.fit, self.terms, list(self.noise)
        if self.dictionary.recurring or len(terms) <= 3 or len(before.random) >= self.decisions.max_correlated:
            return
        first = self.competing[self._order(self._gains())[0]].name
        self.fit = before.refit([e for e in before.effects if e.name in self.given or e.name == first])
        self.terms = {first: terms[first]}
        found = self._include_process()
        if found:
            self._select()
            likelier = self.fit.refit(weights_of=before).log_likelihood - before.refit(weights_of=before).log_likelihood
            numbers = float(np.log(len(before.problem.intervals)))  # two numbers of a process, by half of it each
            both = (self.terms, terms)
            costs = [[cost_of(t, self.decisions, {*self.given, *some}) for t in some.values()] for some in both]
            found = likelier - numbers - sum(costs[0]) + sum(costs[1]) > 0.0
        if not found:
            self.fit, self.terms, self.noise = before, terms, noise
        self._linearise()

    def _include_process(self) -> bool:
        """Include the random process with the largest gain, if one is detected; return whether there was one."""
        full = len(self.fit.random) >= self.decisions.max_correlated
        if full or not (found := random_coefficients(self.fit, self.decisions)):
            return False
        self.begin("search: random processes")
        before = self.fit
        larger, effect = iterate(before.refit(random=(*before.random, found[0].effect)), found[0].effect)
        recurs = self.dictionary.recurring and self._is_worse(larger, before)  # it takes part of what recurs
        if recurs or larger.log_likelihood <= before.log_likelihood:  # it diverged
            return False
        self.fit = larger
        refitted = larger.log_likelihood - before.log_likelihood - float(np.log(len(before.problem.intervals)))
        self.noise.append(DetectedRandomEffect(effect, max(found[0].nats, refitted)))
        return True

    def result(self, clocks: Clocks) -> Learned:
        """Return the model with the evidence for each of its terms, and for others in their place."""
        self._linearise()
        gains, given = self._gains(), [e for e in self.fit.effects if e.name in self.given]
        order = self._order(gains)
        # with none, one, two, ... of the effects of the model, the largest gain first
        effects = [self.fit.by_name[self.competing[i].name] for i in order]
        fits = [*(self.fit.refit((*given, *effects[:k]), weights_of=self.fit) for k in range(len(effects))), self.fit]
        tested = tested_candidates(self.fit, self.dictionary.library.values(), self.dictionary)
        steps = [Step(before=self.fit.for_reports(), candidates=tuple(tested), added=None)]
        included, rivals = list[Dependence](), list[Dependence]()
        for i, before, after in reversed([*zip(order, fits, fits[1:], strict=False)]):
            term, instead = self.competing[i], self._instead(i)
            bare = drop_term(self.fit, self.fit.by_name[term.name])
            step = Step(before=before.for_reports(), candidates=tuple(tested), added=None)
            if isinstance(term, BasisTerm):
                included.insert(0, dependence_of(bare, term, gains[i], self.dictionary))
                steps.insert(0, replace(step, dependence=included[0]))
            if not isinstance(term, LibraryTerm):
                continue
            basis = [(more, self.competing[j]) for j, more in instead.items()]
            more, other = max(
                ((more, t) for more, t in basis if isinstance(t, BasisTerm)), key=itemgetter(0), default=(-np.inf, None)
            )
            if other is not None and -more < self.decisions.rival_nats:
                one = dependence_of(bare, other, gains[i] + more, self.dictionary)
                rivals.insert(0, replace(one, instead_of=(term.name,)))
            candidates = self._ranked(bare, term, gains[i], instead, tested)
            rmse = ten_second_error(before), ten_second_error(after)
            candidates = replace(candidates[0], rmse=rmse), *candidates[1:]
            steps.insert(0, replace(step, candidates=candidates, added=term.name))
        if not self.dictionary.recurring:
            of_time = [t for t in self.dictionary.basis.values() if t.function.regressor == "time"]
            best = max(score_terms(self.fit, of_time, self.dictionary), key=lambda one: one.nats, default=None)
            if best is not None and best.nats > self.decisions.replacement_nats and isinstance(best.term, BasisTerm):
                rivals.append(dependence_of(self.fit, best.term, best.nats, self.dictionary))
        kept = {effect.name for effect in self.fit.effects}
        final = with_robust_errors(self.fit, kept - self.given)
        return Learned(
            clocks=self._clocks_of(final, clocks, gains, included),
            rounds=tuple(steps),
            noise=tuple(self.noise),
            unknown=(*included, *rivals),
            laws=tuple(included),
            against={self.competing[i].name: self.search.odds_against(i) for i in self.chosen},
            fit=final,
            error_m=ten_second_error(final),
            disagreements=disagreements(final, self.decisions.heterogeneity_level),
            contradictions=tuple(one for one in tested if one.contradicts_physics(self.decisions)),
            decisions=self.decisions,
            held_out={
                self.competing[i].name: (float(folds.sum()), float(folds.std(ddof=1) * np.sqrt(len(folds))))
                for i, folds in self._held_out().items()
            },
        )

    def _order(self, gains: Mapping[int, float]) -> list[int]:
        """Return the indices of the effects of the model, the largest gain first."""
        return sorted((i for i in gains if not isinstance(self.competing[i], ClockTerm)), key=lambda i: -gains[i])

    def _clocks_of(self, final: Fit, clocks: Clocks, gains: Mapping[int, float], found: Sequence[Dependence]) -> Clocks:
        """Return the clocks of the final model, with the evidence for them and for others in their place."""
        recordings, free = self.fit.problem.recordings, self.fit.free_clocks
        base = np.ravel(self.clocks.base)
        margins = [
            min([gains[i], *(-more for more in self._instead(i).values())])
            for i in self.chosen
            if isinstance(term := self.competing[i], ClockTerm) and not base[list(term.which)].any()
        ]
        return replace(
            clocks,
            clocks=self.fit.problem.clocks,
            free=free,
            errors=with_rounding(final.clock_errors.tolist(), free, recordings),
            margins_nats=tuple(margins) if np.any(free) else (),
            left_nats=sum(one.nats for one in found if one.regressor.endswith("acceleration")),
        )

    def _ranked(
        self, bare: Fit, term: LibraryTerm, gain: float, instead: Mapping[int, float], tested: Sequence[Candidate]
    ) -> tuple[Candidate, ...]:
        """Return an effect of the model and its rivals as candidates, in order of their gains.

        bare : the fit without the effect
        gain : its gain beside the other terms
        instead : evidence of the model with another term in its place, minus that of the model, by its index
        """
        (own,) = tested_candidates(bare, [term], self.dictionary)
        others = {self.competing[j].name: gain + more for j, more in sorted(instead.items(), key=itemgetter(1))}
        rivals = [
            replace(one, gain=others[one.name], refused="")
            if others.get(one.name, 0.0) > 0.0 and one.name not in self.terms
            else one
            for one in tested
            if one.name != term.name
        ]
        first = replace(own, fitted=self.fit.by_name[term.name], gain=gain, refused="")
        return (first, *sorted(rivals, key=lambda one: -one.gain))

    def _instead(self, i: int) -> dict[int, float]:
        """Return the evidence with another term in place of one of the model, minus that of the model, by its index."""
        rest = tuple(j for j in self.chosen if j != i)
        subsets = self.evidence.extensions(rest)
        score = self.evidence.gains([tuple(sorted(self.chosen)), *subsets]).score
        found: dict[int, float] = {}
        for subset, value in zip(subsets, score[1:], strict=True):
            (other,) = set(subset) - set(rest)
            if self.competing[other].name != self.competing[i].name and np.isfinite(value):
                found[other] = float(value - score[0])
        return found
