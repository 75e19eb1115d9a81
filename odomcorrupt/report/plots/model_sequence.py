"""The picture of the error falling: error against distance for each model, with the band it expects."""

from __future__ import annotations

from math import isfinite
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from odomcorrupt.report.plots.figure import BLUE, GREEN, ORANGE, RED, SKY, drawing, new_figure, rendered
from odomcorrupt.report.text.comparison import ladder_steps

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.validate.compare import Comparison, Judgement

__all__ = ["COLOURS", "MARKERS", "draw_errors", "draw_ladder"]

COLOURS = (RED, BLUE, GREEN, ORANGE, "#CC79A7", SKY)
MARKERS = ("o", "s", "^", "D", "v", "P")
"""A shape for each model besides its colour: a grey print tells them apart, too."""


def draw_ladder(comparison: Comparison, path: Path) -> None:
    """Write the picture of errors against distance."""
    path.write_bytes(rendered(draw_errors(comparison), path.suffix.lstrip(".") or "png"))


def draw_errors(comparison: Comparison) -> Figure:
    """Draw measured errors against distance with each model's expectation, and the 10 s error of each step below."""
    with drawing():
        figure = new_figure(9.0, 5.6 + 0.28 * len(comparison.judgements))
        parts: Any = figure.subfigures(2, 1, height_ratios=(3.6, 1.1 + 0.28 * len(comparison.judgements)))
        above, below = parts
        headed = all(piece.headed for judgement in comparison.judgements for piece in judgement.pieces)
        wanted = (("position", "m", _position), ("yaw", "deg", _yaw))[: 2 if headed else 1]
        panels = above.subplots(1, len(wanted), squeeze=False)[0]
        for axes, (what, unit, pick) in zip(panels, wanted, strict=True):
            for judgement, colour, marker in zip(comparison.judgements, COLOURS, MARKERS, strict=False):
                _curve(axes, judgement, pick(judgement), {"color": colour, "marker": marker})
            axes.set(xscale="log", yscale="log", xlabel="path driven (m)", title=f"{what} error, RMS ({unit})")
            for axis in (axes.xaxis, axes.yaxis):
                axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
                axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
                axis.set_minor_formatter(NullFormatter())
            axes.grid(visible=True, which="major", color="0.9")
            axes.set_axisbelow(True)
        above.legend(*panels[0].get_legend_handles_labels(), loc="outside upper left", ncols=2, fontsize=9)
        _bars(below.subplots(), comparison)
    return figure


def _position(judgement: Judgement) -> Array:
    return np.array([[h.position_measured, h.position_expected] for h in judgement.curve]).reshape(-1, 2)


def _yaw(judgement: Judgement) -> Array:
    both = np.array([[h.measured[2], h.expected[2]] for h in judgement.curve]).reshape(-1, 2)
    degrees: Array = np.degrees(both)
    return degrees


def _curve(axes: Axes, judgement: Judgement, both: Array, style: dict[str, str]) -> None:
    distance = np.array([h.distance_m for h in judgement.curve])
    measured, expected = both[:, 0], both[:, 1]
    # a mean of N squares scatters by chance: the band is where 90 % of measured errors of a right model lie
    spread = 1.645 / np.sqrt(2.0 * np.array([h.windows for h in judgement.curve]))
    low, high = expected * np.maximum(1.0 - spread, 0.05), expected * (1.0 + spread)
    axes.fill_between(
        distance, low, high, color=style["color"], alpha=0.2, linewidth=0, label=f"{judgement.name} expects (90 % band)"
    )
    axes.plot(distance, measured, linewidth=1.4, markersize=4.5, label=f"{judgement.name}: measured", **style)  # type: ignore[arg-type]


def _bars(axes: Axes, comparison: Comparison) -> None:
    # too short a recording has no window of 10 s
    steps = [step for step in ladder_steps(comparison) if isfinite(step[1])]
    if not steps:
        axes.set_axis_off()
        return
    names, millimetres = [name for name, _, _ in steps], np.array([error for _, error, _ in steps]) * 1e3
    own = {judgement.name: colour for judgement, colour in zip(comparison.judgements, COLOURS * 9, strict=False)}
    colours = ["0.65" if judgement is None else own[judgement.name] for _, _, judgement in steps]
    bars = axes.barh(np.arange(len(names)), millimetres, color=colours, height=0.7)
    axes.bar_label(bars, labels=[f"{e:.1f} mm" for e in millimetres], padding=4, fontsize=9)
    axes.set_yticks(np.arange(len(names)), names)
    axes.invert_yaxis()
    axes.set(
        title="position error 10 s after starting at the truth, RMS (mm)",
        xlim=(0.0, 1.15 * max(float(millimetres.max()), 1e-9)),
    )
