"""Fits and findings as JSON: schema 2, described in docs/json.md. Unknown values are null, never NaN."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from odomcorrupt.effects import registry
from odomcorrupt.effects.effect import Effect, amplitudes, choices, parameters
from odomcorrupt.report.findings import (
    clocks_found,
    dependences_found,
    effects_found,
    effects_with_errors,
    is_unexplained,
    noise_found,
)
from odomcorrupt.report.json.numbers import finite, picked
from odomcorrupt.report.text.comparison import rejection, reproduction_sentence
from odomcorrupt.report.text.design import drive_sentence
from odomcorrupt.report.text.diagnosis import position_error
from odomcorrupt.study.estimate.outliers import single_events
from odomcorrupt.study.validate.trajectory_error import clock_gain

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from odomcorrupt.report.findings import FoundDependence
    from odomcorrupt.study.design.advise import Advice
    from odomcorrupt.study.estimate.calibrate import RobotFit
    from odomcorrupt.study.estimate.gauss_newton import Fit
    from odomcorrupt.study.io.recording import Recording
    from odomcorrupt.study.select.candidates import Candidate
    from odomcorrupt.study.select.result import Learned
    from odomcorrupt.study.validate.compare import ModelEvaluation
    from odomcorrupt.study.validate.predictive_check import Reproduction

SCHEMA = 2


def learned_json(
    learned: Learned,
    sequence: Sequence[ModelEvaluation],
    advice: Advice,
    *,
    evaluated: ModelEvaluation | None = None,
    fit: Fit | None = None,
) -> dict[str, Any]:
    """Return the findings of a search in order: clocks, then effects, then noise.

    sequence : models in the order of the search, cross-validated, see `sequence_comparison`
    evaluated : evaluation of the final model, if available: the last model of the sequence lacks noise terms
    fit : fit of the final model, if it is not that of the search
    """
    found = [*_clocks_found(learned)]
    for place, one in enumerate(effects_found(learned)):
        entry = _entry(one.effect, one.errors, one.step.alternatives, one.confidence)
        held_out = {"held_out": _held_out(sequence[place], sequence[place + 1])}
        found.append(entry | held_out | _matters(one.effect.name, learned))
    unmeasured = {"held_out": None, "negligible": False}
    # parameters of random effects have no standard errors
    found += [_entry(one.effect, (), (), one.confidence) | unmeasured for one in noise_found(learned)]
    missing, unknown = bool(learned.lacking or learned.noise), learned.unexplained or is_unexplained(learned, evaluated)
    return finite(
        {
            "schema": SCHEMA,
            "verdict": "unknown" if unknown else "missing" if missing else "complete",
            "rejected": (evaluated and rejection(evaluated)) or None,
            "recordings": recordings_json(learned.fit.problem.recordings),
            "mistakes": [one._asdict() for one in learned.fit.problem.recordings[0].mistakes],
            "drive_type": {"name": learned.drive_type.name, "guessed_because": learned.drive_type.reason or None},
            "found": found,
            "candidates": [_candidate(c) for c in learned.rounds[0].candidates],
            "unknown": [
                _unknown(one) | {"negligible": learned.hardly_moves(one.law), "mean_in_model": one.mean}
                for one in dependences_found(learned, fit)
            ],
            "not_testable": [
                {"effect": one.effect, "why": one.why, "drive": drive_sentence(one.plan) if one.plan else one.hint}
                for one in advice.untestable
            ],
            "events": [
                {
                    **picked(one, "recording", "start_s", "end_s"),
                    "x_m": one.place_xy[0],
                    "y_m": one.place_xy[1],
                    **picked(one, "along_m", "across_m", "yaw_rad"),
                }
                for one in single_events(learned.fit)
            ],
            "disagreements": [
                {
                    **picked(one, "effect", "parameter", "unit", "p"),
                    "recordings": [
                        {"name": name, "value": value, "standard_error": error}
                        for name, value, error in zip(one.recordings, one.values, one.standard_errors, strict=True)
                    ],
                }
                for one in learned.disagreements
            ],
            "contradictions": [{"effect": one.name, "why": one.refused} for one in learned.contradictions],
            "ladder": [_step(evaluation) for evaluation in sequence],
            **_advice(advice),
        }
    )


def recordings_json(recordings: Iterable[Recording]) -> list[dict[str, Any]]:
    """Return the reader's notes on each recording, and how a filter that receives poses corrects its odometry."""
    return [
        {
            "name": one.name,
            "odometry_pulled_per_s": one.pulled_per_s,
            "odometry_pose_corrections": one.pose_corrections,
            "notes": list(one.notes),
        }
        for one in recordings
    ]


def reproduction_json(one: Reproduction) -> dict[str, Any]:
    """Return the drift of a model relative to that of the recordings it was learned from."""
    return finite(
        {
            "measured_rmse_10s": one.measured_m,
            "corrupted_rmse_10s": one.drawn_m,
            "corrupted_rmse_10s_range": [one.least_m, one.most_m],
            "long": one.long
            and {
                "after_s": one.long.after_s,
                "measured_rmse": one.long.measured_m,
                "corrupted_rmse": one.long.drawn_m,
                "corrupted_rmse_least": one.long.least_m,
            },
            "holds": one.holds,
            "outliers": {"count": one.outliers, "duration_s": one.outlier_s, "share": one.outlier_share},
            "sentence": reproduction_sentence(one) or None,
        }
    )


def _advice(advice: Advice) -> dict[str, Any]:
    best = advice.best
    return {
        "choices": [
            {
                "names": list(choice.names),
                "why": choice.why,
                "drive": drive_sentence(choice.plan) if choice.plan else None,
                "expected_nats": choice.nats if choice.plan else 0.0,
                "hint": choice.hint,
            }
            for choice in advice.choices
        ],
        "detectable": [picked(limit, "effect", "parameter", "size", "unit") for limit in advice.limits],
        "next_drive": None
        if best is None
        else {
            "manoeuvre": best.manoeuvre.name,
            "drive": drive_sentence(best),
            "duration_s": best.duration_s,
            "floor_m": list(best.floor_m),
        },
    }


def _clocks_found(learned: Learned) -> Iterable[dict[str, Any]]:
    """Return the significant clock effects, with those of the first run representing all."""
    kinds = registry()
    firsts = {one.name: one for one in reversed([*clocks_found(learned.clocks)])}
    if not firsts:
        return
    change = clock_gain(learned.fit.problem.recordings, learned.clocks.clocks)
    held_out = {
        "nats_per_m": [None, None],
        "rmse_10m": change.after_10m,
        "rmse_50m": change.after_50m,
        "rmse_10s": change.after_10s,
    }
    for one in reversed(firsts.values()):
        effect = kinds[one.name](**{amplitudes(kinds[one.name])[0].name: one.value})
        yield _entry(effect, [one.error], (), one.confidence) | {"held_out": held_out, "negligible": False}


def _matters(name: str, learned: Learned) -> dict[str, Any]:
    """Return whether a part of the model is negligible, and its size: lengths in metres, null if not measured."""
    own = learned.contributions.get(name)
    spans = () if own is None else (("10s", own.ten_seconds), ("50m", own.far))
    return {
        "negligible": learned.is_negligible(name),
        "contribution": {key: span and picked(span, "moved_m", "error_m", "travelled_m") for key, span in spans}
        or None,
    }


def _held_out(before: ModelEvaluation, after: ModelEvaluation) -> dict[str, Any] | None:
    if after.judged_on == "fitted data":
        return None
    return {
        "nats_per_m": [before.nats.per_m, after.nats.per_m],
        "rmse_10m": [position_error(before, 10.0), position_error(after, 10.0)],
        "rmse_50m": [position_error(before, 50.0), position_error(after, 50.0)],
        "rmse_10s": [before.ten_second_error_m, after.ten_second_error_m],
    }


def _unknown(found: FoundDependence) -> dict[str, Any]:
    unknown = found.law
    return {
        "channel": unknown.channel,
        "depends_on": unknown.regressor,
        "detail": {
            "centres": unknown.centres,
            "curve": unknown.curve,
            "standard_error": unknown.curve_error,
            "p": unknown.p,
            **picked(unknown, "nats", "per", "wavelength_m", "wheels"),
        },
        "expression": found.expression,
        "parameters": {
            name: {"value": number.value, "standard_error": number.error, "unit": number.unit}
            for name, number in found.numbers.items()
        },
        "in_model": found.fitted,
        "instead_of": ", ".join(unknown.instead_of) or None,
    }


def _entry(effect: Effect, errors: Sequence[float], alternatives: Sequence[str], confidence: float) -> dict[str, Any]:
    return _effect(effect, errors) | {"alternatives": list(alternatives), "confidence": confidence}


def _effect(effect: Effect, errors: Sequence[float]) -> dict[str, Any]:
    """Return an effect with its parameters, amplitudes with standard errors first, and its word-valued parameters."""
    known = dict(zip((p.name for p in amplitudes(effect)), errors, strict=False))
    own = sorted(parameters(effect), key=lambda p: not p.amplitude)
    return {
        "effect": effect.name,
        "kind": effect.kind,
        "parameters": {
            p.name: {"value": getattr(effect, p.name), "standard_error": known.get(p.name), "unit": p.unit} for p in own
        },
        "words": {word: getattr(effect, word) for word in choices(effect)},
    }


def _candidate(candidate: Candidate) -> dict[str, Any]:
    score = candidate.score
    return {
        "effect": score.effect.name,
        "evidence_nats": candidate.gain if candidate.fitted is not None else 0.5 * score.statistic,
        "p": score.p,
        "held_out_nats": score.held_out_nats,
        "estimate": {p.name: v for p, v in zip(amplitudes(score.effect), score.estimate, strict=True)},
        "refused": candidate.refused or None,
    }


def _step(evaluation: ModelEvaluation) -> dict[str, Any]:
    return {
        "model": evaluation.name,
        "rmse_10s": evaluation.ten_second_error_m,
        "rmse_10m": position_error(evaluation, 10.0),
        "rmse_50m": position_error(evaluation, 50.0),
        "nats_per_m": evaluation.nats.per_m,
    }


def fit_json(result: RobotFit, laws: Mapping[str, RobotFit]) -> dict[str, Any]:
    """Return a fit as plain values.

    result : fit of a robot
    laws : fits of all laws if all were tried, the likeliest first
    """
    fit = result.fit
    truth = fit.noise.truth
    pairs = zip(fit.problem.recordings, result.clocks.clocks, result.clocks.errors, strict=True)
    best = next(iter(laws.values())).information_nats if laws else 0.0
    return finite(
        {
            "schema": SCHEMA,
            "law": fit.problem.approach.law_name,
            "coefficients": {i.name: picked(i, "value", "low", "high", "identifiable") for i in result.intervals},
            "effects": [_effect(effect, errors) for effect, errors in effects_with_errors(fit)],
            "clocks": [
                {
                    "recording": recording.name,
                    "offset_s": clock.offset_s,
                    "skew": clock.rate,
                    "offset_error_s": spread[0],
                    "skew_error": spread[1],
                }
                for recording, clock, spread in pairs
            ],
            "truth_noise": {"xy_m": truth.xy_m, "yaw_rad": truth.yaw_rad, "wander": truth.random_walk},
            "log_likelihood_nats": fit.log_likelihood,
            "rmse_10s": result.ten_second_error_m,
            "laws": {name: {"nats_behind": best - one.information_nats} for name, one in laws.items()},
        }
    )
