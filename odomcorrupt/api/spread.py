"""Dispersion of the runs of a batch, compared with the prediction of the linearised model."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from os import PathLike, fspath
from pathlib import Path
from typing import TYPE_CHECKING, Any

from odomcorrupt.api.result import Result
from odomcorrupt.batching.dispersion import measure, spread_brief, spread_text
from odomcorrupt.report.json.numbers import finite

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from odomcorrupt.batching.dispersion import SpreadReport
    from odomcorrupt.summary import Summary


@dataclass(frozen=True, slots=True, repr=False)
class Spread(Result):
    """Dispersion of the runs of a batch, measured and predicted by the linearised model.

    result : complete numerical result: standard deviations after each distance, paths, errors of each run
    following : words of the suggested next command
    """

    result: SpreadReport
    following: tuple[object, ...] = ()

    def summary(self) -> Summary:
        """Return whether the dispersion at the end is as predicted, and its values along the drive."""
        return spread_brief(self.result, self.following)

    def details(self) -> str:
        """Return a table of the dispersion along the drive, measured and predicted."""
        return spread_text(self.result)

    def to_dict(self) -> dict[str, Any]:
        """Return directory, number of runs, random effects, and the rows: metres and radians."""
        report = self.result
        return finite(
            {
                "schema": 2,
                "directory": report.directory,
                "runs": report.runs,
                "random_effects": report.random_effects,
                "rows": self.rows(),
            }
        )

    def rows(self) -> list[dict[str, Any]]:
        """Return one row per distance: standard deviations of the runs and predicted, and the mean error."""
        return [asdict(row) for row in self.result.rows]

    def _figure(self) -> Figure:
        """Return a figure of the clean path and the runs, and of their errors against distance."""
        from odomcorrupt.report.plots.samples import draw_spread

        return draw_spread(self.result)


def spread(directory: str | PathLike[str]) -> Spread:
    """Return how position and heading of a batch's runs spread with distance, beside what the linear model predicts.

    Parameters
    ----------
    directory : path
        Directory of a batch with at least two runs.

    Returns
    -------
    Spread
        `rows()` and `to_pandas()` have the standard deviations after 1, 2, 5, 10 ... m and at the end.

    Raises
    ------
    BatchError
        If the directory has no batch of at least two runs.

    Examples
    --------
    >>> import odomcorrupt as oc
    >>> runs = oc.batch("fixtures/office.mcap", "spread", model="typical", runs=3, seed=1, output="trajectories")
    >>> oc.spread(runs.directory).result.runs
    3
    """
    return Spread(measure(Path(fspath(directory))))
