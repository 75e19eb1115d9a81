"""Stepwise selection: include the term that explains most, refit, drop what it made redundant, until nothing is left.

Three kinds of terms compete in every step: effects of the library, correlated noise, and basis functions of one
regressor. A known effect is the likelier a priori, so a basis function has to explain plainly more to come before one,
and noise more than either, because whatever is not in the model looks like noise. Basis functions are screened only
where they may come next: where no effect is admitted, or noise would be.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from odomcorrupt.effects import registry
from odomcorrupt.study.estimate.clocks import Clocks, find_clocks
from odomcorrupt.study.estimate.config import choose_approach
from odomcorrupt.study.estimate.drift_error import ten_second_error
from odomcorrupt.study.estimate.extrinsics import mounting_of
from odomcorrupt.study.estimate.gauss_newton import Fit, fit
from odomcorrupt.study.estimate.random_process import WANDERING
from odomcorrupt.study.estimate.robust_errors import with_robust_errors
from odomcorrupt.study.io.encoders import encoder_effects, restore_lost
from odomcorrupt.study.select.candidates import Candidate, library_candidates, with_shape_refined
from odomcorrupt.study.select.decisions import DECISIONS, Decisions, penalty
from odomcorrupt.study.select.dependence import Dependence, basis_scores, dependences
from odomcorrupt.study.select.elimination import backward_eliminate, eliminate_random, iterate, one_heading
from odomcorrupt.study.select.heading_source import GAIN, heading_source_of
from odomcorrupt.study.select.heterogeneity import Disagreement, disagreements
from odomcorrupt.study.select.model_comparison import (
    ModelComparison,
    Proposal,
    best_dependence,
    best_replacement,
    compare_with_basis,
)
from odomcorrupt.study.select.random_effects import (
    RandomCoefficient,
    beside_bursts,
    gain_in_refit,
    outlier_effects,
    random_coefficients,
)
from odomcorrupt.study.select.screening import CoarseDesign
from odomcorrupt.study.terms.term import LibraryTerm

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.study.io.recording import Recording

__all__ = ["Learned", "Step", "learn"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Step:
    """One step of the selection.

    before : the model before it
    candidates : effects of the library, the one that was included first
    added : name of the effect that was included, None where none was
    dependence : what was included instead, because no effect of the library explains it
    alternative_nats : see `Decisions`
    """

    before: Fit
    candidates: tuple[Candidate, ...]
    added: str | None
    dependence: Dependence | None = None
    alternative_nats: float = DECISIONS.alternative_nats

    @property
    def name(self) -> str | None:
        """What was included: the name of an effect, or what depends on what; None if nothing was."""
        return self.added if self.dependence is None else self.dependence.title

    @property
    def alternatives(self) -> tuple[str, ...]:
        """Effects that would have done nearly as well as the included one."""
        if self.added is None:
            return ()
        least = self.candidates[0].gain - self.alternative_nats
        near = [c.name for c in self.candidates[1:] if not c.refused and c.gain > least]
        named = {self.added, *near}
        if heading_source_of(self.before.problem.recordings):
            named -= {GAIN}
        return (*near, *(name for name, kind in registry().items() if kind.twin_of in named))


@dataclass(frozen=True, slots=True, kw_only=True)
class Learned:
    """What a selection found.

    clocks : those of the recordings
    rounds : all steps in order; the last one included nothing, or a limit was reached
    noise : what encoders did, and random effects that were found
    unknown : dependences that no effect of the library explains
    laws : those of them that are in the model as basis functions
    margins : by how many nats each included effect explains more than the best basis function would in its place
    fit : the final fit
    error_m : its 10 s position error on the fitted data
    disagreements : parameters that recordings do not agree about
    decisions : the decisions it was selected by
    held_out : log likelihood that each part of the model gains on data it was not fitted on, and its standard error
    """

    clocks: Clocks
    rounds: tuple[Step, ...]
    noise: tuple[RandomCoefficient, ...]
    unknown: tuple[Dependence, ...]
    laws: tuple[Dependence, ...]
    margins: Mapping[str, float]
    fit: Fit
    error_m: float
    disagreements: tuple[Disagreement, ...] = ()
    decisions: Decisions = DECISIONS
    held_out: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    @property
    def added(self) -> tuple[str, ...]:
        """Names of the effects of the library that were included and kept, in order."""
        return tuple(step.added for step in self.steps if step.added is not None)

    @property
    def steps(self) -> tuple[Step, ...]:
        """Steps whose inclusion is in the final model; of one that left and came back, the later."""
        kept = {effect.name for effect in self.fit.effects}
        stayed = {step.name: step for step in self.rounds if step.added in kept or step.dependence in self.laws}
        return tuple(step for step in self.rounds if stayed.get(step.name) is step)


def learn(
    recordings: Sequence[Recording],
    start: Sequence[Effect] = (),
    *,
    law_name: str = "diffusion",
    decisions: Decisions = DECISIONS,
    most: int | None = None,
) -> Learned:
    """Return the model that recordings of one robot select, starting from the given effects.

    Parameters
    ----------
    recordings : of one robot, odometry with truth
    start : effects that are in the model from the beginning and are not dropped
    law_name : the noise law, see `odomcorrupt.model.noise_laws`
    decisions : every number that decides what is included, kept, replaced or dropped
    most : how many effects are included at most, default `decisions.max_effects`

    """
    if most is not None:
        decisions = replace(decisions, max_effects=most)
    start = (*start, *mounting_of(recordings, start))
    encoders = encoder_effects(recordings[0])
    recordings = [restore_lost(recording, encoders) for recording in recordings]
    approach = choose_approach(recordings, law_name)
    clocks = find_clocks(recordings, approach)
    fitted = fit(
        recordings,
        [e for e in start if e.kind != "noise"],
        clocks=clocks.clocks,
        free_clocks=clocks.free,
        approach=approach,
        random=[e for e in start if e.name in WANDERING],
    )
    noise = [RandomCoefficient(e, decisions.counted_nats) for e in encoders]
    given = {e.name for e in start}
    found = _Selection(fitted, noise, given, decisions).run()
    if (other := _dependence_first(found, noise)) is not None and _explains_more(other, found):
        found = other
    kept = {effect.name for effect in found.fit.effects}
    included = tuple(one for one in found.included if one.name in kept)
    final = with_robust_errors(found.fit, kept - given)
    errors = tuple((float(offset), float(rate)) for offset, rate in final.clock_errors)
    return Learned(
        clocks=replace(clocks, clocks=final.problem.clocks, errors=errors),
        rounds=tuple(found.steps),
        noise=tuple(found.noise),
        unknown=(*included, *found.open),
        laws=included,
        margins={name: own.margin for name, own in found.compared.items()},
        fit=final,
        error_m=ten_second_error(final),
        disagreements=disagreements(final, decisions.heterogeneity_level),
        decisions=decisions,
    )


@dataclass(slots=True)
class _Selection:
    """A model on its way through the selection.

    fit, noise : the model as it is, and its random effects
    given : names of effects that are not dropped
    steps : so far
    included, open : dependences that are in the model, and those that it leaves
    compared, compared_at : included effects of the library against basis functions in their place, and in which fit
    """

    fit: Fit
    noise: list[RandomCoefficient]
    given: set[str]
    decisions: Decisions
    steps: list[Step] = field(default_factory=list)
    included: list[Dependence] = field(default_factory=list)
    open: list[Dependence] = field(default_factory=list)
    compared: dict[str, ModelComparison] = field(default_factory=dict)
    compared_at: Fit | None = None

    def __post_init__(self) -> None:
        self.noise = list(self.noise)

    def run(self) -> _Selection:
        """Take steps until one includes nothing, then finish; return itself."""
        while self._step():
            pass
        self._finish()
        return self

    def include(self, proposal: Proposal, candidates: Sequence[Candidate]) -> None:
        """Include a dependence, and drop what it makes redundant."""
        self.included.append(proposal.dependence)
        self._record(candidates, dependence=proposal.dependence)
        if proposal.candidate.fit is not None:
            self._continue_from(proposal.candidate.fit)

    def _continue_from(self, fit: Fit) -> None:
        """Take a model with one more term, without what the term makes redundant."""
        fit = backward_eliminate(fit, self.given, self.decisions)
        self.noise, self.fit = eliminate_random(self.noise, fit, self.decisions)

    def _step(self) -> bool:
        """Include the term that explains most, and return whether there was one."""
        decisions, self.open = self.decisions, []
        candidates = library_candidates(self.fit, decisions)
        best = candidates[0] if candidates and not candidates[0].refused else None
        correlated = self._correlated(best.gain if best is not None else 0.0)
        proposal = None
        if best is None or correlated is not None:
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
        self._record(candidates, added=best.name)
        # robust weights are estimated again, because what looked like outliers may be explained now
        self._continue_from(with_shape_refined(best.fit.refit(), best.score, decisions)[0])
        return True

    def _record(
        self, candidates: Sequence[Candidate], *, added: str | None = None, dependence: Dependence | None = None
    ) -> None:
        self.steps.append(
            Step(
                before=self.fit,
                candidates=tuple(candidates),
                added=added,
                dependence=dependence,
                alternative_nats=self.decisions.alternative_nats,
            )
        )

    def _correlated(self, gain: float) -> RandomCoefficient | None:
        """Return the random coefficient that explains plainly more than the best effect, if there is room for one."""
        if len(self.fit.random) >= self.decisions.max_correlated:
            return None
        found = random_coefficients(self.fit, self.decisions)
        return found[0] if found and found[0].nats > gain + self.decisions.alternative_nats else None

    def propose(self, *, alone: bool) -> Proposal | None:
        """Return the dependence that may come next; where no effect is left (`alone`), in place of one first."""
        decisions, design = self.decisions, CoarseDesign(self.fit.problem)
        self.open = dependences(self.fit, basis_scores(self.fit, decisions, design), decisions)
        if alone:
            self._compare(design)
        if len(self.included) >= decisions.max_dependences:
            return None
        effects = [(e, self.compared[e.name]) for e in self.fit.effects if alone and e.name in self.compared]
        return best_replacement(self.fit, effects, decisions) or best_dependence(self.fit, self.open, decisions)

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
        """Name outliers, agree on one source of the heading, drop what is redundant, and compare what was included."""
        decisions = self.decisions
        outliers = outlier_effects(self.fit, decisions, tails=not self.noise and not self.open)
        if outliers:
            self.noise, self.fit = beside_bursts(self.noise, self.fit, decisions)
        self.noise += outliers
        self.fit = one_heading(self.fit, self.given, decisions)
        self.fit = backward_eliminate(self.fit, self.given, decisions)
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
        return sum(
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
    other = _Selection(first.before, noise, found.given, decisions)
    proposal = other.propose(alone=False)
    if proposal is None or proposal.candidate.gain < first.candidates[0].gain + decisions.replacement_nats:
        return None
    other.include(proposal, first.candidates)
    return other.run()


def _explains_more(one: _Selection, other: _Selection) -> bool:
    """Return whether one model explains plainly more than another, whichever stretches are set apart as outliers.

    Known effects are the likelier a priori; not where the other model needed a basis function besides.
    """
    worth = other.penalty - one.penalty
    same = other.fit.refit(weights=one.fit.noise.weights)
    turned = one.fit.refit(weights=other.fit.noise.weights)
    gains = (one.fit.log_likelihood - same.log_likelihood, turned.log_likelihood - other.fit.log_likelihood)
    decisions = other.decisions
    return min(gains) + worth > (decisions.alternative_nats if other.included else decisions.replacement_nats)
