"""Figures of a score: error against drift with the break-down point, error along the path, and places of failure."""

from __future__ import annotations

from math import isfinite
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.ticker import NullLocator

from odomcorrupt.report.plots.figure import LOST, ORANGE, RUNS, TRUTH, drawn, plain_logarithm

if TYPE_CHECKING:
    from collections.abc import Callable

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from odomcorrupt.scoring.run import ScoreReport

_SHOWN = 200
"""Largest number of runs drawn as lines."""


def draw_score(report: ScoreReport) -> Figure:
    """Draw all three figures side by side."""
    with drawn(13.5, 4.4) as figure:
        for axes, draw in zip(figure.subplots(1, 3), (drift, along, places), strict=True):
            draw(axes, report)
    return figure


def draw_alone(draw: Callable[[Axes, ScoreReport], None], report: ScoreReport, *size_in: float) -> Figure:
    """Draw one of the three figures alone, of the given width and height, inches."""
    with drawn(*size_in) as figure:
        draw(figure.subplots(), report)
    return figure


def drift(axes: Axes, report: ScoreReport) -> None:
    """Draw ATE against drift, with lost runs marked, the break-down point and its interval."""
    runs = [run for run in report.runs if run.scored and isfinite(run.drift)]
    above = [run.drift for run in runs if run.drift > 0.0]
    # zero drift is drawn at the left end of the logarithmic axis
    least = 0.5 * min(above, default=1.0)
    for lost, colour, marker, label in ((False, RUNS, "o", "not lost"), (True, LOST, "X", "lost")):
        own = [run for run in runs if run.failed is lost]
        if own:
            shares = [100.0 * max(run.drift, least) for run in own]
            axes.plot(
                shares, [run.metrics["ate_m"] for run in own], marker, color=colour,
                markersize=4.5, alpha=0.7, markeredgewidth=0.0, label=f"{len(own)} {label}",
            )  # fmt: skip
    points = report.points
    if len(points) > 1:
        at = [100.0 * max(point.drift, least) for point in points]
        for quantile, style in (("median", "-"), ("p90", "--")):
            ate = [getattr(point.summary("ate_m"), quantile).value for point in points]
            axes.plot(at, ate, style, color=TRUTH, linewidth=1.2, label=f"{quantile} of a point")
    found, drifts = report.breakdown, [max(run.drift, least) for run in runs]
    left, right = 80.0 * min(drifts, default=1.0), 125.0 * max(drifts, default=1.0)
    if found.drift and isfinite(found.drift):
        axes.axvline(100.0 * found.drift, color=ORANGE, linewidth=1.5, label="5 % of runs lost")
        ends = max(100.0 * found.low, left), min(100.0 * found.high, right)
        axes.axvspan(*ends, color=ORANGE, alpha=0.15, linewidth=0.0)
    if above and all(run.metrics["ate_m"] > 0.0 for run in runs):
        axes.set(xscale="log", yscale="log", xlim=(left, right))
        for axis in (axes.xaxis, axes.yaxis):
            plain_logarithm(axis)
            axis.set_minor_locator(NullLocator())
    axes.set(xlabel="drift of the odometry, % of the way (rms over 10 m)", ylabel="ATE of the estimate, m")
    axes.set_title("Error against the added drift")
    if runs:
        axes.legend(loc="best")


def along(axes: Axes, report: ScoreReport) -> None:
    """Draw the position error of each run along the path, with median and 90 % quantile."""
    runs = [run for run in report.runs if run.scored]
    for run in runs[:_SHOWN]:
        axes.plot(run.distance_m, run.position_m, color=LOST if run.failed else RUNS, alpha=0.15, linewidth=0.7)
    known = [s for s in report.sections if s.runs]
    middle = [(s.from_m + s.to_m) / 2.0 for s in known]
    axes.plot(middle, [s.median_m for s in known], color=TRUTH, linewidth=1.8, label="median of runs")
    axes.plot(middle, [s.p90_m for s in known], color=TRUTH, linewidth=1.2, linestyle="--", label="9 of 10 runs below")
    axes.axhline(report.limits.lost_m, color=ORANGE, linewidth=1.0, label="limit of a loss")
    top = max((s.p90_m for s in known), default=1.0)
    axes.set(xlabel="distance driven, m", ylabel="position error, m", yscale="log", title="Error along the path")
    axes.set_ylim(bottom=1e-3 * top)
    plain_logarithm(axes.yaxis)
    axes.legend(loc="best")


def places(axes: Axes, report: ScoreReport) -> None:
    """Draw the true path, the estimates, and the places where runs were lost."""
    runs = [run for run in report.runs if run.scored]
    for run in runs[:_SHOWN]:
        axes.plot(*run.estimate_xy.T, color=LOST if run.failed else RUNS, alpha=0.15, linewidth=0.7)
    axes.plot([], [], color=RUNS, label=f"{min(len(runs), _SHOWN)} estimates")
    axes.plot(*report.clean_xy.T, color=TRUTH, linewidth=1.4, label="truth")
    lost = np.array([run.failure.xy_m for run in runs if run.failure is not None]).reshape(-1, 2)
    if len(lost):
        axes.plot(*lost.T, "X", color=LOST, markersize=6, label=f"{len(lost)} lost here")
    low, high = report.clean_xy.min(axis=0), report.clean_xy.max(axis=0)
    margin = 0.15 * float((high - low).max()) + 0.5
    axes.set(xlim=(low[0] - margin, high[0] + margin), ylim=(low[1] - margin, high[1] + margin))
    axes.set_aspect("equal", adjustable="box")
    axes.set(xlabel="x, m", ylabel="y, m", title="Where")
    axes.legend(loc="best")
