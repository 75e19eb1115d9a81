"""Figures of paths in the plane: clean and corrupted, against the truth, of many runs, of models; and their errors."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.errors import EffectError
from odomcorrupt.geometry.trajectory import distance_along
from odomcorrupt.report.plots.figure import ORANGE, RUNS, TRUTH, drawn, model_panels, short_name, style_of
from odomcorrupt.study.validate.predictive_check import Replay, replay

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from odomcorrupt.forecasting import Forecast
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.scoring.errors import PathErrors
    from odomcorrupt.study.validate.compare import Comparison

_MARKS = 20
_SHOWN_M = 100.0
"""Longest path drawn, metres: more would hide lines. Places in the sentences refer to the whole path."""


def draw_paths(comparison: Comparison) -> Figure:
    """Draw truth, odometry and runs of each model over the longest segment of its evaluation, one panel each."""
    with model_panels(comparison.evaluations, 4.6, 6.5, 0.7) as (figure, panels):
        # adjacent panels, below the legend
        figure.set_layout_engine("compressed", rect=(0.0, 0.0, 1.0, 1.0 - 0.35 / figure.get_figheight()))
        for axes, evaluation in panels:
            number = [one is evaluation for one in comparison.evaluations].index(True)
            try:
                longest = max(evaluation.pieces, key=lambda piece: float(piece.interval_metres.sum()))
                _panel(axes, replay(longest, runs=100), short_name(evaluation.name), number)
            except EffectError:  # a law that absorbs all motion can be removed from odometry, but not applied
                none = "no odometry of this drive satisfies it: no runs to show"
                axes.set_title(f"{short_name(evaluation.name)}\n{none}", fontsize=10)
        figure.legend(*panels[0][0].get_legend_handles_labels(), loc="upper left", ncols=4)
    return figure


def _panel(axes: Axes, paths: Replay, name: str, number: int) -> None:
    end, colour = int(np.searchsorted(paths.distance_m, _SHOWN_M)), style_of(number)["color"]
    truth, measured, runs = paths.truth_xyt[:end], paths.measured_xyt[:end], paths.runs_xyt[:, :end]
    for i, run in enumerate(runs):
        axes.plot(
            run[:, 0], run[:, 1], color=colour, linewidth=0.6, alpha=0.25, rasterized=True, zorder=1,
            label=f"{len(runs)} runs of the model" if i == 0 else None,
        )  # fmt: skip
    axes.plot(*runs[:, -1, :2].T, ".", color=colour, markersize=4, alpha=0.7, zorder=2, label="their ends")
    axes.plot(*truth[:, :2].T, color=TRUTH, linewidth=1.2, zorder=3, label="truth")
    axes.plot(*measured[:, :2].T, "--", color="0.4", linewidth=1.6, zorder=4, label="measured odometry")
    axes.plot(*truth[0, :2], "s", color=TRUTH, markersize=7, zorder=5)
    axes.plot(*truth[-1, :2], "o", color=TRUTH, markersize=7, zorder=5)
    axes.plot(*measured[-1, :2], "o", color="0.4", markeredgecolor="white", markersize=8, zorder=6)
    marks = np.searchsorted(paths.distance_m, np.linspace(0.0, paths.distance_m[-1], _MARKS + 1)[1:])
    inside = int(paths.inside(np.minimum(marks, len(paths.distance_m) - 1)).sum())
    shown = f" (first {_SHOWN_M:g} m)" if end < len(paths.distance_m) else ""
    axes.set_title(f"{name}{shown}\nmeasured in its 90 % region at {inside} of {_MARKS} places", fontsize=10)
    axes.set(xlabel="x (m)", ylabel="y (m)")
    axes.set_aspect("equal", adjustable="box")


def draw_corruption(
    before_xyt: Array, after_xyt: Array, title: str, names: tuple[str, str] = ("clean", "noisy")
) -> Figure:
    """Draw a path before and after a change, and the difference in position and heading against distance.

    before_xyt, after_xyt : (n, 3) metres and radians, the same messages in the same order
    title : title of the figure
    names : names of the two paths
    """
    count = min(len(before_xyt), len(after_xyt))
    before, after = before_xyt[:count], after_xyt[:count]
    driven_m = distance_along(before)
    error = after - before
    with drawn(9.0, 4.6) as figure:
        plane, growth = figure.subplots(1, 2, width_ratios=(3, 2))
        plane.plot(after[:, 0], after[:, 1], color=RUNS, linewidth=1.2, label=names[1])
        plane.plot(before[:, 0], before[:, 1], color=TRUTH, linewidth=1.4, label=names[0])
        plane.set(xlabel="x in odom, m", ylabel="y in odom, m")
        plane.set_aspect("equal", adjustable="datalim")
        plane.legend(loc="best")
        growth.plot(driven_m, np.hypot(error[:, 0], error[:, 1]), color=RUNS, label="position, m")
        growth.set(xlabel="distance driven, m", ylabel="position, m", xlim=(0.0, None), ylim=(0.0, None))
        heading = growth.twinx()
        heading.grid(visible=False)
        heading.spines["right"].set_visible(True)
        heading.plot(driven_m, np.degrees(error[:, 2]), color=ORANGE, linestyle="--", label="heading, deg")
        heading.set_ylabel("heading, deg")
        lines = [*growth.get_lines(), *heading.get_lines()]
        growth.legend(lines, [str(line.get_label()) for line in lines], loc="upper left")
        figure.suptitle(title, x=0.01, ha="left")
    return figure


def draw_errors(error: PathErrors, true_name: str, name: str, title: str) -> Figure:
    """Draw a path and its heading with the truth, and the error of each below."""
    t = error.t_s
    with drawn(10.0, 6.6) as figure:
        (path, heading), (position, turn) = figure.subplots(2, 2, height_ratios=(2.2, 1))
        for xyt, colour, style, label in (
            (error.truth_xyt, TRUTH, "-", true_name),
            (error.estimate_xyt, RUNS, (0, (4, 3)), name),
        ):
            path.plot(xyt[:, 0], xyt[:, 1], color=colour, linestyle=style, label=label, linewidth=1.8)
            heading.plot(t, np.degrees(xyt[:, 2]), color=colour, linestyle=style, linewidth=1.8)
        path.plot(*error.truth_xyt[0, :2], "s", color=TRUTH, markersize=6, label="start")
        path.set(xlabel="x (m)", ylabel="y (m)")
        path.set_aspect("equal", adjustable="datalim")
        path.legend(loc="best")
        heading.set(ylabel="heading (deg)", xlabel="time (s)")
        worst = float(error.position_m.max())
        position.plot(t, 1e3 * error.position_m, color=TRUTH, linewidth=1.2)
        position.set(ylabel="position error (mm)", xlabel="time (s)", title=f"at most {worst:.4f} m", ylim=(0.0, None))
        worst = float(np.abs(error.heading_rad).max())
        turn.plot(t, 1e3 * error.heading_rad, color=TRUTH, linewidth=0.8)
        turn.set(ylabel="heading error (mrad)", xlabel="time (s)", title=f"at most {worst:.4f} rad")
        figure.suptitle(title, x=0.01, ha="left")
    return figure


def draw_runs(runs_xyt: Array, true_xyt: Array, true_name: str, title: str) -> Figure:
    """Draw noisy paths (runs, n, 3) and the true one (m, 3) over them."""
    with drawn(8.0, 6.4) as figure:
        axes = figure.subplots()
        # more than a thousand points per run are not visible
        every = max(runs_xyt.shape[1] // 1000, 1)
        for i, run in enumerate(runs_xyt):
            label = f"{len(runs_xyt)} noisy runs" if i == 0 else None
            axes.plot(run[::every, 0], run[::every, 1], color=RUNS, linewidth=0.6, alpha=0.5, label=label)
        ends = runs_xyt[:, -1]
        axes.plot(ends[:, 0], ends[:, 1], ".", color=RUNS, markersize=5, label="their ends")
        axes.plot(true_xyt[:, 0], true_xyt[:, 1], color=TRUTH, linewidth=2.2, label=true_name)
        axes.plot(*true_xyt[0, :2], "s", color=TRUTH, markersize=7, label="start")
        axes.plot(*true_xyt[-1, :2], "o", color="white", markeredgecolor=TRUTH, markersize=7, label="true end")
        axes.set(xlabel="x (m)", ylabel="y (m)", title=title)
        axes.set_aspect("equal", adjustable="datalim")
        axes.legend(loc="best")
    return figure


def draw_fan(outlook: Forecast, title: str) -> Figure:
    """Draw noisy paths over the clean one, and the drift of position and heading against distance."""
    with drawn(9.0, 4.6) as figure:
        places = figure.add_gridspec(2, 2, width_ratios=(3, 2))
        plane = figure.add_subplot(places[:, 0])
        position, heading = figure.add_subplot(places[0, 1]), figure.add_subplot(places[1, 1])
        for path in outlook.noisy_xy:
            plane.plot(path[:, 0], path[:, 1], color=RUNS, alpha=0.15, linewidth=0.8)
            plane.plot(path[-1, 0], path[-1, 1], ".", color=RUNS, alpha=0.6, markersize=4)
        plane.plot([], [], color=RUNS, label=f"{outlook.runs} runs, ends as dots")
        plane.plot(outlook.clean_xy[:, 0], outlook.clean_xy[:, 1], color=TRUTH, linewidth=1.4, label="clean")
        plane.set(xlabel="x in odom (m)", ylabel="y in odom (m)", title="Paths by the corrupted odometry")
        plane.set_aspect("equal", adjustable="datalim")
        plane.legend(loc="best")
        distance = [row.after_m for row in outlook.rows]
        position.plot(distance, [row.position_rms_m for row in outlook.rows], "o-", color=RUNS)
        position.set(title="How the drift grows (root mean square)", ylabel="position (m)")
        heading.plot(distance, [math.degrees(row.heading_rms_rad) for row in outlook.rows], "o-", color=RUNS)
        heading.set(xlabel="distance driven (m)", ylabel="heading (deg)")
        for axes in (position, heading):
            axes.set(xlim=(0.0, None), ylim=(0.0, None))
        figure.suptitle(title, x=0.01, ha="left")
    return figure
