"""Stepwise selection: include the term that explains most, refit, drop what it made redundant, until nothing is left.

Three kinds of terms compete in every step: effects of the library, correlated noise, and basis functions of one
regressor. A known effect is the likelier a priori, so a basis function has to explain plainly more to come before one,
and noise more than either, because whatever is not in the model looks like noise. Basis functions are screened only
where they may come next: where no effect is admitted, or noise would be.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.study.estimate.clocks import clock_nats, find_clocks, levelled, with_rounding
from odomcorrupt.study.estimate.config import choose_approach
from odomcorrupt.study.estimate.correlation_length import with_correlation_lengths
from odomcorrupt.study.estimate.drift_error import ten_second_error
from odomcorrupt.study.estimate.extrinsics import mounting_of
from odomcorrupt.study.estimate.gauss_newton import Fit, carried, fit
from odomcorrupt.study.estimate.random_process import CORRELATED_NOISE
from odomcorrupt.study.estimate.robust_errors import with_robust_errors
from odomcorrupt.study.io.clock import Clock
from odomcorrupt.study.io.encoders import encoder_effects, hides_losses, restore_lost
from odomcorrupt.study.select.candidates import (
    Candidate,
    channels_of,
    library_candidates,
    terms_of,
    with_shape_refined,
)
from odomcorrupt.study.select.closed_loop import is_pulled, may_be_of_lags, of_pulls
from odomcorrupt.study.select.decisions import DECISIONS, Decisions, penalty
from odomcorrupt.study.select.dependence import Dependence, basis_scores, dependences
from odomcorrupt.study.select.elimination import (
    eliminate_random,
    eliminate_untested,
    iterate,
    one_heading,
    without_redundant,
)
from odomcorrupt.study.select.heterogeneity import disagreements
from odomcorrupt.study.select.model_comparison import (
    ModelComparison,
    Proposal,
    best_dependence,
    best_replacement,
    compare_with_basis,
    name_for,
)
from odomcorrupt.study.select.random_effects import (
    RandomCoefficient,
    beside_bursts,
    gain_in_refit,
    outlier_effects,
    random_coefficients,
)
from odomcorrupt.study.select.result import Learned, Step
from odomcorrupt.study.select.screening import CoarseDesign
from odomcorrupt.study.terms.term import LibraryTerm
from odomcorrupt.study.work import Work

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.study.estimate.clocks import Clocks
    from odomcorrupt.study.io.recording import Recording

__all__ = ["Learned", "Step", "learn"]

_LIKE_SKIDS_S = 0.02
"""An offset of a clock up to which what wheels do at changes of speed may be mistaken for it."""
_LIKE_CLOCKS = ("accel_slip", "backlash")
"""What wheels do at changes of speed."""


def learn(
    recordings: Sequence[Recording],
    start: Sequence[Effect] = (),
    *,
    law_name: str = "diffusion",
    decisions: Decisions = DECISIONS,
    most: int | None = None,
    work: Work | None = None,
) -> Learned:
    """Return the model that recordings of one robot select, starting from the given effects.

    Parameters
    ----------
    recordings : of one robot, odometry with truth
    start : effects that are in the model from the beginning and are not dropped
    law_name : the noise law, see `odomcorrupt.model.noise_laws`
    decisions : every number that decides what is included, kept, replaced or dropped
    most : how many effects are included at most, default `decisions.max_effects`
    work : takes note of every stage
    """
    (work := work or Work()).begin_clocks()
    if most is not None:
        decisions = replace(decisions, max_effects=most)
    start = (*start, *mounting_of(recordings, start))
    as_given, encoders = recordings, encoder_effects(recordings[0])
    recordings = [restore_lost(recording, encoders) for recording in recordings]
    approach = choose_approach(recordings, law_name)
    recordings = with_correlation_lengths(recordings, approach)
    clocks = find_clocks(recordings, approach)
    same_data = all(one is other for one, other in zip(recordings, as_given, strict=True))
    recordings = levelled(recordings, clocks)
    fitted = fit(
        recordings,
        [e for e in start if e.kind != "noise"],
        clocks=clocks.clocks,
        free_clocks=clocks.free,
        approach=approach,
        random=[e for e in start if e.name in CORRELATED_NOISE],
    )
    noise = [RandomCoefficient(e, decisions.counted_nats) for e in encoders]
    given = {e.name for e in start}
    found = _Selection(fitted, noise, given, decisions, work).run()
    if (other := _dependence_first(found, noise)) is not None and _explains_more(other, found):
        found = other
    found, clocks = _with_other_clock(found, clocks, noise)
    late_nats = sum(one.nats for one in (*found.included, *found.open) if one.follows_acceleration)
    kept = {effect.name for effect in found.fit.effects}
    included = tuple(one for one in found.included if one.name in kept)
    final = with_robust_errors(found.fit, kept - given)
    errors = with_rounding(final.clock_errors.tolist(), clocks.free, recordings)
    return Learned(
        clocks=replace(clocks, clocks=final.problem.clocks, errors=errors, left_nats=late_nats),
        first_clocks=clocks if same_data else None,
        rounds=tuple(found.steps),
        noise=tuple(found.noise),
        unknown=(*included, *found.open),
        laws=included,
        margins={name: own.margin for name, own in found.compared.items()},
        fit=final,
        error_m=ten_second_error(final),
        disagreements=disagreements(final, decisions.heterogeneity_level),
        contradictions=tuple({one.name: one for one in found.contradictions}.values()),
        decisions=decisions,
        hides_losses=hides_losses(as_given[0]),
    )


@dataclass(slots=True)
class _Selection:
    """A model on its way through the selection.

    fit, noise : the model as it is, and its random effects
    given, work : names of effects that are not dropped; what takes note of every step
    steps : so far
    included, open : dependences that are in the model, and those that it leaves
    contradictions : effects that would explain the data with a sign that physics forbids
    withdrawn : names of effects that were admitted, and did not last beside the model as it is
    compared, compared_at : included effects of the library against basis functions in their place, and in which fit
    seen : terms of the models so far
    """

    fit: Fit
    noise: list[RandomCoefficient]
    given: set[str]
    decisions: Decisions
    work: Work = field(default_factory=Work)
    steps: list[Step] = field(default_factory=list)
    included: list[Dependence] = field(default_factory=list)
    open: list[Dependence] = field(default_factory=list)
    contradictions: list[Candidate] = field(default_factory=list)
    withdrawn: set[str] = field(default_factory=set)
    compared: dict[str, ModelComparison] = field(default_factory=dict)
    compared_at: Fit | None = None
    seen: set[frozenset[str]] = field(default_factory=set)

    def __post_init__(self) -> None:
        self.noise = list(self.noise)

    def run(self) -> _Selection:
        """Take steps until one includes nothing, then finish; return itself."""
        while self._step() or self._name_laws():
            pass
        self._finish()
        return self

    def include(self, proposal: Proposal, candidates: Sequence[Candidate]) -> None:
        """Include a dependence, and drop what it makes redundant."""
        self.included.append(proposal.dependence)
        self._record(candidates, dependence=proposal.dependence)
        if proposal.candidate.fit is not None:
            self._continue_from(without_redundant(proposal.candidate.fit, self.given, self.decisions))

    def _name_laws(self) -> bool:
        """Put known effects in the place of laws that do no more than copy them; return whether the model changed."""
        for law in list(self.included):
            name = name_for(self.fit, law, self.decisions)
            if name is None or self._had(name.fit):
                continue
            self.included.remove(law)
            if name.fit is None:
                self.contradictions.append(name)
                self.fit = self.fit.refit([e for e in self.fit.effects if e.name != law.name])
            else:
                self._record([name], added=name.name)
                self._continue_from(without_redundant(name.fit, self.given, self.decisions))
            return True
        return False

    def _contradicted(self) -> set[str]:
        """Return the channels that causes of impossible signs act on: an error there depends on what the data lack."""
        return {channel for one in self.contradictions for channel in channels_of(self.fit, one.score.effect)}

    def _continue_from(self, fit: Fit) -> None:
        """Take a model that has one more term."""
        self.withdrawn.clear()
        self.noise, self.fit = eliminate_random(self.noise, fit, self.decisions)

    def _step(self) -> bool:
        """Include the term that explains most, and return whether there was one."""
        decisions, self.open = self.decisions, []
        self.seen.add(terms_of(self.fit))
        self.work.begin_step()
        candidates = library_candidates(self.fit, decisions, self.withdrawn)
        best = candidates[0] if candidates and not candidates[0].refused else None
        correlated = self._correlated(best.gain if best is not None else 0.0)
        proposal = None
        if best is None or correlated is not None:
            self.work.within_step("screening dependences")
            proposal = self.propose(alone=best is None)
        if correlated is not None:
            explained = max((proposal.candidate.gain if proposal else 0.0, *(one.nats for one in self.open)))
            if self._include_correlated(correlated, explained):
                return True
        if proposal is not None and (best is None or proposal.candidate.gain > best.gain + decisions.replacement_nats):
            self.include(proposal, candidates)
            return True
        full = len([step for step in self.steps if step.added is not None]) >= decisions.max_effects
        if best is None or best.fit is None or full:
            self._record(candidates)
            return False
        self.work.within_step("refits")
        # robust weights are estimated again, because what looked like outliers may be explained now
        larger = with_shape_refined(best.fit.refit(), best.score, decisions)[0]
        larger = without_redundant(larger, self.given, decisions)
        if best.name not in {effect.name for effect in larger.effects} or self._had(larger):
            self.withdrawn.add(best.name)
            return True
        self._record(candidates, added=best.name)
        self._continue_from(larger)
        return True

    def _record(
        self, candidates: Sequence[Candidate], *, added: str | None = None, dependence: Dependence | None = None
    ) -> None:
        self.steps.append(Step(
            before=self.fit, candidates=tuple(candidates), added=added, dependence=dependence,
            alternative_nats=self.decisions.alternative_nats,
        ))  # fmt: skip

    def _correlated(self, gain: float) -> RandomCoefficient | None:
        """Return the random coefficient that explains plainly more than the best effect, if there is room for one."""
        if len(self.fit.random) >= self.decisions.max_correlated or is_pulled(self.fit):
            return None
        found = random_coefficients(self.fit, self.decisions)
        return found[0] if found and found[0].nats > gain + self.decisions.alternative_nats else None

    def propose(self, *, alone: bool) -> Proposal | None:
        """Return the dependence that may come next; where no effect is left (`alone`), in place of one first."""
        decisions, design = self.decisions, CoarseDesign(self.fit.problem)
        found = dependences(self.fit, basis_scores(self.fit, decisions, design), decisions)
        found = [
            one for one in found
            if one.best is None
            or not (of_pulls(self.fit, one.best.score.estimated) or may_be_of_lags(self.fit, one.best.score))
        ]  # fmt: skip
        self.open = [one for one in found if one.channel not in self._contradicted()]
        if alone:
            self._compare(design)
        if len(self.included) >= decisions.max_dependences:
            return None
        effects = [(e, self.compared[e.name]) for e in self.fit.effects if alone and e.name in self.compared]
        # what the data contradict in one place is no better in another: it would come and go
        replacement = best_replacement(self.fit, effects, decisions, self._contradicted())
        proposal = replacement or best_dependence(self.fit, self.open, decisions)
        return None if proposal is None or self._had(proposal.candidate.fit) else proposal

    def _had(self, fit: Fit | None) -> bool:
        """Return whether a model has the terms of an earlier one: a search that comes back would never end."""
        return fit is not None and terms_of(fit) in self.seen

    def _compare(self, design: CoarseDesign) -> None:
        added = {step.added for step in self.steps}
        effects = [e for e in self.fit.effects if e.name in added]
        self.compared = {e.name: compare_with_basis(self.fit, e, self.decisions, design) for e in effects}
        self.compared_at = self.fit

    def _include_correlated(self, one: RandomCoefficient, explained: float) -> bool:
        """Include a random coefficient, if it gains plainly more than a dependence would; return whether it did."""
        calmer = self.fit.refit(random=(*self.fit.random, one.effect))
        if not gain_in_refit(one, self.fit, calmer) > explained + self.decisions.alternative_nats:
            return False
        self.fit, effect = iterate(calmer, one.effect)
        self.noise.append(replace(one, effect=effect))
        return True

    def _finish(self) -> None:
        """Note what contradicts physics, name outliers, and drop what is redundant; compare what was included."""
        decisions = self.decisions
        against = [one for one in self.steps[-1].candidates if one.contradicts_physics(decisions)]
        self.contradictions += [one for one in against if one.score.robust_nats > decisions.replacement_nats]
        self.open = [one for one in self.open if one.channel not in self._contradicted()]
        tails = not (self.noise or self.open or self.included)
        outliers = [] if is_pulled(self.fit) else outlier_effects(self.fit, decisions, tails=tails)
        if outliers:
            self.noise, self.fit = beside_bursts(self.noise, self.fit, decisions)
        self.noise += outliers
        self.fit = eliminate_untested(one_heading(self.fit, self.given, decisions), self.given, decisions)
        if bursts := [one.effect for one in outliers if one.effect.name == "slip_burst"]:
            # what they do is no noise of every step
            self.fit = self.fit.refit((*self.fit.effects, *bursts))
        if self.compared_at is not self.fit:
            self._compare(CoarseDesign(self.fit.problem))

    @property
    def penalty(self) -> float:
        """Nats that its effects must gain."""
        forms = {one.name: one.best.score.penalty for one in self.included if one.best is not None}
        motions, count = self.fit.problem.motions, len(self.fit.problem.nodes)
        clocks = 0.5 * float(np.log(count) * np.sum(self.fit.free_clocks))
        return clocks + sum(
            forms[e.name] if e.name in forms else penalty(LibraryTerm.of(e, motions), count, self.decisions)
            for e in self.fit.effects
        )


def _dependence_first(found: _Selection, noise: list[RandomCoefficient]) -> _Selection | None:
    """Return the selection that begins with a basis function, where one explains more than the effect that came first.

    Several effects together may stand in for one cause that the library does not have, and none of them then gives way
    to it alone. Where effects did suffice there is no second start.
    """
    first, decisions = found.steps[0], found.decisions
    outdone = any(own.margin < 0.0 for own in found.compared.values())
    if first.added is None or not (found.included or found.open or outdone):
        return None
    other = _Selection(first.before, noise, found.given, decisions, found.work)
    proposal = other.propose(alone=False)
    if proposal is None or proposal.candidate.gain < first.candidates[0].gain + decisions.replacement_nats:
        return None
    other.include(proposal, first.candidates)
    return other.run()


def _with_other_clock(found: _Selection, clocks: Clocks, noise: list[RandomCoefficient]) -> tuple[_Selection, Clocks]:
    """Return the selection with a clock or that without, whichever explains more, and the clocks, the other a rival.

    Clocks come before everything else, and a small offset does about what a wheel does that skids, or whose play is
    crossed, whenever the speed changes. What it leaves of that is a dependence on the acceleration. Where there is no
    clock, what resembles one may be its own: stamps that are rounded are late by half of what they are rounded to.
    """
    late = any(one.follows_acceleration for one in (*found.included, *found.open))
    offset_s = max(abs(clock.offset_s) for clock in clocks.clocks)
    rivals = [step.candidates[0].gain for step in found.steps if step.added in _LIKE_CLOCKS]
    alike = bool(rivals) and not np.any(clocks.free)
    if not alike and not (late and 0.0 < offset_s < _LIKE_SKIDS_S):
        return found, clocks
    other = replace(
        clocks, clocks=(Clock(),) * len(clocks.clocks), free=((alike, False),) * len(clocks.free), ambiguous_nats=0.0
    )
    problem, first = found.fit.problem, found.steps[0].before
    begin = fit(
        problem.recordings,
        first.effects,
        clocks=other.clocks,
        free_clocks=other.free,
        approach=problem.approach,
        start=first.noise.free,
        random=[e for e in first.random if e.name in found.given],
    )
    second = _Selection(begin, noise, found.given, found.decisions, found.work).run()
    more = _more_nats(second, found)
    if more > 0.0:
        found, clocks = second, other
    if np.any(found.fit.free_clocks):
        return found, replace(clocks, rival_nats=(*clocks.rival_nats, clock_nats(found.fit) - abs(more)))
    rivals = [step.candidates[0].gain for step in found.steps if step.added in _LIKE_CLOCKS]
    nats = max(rivals, default=0.0) - abs(more)
    return found, replace(clocks, ambiguous_nats=max(nats, clocks.ambiguous_nats, 0.0))


def _explains_more(one: _Selection, other: _Selection) -> bool:
    """Return whether one model explains plainly more than another.

    Known effects are the likelier a priori; not where the other model needed a basis function besides.
    """
    least = other.decisions.alternative_nats if other.included else other.decisions.replacement_nats
    return _more_nats(one, other) > least


def _more_nats(one: _Selection, other: _Selection) -> float:
    """Return by how much one model explains more than another, whichever stretches are set apart as outliers."""
    here, there = one.fit, other.fit
    same = there.refit(weights=carried(here.noise.weights, here.problem, there.problem))
    turned = here.refit(weights=carried(there.noise.weights, there.problem, here.problem))
    gains = (here.log_likelihood - same.log_likelihood, turned.log_likelihood - there.log_likelihood)
    return min(gains) + other.penalty - one.penalty
