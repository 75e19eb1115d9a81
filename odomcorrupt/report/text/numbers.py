"""Numbers of findings in words: values with errors in common units, confidences, clocks and fitted dependences."""

from __future__ import annotations

from math import degrees
from typing import TYPE_CHECKING

from odomcorrupt.effects.effect import Effect, amplitudes, choices, parameters
from odomcorrupt.effects.ground import RegionSlip
from odomcorrupt.report.findings import ClockFound, clocks_found

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.study.estimate.clocks import Clocks

_COMMON = {"m": (1e3, "mm"), "s": (1e3, "ms"), "": (1e2, "%")}


def plainly(value: float) -> str:
    """Return a number to two digits, without an exponent: "170"."""
    return f"{float(f'{value:.2g}'):g}"


def value_text(value: float, error: float | None, unit: str) -> str:
    """Return a value with its error in common units."""
    scale, shown = _COMMON.get(unit, (1.0, unit))
    if unit.startswith("rad"):
        scale, shown = degrees(1.0), "deg" + unit[3:]
    elif unit == "s" and abs(value) >= 1.0:
        scale, shown = 1.0, unit
    return f"{value * scale:.4g}{'' if error is None else f' +- {error * scale:.2g}'} {shown}"


def numbers_text(effect: Effect, errors: Sequence[float]) -> list[str]:
    """Return an effect's numbers in words: amplitudes with their errors, then its shape, positions in metres."""
    own = amplitudes(effect)
    shown = zip(own, errors, strict=True)
    sizes = [f"{p.name} {value_text(getattr(effect, p.name), error, p.unit)}" for p, error in shown]
    shapes = [p for p in parameters(effect) if not p.amplitude]
    extent = _extent(effect)
    shapes = [p for p in shapes if not (extent and p.name in ("radius", "width"))]
    return [*sizes, *(f"{p.name} {_shape_text(getattr(effect, p.name), p.unit)}" for p in shapes), *extent]


def _extent(effect: Effect) -> list[str]:
    """Return the full size of a region in words; its parameters are half sizes."""
    if not isinstance(effect, RegionSlip):
        return []
    if not effect.width:
        return [f"diameter {2.0 * effect.radius:.2g} m"]
    return [f"{2.0 * effect.radius:.1f} m x {2.0 * effect.width:.1f} m"]


def noise_text(effect: Effect) -> list[str]:
    """Return a random effect's numbers and the wheel it acts on, in words; a time constant of zero is left out."""
    shown = [p for p in parameters(effect) if p.amplitude or getattr(effect, p.name)]
    wheel = getattr(effect, "wheel", "both")
    # a difference between the gains of the wheels is a turn for each metre of travel
    gain = "rad/m" if getattr(effect, "channel", "") == "wheels" else ""
    return [
        *([f"wheel {wheel}"] if wheel != "both" else []),
        *(f"{p.name} {value_text(getattr(effect, p.name), None, p.unit or gain)}" for p in shown),
    ]


def _shape_text(value: float, unit: str) -> str:
    """Return a shape parameter in words; positions are given to the millimetre, however large their coordinates."""
    return f"{round(value, 3):.10g} m" if unit == "m" else value_text(value, None, unit)


def clock_lines(names: Sequence[str], clocks: Clocks) -> list[str]:
    """Return a line for every recording with a clock error, with its confidence."""
    parts: dict[int, list[str]] = {}
    for one in clocks_found(clocks):
        said = f"{one.name.rpartition('_')[2]} {clock_text(one)} ({confidence_words(one.confidence)})"
        parts.setdefault(one.recording, []).append(said)
    return [f"{names[i]}: the odometry's clock is off: {', '.join(parts[i])}" for i in sorted(parts)]


def clock_text(one: ClockFound) -> str:
    """Return the value and standard error of a clock error: ms of an offset, ppm of a skew."""
    if one.name == "time_offset":
        return value_text(one.value, one.error, "s")
    return f"{one.value * 1e6:.0f} +- {one.error * 1e6:.2g} ppm"


def words_text(effect: Effect) -> str:
    """Return an effect's word-valued parameters that differ from the default, as " (heading gyro)", or ""."""
    said = [
        f"{word} {getattr(effect, word)}"
        for word, (usual, *_) in choices(effect).items()
        if getattr(effect, word) != usual
    ]
    return f" ({', '.join(said)})" if said else ""


def confidence_words(probability: float) -> str:
    """Return "confidence 0.99", rounded down, as 0.999 is not certain; or "confidence below 0.01"."""
    return "confidence below 0.01" if probability < 0.01 else f"confidence {int(100.0 * probability) / 100.0:.2f}"
