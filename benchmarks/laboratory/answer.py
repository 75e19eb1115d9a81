"""Results of a search as plain numbers: the only module that depends on the classes of the study."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.stats import chi2

from laboratory.cases import CLOCKS, same_class
from odomcorrupt.effects.effect import amplitudes, parameters
from odomcorrupt.study.select.confidence import confidence, support_of

if TYPE_CHECKING:
    from odomcorrupt.study.select.result import Learned, Step

__all__ = ["errors_of", "plain_answer"]

KEPT_AS = {"e": "depth"}
"""Parameters of the simulator's causes and their names in the library's effect."""
SURE = float(np.sqrt(chi2.isf(1e-4, 1)))


def plain_answer(learned: Learned) -> dict[str, Any]:
    """Return names in order, their alternatives, confidences, values with errors, noise and unknown dependences."""
    clock_names, values = _clocks(learned)
    position = 0
    for effect in learned.fit.effects:
        own = amplitudes(effect)
        errors = learned.fit.standard_errors[position : position + len(own)]
        position += len(own)
        values[effect.name] = {
            "values": {p.name: getattr(effect, p.name) for p in parameters(effect)},
            "errors": {p.name: float(error) for p, error in zip(own, errors, strict=True)},
        }
    looks = [_step(r, learned) for r in learned.rounds]
    return {
        "clocks": clock_names,
        "added": list(learned.added),
        "looks": looks,
        "noise": [[gain.effect.name, gain.nats] for gain in learned.noise],
        "unknown": [[u.regressor, u.channel, u.nats, u.expression] for u in learned.unknown],
        "laws": [[u.regressor, u.channel] for u in learned.laws],
        "found": values,
        "nodes": len(learned.fit.problem.intervals),
    }


def errors_of(truth: dict[str, Any], cause: str, found: dict[str, Any]) -> dict[str, Any] | None:
    """Return the relative error of a cause's estimate, and for each parameter whether its interval covers the truth.

    Parameters that are a direction or vector are compared as a vector; twins share their parameters.
    """
    name = cause if cause in found else same_class(cause)
    if name not in found:
        return None
    if cause == "eccentric_wheel":
        truth = {KEPT_AS.get(key, key): value for key, value in truth.items()}
    if cause == "magnetic_heading":  # amplitude and direction of the field, in `hard_iron` its two components
        field = truth["amplitude"] * np.exp(1j * truth["direction"])
        truth = {"m": float(field.real), "k": -float(field.imag)}
    values, errors = found[name]["values"], found[name]["errors"]
    if cause == "slope":
        sought = truth["creep"] * np.exp(1j * truth["direction"])
        got = values["creep"] * np.exp(1j * values["direction"])
        return {"relative": float(abs(got - sought) / abs(sought)), "covered": []}
    keys = [key for key in values if key in errors]
    sought = np.array([float(truth.get(key, 0.0)) for key in keys])
    got = np.array([float(values[key]) for key in keys])
    relative = float(np.linalg.norm(got - sought) / np.linalg.norm(sought))
    covered = [bool(abs(g - s) <= 1.96 * errors[key]) for key, g, s in zip(keys, got, sought, strict=True)]
    return {"relative": relative, "covered": covered}


def _step(step: Step, learned: Learned) -> dict[str, Any]:
    row: dict[str, Any] = {
        "added": step.added,
        "alternatives": list(step.alternatives),
        "gains": _gains(step.candidates),
    }
    if step.added is not None:
        support = support_of(step, learned)
        row["evidence"] = asdict(support)
        row["confidence"] = confidence(support)
    return row


def _gains(candidates: Any) -> dict[str, float]:
    return {c.score.effect.name: float(c.gain) for c in candidates if np.isfinite(c.gain)}


def _clocks(learned: Learned) -> tuple[list[str], dict[str, Any]]:
    """Return significant clock errors, largest z-score first, and values with errors; each from its clearest run."""
    found: dict[str, tuple[float, str, float, float]] = {}
    for run, free in enumerate(learned.clocks.free):
        clock, error = learned.fit.problem.clocks[run], learned.fit.clock_errors[run]
        numbers = (("time_offset", "offset", clock.offset_s, 1e-12), ("clock_skew", "rate", clock.rate, 1e-15))
        for number, (name, key, value, least) in enumerate(numbers):
            evidence = abs(value) / max(error[number], least)
            if free[number] and evidence > found.get(name, (-1.0,))[0]:
                found[name] = (evidence, key, value, float(error[number]))
    names = sorted((name for name in CLOCKS if name in found and found[name][0] > SURE), key=lambda n: -found[n][0])
    values = {
        name: {"values": {key: value}, "errors": {key: deviation}} for name, (_, key, value, deviation) in found.items()
    }
    return names, values
