"""The picture of one corruption or correction: two paths over each other, and how they part with the distance."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.report.plots.figure import BLACK, BLUE, ORANGE, drawing, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from odomcorrupt.geometry.se2 import Array

__all__ = ["draw_corruption"]


def draw_corruption(
    before_xyt: Array, after_xyt: Array, title: str, names: tuple[str, str] = ("clean", "noisy")
) -> Figure:
    """Draw a path before and after it was changed, and the difference in position and heading against distance.

    Parameters
    ----------
    before_xyt, after_xyt : (n, 3) metres and radians, the same messages in the same order
    title : of the picture
    names : of the two paths
    """
    count = min(len(before_xyt), len(after_xyt))
    before, after = before_xyt[:count], after_xyt[:count]
    driven_m = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(before[:, :2], axis=0).T))))
    error = after - before
    with drawing():
        figure = new_figure(9.0, 4.6)
        plane, growth = figure.subplots(1, 2, width_ratios=(3, 2))
        plane.plot(after[:, 0], after[:, 1], color=BLUE, linewidth=1.2, label=names[1])
        plane.plot(before[:, 0], before[:, 1], color=BLACK, linewidth=1.4, label=names[0])
        plane.set(xlabel="x in odom, m", ylabel="y in odom, m")
        plane.set_aspect("equal", adjustable="datalim")
        plane.legend(loc="best", fontsize=9)
        growth.plot(driven_m, np.hypot(error[:, 0], error[:, 1]), color=BLUE, label="position, m")
        growth.set(xlabel="distance driven, m", ylabel="position, m", xlim=(0.0, None), ylim=(0.0, None))
        heading = growth.twinx()
        heading.spines["right"].set_visible(True)
        heading.plot(driven_m, np.degrees(error[:, 2]), color=ORANGE, linestyle="--", label="heading, deg")
        heading.set_ylabel("heading, deg")
        lines = [*growth.get_lines(), *heading.get_lines()]
        growth.legend(lines, [str(line.get_label()) for line in lines], loc="upper left", fontsize=9)
        figure.suptitle(title, x=0.01, ha="left", fontsize=11)
    return figure
