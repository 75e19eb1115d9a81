"""Figure of the model sequence: error against distance for each model, with its expected error."""

from __future__ import annotations

from math import isfinite
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.stats import chi2

from odomcorrupt.report.plots.figure import COLOURS, MARKERS, drawing, new_figure, plain_logarithm, short_name
from odomcorrupt.report.text.comparison import sequence_steps

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from odomcorrupt.study.validate.compare import Comparison, Judgement

__all__ = ["draw_errors", "rms_interval"]


def draw_errors(comparison: Comparison) -> Figure:
    """Draw measured errors against distance with each model's expectation, and the 10 s error of each step below.

    Vertical bars are 90 % intervals of the measured values; grey figures on top count the last model's windows.
    """
    with drawing():
        figure = new_figure(9.0, 5.9 + 0.28 * len(comparison.judgements))
        parts: Any = figure.subfigures(2, 1, height_ratios=(3.9, 1.1 + 0.28 * len(comparison.judgements)))
        above, below = parts
        headed = all(piece.headed for judgement in comparison.judgements for piece in judgement.pieces)
        wanted = (("position", "m"), ("yaw", "deg"))[: 2 if headed else 1]
        panels = above.subplots(1, len(wanted), squeeze=False)[0]
        for axes, (what, unit) in zip(panels, wanted, strict=True):
            count = len(comparison.judgements)
            for i, judgement in enumerate(comparison.judgements):
                style = {"color": COLOURS[i % len(COLOURS)], "marker": MARKERS[i % len(MARKERS)]}
                _curve(axes, judgement, what, style, 1.025 ** (2 * i - count + 1))
            axes.set(xscale="log", yscale="log", xlabel="path driven (m)", title=f"{what} error, RMS ({unit})")
            axes.set_ylim(top=1.35 * axes.get_ylim()[1])
            _counts(axes, comparison.judgements[-1])
            for axis in (axes.xaxis, axes.yaxis):
                plain_logarithm(axis)
            axes.grid(visible=True, which="major", color="0.9")
        # one legend entry per kind of line, not per model
        panels[0].plot([], [], color="0.4", marker="|", markersize=9, linewidth=1.3, label="measured, 90 % interval")
        panels[0].plot([], [], color="0.4", linewidth=1.3, linestyle=(0, (4, 3)), label="expected by the model")
        above.legend(*panels[0].get_legend_handles_labels(), loc="outside upper left", ncols=3, fontsize=9)
        _bars(below.subplots(), comparison)
    return figure


def rms_interval(measured: float, windows: int) -> tuple[float, float]:
    """Return the central 90 % interval of a root mean square measured over this many independent windows."""
    tail, square = (1.0 - 0.9) / 2.0, windows * measured**2
    return float(np.sqrt(square / chi2.isf(tail, windows))), float(np.sqrt(square / chi2.ppf(tail, windows)))


def _curve(axes: Axes, judgement: Judgement, what: str, style: dict[str, str], shift: float) -> None:
    """Draw measured errors with their 90 % interval, and the model's expectation as a dashed line."""
    distance = np.array([h.distance_m for h in judgement.curve])
    windows = [h.windows for h in judgement.curve]
    if what == "yaw":
        measured, expected = np.degrees([[h.measured[2], h.expected[2]] for h in judgement.curve]).reshape(-1, 2).T
    else:
        pairs = [[h.position_measured, h.position_expected] for h in judgement.curve]
        measured, expected = np.array(pairs).reshape(-1, 2).T
    ends = np.array([rms_interval(m, n) for m, n in zip(measured, windows, strict=True)]).reshape(-1, 2)
    axes.vlines(distance * shift, *ends.T, color=style["color"], linewidth=1.1, alpha=0.8)
    axes.plot(distance * shift, measured, linewidth=1.3, markersize=4.5, label=short_name(judgement.name), **style)  # type: ignore[arg-type]
    axes.plot(distance, expected, linewidth=1.3, linestyle=(0, (4, 3)), color=style["color"])


def _counts(axes: Axes, judgement: Judgement) -> None:
    """Write the number of windows above the points, for as many path lengths as fit."""
    last = 0.0
    for h in judgement.curve:
        if h.distance_m >= 1.7 * last:
            axes.annotate(
                str(h.windows), (h.distance_m, 1.0), xycoords=("data", "axes fraction"), ha="center", va="top",
                fontsize=7.5, color="0.4",
            )  # fmt: skip
            last = h.distance_m


def _bars(axes: Axes, comparison: Comparison) -> None:
    # a recording of less than 10 s has no window
    steps = [step for step in sequence_steps(comparison) if isfinite(step[1])]
    if not steps:
        axes.set_axis_off()
        return
    names, millimetres = [short_name(name) for name, _, _ in steps], np.array([error for _, error, _ in steps]) * 1e3
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
