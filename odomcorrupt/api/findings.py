"""Search for the physical effects that a model lacks: its diagnosis, and a model learned with them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from os import PathLike, fspath
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from odomcorrupt.api.comparison import Comparison
from odomcorrupt.api.model import Model, ModelLike, as_model
from odomcorrupt.api.recordings import PathLikes, Recordings, as_recordings, refuse_turns_alone, require_travel
from odomcorrupt.api.result import Result
from odomcorrupt.extras import part_of_study
from odomcorrupt.result_files import refuse_existing, write_bytes
from odomcorrupt.summary import Line, Summary

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from odomcorrupt.study.estimate.gauss_newton import Fit as ModelFit
    from odomcorrupt.study.pipeline import DiagnosedModel, LearnedRobot
    from odomcorrupt.study.select.decisions import Decisions
    from odomcorrupt.study.validate.compare import ModelEvaluation
    from odomcorrupt.study.work import Watch


@dataclass(frozen=True, slots=True, repr=False)
class Findings(Result):
    """Result of a search for missing effects; base class of `Diagnosis` and `Learned`.

    recordings : recordings searched
    result : complete numerical result
    following : suggested next command
    """

    recordings: Recordings
    result: DiagnosedModel | LearnedRobot
    following: str = ""

    @property
    def verdict(self) -> Literal["complete", "missing", "unknown"]:
        """Whether an effect was found; unknown if an error remains that no known effect explains."""
        return self.to_dict()["verdict"]

    @property
    def found(self) -> list[dict[str, Any]]:
        """Findings in the form of docs/json.md: clocks, effects in order, noise."""
        return self.to_dict()["found"]

    @property
    def missing(self) -> tuple[str, ...]:
        """Names of the missing effects found, the one with the most evidence first."""
        search = self.result.search
        return tuple(name for name in search.added if name not in search.of_setup)

    def rows(self) -> list[dict[str, Any]]:
        """Return one row per parameter of the findings."""
        return [
            {"effect": one["effect"], "kind": one["kind"], "parameter": name, **number, "confidence": one["confidence"]}
            for one in self.found
            for name, number in one["parameters"].items()
        ]

    def save_next_drive(self, path: str | PathLike[str], *, overwrite: bool = False) -> str:
        """Write the drive that separates the most of the undecided effects, as /cmd_vel in an MCAP.

        Parameters
        ----------
        path : path
            MCAP to write.
        overwrite : bool
            Whether an existing file is replaced.

        Returns
        -------
        str
            Description of the drive; "" if no drive would decide anything, in which case no file is written.
        """
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
    def _evaluated(self) -> ModelEvaluation | None:
        """Held-out evaluation of the model with all findings; None if it lacks one of them."""
        raise NotImplementedError

    @property
    def _fit(self) -> ModelFit | None:
        """Fit whose standard errors are reported; None for the fit of the search."""
        return None

    def to_dict(self) -> dict[str, Any]:
        """Return the findings in the form of docs/json.md."""
        from odomcorrupt.report.json.diagnosis import learned_json

        found = self.result
        return learned_json(
            found.search, found.sequence.evaluations, found.advice, evaluated=self._evaluated, fit=self._fit
        )

    def report(self) -> str:
        """Return the findings as a self-contained HTML page with tables and figures, usable offline."""
        from odomcorrupt import __version__
        from odomcorrupt.report.html.diagnosis import SearchReport, found_html

        story = SearchReport(self.result.search, self.result.sequence, self.result.advice, self.following)
        return found_html(story, version=__version__)


@dataclass(frozen=True, slots=True, repr=False)
class Diagnosis(Findings):
    """Effects that a model lacks."""

    result: DiagnosedModel

    @property
    def _evaluated(self) -> ModelEvaluation | None:
        # the sequence contains no noise term: its lack of fit may be due to the noise found
        return None if self.result.search.noise else self.result.sequence.evaluations[-1]

    def summary(self) -> Summary:
        """Return the missing effects, their size and probability, and the gain of each."""
        from odomcorrupt.report.text.brief import findings_brief
        from odomcorrupt.report.text.limits import mistakes_first

        found = self.result
        brief = findings_brief(
            found.search,
            found.advice,
            found.sequence,
            notes=self.recordings.notes,
            alerts=self.recordings.alerts,
            following=self.following,
        )
        brief = mistakes_first(brief, self.recordings.mistakes)
        if all(run.positioned for run in self.recordings):
            return brief
        said = "wheels and a gyro alone do not show it: wheel_scale, speed_scale and similar effects are not testable"
        return brief._replace(lines=(*brief.lines, Line("travel", said, "warning")))

    def details(self) -> str:
        """Return the candidates, the findings, the gain of each addition, and undecided alternatives."""
        from odomcorrupt.report.text.diagnosis import candidates_table, found_text, shares_text

        found = self.result
        said = found_text(found.search, found.advice, evaluated=self._evaluated)
        parts = [candidates_table(found.search.rounds[0]), said]
        if found.search.added:
            parts.append(shares_text(found.sequence.evaluations))
        return "\n\n".join([*parts, *([f"next: {self.following}"] if self.following else [])])

    def _figure(self) -> Figure:
        """Return a figure of the candidates with their evidence."""
        from odomcorrupt.report.plots.diagnosis import draw_candidates

        return draw_candidates(self.result.search)


@part_of_study
def diagnose(
    recordings: Recordings | PathLikes,
    model: ModelLike | None = None,
    *,
    decisions: Decisions | None = None,
    watch: Watch = lambda _stage, _share: None,
) -> Diagnosis:
    """Name the physical effects that a model lacks, with the held-out gain of each.

    Parameters
    ----------
    recordings : Recordings or paths
        Runs of one robot.
    model : Model or path of a model file, optional
        Known part of the model; None for noise alone.
    decisions : odomcorrupt.study.select.decisions.Decisions, optional
        Thresholds of inclusion, replacement and removal of effects; None for the defaults, `DECISIONS` of that module.
    watch : callable
        Called with the name of each stage and the completed share of the work.

    Returns
    -------
    Diagnosis
        `missing` has names, `found` sizes and probabilities.

    Examples
    --------
    >>> import odomcorrupt as oc
    >>> oc.diagnose("fixtures/mystery.mcap").verdict
    'missing'
    """
    known = None if model is None else as_model(model).motion_model
    runs = refuse_turns_alone(as_recordings(recordings))
    if known is not None:
        runs = runs.on_track(known.track_m).of_drive_type(known.setup.drive_type).in_frame(known.setup.origin)
    from odomcorrupt.study.pipeline import diagnose_model
    from odomcorrupt.study.select.decisions import DECISIONS

    name = Path(fspath(model)).name if isinstance(model, str | PathLike) else "the model" if known else ""
    return Diagnosis(runs, diagnose_model(runs, known, name=name, decisions=decisions or DECISIONS, watch=watch))


@dataclass(frozen=True, slots=True, repr=False)
class Learned(Findings):
    """Learned model of a robot, the findings of the search, and its held-out evaluation."""

    result: LearnedRobot

    @property
    def model(self) -> Model:
        """The learned model, in usable form."""
        from odomcorrupt.report.text.comparison import reproduction_sentence

        model = self.result.proof.model
        said = reproduction_sentence(self.result.reproduction)
        if said:
            written = model.source.get("remarks", [])
            remarks = [*(written if isinstance(written, list) else []), said]
            model = replace(model, source=dict(model.source) | {"remarks": remarks})
        return Model.of(model)

    @property
    def comparison(self) -> Comparison:
        """Comparison of the model without and with the findings, on held-out recordings."""
        return Comparison(self.result.comparison)

    @property
    def _evaluated(self) -> ModelEvaluation:
        return self.result.comparison.evaluations[-1]

    @property
    def _fit(self) -> ModelFit:
        return self.result.robot.fit

    def summary(self) -> Summary:
        """Return the findings, their size and probability, and the held-out errors without and with them."""
        from odomcorrupt.report.text.brief import findings_brief
        from odomcorrupt.report.text.limits import mistakes_first

        found = self.result
        brief = findings_brief(
            found.search,
            found.advice,
            found.comparison,
            robot=found.robot,
            reproduction=found.reproduction,
            written=found.proof.model,
            notes=(*found.dropped, *found.proof.changes, *replace(self.recordings, runs=tuple(found.recordings)).notes),
            alerts=(*found.alerts, *self.recordings.alerts),
            following=self.following,
        )
        return mistakes_first(brief, self.recordings.mistakes)

    def details(self) -> str:
        """Return the findings, undecided alternatives, the fit, and the full comparison."""
        from odomcorrupt.report.text.comparison import comparison_text, reproduction_sentence
        from odomcorrupt.report.text.diagnosis import fit_text, found_text

        found = self.result
        said = found_text(found.search, found.advice, evaluated=self._evaluated, fit=self._fit)
        fitted = [fit_text(found.robot, clocks=False), *found.proof.changes]
        drifts = [one for one in (reproduction_sentence(found.reproduction),) if one]
        return "\n".join([said, *drifts, *found.alerts, *found.dropped, *fitted, "", comparison_text(found.comparison)])

    def to_dict(self) -> dict[str, Any]:
        """Return the findings and the comparison in the form of docs/json.md."""
        from odomcorrupt.report.json.diagnosis import reproduction_json

        return Findings.to_dict(self) | {
            "reproduction": reproduction_json(self.result.reproduction),
            "comparison": self.comparison.to_dict(),
        }

    def draw(self, picture: str) -> Figure:
        """Return a figure of the errors without and with the findings, or by name one of `Comparison.draw`."""
        return self.comparison.draw(picture)


@part_of_study
def learn(
    recordings: Recordings | PathLikes,
    *,
    validate: Recordings | PathLikes = (),
    decisions: Decisions | None = None,
    watch: Watch = lambda _stage, _share: None,
) -> Learned:
    """Learn a robot's effects: fit, search for a missing effect, add it, and repeat until none is missing.

    Parameters
    ----------
    recordings : Recordings or paths
        Runs of one robot.
    validate : Recordings or paths, optional
        Recordings to evaluate the result on, read like the first ones; if none, the result is cross-validated.
    decisions : odomcorrupt.study.select.decisions.Decisions, optional
        Thresholds of inclusion, replacement and removal of effects; None for the defaults, `DECISIONS` of that module.
    watch : callable
        Called with the name of each stage and the completed share of the work.

    Returns
    -------
    Learned
        `model` is the robot's model; `print` shows the findings and the change of the error.

    Raises
    ------
    FitError, RecordingError
        If the recordings are not sufficient for a fit.

    Examples
    --------
    >>> import odomcorrupt as oc
    >>> rec = oc.read_recordings("fixtures/mystery.mcap", truth="/ground_truth")
    >>> result = oc.learn(rec, validate="fixtures/mystery_other.mcap")
    >>> result.missing
    ('wheelbase',)
    """
    runs = require_travel(as_recordings(recordings))
    held_out = validate if isinstance(validate, Recordings) or validate else ()
    others = as_recordings(held_out, like=runs).in_frame(runs.geodetic_origin) if held_out else ()
    from odomcorrupt.study.pipeline import learn_robot
    from odomcorrupt.study.select.decisions import DECISIONS

    return Learned(runs, learn_robot(runs, others, decisions=decisions or DECISIONS, watch=watch))
