"""Map of lack of fit: the truth's path coloured by error, with the reported places, times and segments."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.patches import Circle

from odomcorrupt.report.plots.figure import BLACK, RED, drawing, model_panels, short_name
from odomcorrupt.report.text.lack_of_fit import MOST
from odomcorrupt.study.estimate.windows import distance_windows, window_errors

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.validate.compare import Comparison, Judgement
    from odomcorrupt.study.validate.evaluation import Evaluation
    from odomcorrupt.study.validate.lack_of_fit import Failure

__all__ = ["draw_failure_map"]

_PHASES = 5
_LENGTHS_M = (0.5, 1.0, 2.0, 5.0, 10.0)
_FEWEST = 12
_DARKEST_RATIO = 4.0
"""Ratio of measured to expected squared error with the darkest colour."""


def draw_failure_map(comparison: Comparison) -> Figure:
    """Draw a panel for each model."""
    length_m = _length(comparison)
    with drawing():
        figure, panels = model_panels(comparison.judgements, 4.4, 6.0, 0.9)
        lines = [_panel(axes, judgement, length_m) for axes, judgement in panels]
        bar = figure.colorbar(
            lines[-1], ax=[axes for axes, _ in panels], location="bottom", shrink=0.6, aspect=40, extend="max",
            label=f"squared error over {length_m:g} m of path, divided by the expected (1: right)",
        )  # fmt: skip
        bar.ax.axvline(1.0, color=BLACK, linewidth=1.2)
    return figure


def _length(comparison: Comparison) -> float:
    """Return a path length (m) that is short relative to the drive, and long enough for errors to accumulate."""
    metres = max(float(piece.node_metres.sum()) for piece in comparison.judgements[0].pieces)
    return max((length for length in _LENGTHS_M if length <= metres / _FEWEST), default=_LENGTHS_M[0])


def _panel(axes: Axes, judgement: Judgement, length_m: float) -> LineCollection:
    piece = max(judgement.pieces, key=lambda p: float(p.node_metres.sum()))
    xy = piece.problem.nodes.truth_xyt[:, :2]
    segments = np.stack((xy[:-1], xy[1:]), axis=1)
    ratio = _local_ratio(piece, length_m)
    linked = piece.problem.nodes.linked[1:]
    # largest errors on top, where a path crosses itself
    order = np.argsort(ratio[:-1][linked])
    lines = LineCollection(
        list(segments[linked][order]), cmap="cividis_r", linewidths=2.6, capstyle="round", rasterized=True
    )
    lines.set_array(ratio[:-1][linked][order])
    lines.set_clim(0.0, _DARKEST_RATIO)
    axes.add_collection(lines)
    axes.plot(*xy[0], "s", color=BLACK, markersize=7, zorder=4)
    several = len(judgement.pieces) > 1
    for number, failure in enumerate(judgement.failures[:MOST], start=1):
        if not several or failure.recording == piece.recording.name:
            _mark(axes, piece, failure, number)
    axes.autoscale_view()
    axes.set_aspect("equal", adjustable="box")
    axes.set(xlabel="x (m)", ylabel="y (m)", title=short_name(judgement.name))
    axes.grid(visible=True, color="0.93")
    return lines


def _mark(axes: Axes, piece: Evaluation, failure: Failure, number: int) -> None:
    """Write the number of a lack of fit at its place; motions and drifts have none."""
    nodes = piece.problem.nodes
    if failure.kind == "place" and failure.place is not None:
        x, y, radius = failure.place
        axes.add_patch(
            Circle((x, y), radius, fill=False, edgecolor=RED, linewidth=1.6, linestyle=(0, (4, 2)), zorder=5)
        )
    elif failure.kind == "time" and failure.span_s is not None:
        during = (nodes.end_s > failure.span_s[0]) & (nodes.start_s < failure.span_s[1])
        part = nodes.truth_xyt[during]
        axes.plot(part[:, 0], part[:, 1], color=RED, linewidth=0.9, linestyle=(0, (2, 2)), zorder=5)
        x, y = map(float, part[len(part) // 2, :2])
    elif failure.kind == "moment" and failure.place is not None:
        x, y, _ = failure.place
        axes.plot(x, y, "X", color=RED, markeredgecolor="white", markersize=9, zorder=6)
    else:
        return
    axes.annotate(
        str(number), (x, y), xytext=(6, 6), textcoords="offset points", fontsize=10, fontweight="bold", color=RED,
        zorder=7,
        bbox={"boxstyle": "round,pad=0.15", "facecolor": "white", "edgecolor": "none", "alpha": 0.8},
    )  # fmt: skip


def _local_ratio(piece: Evaluation, length_m: float) -> Array:
    """Return, for each interval (K,), the mean NEES per degree of freedom of windows that cover it."""
    nodes = piece.problem.nodes
    middle = (nodes.start_s + nodes.end_s) / 2.0
    total, count = np.zeros(len(nodes)), np.zeros(len(nodes))
    for phase in np.arange(_PHASES) / _PHASES:
        windows = distance_windows(piece.left, length_m, phase)
        if not len(windows):
            continue
        errors = window_errors(windows, piece.model.noise, piece.truth, piece.problem.steps, headed=piece.headed)
        nees = errors.nees / errors.error.shape[1]
        at = np.searchsorted(windows.end_s, middle)
        covered = (at < len(nees)) & (middle >= windows.start_s[0])
        total[covered] += nees[at[covered]]
        count[covered] += 1.0
    ratio: Array = np.divide(total, count, out=np.ones(len(nodes)), where=count > 0.0)
    return ratio
