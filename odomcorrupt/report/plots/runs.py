"""The picture of a forecast: the clean path, and the fan of what odometry would say."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from odomcorrupt.report.plots.figure import BLACK, BLUE, ORANGE, drawing, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from odomcorrupt.preview.forecast import Forecast

__all__ = ["draw_fan"]


def draw_fan(outlook: Forecast, title: str) -> Figure:
    """Draw noisy paths over the clean one, and how position and heading drift with the distance."""
    with drawing():
        figure = new_figure(9.0, 4.6)
        places = figure.add_gridspec(2, 2, width_ratios=(3, 2))
        plane = figure.add_subplot(places[:, 0])
        position, heading = figure.add_subplot(places[0, 1]), figure.add_subplot(places[1, 1])
        for path in outlook.noisy_xy:
            plane.plot(path[:, 0], path[:, 1], color=BLUE, alpha=0.15, linewidth=0.8)
            plane.plot(path[-1, 0], path[-1, 1], ".", color=BLUE, alpha=0.6, markersize=4)
        plane.plot([], [], color=BLUE, label=f"{outlook.runs} runs, ends as dots")
        plane.plot(outlook.clean_xy[:, 0], outlook.clean_xy[:, 1], color=BLACK, linewidth=1.4, label="clean")
        plane.set(xlabel="x in odom (m)", ylabel="y in odom (m)", title="Where odometry would say the robot went")
        plane.set_aspect("equal", adjustable="datalim")
        plane.legend(loc="best", fontsize=9)
        distance = [row.after_m for row in outlook.rows]
        position.plot(distance, [row.position_rms_m for row in outlook.rows], "o-", color=BLUE)
        position.set(title="How the drift grows (root mean square)", ylabel="position (m)")
        heading.plot(distance, [math.degrees(row.heading_rms_rad) for row in outlook.rows], "s-", color=ORANGE)
        heading.set(xlabel="distance driven (m)", ylabel="heading (deg)")
        for axes in (position, heading):
            axes.set(xlim=(0.0, None), ylim=(0.0, None))
            axes.grid(visible=True, color="0.92")
        figure.suptitle(title, x=0.01, ha="left", fontsize=11)
    return figure
