"""The physical effects that a model misses."""

from __future__ import annotations

from dataclasses import dataclass
from os import PathLike, fspath
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, cast

from odomcorrupt.api.model import as_model
from odomcorrupt.api.recordings import as_recordings
from odomcorrupt.api.result import Result

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from odomcorrupt.api.model import ModelLike
    from odomcorrupt.api.recordings import PathLikes, Recordings
    from odomcorrupt.report.text.summary import Summary
    from odomcorrupt.study.estimate.gauss_newton import Fit as ModelFit
    from odomcorrupt.study.pipeline import DiagnosedModel, LearnedRobot
    from odomcorrupt.study.validate.compare import Judgement
    from odomcorrupt.study.work import Watch

__all__ = ["Diagnosis", "Findings", "diagnose"]


@dataclass(frozen=True, slots=True, repr=False)
class Findings(Result):
    """What a search for missing effects found: the base of `Diagnosis` and `Learned`.

    recordings : what was searched
    result : everything that was computed
    following : the command to type next
    """

    recordings: Recordings
    result: DiagnosedModel | LearnedRobot
    following: str = ""

    @property
    def verdict(self) -> Literal["complete", "missing", "unknown"]:
        """Whether an effect of the robot was found; unknown where something is left that no known effect explains."""
        return cast('Literal["complete", "missing", "unknown"]', self.to_dict()["verdict"])

    @property
    def found(self) -> list[dict[str, Any]]:
        """What was found, as docs/json.md describes it: clocks, effects in order, noise."""
        return cast("list[dict[str, Any]]", self.to_dict()["found"])

    @property
    def missing(self) -> tuple[str, ...]:
        """Names of the robot's effects that were found, the one with the most evidence first."""
        search = self.result.search
        return tuple(name for name in search.added if name not in search.of_setup)

    def rows(self) -> list[dict[str, Any]]:
        """Return a row for each parameter of what was found."""
        return [
            {"effect": one["effect"], "kind": one["kind"], "parameter": name, **number, "confidence": one["confidence"]}
            for one in self.found
            for name, number in one["parameters"].items()
        ]

    def save_next_drive(self, path: str | PathLike[str], *, overwrite: bool = False) -> str:
        """Write the drive that separates most of the names that are open, as /cmd_vel in an MCAP.

        Parameters
        ----------
        path : path
            MCAP to write.
        overwrite : bool
            Whether an existing file is replaced.

        Returns
        -------
        str
            What to drive; "" where nothing is open that a drive would settle, and nothing was written.

        """
        from odomcorrupt.files import refuse_existing, write_bytes
        from odomcorrupt.report.text.design import drive_sentence
        from odomcorrupt.study.design.plan import drive_bag

        target = Path(fspath(path))
        refuse_existing(target, overwrite=overwrite)
        plan = self.result.advice.best
        if plan is None:
            return ""
        write_bytes(target, drive_bag(plan))
        return drive_sentence(plan)

    @property
    def _evaluated(self) -> Judgement | None:
        """Held-out evaluation of the model with all that was found; None where it lacks some of it."""
        raise NotImplementedError

    @property
    def _fit(self) -> ModelFit | None:
        """Fit whose standard errors are reported; None for that of the search."""
        return None

    def to_dict(self) -> dict[str, Any]:
        """Return what was found as docs/json.md describes it."""
        from odomcorrupt.report.json.diagnosis import learned_json

        found = self.result
        return learned_json(
            found.search, found.sequence.judgements, found.advice, evaluated=self._evaluated, fit=self._fit
        )

    def report(self) -> str:
        """Return what was found as one page of HTML, tables and pictures in one text, which needs no network."""
        from odomcorrupt import __version__
        from odomcorrupt.report.html.diagnosis import Story, found_html

        story = Story(self.result.search, self.result.sequence, self.result.advice, self.following)
        return found_html(story, version=__version__)


@dataclass(frozen=True, slots=True, repr=False)
class Diagnosis(Findings):
    """What a model misses."""

    result: DiagnosedModel

    @property
    def _evaluated(self) -> Judgement | None:
        # the sequence has no noise: what it rejects may be what was named
        return None if self.result.search.noise else self.result.sequence.judgements[-1]

    def summary(self) -> Summary:
        """Return what is missing, how large and how probable it is, and what it gains."""
        from odomcorrupt.report.text.brief import findings_brief

        found = self.result
        brief = findings_brief(
            found.search, found.advice, found.sequence, notes=self.recordings.notes, following=self.following
        )
        if all(run.positioned for run in self.recordings):
            return brief
        from odomcorrupt.report.text.summary import Line, Summary

        said = "cannot be known from wheels and a gyro alone: not testable are wheel_scale, speed_scale and the like"
        return Summary((*brief.lines, Line("travel", said, "warning")))

    def details(self) -> str:
        """Return the candidates, what was found, what each addition gains, and what is open."""
        from odomcorrupt.report.text.diagnosis import candidates_table, found_text, shares_text

        found = self.result
        said = found_text(found.search, found.advice, evaluated=self._evaluated)
        parts = [candidates_table(found.search.rounds[0]), said]
        if found.search.added:
            parts.append(shares_text(found.sequence.judgements))
        return "\n\n".join([*parts, *([f"next: {self.following}"] if self.following else [])])

    def _figure(self) -> Figure:
        """Return the candidates with their evidence."""
        from odomcorrupt.report.plots.diagnosis import draw_candidates

        return draw_candidates(self.result.search)


def diagnose(
    recordings: Recordings | PathLikes, model: ModelLike | None = None, *, watch: Watch = lambda _stage, _share: None
) -> Diagnosis:
    """Name the physical effects that a model misses, with what each would gain on held-out stretches.

    Parameters
    ----------
    recordings : Recordings or paths
        Runs of one robot.
    model : Model or path of a model file, optional
        What is known of it; None is noise alone.
    watch : callable
        Called with the name of each stage and the share of the work that is done.

    Returns
    -------
    Diagnosis
        `missing` are names, `found` sizes and probabilities.

    Examples
    --------
    >>> import odomcorrupt as oc
    >>> oc.diagnose("fixtures/mystery.mcap").verdict
    'missing'

    """
    known = None if model is None else as_model(model).motion_model
    runs = as_recordings(recordings)
    if known is not None:
        runs = runs.on_track(known.track_m).of_drive_type(known.setup.drive_type).in_frame(known.setup.origin)
    from odomcorrupt.study.pipeline import diagnose_model

    name = Path(fspath(model)).name if isinstance(model, str | PathLike) else "the model" if known else ""
    return Diagnosis(runs, diagnose_model(runs, known, name=name, watch=watch))
