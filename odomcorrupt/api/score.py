"""Errors of a localisation over the runs of a batch, and a gate on their rise."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar

from odomcorrupt.api.recordings import PathLikes, as_paths
from odomcorrupt.api.result import Result
from odomcorrupt.extras import part_of_study
from odomcorrupt.report import score as texts
from odomcorrupt.scoring.gate import check
from odomcorrupt.scoring.run import score as score_runs

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from os import PathLike

    from matplotlib.figure import Figure

    from odomcorrupt.scoring.errors import Alignment, Limits
    from odomcorrupt.scoring.gate import Verdict
    from odomcorrupt.scoring.run import ScoreReport
    from odomcorrupt.summary import Summary


@dataclass(frozen=True, slots=True, repr=False)
class Score(Result):
    """Errors of a localisation in each run of a batch, against the drift of its odometry.

    result : complete numerical result: statistics over the runs, break-down point, errors along the path
    verdicts : verdicts of the rules of `check`
    """

    result: ScoreReport
    verdicts: tuple[Verdict, ...] = ()
    schema: ClassVar[int] = 1

    @property
    def failed(self) -> bool:
        """Whether a rule of `check` has failed."""
        return any(verdict.failed for verdict in self.verdicts)

    def check(self, rules: Sequence[str], baseline: Mapping[str, Any] | Sequence[Mapping[str, Any]] = ()) -> Score:
        """Return the same score with the verdicts of a gate.

        rules : such as "ate_p90 +20%" (relative to the baseline), "lost +1", "lost +5%" or "ate_median > 0.3"
        baseline : `to_dict()` of an earlier score, as in a file of `--save`; of several, the median of each run

        Returns
        -------
        Score
            `verdicts` has one verdict per rule, and a failed one for crashes that no rule allows, or if the estimates
            of all runs are identical.

        Raises
        ------
        ScoreError
            If a rule is invalid, a rise has no baseline, or the two have too few runs with equal seeds.
        """
        return replace(self, verdicts=tuple(check(self.to_dict(), rules, baseline)))

    def summary(self) -> Summary:
        """Return the gate's result, the number of failed runs, the errors and the break-down point."""
        return texts.score_brief(self.result, self.verdicts)

    def details(self) -> str:
        """Return sentences, the tables of points and over runs, a line for each run, and the gate's verdicts."""
        return "\n".join([texts.score_text(self.result), *texts.gate_lines(self.verdicts)])

    def markdown(self) -> str:
        """Return the gate's result, what failed, and the tables of points and over runs, for a summary page of CI."""
        return texts.score_markdown(self.result, self.verdicts)

    def junit(self) -> str:
        """Return the gate as JUnit XML, a test case for each rule."""
        return texts.score_junit(self.result, self.verdicts)

    def points_csv(self) -> str:
        """Return drift, number of runs, failed runs, median and p90 of the ATE for each point of a sweep, as CSV."""
        return texts.score_csv(self.result)

    def _values(self) -> dict[str, Any]:
        return texts.score_json(self.result, self.verdicts)

    def rows(self) -> list[dict[str, Any]]:
        """Return one row per run: its state, the drift of its odometry, and the errors."""
        shown = ("name", "seed", "run", "status", "drift", "drift_end_m")
        return [{name: run[name] for name in shown} | run["metrics"] for run in self.to_dict()["runs"]]

    def report(self) -> str:
        """Return the score as a self-contained HTML page with tables and figures, usable offline."""
        from odomcorrupt.report.html import score_html

        return score_html(self.result, self.verdicts)

    def _figure(self) -> Figure:
        from odomcorrupt.report.plots.score import draw_score

        return draw_score(self.result)


@part_of_study
def score(
    runs: PathLikes,
    estimate: str | None = None,
    *,
    truth: str | None = None,
    truth_bag: str | PathLike[str] | None = None,
    outputs: str | PathLike[str] | None = None,
    align: Alignment = "rigid",
    limits: Limits | None = None,
) -> Score:
    """Return the errors of a localisation that was run on each bag of a batch.

    runs : directory of a batch, or of a sweep with several batches, combined in one score
    estimate : topic, or edge of TF such as "/tf:map.base_link", in the bags with the estimates; None for text files
    truth : topic or edge of TF of the truth: in the batch's input, else in the run or in the bag with the estimate.
        None: the odometry before corruption (`clean.tum` of the batch), i.e. the truth of a simulation
    truth_bag : bag, TUM or CSV file with the truth, if it is a separate one
    outputs : directory with the estimates: files or bags that begin like the runs (`run_000012.tum`); by default beside
        the runs. For a sweep, it contains a directory for each point
    align : "rigid", "origin", "none" or "same"; alignment of estimate and truth: best fit of positions, equal first
        poses, none (both in one frame), or none although the frames have different names
    limits : limits of loss, jumps and coverage

    Returns
    -------
    Score
        `result` has the statistics over the runs, `to_pandas()` one row per run.

    Raises
    ------
    ScoreError
        If there is no batch, no run has an estimate, or poses in different frames would be subtracted.

    Examples
    --------
    >>> import odomcorrupt as oc
    >>> oc.batch("fixtures/office.mcap", "scored", model="typical", runs=2, seed=1, output="overlay")
    <Batch: MADE 2 runs made now, 2 in scored>
    >>> oc.score("scored", "/odom", align="origin").result.runs[0].status
    'lost'
    """
    return Score(
        score_runs(
            as_paths(runs), estimate, truth=truth, truth_bag=truth_bag, outputs=outputs, align=align, limits=limits
        )
    )
