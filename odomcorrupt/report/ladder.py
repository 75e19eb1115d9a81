"""The picture of the error falling: error against distance for each model, with the band it expects."""

from __future__ import annotations

from typing import TYPE_CHECKING

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.axes import Axes

    from odomcorrupt.study.compare import Comparison, Judgement

__all__ = ["COLOURS", "draw_ladder"]

COLOURS = ("#D55E00", "#0072B2", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
"""Okabe & Ito: told apart by everybody."""


def draw_ladder(comparison: Comparison, path: Path) -> None:
    """Draw measured error against distance with each model's expectation, and the 10 s error of each step below."""
    with mpl.rc_context({"font.size": 10, "svg.hashsalt": "odomcorrupt", "axes.spines.top": False,
                         "axes.spines.right": False}):  # fmt: skip
        figure = Figure(figsize=(8.0, 6.4), layout="constrained")
        above, below = figure.subplots(2, 1, height_ratios=(3, 1 + 0.25 * len(comparison.judgements)))
        for judgement, colour in zip(comparison.judgements, COLOURS, strict=False):
            _curve(above, judgement, colour)
        above.set(xscale="log", yscale="log", xlabel="distance driven (m)", ylabel="position error, RMS (m)")
        above.xaxis.set_major_formatter("{x:g}")
        above.yaxis.set_major_formatter("{x:g}")
        above.grid(visible=True, which="major", color="0.9")
        above.set_title("Odometry against truth: measured, and what each model expects", loc="left")
        above.legend(frameon=False, loc="upper left")
        _bars(below, comparison)
        figure.savefig(path, dpi=150, metadata={"Software": None} if path.suffix == ".png" else None)


def _curve(axes: Axes, judgement: Judgement, colour: str) -> None:
    distance = np.array([h.distance_m for h in judgement.curve])
    measured = np.array([h.position_measured for h in judgement.curve])
    expected = np.array([h.position_expected for h in judgement.curve])
    # a mean of N squares scatters by chance: the band is where 90 % of measured errors of a right model lie
    spread = 1.645 / np.sqrt(2.0 * np.array([h.windows for h in judgement.curve]))
    low, high = expected * np.maximum(1.0 - spread, 0.05), expected * (1.0 + spread)
    axes.fill_between(distance, low, high, color=colour, alpha=0.18, linewidth=0, label=f"{judgement.name} expects")
    axes.plot(distance, measured, "o-", color=colour, label=f"{judgement.name}: measured", markersize=4)


def _bars(axes: Axes, comparison: Comparison) -> None:
    steps = [("odometry as it came", comparison.raw_error_m, "0.6")]
    if comparison.clock_error_m != comparison.raw_error_m:
        steps.append(("its clock set right", comparison.clock_error_m, "0.6"))
    steps += [(j.name, j.ten_second_error_m, c) for j, c in zip(comparison.judgements, COLOURS, strict=False)]
    names, errors, colours = zip(*steps, strict=True)
    millimetres = np.array(errors) * 1e3
    bars = axes.barh(np.arange(len(names)), millimetres, color=colours)
    axes.bar_label(bars, labels=[f"{e:.1f} mm" for e in millimetres], padding=4)
    axes.set_yticks(np.arange(len(names)), names)
    axes.invert_yaxis()
    axes.set(xlabel="position error 10 s after starting at the truth, RMS (mm)", xlim=(0.0, 1.15 * millimetres.max()))
