"""From recordings to a robot's model: selection of effects, experiment design, fit, and held-out comparison.

Clocks are estimated once, before the selection, and used in all later steps.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, TypeAlias

from odomcorrupt.study.design.advise import Advice, advise
from odomcorrupt.study.estimate.calibrate import RobotFit, fit_robot
from odomcorrupt.study.estimate.config import choose_approach
from odomcorrupt.study.estimate.correlation_length import with_correlation_lengths
from odomcorrupt.study.estimate.random_process import CORRELATED_NOISE, part_name
from odomcorrupt.study.estimate.windows import with_gyros_corrected
from odomcorrupt.study.io.encoders import thinned
from odomcorrupt.study.io.first_look import factors_of
from odomcorrupt.study.io.recording import shared_frame
from odomcorrupt.study.select.contribution import contributions
from odomcorrupt.study.select.decisions import DECISIONS
from odomcorrupt.study.select.selection import Watch, learn, stages
from odomcorrupt.study.validate.compare import Comparison, clocks_beside, compare, sequence_comparison
from odomcorrupt.study.validate.held_out import drop_unsupported_parts, without_parts
from odomcorrupt.study.validate.predictive_check import Reproduction, reproduction_of
from odomcorrupt.study.validate.round_trip import RoundTrip, verified_model

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from odomcorrupt.model.motion_model import MotionModel
    from odomcorrupt.study.io.recording import Recording
    from odomcorrupt.study.select.decisions import Decisions
    from odomcorrupt.study.select.result import Learned

LAW = "diffusion"
"""Noise law of learned models: the only law whose drift does not depend on the message rate."""


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class LearnedRobot:
    """Result of learning a robot's model.

    recordings, held_out : fitted recordings, and evaluated recordings; equal if none were held out
    search : effects, noise and dependences that were found, and those that were tested
    advice : questions that these data leave open, and the drive that would answer them
    base, robot : the fits without effects and with all that were found
    proof : the usable model, verified by reading it back, correcting and corrupting
    reproduction : drift of the model compared with the recordings, including stretches excluded from the fit
    dropped : sentences on effects that were found but dropped because of held-out data
    comparison : both models, evaluated on the held-out recordings or by cross-validation
    unplaced : names of effects of places that the held-out recordings could not test, because their frame is another
        one; the comparison is by cross-validation then
    """

    recordings: Sequence[Recording]
    held_out: Sequence[Recording]
    search: Learned
    advice: Advice
    base: RobotFit
    robot: RobotFit
    proof: RoundTrip
    reproduction: Reproduction
    dropped: tuple[str, ...]
    comparison: Comparison
    unplaced: tuple[str, ...] = ()

    @property
    def alerts(self) -> tuple[str, ...]:
        """Restrictions of the evaluation that every summary states."""
        if not self.unplaced:
            return ()
        names = " and ".join(self.unplaced)
        why = "the other recordings have places of their own (a laser's map)"
        return (f"{names}: {why}, so errors are those of halves of the fitted drive",)

    @cached_property
    def sequence(self) -> Comparison:
        """Comparison of the models before each inclusion and the final one; computed on first use."""
        return sequence_comparison(self.search, self.held_out, clocks=self.comparison.clocks)


def learn_robot(
    recordings: Sequence[Recording],
    held_out: Sequence[Recording] = (),
    *,
    decisions: Decisions = DECISIONS,
    watch: Watch | None = None,
) -> LearnedRobot:
    """Return the model supported by recordings of one robot, with its evaluation on held-out data.

    recordings : runs of one robot, each with its own clock
    held_out : recordings for evaluation; without any, cross-validation on halves of `recordings`
    """
    begin = stages(watch)
    recordings, held_out = (
        with_correlation_lengths(thinned(some), choose_approach(some)) if some else some
        for some in (recordings, held_out)
    )
    search = learn(recordings, factors_of(recordings), decisions=decisions, begin=begin)
    begin("each part on held-out data")
    search, (robot, proof, reproduction), remarks = _supported(search, recordings, held_out, begin)
    base = fit_robot(recordings, (), law_name=LAW, clocks=search.clocks)
    begin("what the data leave open")
    advice = advise(search)
    models = {"without effects": base.model}
    names = [effect.name for effect in factors_of(recordings)]
    names += [*search.added, *(one.title for one in search.laws)]
    names += [gain.effect.name for gain in search.noise]
    if names:
        models["with " + ", ".join(names)] = proof.model
    begin("comparison on held-out data")
    placed = [effect.name for effect in proof.model.effects if effect.reads_places]
    unplaced = placed if held_out and shared_frame([*recordings, *held_out]) is None else []
    judged_on = recordings if unplaced else held_out or recordings
    clocks = clocks_beside(judged_on, choose_approach(judged_on), list(models.values())[-1])
    comparison = compare(judged_on, models, clocks=clocks)
    explained = contributions(search.fit, judged_on, comparison.clocks.clocks)
    verdict = comparison.evaluations[-1].verdict
    misfit = max(verdict.misfit, 1.0) if verdict.fails else 1.0
    return LearnedRobot(
        recordings=recordings,
        held_out=judged_on,
        search=replace(search, contributions=explained, drifts_too_far=reproduction.too_large, misfit=misfit),
        advice=advice,
        base=base,
        robot=robot,
        proof=proof,
        reproduction=reproduction,
        dropped=tuple(remarks),
        comparison=comparison,
        unplaced=tuple(unplaced),
    )


_Written: TypeAlias = tuple[RobotFit, RoundTrip, Reproduction]


def _supported(
    search: Learned, recordings: Sequence[Recording], held_out: Sequence[Recording], begin: Callable[[str], None]
) -> tuple[Learned, _Written, list[str]]:
    """Return a search without the parts that other data do not support or that no model file can have, and remarks.

    A part that has no inverse may have been balanced by another one, so the others are refitted and tested again.
    """
    remarks: list[str] = []
    while True:
        search, parts = drop_unsupported_parts(search, held_out) if held_out else (search, ())
        begin("fit")
        remaining, written, more = _without_excess(search, recordings)
        unusable = written[1].left_out
        remarks += [part.remark for part in parts if part.failure]
        if not unusable:
            return remaining, written, [*remarks, *more]
        remarks += [change for change in written[1].changes if any(name in change for name in unusable)]
        search = without_parts(search, unusable)


def _written(search: Learned, recordings: Sequence[Recording]) -> _Written:
    """Return the fit of all that a search found, its model in a usable form, and the drift of that model."""
    found = (*search.fit.effects, *(gain.effect for gain in search.noise))
    robot = fit_robot(recordings, found, law_name=LAW, clocks=search.clocks, shaped=search.added)
    proof = verified_model(robot.model, recordings)
    return robot, proof, reproduction_of(robot.fit, proof.model, recordings)


def _without_excess(search: Learned, recordings: Sequence[Recording]) -> tuple[Learned, _Written, list[str]]:
    """Return a search, what is written of it, and remarks.

    Random processes with which the model drifts clearly farther than the recordings, and without which it does not, are
    dropped; their confidence would be even odds at most (`Learned.drifts_too_far`).
    """
    written = _written(search, recordings)
    processes = [gain for gain in search.noise if gain.effect.name in CORRELATED_NOISE]
    if not (written[-1].too_large and processes):
        return search, written, []
    others = tuple(gain for gain in search.noise if gain not in processes)
    calmer = replace(search, noise=others, fit=search.fit.refit(random=()))
    without = _written(calmer, recordings)
    if not without[-1].holds:
        return search, written, []
    names = " and ".join(part_name(gain.effect) for gain in processes)
    found = "were found, but are" if len(processes) > 1 else "was found, but is"
    said = (
        f"{names} {found} not in the model: with it, a robot would drift much farther than in the recordings; without "
        "it, about as far"
    )
    return calmer, without, [said]


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class DiagnosedModel:
    """Errors in recordings that a model does not explain.

    search : effects, noise and dependences that were found, and those that were tested
    advice : questions that these data leave open, and the drive that would answer them
    sequence : the model and the improvement by each inclusion, cross-validated
    """

    search: Learned
    advice: Advice
    sequence: Comparison


def diagnose_model(
    recordings: Sequence[Recording],
    model: MotionModel | None = None,
    *,
    name: str = "",
    decisions: Decisions = DECISIONS,
    watch: Watch | None = None,
) -> DiagnosedModel:
    """Return the errors in recordings that a model does not explain; None is a model of noise only.

    The set-up of the model (lever arm, mounting) is refitted, because it belongs to the recordings.

    name : name of the model in the comparison
    """
    if model is not None:
        model = model.in_frame(shared_frame(recordings) or "")
    start = factors_of(recordings) if model is None else (*model.effects, *model.setup.effects)
    if model is None or not model.noise.per_message:
        recordings = thinned(recordings)
    begin = stages(watch)
    law = LAW if model is None else model.noise.law_name
    search = learn(recordings, start, law_name=law, decisions=decisions, begin=begin)
    begin("what the data leave open")
    advice = advise(search)
    begin("comparison of the additions")
    sequence = sequence_comparison(search, with_gyros_corrected(recordings, search.fit), name or "without effects")
    search = replace(search, contributions=contributions(search.fit))
    return DiagnosedModel(search=search, advice=advice, sequence=sequence)
