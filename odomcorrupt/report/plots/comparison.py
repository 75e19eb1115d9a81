"""Figures of a comparison by name; NEES and PIT of each model."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from matplotlib.ticker import NullFormatter

from odomcorrupt.report.plots.figure import BLACK, COLOURS, MARKERS, drawing, new_figure, plain_logarithm, short_name
from odomcorrupt.report.plots.lack_of_fit_map import draw_failure_map
from odomcorrupt.report.plots.model_sequence import draw_errors
from odomcorrupt.report.plots.paths import draw_paths
from odomcorrupt.report.plots.residuals import draw_residuals

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from odomcorrupt.study.validate.compare import Comparison

__all__ = ["PICTURES", "Picture", "draw_nees", "draw_pit"]


def draw_nees(comparison: Comparison) -> Figure:
    """Draw NEES per degree of freedom and 90 % coverage against path length."""
    with drawing():
        figure = new_figure(9.0, 4.2)
        left, right = figure.subplots(1, 2)
        count = len(comparison.judgements)
        for i, judgement in enumerate(comparison.judgements):
            colour, marker = COLOURS[i % len(COLOURS)], MARKERS[i % len(MARKERS)]
            # shifted sideways, so that the bars do not overlap
            shift = min(1.06, 1.3 ** (1.0 / count)) ** (2 * i - count + 1)
            distance = shift * np.array([h.distance_m for h in judgement.horizons])
            low, high = np.array([h.nees_bounds for h in judgement.horizons]).reshape(-1, 2).T
            left.vlines(distance, low, high, color=colour, linewidth=7 if count <= 3 else 4, alpha=0.25)
            style = {"color": colour, "marker": marker, "markersize": 5.5, "linewidth": 1.2}
            style["label"] = short_name(judgement.name)
            left.plot(distance, [h.nees for h in judgement.horizons], **style)
            inside = [100.0 * float(np.nanmean(h.coverage_90)) for h in judgement.horizons]
            right.plot(distance, inside, **style)
        left.axhline(1.0, color=BLACK, linewidth=1.0)
        left.set(
            yscale="log", title="NEES per degree of freedom\n(1: errors are as large as expected; bars: 95 % chance)"
        )
        plain_logarithm(left.yaxis)
        right.axhline(90.0, color=BLACK, linewidth=1.0)
        right.set(
            ylim=(0.0, 102.0), title="errors inside the model's 90 % interval (%)\n(mean over along, across, yaw)"
        )
        for axes in (left, right):
            _distances(axes, [h.distance_m for h in max((j.horizons for j in comparison.judgements), key=len)])
        figure.legend(*left.get_legend_handles_labels(), loc="outside upper left", ncols=3, fontsize=9)
    return figure


def _distances(axes: Axes, distances: list[float]) -> None:
    axes.set(xscale="log", xlabel="path driven (m)")
    axes.set_xticks(distances, [f"{d:g}" for d in distances])
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.grid(visible=True, which="major", color="0.92")


def draw_pit(comparison: Comparison) -> Figure:
    """Draw the difference between the distribution of innovations and the predicted one, with its 95 % band."""
    channels = list(comparison.judgements[0].pits)
    with drawing():
        figure = new_figure(9.0, 3.6)
        panels = figure.subplots(1, len(channels), sharey=True, squeeze=False)[0]
        for axes, channel in zip(panels, channels, strict=True):
            band = comparison.judgements[0].pits[channel]
            axes.fill_between(band.at, band.low, band.high, color="0.85", label="95 % of right models stay inside")
            for judgement, colour in zip(comparison.judgements, COLOURS, strict=False):
                pit = judgement.pits[channel]
                label = short_name(judgement.name)
                axes.step(pit.at, pit.difference, where="mid", color=colour, linewidth=1.4, label=label)
            axes.axhline(0.0, color=BLACK, linewidth=0.8)
            axes.set(title=channel, xlabel="predicted probability", xlim=(0.0, 1.0))
        panels[0].set_ylabel("measured minus predicted")
        figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper left", ncols=3, fontsize=9)
    return figure


class Picture(NamedTuple):
    """A figure's heading, its description, and the function that draws it."""

    title: str
    caption: str
    draw: Callable[[Comparison], Figure]


PICTURES: Mapping[str, Picture] = {
    "path": Picture(
        "The path",
        "The truth corrupted by each model a hundred times, and the odometry as it was measured, all started at the "
        "truth. Under a right model the measured path looks like one of the runs. Square: start; discs: ends.",
        draw_paths,
    ),
    "error": Picture(
        "Error against distance",
        "Errors after a length of path, windows not overlapping and each started at the truth. Dashed: what the model "
        "expects. Bars: 90 % interval of the measured value; grey figures: how many windows it is measured on.",
        draw_errors,
    ),
    "nees": Picture(
        "NEES by length of path",
        "Rising with distance: a cause is missing, or noise that remembers. Flat but not 1: the noise has the wrong "
        "size. Falling: noise of the truth taken for motion noise.",
        draw_nees,
    ),
    "residuals": Picture(
        "What the error depends on",
        "Growth of the error per metre driven, odometry minus truth, in parts of the drive. Bars that miss zero all "
        "along a curve show on what the error depends; of a right model one in twenty misses it.",
        draw_residuals,
    ),
    "map": Picture(
        "Where it fails",
        "The truth's path; dark where errors are larger than expected. Numbers are those of the sentences above: "
        "circles are places, dotted lines stretches of time, crosses moments.",
        draw_failure_map,
    ),
    "pit": Picture(
        "Distribution of the errors",
        "How many whitened innovations fell below each predicted quantile, less how many should have. Outside the "
        "band: S-shaped where the noise has the wrong size, one bump where there is a bias.",
        draw_pit,
    ),
}
