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
        plane, growth = figure.subplots(1, 2, width_ratios=(3, 2))
        for path in outlook.noisy_xy:
            plane.plot(path[:, 0], path[:, 1], color=BLUE, alpha=0.15, linewidth=0.8)
            plane.plot(path[-1, 0], path[-1, 1], ".", color=BLUE, alpha=0.6, markersize=4)
        plane.plot([], [], color=BLUE, label=f"{outlook.runs} runs, ends as dots")
        plane.plot(outlook.clean_xy[:, 0], outlook.clean_xy[:, 1], color=BLACK, linewidth=1.4, label="clean")
        plane.set(xlabel="x in odom, m", ylabel="y in odom, m", title="Where odometry would say the robot went")
        plane.set_aspect("equal", adjustable="datalim")
        plane.legend(loc="best", fontsize=9)
        distance = [row.after_m for row in outlook.rows]
        growth.plot(distance, [row.position_rms_m for row in outlook.rows], "o-", color=BLUE, label="position, m (rms)")
        growth.plot(
            distance,
            [math.degrees(row.heading_rms_rad) / 10.0 for row in outlook.rows],
            "s--", color=ORANGE, label="heading, 10 deg (rms)",
        )  # fmt: skip
        growth.set(xlabel="distance driven, m", title="How the drift grows", xlim=(0.0, None), ylim=(0.0, None))
        growth.legend(loc="best", fontsize=9)
        figure.suptitle(title, x=0.01, ha="left", fontsize=11)
    return figure
