"""A fit as JSON: schema 2, described in docs/json.md."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from odomcorrupt.effects.effect import amplitudes, choices, parameters
from odomcorrupt.report.json.numbers import finite

if TYPE_CHECKING:
    from collections.abc import Mapping

    from odomcorrupt.study.estimate.calibrate import RobotFit

__all__ = ["fit_json"]

SCHEMA = 2


def fit_json(result: RobotFit, laws: Mapping[str, RobotFit]) -> dict[str, Any]:
    """Return a fit as plain values.

    Parameters
    ----------
    result : the fit
    laws : the fits of every law where all were tried, the likeliest first
    """
    fit = result.fit
    errors = iter(fit.standard_errors)
    effects = []
    for effect in fit.effects:
        spread = {p.name: float(next(errors)) for p in amplitudes(effect)}
        values = {
            p.name: {"value": getattr(effect, p.name), "standard_error": spread.get(p.name), "unit": p.unit}
            for p in parameters(effect)
        }
        words = {word: getattr(effect, word) for word in choices(effect)}
        effects.append({"effect": effect.name, "kind": effect.kind, "parameters": values, "words": words})
    truth = fit.noise.truth
    pairs = zip(fit.problem.recordings, result.clocks.clocks, result.clocks.errors, strict=True)
    best = next(iter(laws.values())).information_nats if laws else 0.0
    content: dict[str, Any] = finite(
        {
            "schema": SCHEMA,
            "law": fit.problem.approach.law_name,
            "coefficients": {
                i.name: {"value": i.value, "low": i.low, "high": i.high, "identifiable": i.identifiable}
                for i in result.intervals
            },
            "effects": effects,
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
    return content
