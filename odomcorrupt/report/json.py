"""Results of the study as JSON: schema 1, described in docs/json.md. No NaN ever: what is not known is null."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from odomcorrupt.effects import registry
from odomcorrupt.effects.effect import amplitudes, parameters

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.study.judge.compare import Judgement
    from odomcorrupt.study.search.candidates import Candidate
    from odomcorrupt.study.search.learn import Learned, Round
    from odomcorrupt.study.search.random_gain import RandomGain
    from odomcorrupt.study.search.unknown import Unknown

__all__ = ["learned_json"]

SCHEMA = 1
_REAL = 3.9


def learned_json(learned: Learned, ladder: Sequence[Judgement]) -> dict[str, Any]:
    """Return what a search found, in the order it was found: clocks first, then effects, then noise.

    ladder : the models on the way judged on held-out halves, as `study.ladder.held_out_ladder` gives them
    """
    errors = iter(learned.fit.standard_errors)
    own = {e.name: (e, [float(next(errors)) for _ in amplitudes(e)]) for e in learned.fit.effects}
    found = [*_clocks_found(learned)]
    steps = [look for look in learned.rounds if look.added is not None]
    for place, look in enumerate(steps):
        if look.added in own:
            entry = _found(look, *own[look.added])
            entry["held_out"] = _held_out(ladder[place], ladder[place + 1])
            found.append(entry)
    found += [_noise(gain) for gain in learned.noise]
    last = learned.rounds[-1]
    untestable = [c for c in last.candidates if c.refused.startswith(("not testable", "cannot be told"))]
    return {
        "schema": SCHEMA,
        "verdict": "unknown" if learned.unknown else "missing" if found else "complete",
        "found": found,
        "candidates": [_candidate(c) for c in learned.rounds[0].candidates],
        "unknown": [_unknown(u) for u in learned.unknown],
        "not_testable": [
            {"effect": c.score.effect.name, "why": c.refused, "drive": c.score.effect.about.drive}
            for c in untestable
            if c.score.effect.about is not None
        ],
        "ladder": _ladder(steps, ladder),
    }


def _clocks_found(learned: Learned) -> Iterable[dict[str, Any]]:
    """Return clock effects that are really there, those of the first run standing for all."""
    kinds = registry()
    for name, position in (("time_offset", 0), ("clock_skew", 1)):
        for clock, free, errors in zip(learned.clocks.clocks, learned.clocks.free, learned.clocks.errors, strict=True):
            value = (clock.offset_s, clock.rate)[position]
            # a skew makes an offset free, too, which need not be there itself
            if free[position] and abs(value) > _REAL * errors[position]:
                p = amplitudes(kinds[name])[0]
                yield _entry(kinds[name](**{p.name: value}), [errors[position]], (), 0.9999) | {"held_out": None}
                break


def _found(look: Round, effect: Effect, errors: Sequence[float]) -> dict[str, Any]:
    rivals = [c.gain for c in look.candidates if not c.refused]
    best = look.candidates[0]
    odds = 1.0 / (sum(math.exp(max(g - best.gain, -700.0)) for g in rivals) + math.exp(max(-best.gain, -700.0)))
    return _entry(effect, errors, look.alternatives, min(odds, 1.0 - best.score.p))


def _noise(gain: RandomGain) -> dict[str, Any]:
    """Return a random effect; its numbers come without errors."""
    entry = _entry(gain.effect, [math.nan] * len(amplitudes(gain.effect)), (), 1.0 - math.exp(-gain.nats))
    for p in parameters(gain.effect):
        entry["parameters"][p.name] = {"value": getattr(gain.effect, p.name), "standard_error": None, "unit": p.unit}
    return entry | {"held_out": None}


def _held_out(before: Judgement, after: Judgement) -> dict[str, Any]:
    def position(judgement: Judgement, distance_m: float) -> float | None:
        values = [h.position_measured for h in judgement.curve if h.distance_m == distance_m]
        return _number(values[0]) if values else None

    return {
        "nats_per_m": [_number(before.nats.per_m), _number(after.nats.per_m)],
        "rmse_10m": [position(before, 10.0), position(after, 10.0)],
        "rmse_50m": [position(before, 50.0), position(after, 50.0)],
        "rmse_10s": [_number(before.ten_second_error_m), _number(after.ten_second_error_m)],
    }


def _unknown(unknown: Unknown) -> dict[str, Any]:
    return {
        "channel": unknown.channel,
        "depends_on": unknown.driver,
        "detail": {
            "centres": unknown.centres.tolist(),
            "curve": unknown.curve.tolist(),
            "standard_error": unknown.curve_error.tolist(),
            "p": unknown.p,
            "nats": _number(unknown.nats),
        },
        "expression": unknown.expression,
    }


def _entry(effect: Effect, errors: Sequence[float], alternatives: Sequence[str], confidence: float) -> dict[str, Any]:
    return {
        "effect": effect.name,
        "kind": effect.kind,
        "parameters": {
            p.name: {"value": getattr(effect, p.name), "standard_error": _number(error), "unit": p.unit}
            for p, error in zip(amplitudes(effect), errors, strict=True)
        },
        "alternatives": list(alternatives),
        "confidence": confidence,
    }


def _candidate(candidate: Candidate) -> dict[str, Any]:
    score = candidate.score
    return {
        "effect": score.effect.name,
        "evidence_nats": _number(candidate.gain if candidate.fit is not None else 0.5 * score.statistic),
        "p": score.p,
        "held_out_nats": score.held_out_nats,
        "estimate": {p.name: _number(v) for p, v in zip(amplitudes(score.effect), score.estimate, strict=True)},
        "refused": candidate.refused or None,
    }


def _ladder(steps: Sequence[Round], judged: Sequence[Judgement]) -> list[dict[str, Any]]:
    names = ["without effects", *(f"+ {look.added}" for look in steps)]
    return [
        {"model": name, "rmse_10s": _number(j.ten_second_error_m), "nats_per_m": _number(j.nats.per_m)}
        for name, j in zip(names, judged, strict=True)
    ]


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
