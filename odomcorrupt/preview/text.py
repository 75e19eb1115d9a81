"""A forecast as text and as plain values."""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING, Any

from odomcorrupt.corruption.inverse import acts
from odomcorrupt.corruption.summary import holonomic_words, model_brief, model_words, per_message, size_words
from odomcorrupt.report.text.summary import Line, Summary

if TYPE_CHECKING:
    from odomcorrupt.model.motion_model import MotionModel
    from odomcorrupt.preview.forecast import Forecast

__all__ = ["SCHEMA", "brief", "forecast_json", "forecast_text"]

SCHEMA = 2
"""Version of the values that `forecast_json` returns."""

SAME = 0.03
"""Factors this near 1 are the discretisation of the drive, not a law that depends on the rate."""


def _changes_at_half_rate(outlook: Forecast) -> bool:
    return abs(outlook.half_rate_position - 1.0) > SAME or abs(outlook.half_rate_heading - 1.0) > SAME


def brief(outlook: Forecast, model: MotionModel, origin: str, seed: int, name: str) -> Summary:
    """Return a short summary: drift at the end and on the way, model, dependence on the message rate.

    Parameters
    ----------
    outlook, model : the forecast, and its model
    origin : source of the model's numbers, in words
    seed : seed of the runs
    name : name of the bag
    """
    end = outlook.rows[-1]
    said = f"{size_words(end.position_rms_m, end.heading_rms_rad)} RMS after {outlook.distance_m:.4g} m"
    lines = [Line("DRIFT", f"{said}; 9 of 10 below {end.position_90_m:.3g} m")]
    middle = [row for row in outlook.rows[:-1] if row.after_m >= 1.0][-2:]
    lines += [
        Line(f"at {row.after_m:g} m", f"{size_words(row.position_rms_m, row.heading_rms_rad)} RMS") for row in middle
    ]
    lines.append(Line("model", model_brief(model, origin.partition(":")[0])))
    lines.append(Line("runs", f"{outlook.runs} of seed {seed}, over {outlook.name} of {name}"))
    if per_message(model.noise):
        lines += [Line("rate", sentence, "warning") for sentence in _rate(outlook, model)]
    elif not model.noise.coefficients.silent:
        lines.append(Line("rate", "the noise does not depend on the message rate"))
    lines += [Line("odd", one, "warning") for one in holonomic_words(model, outlook.sideways_m, outlook.distance_m)]
    return Summary(tuple(lines))


def forecast_text(outlook: Forecast, model: MotionModel, origin: str, seed: int) -> str:
    """Return a forecast as text: drive, model, table of drift, dependence on the message rate."""
    rate = "" if outlook.rate_hz is None else f" at {outlook.rate_hz:.3g} Hz"
    runs = f"runs {outlook.first_run} to {outlook.first_run + outlook.runs - 1} of seed {seed}"
    lines = [
        f"{outlook.name}: {outlook.distance_m:.4g} m in {outlook.duration_s:.4g} s{rate}",
        f"{model_words(model, origin)}; {runs}",
        "",
        "    after     position   9 of 10 below       heading" + "   of it constant" * _systematic(model),
    ]
    for i, row in enumerate(outlook.rows):
        after = "the end" if i == len(outlook.rows) - 1 else f"{row.after_m:.0f} m"
        line = f"{after:>9}   {row.position_rms_m:8.3g} m   {row.position_90_m:11.3g} m"
        line += f"   {math.degrees(row.heading_rms_rad):7.3g} deg"
        if _systematic(model):
            line += f"   {size_words(row.position_mean_m, row.heading_mean_rad)}"
        lines.append(line)
    said = _rate(outlook, model) + holonomic_words(model, outlook.sideways_m, outlook.distance_m)
    return "\n".join([*lines, *([""] if said else []), *said])


def _systematic(model: MotionModel) -> bool:
    return any(acts(effect) and effect.kind != "noise" for effect in model.effects)


def _rate(outlook: Forecast, model: MotionModel) -> list[str]:
    if model.noise.coefficients.silent:
        return []
    grown = f"travel would be {outlook.half_rate_position:.3g} and heading {outlook.half_rate_heading:.3g} times"
    if per_message(model.noise):
        return [f"The noise depends on the message rate: at half of it, {grown} as uncertain."]
    said = "The noise does not depend on the message rate."
    if _changes_at_half_rate(outlook):
        said += (
            " This recording does: what jitters from message to message counts as motion; with every second message "
            f"{grown} as uncertain."
        )
    return [said]


def forecast_json(outlook: Forecast, model: MotionModel, seed: int) -> dict[str, Any]:
    """Return a forecast as JSON-compatible values: metres, radians, seconds."""
    return {
        "schema": SCHEMA,
        "odometry_source": outlook.name,
        "distance_m": outlook.distance_m,
        "duration_s": outlook.duration_s,
        "sideways_m": outlook.sideways_m,
        "rate_hz": outlook.rate_hz,
        "seed": seed,
        "first_run": outlook.first_run,
        "runs": outlook.runs,
        "rows": [dataclasses.asdict(row) for row in outlook.rows],
        "depends_on_rate": bool(per_message(model.noise)),
        "half_rate_position_factor": outlook.half_rate_position,
        "half_rate_heading_factor": outlook.half_rate_heading,
        "warnings": holonomic_words(model, outlook.sideways_m, outlook.distance_m),
    }
