"""Comparison of models on recordings: predicted and measured errors, lack of fit, and likelihood.

Models are evaluated on recordings that they were not fitted to, or cross-validated if they were (`cross_validation`),
all on the same pieces and with the same clocks. Whether a model is better takes several measures: on one drive the
position error after 10 s fell to 95 % while the log likelihood fell by 24 nats per metre and the trajectory error
doubled.

If each were evaluated with its best clock, a clock would make up for a part of the errors of a wrong model (late travel
looks like slip at starts). But a clock is known within its standard error only, which widens the bounds of all of them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import degrees, isfinite
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from odomcorrupt.effects.effect import amplitudes
from odomcorrupt.study.estimate.calibrate import model_of
from odomcorrupt.study.estimate.clocks import Clocks, clock_rivals, find_clocks
from odomcorrupt.study.estimate.config import choose_approach
from odomcorrupt.study.estimate.correlation_length import with_correlation_lengths
from odomcorrupt.study.estimate.gauss_newton import fit_problem
from odomcorrupt.study.estimate.problem import pose_problem, undo
from odomcorrupt.study.estimate.windows import drift_of
from odomcorrupt.study.io.clock import Clock, aligned
from odomcorrupt.study.io.encoders import restore_lost, thinned
from odomcorrupt.study.io.headings import with_headings
from odomcorrupt.study.io.recording import was_fitted
from odomcorrupt.study.select.decisions import DECISIONS
from odomcorrupt.study.validate.calibration import CURVE_M, HORIZONS_M, Horizon
from odomcorrupt.study.validate.cross_validation import HELD_BY, split_of
from odomcorrupt.study.validate.evaluation import Evaluation, LogScore, evaluate_stretch, horizons_of, log_score_of
from odomcorrupt.study.validate.goodness_of_fit import Verdict, pits_of, verdict_of, whiteness_of
from odomcorrupt.study.validate.lack_of_fit import Failure, drift_failures, failures, sudden_failures
from odomcorrupt.study.validate.trajectory_error import TrajectoryError, trajectory_error

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.model.motion_model import MotionModel
    from odomcorrupt.study.estimate.config import Approach
    from odomcorrupt.study.io.recording import Recording
    from odomcorrupt.study.select.result import Learned
    from odomcorrupt.study.validate.cross_validation import Fold
    from odomcorrupt.study.validate.goodness_of_fit import Pit, Whiteness

JudgedOn = Literal["recordings", "folds", "fitted data"]
NOT_APPLIED = "not applied: learned in the frame of another truth (a laser's map)"
"""Why effects of places are left out of an evaluation."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ModelEvaluation:
    """Evaluation of one model on the recordings.

    judged_on : "recordings" that it was not fitted to; "folds": refitted without a fold (some recordings, or half
        of the only one) and evaluated on it; "fitted data" if the only one is too short to be split
    ten_second_error_m : root mean square position error after 10 s
    nats : log likelihood per metre driven with its standard error, and its gain over the first model
    horizons : for the table; curve : more of them, for the plot
    pits, whiteness : of the whitened innovations, by channel
    failures : drift failures first, then the others by significance
    trajectory : ATE and RPE
    notes : restrictions of this evaluation, for reports
    pieces : the evaluated stretches, for plots
    unplaced : names of effects that were not applied, because the recordings' frame is not that of their places
    """

    name: str
    judged_on: JudgedOn
    ten_second_error_m: float
    nats: LogScore
    horizons: tuple[Horizon, ...]
    curve: tuple[Horizon, ...]
    pits: Mapping[str, Pit]
    whiteness: Mapping[str, Whiteness]
    verdict: Verdict
    failures: tuple[Failure, ...]
    trajectory: TrajectoryError
    notes: tuple[str, ...]
    pieces: tuple[Evaluation, ...]
    unplaced: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """Evaluations of several models, and 10 s errors (metres) of the raw and the clock-corrected odometry."""

    recordings: tuple[str, ...]
    clocks: Clocks
    raw_error_m: float
    clock_error_m: float
    clock_trajectory: TrajectoryError
    evaluations: tuple[ModelEvaluation, ...]

    @property
    def judged_on(self) -> JudgedOn:
        """Data of the evaluation: the fitted data or their folds if any model was fitted to them."""
        return next((j.judged_on for j in self.evaluations if j.judged_on != "recordings"), "recordings")


def compare(
    recordings: Sequence[Recording], models: Mapping[str, MotionModel], *, clocks: Clocks | None = None
) -> Comparison:
    """Return the evaluation of models (by name) on recordings; default clocks: `clocks_beside` the last model.

    All models are evaluated with the same clocks, so that differences between them are not those of clocks.
    """
    if not any(model.noise.per_message for model in models.values()):
        recordings = thinned(recordings)
    approach = choose_approach(recordings)
    recordings = with_correlation_lengths(recordings, approach)
    found = clocks or clocks_beside(recordings, approach, list(models.values())[-1])
    on_time = _on_time(recordings, found)
    known = {name: [was_fitted(model, r) for r in recordings] for name, model in models.items()}
    split = split_of(on_time, [any(own) for own in zip(*known.values(), strict=True)], approach.spacing_s)
    folds = split.folds(on_time)
    judged = {name: _evaluated(model, folds, approach) for name, model in models.items()}
    first = next(iter(judged.values()))
    evaluations = {
        name: _evaluation(name, models[name], own, first, split.notes, fitted=any(known[name]))
        for name, own in judged.items()
    }
    # A truth of positions only gets headings, because windows start at a pose.
    raw = [piece for fold in split.folds([aligned(r, Clock()) for r in recordings]) for piece in fold.test]
    clock_right = [piece for fold in folds for piece in fold.test]
    return Comparison(
        recordings=tuple(r.name for r in recordings),
        clocks=found,
        raw_error_m=drift_of(raw).rmse,
        clock_error_m=drift_of(clock_right).rmse,
        clock_trajectory=trajectory_error(clock_right),
        evaluations=tuple(evaluations.values()),
    )


def _on_time(recordings: Sequence[Recording], clocks: Clocks) -> list[Recording]:
    """Return recordings with corrected clocks, whose offsets have the remaining errors."""
    known = zip(recordings, clocks.clocks, clocks.errors, strict=True)
    return [replace(aligned(r, clock), stamp_error_s=error_s) for r, clock, (error_s, _) in known]


def _evaluated(model: MotionModel, folds: Sequence[Fold], approach: Approach) -> list[Evaluation]:
    """Return a model's evaluations on all folds; on those that it was fitted to, refitted on the others that it was."""
    found = []
    for fold in folds:
        train = tuple(r for r in fold.train if was_fitted(model, r))
        refitted = bool(train) and any(was_fitted(model, r) for r in fold.test)
        own = _refit(model, train, approach) if refitted else model
        inflation = replace(fold, train=train if refitted else ()).inflation
        found += [evaluate_stretch(piece, own, approach, inflation=inflation) for piece in fold.test]
    return found


def _evaluation(
    name: str,
    model: MotionModel,
    pieces: Sequence[Evaluation],
    first: Sequence[Evaluation],
    notes: Sequence[str],
    *,
    fitted: bool,
) -> ModelEvaluation:
    curve = horizons_of(pieces, CURVE_M)
    horizons = tuple(h for h in curve if h.distance_m in HORIZONS_M)
    axes = min((piece.recording.axes for piece in pieces), key=len)
    chains = [chain[:, : len(axes)] for piece in pieces for chain in piece.chains()]
    pits, whiteness = pits_of(chains, axes), whiteness_of(chains, axes)
    # Over single intervals the errors are mostly the localisation's, whose law is only approximate.
    localised = any(piece.recording.localised for piece in pieces)
    return ModelEvaluation(
        name=name,
        judged_on="folds" if any(piece.refitted for piece in pieces) else "fitted data" if fitted else "recordings",
        ten_second_error_m=drift_of([piece.left for piece in pieces]).rmse,
        nats=log_score_of(pieces, first),
        horizons=horizons,
        curve=curve,
        pits=pits,
        whiteness=whiteness,
        verdict=verdict_of(horizons, *(({}, {}) if localised else (pits, whiteness))),
        failures=(*drift_failures(horizons), *_all_failures(pieces)),
        trajectory=trajectory_error([piece.left for piece in pieces]),
        notes=(*notes, *_notes(model, pieces)),
        pieces=tuple(pieces),
        unplaced=_unplaced(model, pieces),
    )


def _all_failures(pieces: Sequence[Evaluation]) -> list[Failure]:
    """Return the failures of all pieces, with the recording's name if there are several."""
    found = []
    for piece in pieces:
        name = piece.recording.name if len(pieces) > 1 else ""
        found += failures(piece.problem, piece.whitener, piece.innovations, headed=piece.headed, name=name)
        found += sudden_failures(piece.problem, piece.covariance, piece.innovations, headed=piece.headed, name=name)
    return sorted(found, key=lambda f: f.log_p)


def _unplaced(model: MotionModel, pieces: Sequence[Evaluation]) -> tuple[str, ...]:
    """Return the names of a model's effects of places that no piece was evaluated with."""
    used = {effect.name for piece in pieces for effect in piece.model.placed}
    return tuple(effect.name for effect in model.placed if effect.name not in used)


def _notes(model: MotionModel, pieces: Sequence[Evaluation]) -> tuple[str, ...]:
    notes = []
    if unplaced := _unplaced(model, pieces):
        notes.append(f"{', '.join(unplaced)} {NOT_APPLIED}")
    motion = pieces[0].problem.motions[0]
    random = [effect.name for effect in model.effects if effect.kind == "noise" and not effect.gains(motion)]
    if random:
        notes.append(f"corruption draws {', '.join(random)}, but the predicted errors here do not include it")
    k = model.noise.coefficients
    if k.white_v or k.white_omega:
        notes.append("corruption draws white noise on twists, but the predicted errors here do not include it")
    if model.setup.truth is None:
        truth = pieces[0].truth
        notes.append(
            f"the model states no noise of the truth; {truth.xy_m * 1e3:.2g} mm was estimated from these recordings"
        )
    elif any(piece.truth != model.setup.truth for piece in pieces if piece.headed and not piece.refitted):
        own = "; ".join(
            f"{piece.truth.xy_m * 1e3:.2g} mm" + (f", {degrees(piece.truth.yaw_rad):.2g} deg" if piece.headed else "")
            for piece in pieces
        )
        notes.append(
            f"its truth is noisier or better than that of the fitted recordings, and was weighted accordingly ({own})"
        )
    if not all(piece.headed for piece in pieces):
        notes.append("the truth has positions only: yaw is not evaluated")
    return tuple(notes)


def _refit(model: MotionModel, recordings: Sequence[Recording], approach: Approach) -> MotionModel:
    """Return the model with its parameters estimated on these recordings only and the same set of effects.

    Parameters with a standard error are weakly held by their value in the model.
    """
    systematic = [e for e in (*model.effects, *model.setup.effects) if e.kind != "noise"]
    recordings = [restore_lost(recording, systematic) for recording in recordings]
    names = [f"{effect.name}.{p.name}" for effect in systematic for p in amplitudes(effect)]
    held = np.array([HELD_BY * model.standard_errors.get(name, np.inf) for name in names])
    problem = pose_problem(recordings, systematic, approach=replace(approach, law_name=model.noise.law_name))
    refitted = fit_problem(problem, held=np.where(held > 0.0, held, np.inf))
    random = [e for e in model.effects if e.kind == "noise"]
    count = len(model.effects) - len(random)
    return replace(
        model,
        noise=replace(model.noise, coefficients=refitted.noise.coefficients),
        effects=(*refitted.effects[:count], *random),
        setup=replace(model.setup, effects=refitted.effects[count:], truth=refitted.noise.truth),
    )


def sequence_comparison(
    learned: Learned, recordings: Sequence[Recording], first: str = "without effects", *, clocks: Clocks | None = None
) -> Comparison:
    """Return the comparison of the model before each inclusion and of the final one, named by the added term.

    recordings : evaluation data; recordings used in the selection are cross-validated
    first : name of the initial model
    clocks : of the recordings, as for `compare`
    """
    # Terms that were included and dropped again are not steps.
    steps = learned.steps
    before = [step.before for step in (*learned.rounds[:1], *steps[1:])] if steps else []
    fits = [*before, learned.fit]
    names = [first, *(f"+ {step.name}" for step in steps)]
    return compare(recordings, {n: model_of(fitted) for n, fitted in zip(names, fits, strict=True)}, clocks=clocks)


def clocks_beside(recordings: Sequence[Recording], approach: Approach, model: MotionModel) -> Clocks:
    """Return the clocks estimated with a model applied: a strong effect can mask or imitate a clock offset."""
    return find_clocks(without_effects_of(model, recordings), approach, clock_rivals(recordings))


def _effects(model: MotionModel, recording: Recording) -> tuple[Effect, ...]:
    """Return the effects of a model that apply in a recording's frame, and those of its measurement."""
    return (*model.in_frame(recording.frame).effects, *model.setup.effects)


def without_effects_of(model: MotionModel, recordings: Sequence[Recording]) -> list[Recording]:
    """Return recordings with the effects of a model removed from the odometry and their truth unchanged.

    Effects that depend on the heading in the world need headings, which a truth of positions lacks.
    """
    found = []
    for recording in recordings:
        left = undo(with_headings(recording), _effects(model, recording))
        found.append(replace(left, truth=recording.truth, heading_error_rad=recording.heading_error_rad))
    return found


Change = Literal["better", "worse", "same"]

_ERROR_SHARE, _TRAJECTORY_SHARE = DECISIONS.practical.share, DECISIONS.practical.far_share
"""Smaller relative changes of the position error after 10 s count as none (many windows, small scatter); the same for
the absolute trajectory error, which is one number per drive and scatters more."""
_SIGMAS = 2.0
"""Standard errors by which a log likelihood must change to count as different."""


class Measure(NamedTuple):
    """One measure of two models: its values, metres or nats per metre, and whether the change is an improvement."""

    name: str
    before: float
    after: float
    change: Change


class Agreement(NamedTuple):
    """All measures of two models, and their joint verdict.

    verdict : better or worse if some measures agree on it and none contradicts; otherwise same or mixed
    """

    measures: tuple[Measure, ...]
    verdict: Literal["better", "worse", "same", "mixed"]


def agreement_of(comparison: Comparison) -> Agreement:
    """Return the change from the first to the last model of a comparison, by every measure available.

    Measures are position error after 10 s (m), log likelihood (nats per metre) and absolute trajectory error (m).
    """
    first, last = comparison.evaluations[0], comparison.evaluations[-1]
    gain, error = last.nats.gain_per_m, last.nats.gain_error
    likelihood: Change = "same"
    if isfinite(gain) and abs(gain) > _SIGMAS * (error if isfinite(error) else 0.0):
        likelihood = "better" if gain > 0.0 else "worse"
    found = [
        _of_errors("10 s error", first.ten_second_error_m, last.ten_second_error_m, _ERROR_SHARE),
        Measure("log likelihood", first.nats.per_m, last.nats.per_m, likelihood),
        _of_errors("ATE", first.trajectory.ate_m, last.trajectory.ate_m, _TRAJECTORY_SHARE),
    ]
    measures = tuple(one for one in found if isfinite(one.before) and isfinite(one.after))
    changes = {one.change for one in measures} - {"same"}
    return Agreement(measures, "mixed" if len(changes) > 1 else next(iter(changes), "same"))


def _of_errors(name: str, before: float, after: float, share: float) -> Measure:
    worse = after > (1.0 + share) * before
    return Measure(name, before, after, "better" if after < (1.0 - share) * before else "worse" if worse else "same")
