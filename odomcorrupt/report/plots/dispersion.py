"""The picture of a batch: where its runs went, and how their errors grow within the predicted band."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.report.plots.figure import BLUE, RED, drawing, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from odomcorrupt.batching.dispersion import SpreadReport

__all__ = ["draw_spread"]


def draw_spread(report: SpreadReport) -> Figure:
    """Draw the true path and the runs, and errors of position and heading over the distance."""
    with drawing():
        figure = new_figure(10.0, 5.2)
        grid = figure.add_gridspec(2, 2, width_ratios=(3, 2))
        plane = figure.add_subplot(grid[:, 0])
        for path in report.runs_xy:
            plane.plot(path[:, 0], path[:, 1], color=RED, alpha=0.2, linewidth=0.8)
        plane.plot([], [], color=RED, label=f"{len(report.runs_xy)} of {report.runs} runs")
        plane.plot(report.clean_xy[:, 0], report.clean_xy[:, 1], color=BLUE, linewidth=2.0, label="true path")
        plane.set(xlabel="x in odom, m", ylabel="y in odom, m", title="Where odometry says the robot went")
        plane.set_aspect("equal", adjustable="datalim")
        plane.legend(loc="best", fontsize=9)
        for row, (column, factor, label) in enumerate(
            ((1, 1.0, "position error, m"), (2, 180.0 / np.pi, "heading, deg"))
        ):
            growth = figure.add_subplot(grid[row, 1])
            band = report.band
            growth.fill_between(
                band[:, 0],
                2.0 * factor * band[:, column],
                color=BLUE,
                alpha=0.15,
                linewidth=0.0,
                label="predicted, 2 sigma",
            )
            growth.plot(band[:, 0], factor * band[:, column], color=BLUE, linewidth=1.2, label="predicted, 1 sigma")
            errors = report.errors
            for run in errors[:200]:
                growth.plot(run[:, 0], factor * run[:, column], color=RED, alpha=0.12, linewidth=0.7)
            rms = np.sqrt(np.mean(errors[:, :, column] ** 2, axis=0))
            growth.plot(errors[0, :, 0], factor * rms, "o-", color=RED, markersize=3.5, label="runs, rms")
            growth.set(ylabel=label, xlim=(0.0, None), ylim=(0.0, None))
            growth.legend(loc="upper left", fontsize=8)
        growth.set_xlabel("distance driven, m")
        figure.suptitle(f"{report.directory}: {report.runs} runs", x=0.01, ha="left", fontsize=11)
    return figure
