"""The pictures of a comparison, each by name: alone as a file, or all in the report."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from odomcorrupt.report.plots.calibration import draw_nees, draw_pit
from odomcorrupt.report.plots.lack_of_fit_map import draw_failure_map
from odomcorrupt.report.plots.model_sequence import draw_errors
from odomcorrupt.report.plots.path import draw_paths
from odomcorrupt.report.plots.residuals import draw_residuals

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from matplotlib.figure import Figure

    from odomcorrupt.study.validate.compare import Comparison

__all__ = ["PICTURES", "Picture"]


class Picture(NamedTuple):
    """A picture's heading, what it shows in words, and who draws it."""

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
