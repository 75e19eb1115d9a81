"""The picture of the advised drive: its path, and the beginning of its speeds."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from odomcorrupt.report.plots.figure import BLUE, GREEN, ORANGE, drawing, new_figure
from odomcorrupt.study.design.plan import STEP_S

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from odomcorrupt.study.design.plan import Plan

__all__ = ["draw_plan"]

_SHOWN_S = 120.0


def draw_plan(plan: Plan) -> Figure:
    """Draw where a robot that follows the plan goes, and what it is told in the first two minutes."""
    path = plan.path
    shown = slice(0, round(_SHOWN_S / STEP_S))
    times_s = np.arange(len(plan.v_mps))[shown] * STEP_S
    with drawing():
        figure = new_figure(11.0, 3.6)
        parts: Any = figure.subfigures(1, 2, width_ratios=(1.0, 1.9))
        where = parts[0].subplots()
        where.plot(path[:, 0], path[:, 1], color=BLUE, linewidth=1.4)
        where.plot(*path[0, :2], marker="s", color=GREEN, markersize=7, linestyle="")
        size = max(*plan.floor_m, 1.0)
        middle = (path[:, :2].max(axis=0) + path[:, :2].min(axis=0)) / 2.0
        where.set(
            aspect="equal", xlabel="m", ylabel="m", title="path (square: start)",
            xlim=(middle[0] - 0.6 * size, middle[0] + 0.6 * size),
            ylim=(middle[1] - 0.6 * size, middle[1] + 0.6 * size),
        )  # fmt: skip
        where.grid(visible=True, color="0.93")
        above, below = parts[1].subplots(2, 1, sharex=True)
        above.plot(times_s, plan.v_mps[shown], color=BLUE, linewidth=1.3)
        above.set(ylabel="m/s", title="commands, the first two minutes")
        below.plot(times_s, np.degrees(plan.omega_radps[shown]), color=ORANGE, linewidth=1.3)
        below.set(ylabel="deg/s", xlabel="s")
        for axes in (above, below):
            axes.axhline(0.0, color="0.6", linewidth=0.7, zorder=0)
            axes.grid(visible=True, color="0.93")
    return figure
