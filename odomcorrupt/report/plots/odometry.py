"""Pictures of integrated odometry: path and heading with their errors, and noisy runs around the truth."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.report.plots.figure import BLACK, BLUE, RED, drawing, new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.trajectories.trajectory_error import PathError

__all__ = ["draw_errors", "draw_runs"]


def draw_errors(error: PathError, name: str, title: str) -> Figure:
    """Draw a path and its heading over the truth, each with its error below."""
    t = error.t_s
    with drawing():
        figure = new_figure(10.0, 6.6)
        (path, heading), (position, turn) = figure.subplots(2, 2, height_ratios=(2.2, 1))
        for xyt, colour, style, label in (
            (error.truth_xyt, BLUE, "-", "truth"),
            (error.path_xyt, RED, (0, (4, 3)), name),
        ):
            path.plot(xyt[:, 0], xyt[:, 1], color=colour, linestyle=style, label=label, linewidth=1.8)
            heading.plot(t, np.degrees(xyt[:, 2]), color=colour, linestyle=style, linewidth=1.8)
        path.plot(*error.truth_xyt[0, :2], "s", color=BLACK, markersize=6, label="start")
        _plane(path)
        path.legend(loc="best")
        heading.set(ylabel="heading (deg)", xlabel="time (s)")
        worst = float(error.position_m.max())
        position.plot(t, 1e3 * error.position_m, color=BLACK, linewidth=1.2)
        position.set(ylabel="position error (mm)", xlabel="time (s)", title=f"at most {worst:.4f} m", ylim=(0.0, None))
        worst = float(np.abs(error.heading_rad).max())
        turn.plot(t, 1e3 * error.heading_rad, color=BLACK, linewidth=0.8)
        turn.set(ylabel="heading error (mrad)", xlabel="time (s)", title=f"at most {worst:.4f} rad")
        for axes in (heading, position, turn):
            axes.grid(visible=True, color="0.92")
        figure.suptitle(title, x=0.01, ha="left", fontsize=11)
    return figure


def draw_runs(runs_xyt: Array, true_xyt: Array, true_name: str, title: str) -> Figure:
    """Draw noisy paths (runs, n, 3) in red and the true one (m, 3) in blue over them."""
    with drawing():
        figure = new_figure(8.0, 6.4)
        axes = figure.subplots()
        # a thousand points a run are more than a picture shows
        every = max(runs_xyt.shape[1] // 1000, 1)
        for i, run in enumerate(runs_xyt):
            label = f"{len(runs_xyt)} noisy runs" if i == 0 else None
            axes.plot(run[::every, 0], run[::every, 1], color=RED, linewidth=0.6, alpha=0.5, label=label)
        ends = runs_xyt[:, -1]
        axes.plot(ends[:, 0], ends[:, 1], ".", color=RED, markersize=5, label="their ends")
        axes.plot(true_xyt[:, 0], true_xyt[:, 1], color=BLUE, linewidth=2.2, label=true_name)
        axes.plot(*true_xyt[0, :2], "s", color=BLACK, markersize=7, label="start")
        axes.plot(*true_xyt[-1, :2], "o", color="white", markeredgecolor=BLACK, markersize=7, label="true end")
        _plane(axes)
        legend = axes.legend(loc="best")
        for handle in legend.legend_handles:
            if handle is not None:
                handle.set_alpha(1.0)
        axes.set_title(title)
    return figure


def _plane(axes: Axes) -> None:
    axes.set(xlabel="x (m)", ylabel="y (m)")
    axes.set_aspect("equal", adjustable="datalim")
    axes.grid(visible=True, color="0.92")
    axes.set_axisbelow(True)
