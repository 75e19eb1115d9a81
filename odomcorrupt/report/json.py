"""Results of the study as JSON: schema 1, described in docs/json.md. No NaN ever: what is not known is null."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from odomcorrupt.effects import registry
from odomcorrupt.effects.effect import amplitudes

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.study.learn import Learned, Round
    from odomcorrupt.study.search import Candidate

__all__ = ["learned_json"]

SCHEMA = 1


def learned_json(learned: Learned) -> dict[str, Any]:
    """Return what a search found, in the order it was found: setup of the clocks first."""
    found = [*_clocks_found(learned)]
    errors = iter(learned.fit.standard_errors)
    own = {e.name: (e, [float(next(errors)) for _ in amplitudes(e)]) for e in learned.fit.effects}
    found += [_found(look, *own[look.added]) for look in learned.rounds if look.added in learned.added]
    last = learned.rounds[-1]
    testable = [c for c in last.candidates if c.refused.startswith(("not testable", "cannot be told"))]
    return {
        "schema": SCHEMA,
        "verdict": "missing" if found else "complete",
        "found": found,
        "candidates": [_candidate(c) for c in learned.rounds[0].candidates],
        "unknown": [],
        "not_testable": [{"effect": c.score.effect.name, "why": c.refused, "drive": None} for c in testable],
        "ladder": _ladder(learned),
    }


def _clocks_found(learned: Learned) -> Iterable[dict[str, Any]]:
    """Return clock effects that are really there, those of the first run standing for all."""
    kinds = registry()
    for name, position in (("time_offset", 0), ("clock_skew", 1)):
        for clock, free, errors in zip(learned.clocks.clocks, learned.clocks.free, learned.clocks.errors, strict=True):
            if free[position]:
                value = (clock.offset_s, clock.rate)[position]
                p = amplitudes(kinds[name])[0]
                yield _entry(kinds[name](**{p.name: value}), [errors[position]], (), 0.9999)
                break


def _found(look: Round, effect: Effect, errors: Sequence[float]) -> dict[str, Any]:
    rivals = [c.gain for c in look.candidates if not c.refused]
    best = look.candidates[0]
    odds = 1.0 / (sum(math.exp(max(g - best.gain, -700.0)) for g in rivals) + math.exp(max(-best.gain, -700.0)))
    entry = _entry(effect, errors, look.alternatives, min(odds, 1.0 - best.score.p))
    entry["held_out"] = {"nats": _number(best.score.held_out_nats), "rmse_10s_m": [_number(x) for x in best.rmse]}
    return entry


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


def _ladder(learned: Learned) -> list[dict[str, Any]]:
    steps: list[dict[str, Any]] = []
    for look in learned.rounds:
        if look.added is not None:
            before, after = look.candidates[0].rmse
            steps.append({"added": look.added, "rmse_10s_m": [_number(before), _number(after)],
                          "nats": _number(look.candidates[0].gain)})  # fmt: skip
    return steps


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
