"""Stepwise selection: include the term with the largest gain, refit, drop redundant terms, until no term is admitted.

Three kinds of terms compete in every step: library effects, correlated noise, and basis functions of one regressor. A
known effect is likelier a priori, so a basis function needs a clearly larger gain to precede one. Noise needs a larger
gain than either, because any missing term looks like noise. Basis functions are screened only if no effect is admitted
or if noise would be included next.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.study.estimate.clocks import find_clocks, levelled, with_rounding
from odomcorrupt.study.estimate.config import choose_approach
from odomcorrupt.study.estimate.correlation_length import with_correlation_lengths
from odomcorrupt.study.estimate.drift_error import ten_second_error
from odomcorrupt.study.estimate.extrinsics import mounting_of
from odomcorrupt.study.estimate.gauss_newton import Fit, fit
from odomcorrupt.study.estimate.gyro_walk import with_bias_walks
from odomcorrupt.study.estimate.random_process import CORRELATED_NOISE
from odomcorrupt.study.estimate.robust_errors import with_robust_errors
from odomcorrupt.study.io.encoders import encoder_effects, hides_losses, restore_lost
from odomcorrupt.study.select.candidates import Candidate, channels_of, library_candidates, terms_of, with_shape_refined
from odomcorrupt.study.select.decisions import DECISIONS, Decisions
from odomcorrupt.study.select.dependence import Dependence, basis_scores, dependences
from odomcorrupt.study.select.elimination import (
    continued,
    eliminate_random,
    iterate,
    without_redundant,
)
from odomcorrupt.study.select.heterogeneity import disagreements
from odomcorrupt.study.select.model_comparison import (
    ModelComparison,
    compare_each_with_basis,
    margins,
    name_for,
    rivals,
)
from odomcorrupt.study.select.proposals import Proposal, best_dependence, best_replacement
from odomcorrupt.study.select.random_effects import (
    DetectedRandomEffect,
    explained_by,
    gain_in_refit,
    outlier_effects,
    random_coefficients,
)
from odomcorrupt.study.select.result import Learned, Step
from odomcorrupt.study.select.screening import CoarseDesign
from odomcorrupt.study.work import Work

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.study.estimate.clocks import Clocks
    from odomcorrupt.study.io.recording import Recording

__all__ = ["Learned", "Step", "learn"]


def learn(
    recordings: Sequence[Recording],
    start: Sequence[Effect] = (),
    *,
    law_name: str = "diffusion",
    decisions: Decisions = DECISIONS,
    work: Work | None = None,
) -> Learned:
    """Return the model selected from recordings of one robot, beginning with the given effects.

    Parameters
    ----------
    recordings : odometry and truth of one robot
    start : effects that are in the model from the beginning and are not dropped
    law_name : the noise law, see `odomcorrupt.model.noise_laws`
    decisions : thresholds of inclusion, replacement and removal
    work : progress callbacks of the stages
    """
    (work := work or Work()).begin_clocks()
    start = (*start, *mounting_of(recordings, start))
    as_given, encoders = recordings, encoder_effects(recordings[0])
    recordings = [restore_lost(recording, encoders) for recording in recordings]
    approach = choose_approach(recordings, law_name)
    recordings = with_bias_walks(with_correlation_lengths(recordings, approach), approach)
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
    noise = [DetectedRandomEffect(e, decisions.counted_nats) for e in encoders]
    given = {e.name for e in start}
    found = _Selection(fitted, noise, given, clocks, decisions, work).run()
    late_nats = sum(one.nats for one in (*found.included, *found.open) if one.follows_acceleration)
    kept = {effect.name for effect in found.fit.effects}
    included = tuple(one for one in found.included if one.name in kept)
    final = with_robust_errors(found.fit, kept - given)
    errors = with_rounding(final.clock_errors.tolist(), found.clocks.free, recordings)
    return Learned(
        clocks=replace(found.clocks, clocks=final.problem.clocks, errors=errors, left_nats=late_nats),
        first_clocks=clocks if same_data else None,
        rounds=tuple(found.steps),
        noise=tuple(found.noise),
        unknown=(*included, *found.open, *rivals(found.compared, decisions)),
        laws=included,
        margins=margins(found.compared),
        fit=final,
        error_m=ten_second_error(final),
        disagreements=disagreements(final, decisions.heterogeneity_level),
        contradictions=tuple({one.name: one for one in found.contradictions}.values()),
        decisions=decisions,
        hides_losses=hides_losses(as_given[0]),
    )


@dataclass(slots=True)
class _Selection:
    """State of a selection in progress.

    fit, noise : the current model, and its random effects
    given, work : names of effects that are not dropped; progress callbacks
    clocks : clocks of the model, and the evidence for alternatives
    steps : steps so far
    included, open : dependences in the model, and those that it does not explain
    contradictions : effects that fit the data only with a physically impossible sign
    withdrawn : names of effects that were admitted to the current model and removed again
    compared, compared_at : comparisons of library effects with basis functions, and the fit in which they were made
    seen : terms of all models so far, with their largest log likelihood
    """

    fit: Fit
    noise: list[DetectedRandomEffect]
    given: set[str]
    clocks: Clocks
    decisions: Decisions
    work: Work = field(default_factory=Work)
    steps: list[Step] = field(default_factory=list)
    included: list[Dependence] = field(default_factory=list)
    open: list[Dependence] = field(default_factory=list)
    contradictions: list[Candidate] = field(default_factory=list)
    withdrawn: set[str] = field(default_factory=set)
    compared: list[ModelComparison] = field(default_factory=list)
    compared_at: Fit | None = None
    seen: dict[frozenset[str], float] = field(default_factory=dict)

    def run(self) -> _Selection:
        """Take steps until the model no longer changes, then finish; return self."""
        while self._step() or self._name_laws():
            pass
        self._finish()
        return self

    def _include(self, proposal: Proposal, candidates: Sequence[Candidate]) -> None:
        """Include a dependence, and drop terms that it makes redundant."""
        self.included.append(proposal.dependence)
        self._record(candidates, dependence=proposal.dependence)
        if proposal.candidate.fit is not None:
            self._continue_from(proposal.candidate.fit)

    def _name_laws(self) -> bool:
        """Replace a dependence by a known effect with about the same gain; return whether the model changed."""
        for law in list(self.included):
            name = name_for(self.fit, law, self.decisions)
            if name is None or self._already_seen(name.fit, self.decisions.replacement_nats):
                continue
            self.included.remove(law)
            if name.fit is None:
                self.contradictions.append(name)
                self.fit = self.fit.refit([e for e in self.fit.effects if e.name != law.name])
            else:
                self._record([name], added=name.name)
                self._continue_from(name.fit)
            return True
        return False

    def _contradicted(self) -> set[str]:
        """Return the channels of effects with impossible signs: errors there have a cause outside the data."""
        return {channel for one in self.contradictions for channel in channels_of(self.fit, one.score.effect)}

    def _continue_from(self, fit: Fit) -> None:
        """Continue from a model with another term, without terms that this makes redundant."""
        self._accept(without_redundant(fit, self.given, self.decisions))

    def _accept(self, fit: Fit) -> None:
        self.withdrawn.clear()
        self.noise, self.fit = eliminate_random(self.noise, fit, self.decisions)

    def _step(self) -> bool:
        """Include the term with the largest gain, and return whether the selection goes on."""
        decisions, self.open = self.decisions, []
        terms = terms_of(self.fit)
        self.seen[terms] = max(self.fit.log_likelihood, self.seen.get(terms, -np.inf))
        self.work.begin_step()
        candidates = library_candidates(self.fit, decisions, self.withdrawn)
        best = candidates[0] if candidates and not candidates[0].refused else None
        correlated = self._correlated(best)
        proposal = None
        if best is None or correlated is not None:
            self.work.within_step("screening dependences")
            proposal = self._propose(alone=best is None)
        if correlated is not None:
            gains = [(one, one.nats) for one in self.open]
            gains += [(proposal.dependence, proposal.candidate.gain)] if proposal else []
            if self._include_correlated(correlated, explained_by(gains, correlated.effect, decisions)):
                return True
        if proposal is not None and (best is None or proposal.candidate.gain > best.gain + decisions.replacement_nats):
            self._include(proposal, candidates)
            return True
        if best is None or best.fit is None or len(self._selected()) >= decisions.max_effects:
            self._record(candidates)
            return False
        self.work.within_step("refits")
        # robust weights are re-estimated, because the term may explain intervals that were outliers before
        larger = with_shape_refined(best.fit.refit(), best.score, decisions)[0]
        larger = without_redundant(larger, self.given, decisions)
        if best.name not in larger.by_name or self._already_seen(larger):
            self.withdrawn.add(best.name)
            return True
        self._record(candidates, added=best.name)
        self._accept(larger)
        return True

    def _record(
        self, candidates: Sequence[Candidate], *, added: str | None = None, dependence: Dependence | None = None
    ) -> None:
        tried = tuple(replace(one, fit=None) for one in candidates)
        made = Step(before=self.fit.for_reports(), candidates=tried, added=added, dependence=dependence)
        self.steps.append(replace(made, alternative_nats=self.decisions.alternative_nats))

    def _correlated(self, best: Candidate | None) -> DetectedRandomEffect | None:
        """Return the random coefficient with a clearly larger gain than the best effect, if another one is allowed."""
        if len(self.fit.random) >= self.decisions.max_correlated or _is_pulled(self.fit):
            return None
        least = (best.gain if best is not None else 0.0) + self.decisions.alternative_nats
        found = random_coefficients(self.fit, self.decisions, last=best is None, least_nats=least)
        return found[0] if found else None

    def _propose(self, *, alone: bool) -> Proposal | None:
        """Return the dependence to include next; if no effect is admitted (`alone`), preferably as a replacement."""
        decisions, design = self.decisions, CoarseDesign(self.fit.problem)
        found = dependences(self.fit, basis_scores(self.fit, decisions, design), decisions)
        self.open = [one for one in found if one.channel not in self._contradicted()]
        if alone:
            self._compare(design)
        if len(self.included) >= decisions.max_dependences:
            return None
        # no replacement on contradicted channels either: it would be included and removed in turn
        replacement = best_replacement(self.fit, self.compared if alone else [], decisions, self._contradicted())
        proposal = replacement or best_dependence(self.fit, self.open, decisions)
        return None if proposal is None or self._already_seen(proposal.candidate.fit) else proposal

    def _already_seen(self, fit: Fit | None, likelier_nats: float = np.inf) -> bool:
        """Return whether a model has the terms of an earlier one and is not likelier by so much: an endless loop."""
        known = self.seen.get(terms_of(fit)) if fit is not None else None
        return fit is not None and known is not None and fit.log_likelihood < known + likelier_nats

    def _selected(self) -> list[Effect]:
        """Return the library effects of the model that were not given."""
        added = {step.added for step in self.steps}
        return [e for e in self.fit.effects if e.name in added]

    def _compare(self, design: CoarseDesign, *, again: bool = False) -> None:
        """Compare the included effects, each and all together, with basis functions.

        again : whether wide margins of the same effects in an earlier, similar model are kept
        """
        similar = again and self.compared_at is not None and terms_of(self.compared_at) == terms_of(self.fit)
        known = self.compared if similar else []
        self.compared = compare_each_with_basis(self.fit, self._selected(), self.decisions, design, known)
        self.compared_at = self.fit

    def _include_correlated(self, one: DetectedRandomEffect, explained: float) -> bool:
        """Include a random coefficient if it gains clearly more than `explained` nats; return whether it did."""
        calmer = self.fit.refit(random=(*self.fit.random, one.effect))
        if not gain_in_refit(one, self.fit, calmer) > explained + self.decisions.alternative_nats:
            return False
        self.fit, effect = iterate(calmer, one.effect)
        self.noise.append(replace(one, effect=effect))
        return True

    def _finish(self) -> None:
        """Record contradictions of physics, classify outliers, drop redundant terms and compare the included ones."""
        decisions = self.decisions
        against = [one for one in self.steps[-1].candidates if one.contradicts_physics(decisions)]
        self.contradictions += [one for one in against if one.score.robust_nats > decisions.replacement_nats]
        least = decisions.replacement_nats if self.fit.random else 0.0  # as in `best_dependence`
        self.open = [one for one in self.open if one.nats > least and one.channel not in self._contradicted()]
        tails = not (self.noise or self.open or self.included)
        outliers = [] if _is_pulled(self.fit) else outlier_effects(self.fit, decisions, tails=tails)
        self.noise += outliers
        self.fit = continued(self.fit)
        if bursts := [one.effect for one in outliers if one.effect.name == "slip_burst"]:
            # their error is an effect and not noise of every step
            self.fit = self.fit.refit((*self.fit.effects, *bursts))
        if self.compared_at is not self.fit:
            self._compare(CoarseDesign(self.fit.problem), again=True)


def _is_pulled(fit: Fit) -> bool:
    """Return whether a filter pulls the odometry of any recording towards external poses, so that its noise decays."""
    return any(recording.pulled_per_s > 0.0 for recording in fit.problem.recordings)
