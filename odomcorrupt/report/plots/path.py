"""The picture of the path: the truth, the model's cloud of runs around it, and the measured odometry."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.errors import EffectError
from odomcorrupt.report.plots.figure import (
    BLACK,
    BLUE,
    RED,
    SKY,
    drawing,
    new_figure,
    remove_unused,
    short_name,
    shown_models,
)
from odomcorrupt.study.validate.predictive_check import replay

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from odomcorrupt.study.validate.compare import Comparison, Judgement
    from odomcorrupt.study.validate.predictive_check import Replay

__all__ = ["draw_paths", "paths_of"]

RUNS = 100
_MARKS = 20
_SHOWN_M = 100.0
"""Path drawn at most, metres: beyond it lines hide lines. What is said of places holds for all of it."""


def paths_of(judgement: Judgement) -> Replay:
    """Return the longest stretch that a model was judged on, with 100 runs of the model."""
    longest = max(judgement.pieces, key=lambda piece: float(piece.node_metres.sum()))
    return replay(longest, runs=RUNS)


def draw_paths(comparison: Comparison) -> Figure:
    """Draw a panel for each model."""
    shown = shown_models(comparison.judgements)
    columns = min(len(shown), 2)
    rows = -(-len(shown) // columns)
    with drawing():
        figure = new_figure(9.0, 0.7 + (4.6 if columns == 2 else 6.5) * rows)
        # panels side by side without a gap, below the legend
        figure.set_layout_engine("compressed", rect=(0.0, 0.0, 1.0, 1.0 - 0.35 / figure.get_figheight()))
        panels = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
        remove_unused(panels, len(shown))
        for axes, judgement in zip(panels.flat, shown, strict=False):
            try:
                _panel(axes, paths_of(judgement), short_name(judgement.name))
            except EffectError:  # a law that swallows motion can be taken out of odometry, and not put in
                axes.set_title(
                    f"{short_name(judgement.name)}\nno odometry of this drive obeys it: no runs to show", fontsize=10
                )
        handles, labels = panels.flat[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="upper left", ncols=4, fontsize=9)
    return figure


def _panel(axes: Axes, paths: Replay, name: str) -> None:
    end = int(np.searchsorted(paths.distance_m, _SHOWN_M))
    truth, measured, runs = paths.truth_xyt[:end], paths.measured_xyt[:end], paths.runs_xyt[:, :end]
    for i, run in enumerate(runs):
        axes.plot(
            run[:, 0], run[:, 1], color=SKY, linewidth=0.6, alpha=0.35, rasterized=True, zorder=1,
            label=f"{len(runs)} runs of the model" if i == 0 else None,
        )  # fmt: skip
    axes.plot(*runs[:, -1, :2].T, ".", color=BLUE, markersize=4, alpha=0.7, zorder=2, label="their ends")
    axes.plot(*truth[:, :2].T, color=BLACK, linewidth=1.2, zorder=3, label="truth")
    axes.plot(*measured[:, :2].T, color=RED, linewidth=1.4, zorder=4, label="measured odometry")
    axes.plot(*truth[0, :2], "s", color=BLACK, markersize=7, zorder=5)
    axes.plot(*truth[-1, :2], "o", color=BLACK, markersize=7, zorder=5)
    axes.plot(*measured[-1, :2], "o", color=RED, markeredgecolor="white", markersize=8, zorder=6)
    marks = np.searchsorted(paths.distance_m, np.linspace(0.0, paths.distance_m[-1], _MARKS + 1)[1:])
    inside = int(paths.inside(np.minimum(marks, len(paths.distance_m) - 1)).sum())
    shown = f" (first {_SHOWN_M:g} m)" if end < len(paths.distance_m) else ""
    axes.set_title(f"{name}{shown}\nmeasured in its 90 % region at {inside} of {_MARKS} places", fontsize=10)
    axes.set(xlabel="x (m)", ylabel="y (m)")
    axes.set_aspect("equal", adjustable="box")
    axes.grid(visible=True, color="0.93")
    axes.set_axisbelow(True)
