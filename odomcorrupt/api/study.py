"""What recordings say of a robot: its model fitted, compared, diagnosed and learned."""

from __future__ import annotations

from dataclasses import dataclass, field
from os import PathLike, fspath
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from odomcorrupt.api.model import Model, as_model
from odomcorrupt.api.recordings import Recordings, as_recordings, require_travel
from odomcorrupt.api.result import Result
from odomcorrupt.errors import ModelError, OdomCorruptError
from odomcorrupt.extras import require

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from matplotlib.figure import Figure

    from odomcorrupt.api.model import ModelLike
    from odomcorrupt.api.recordings import PathLikes
    from odomcorrupt.report.text.summary import Line, Summary
    from odomcorrupt.study.design.advise import Advice
    from odomcorrupt.study.estimate.calibrate import RobotFit
    from odomcorrupt.study.pipeline import DiagnosedModel, LearnedRobot, Watch
    from odomcorrupt.study.select.stepwise import Learned as Search
    from odomcorrupt.study.validate.compare import Comparison as ModelComparison
    from odomcorrupt.study.validate.round_trip import RoundTrip

__all__ = ["Comparison", "Diagnosis", "Fit", "Learned", "compare", "diagnose", "fit", "learn"]


def _silent(_stage: str, _share: float) -> None:
    """Take no note."""


def _next(words: str) -> Line | None:
    from odomcorrupt.report.text.summary import Line

    return Line("next", words, "command") if words else None


@dataclass(frozen=True, slots=True, repr=False)
class Fit(Result):
    """A motion model fitted to recordings.

    recordings : what it was fitted to
    result : the model with confidence intervals, clocks, and the fit itself
    proof : the model as it can be used: read back, corrected and corrupted with
    laws : the fits of every law where all were tried, the likeliest first
    following : the command to type next
    """

    recordings: Recordings
    result: RobotFit
    proof: RoundTrip
    laws: Mapping[str, RobotFit] = field(default_factory=dict)
    following: str = ""

    @property
    def model(self) -> Model:
        """The model that was fitted, as it can be used."""
        return Model.of(self.proof.model)

    def summary(self) -> Summary:
        """Return the error on the fitted data, the noise and the effects."""
        from odomcorrupt.report.text.brief import fit_brief

        return fit_brief(self.result, _next(self.following))

    def details(self) -> str:
        """Return all coefficients with their intervals, effects, clocks, and stretches that weigh less."""
        from odomcorrupt.report.text.fit import fit_text, laws_table

        return "\n\n".join(
            [*([laws_table(self.laws)] if self.laws else []), fit_text(self.result), *self.proof.changes]
        )

    def to_dict(self) -> dict[str, Any]:
        """Return law, coefficients with intervals, effects, clocks and the error on the fitted data."""
        from odomcorrupt.report.json.fit import fit_json

        return fit_json(self.result, self.laws)

    def rows(self) -> list[dict[str, Any]]:
        """Return a row for each parameter: value and standard error."""
        errors = self.model.standard_errors
        return [
            {"parameter": name, "value": value, "standard_error": errors.get(name)}
            for name, value in self.model.parameters.items()
        ]


def fit(
    recordings: Recordings | PathLikes,
    effects: Sequence[str] = (),
    *,
    start: ModelLike | None = None,
    law: str | None = None,
) -> Fit:
    """Fit a robot's motion model to recordings: noise, that of the truth, clocks, set-up, and the effects asked for.

    Parameters
    ----------
    recordings : Recordings or paths
        Runs of one robot, each with a clock of its own.
    effects : sequence of str
        Names of effects to fit besides those of `start`.
    start : Model or path of a model file, optional
        Model whose effects are refitted.
    law : str, optional
        Noise law, or "all" for the likeliest; by default that of `start`, or diffusion.

    Returns
    -------
    Fit
        `model` is the model; `to_pandas()` its parameters with standard errors.

    Raises
    ------
    EffectError
        Where an effect is unknown or cannot be fitted this way.
    FitError
        Where the recordings do not carry what a fit needs.

    Examples
    --------
    >>> import odomcorrupt as oc
    >>> result = oc.fit("fixtures/mystery.mcap", ["wheel_scale"])
    >>> "wheel_scale.e" in result.model.parameters
    True

    """
    from odomcorrupt.study.estimate.calibrate import effects_to_fit, fit_every_law, fit_robot
    from odomcorrupt.study.pipeline import LAW
    from odomcorrupt.study.validate.round_trip import proved

    begin = None if start is None else as_model(start).motion_model
    wanted = effects_to_fit(begin, effects)
    law_name = law or (LAW if begin is None else begin.noise.law_name)
    runs = require_travel(as_recordings(recordings).on_track(None if begin is None else begin.track_m))
    if law_name == "all":
        laws = fit_every_law(runs, wanted, start=begin)
        best = next(iter(laws.values()))
        return Fit(runs, best, proved(best.model, runs), laws)
    best = fit_robot(runs, wanted, law_name=law_name, start=begin)
    return Fit(runs, best, proved(best.model, runs))


def require_effects(start: Model | None, effects: Sequence[str]) -> None:
    """Raise EffectError where one of the effects cannot be fitted, before recordings are read."""
    require("scipy", "the study needs it", "study")
    from odomcorrupt.study.estimate.calibrate import effects_to_fit

    effects_to_fit(None if start is None else start.motion_model, effects)


@dataclass(frozen=True, slots=True, repr=False)
class Comparison(Result):
    """Models against measurements: the errors measured and expected, and where each model fails.

    result : everything that was computed
    following : the command to type next
    """

    result: ModelComparison
    following: str = ""

    @property
    def rejected(self) -> bool:
        """Whether the data reject the last model."""
        return self.result.judgements[-1].verdict.rejected

    def summary(self) -> Summary:
        """Return whether the last model is better than the first by all measures, and a line for each model."""
        from odomcorrupt.report.text.brief import comparison_brief

        return comparison_brief(self.result, _next(self.following))

    def details(self) -> str:
        """Return clocks, the table of horizons, the models in order, and every failure."""
        from odomcorrupt.report.text.comparison import comparison_text
        from odomcorrupt.report.text.tables import clock_lines

        lines = clock_lines(self.result.recordings, self.result.clocks)
        return "\n".join([*lines, comparison_text(self.result)])

    def to_dict(self) -> dict[str, Any]:
        """Return the comparison as docs/json.md describes it."""
        from odomcorrupt.report.json.comparison import comparison_json

        return comparison_json(self.result)

    def rows(self) -> list[dict[str, Any]]:
        """Return a row for each model: errors in metres, log likelihood in nats per metre, whether it is rejected."""
        return [
            {
                "model": j.name,
                "error_10s_m": j.ten_second_error_m,
                "nats_per_m": j.nats.per_m,
                "nats_per_m_error": j.nats.error,
                "ate_m": j.trajectory.ate_m,
                "rpe_1m_m": j.trajectory.rpe_m,
                "rejected": j.verdict.rejected,
            }
            for j in self.result.judgements
        ]

    def horizon_rows(self) -> list[dict[str, Any]]:
        """Return a row for each model and length of path: errors measured and expected, metres and radians, NEES."""
        return [
            {
                "model": j.name,
                "distance_m": h.distance_m,
                "windows": h.windows,
                "position_measured_m": h.position_measured,
                "position_expected_m": h.position_expected,
                "yaw_measured_rad": h.measured[2],
                "yaw_expected_rad": h.expected[2],
                "nees": h.nees,
            }
            for j in self.result.judgements
            for h in j.horizons
        ]

    def report(self) -> str:
        """Return all of it as one page of HTML, pictures too."""
        from odomcorrupt import __version__
        from odomcorrupt.report.html.comparison import report_html

        return report_html(self.result, version=__version__)

    def draw(self, picture: str) -> Figure:
        """Return a picture: error (against distance), path, nees, residuals, map or pit."""
        from odomcorrupt.report.plots.comparison import PICTURES

        if (picture or "error") not in PICTURES:
            raise OdomCorruptError(f"no picture is called {picture!r}; there are {', '.join(PICTURES)}")
        return PICTURES[picture or "error"].draw(self.result)


def compare(
    recordings: Recordings | PathLikes, models: ModelLike | Sequence[ModelLike] | Mapping[str, ModelLike]
) -> Comparison:
    """Compare models with measurements, and see where they fail.

    Recordings that a model was fitted to are cut in halves: it is refitted to one and judged on the other.

    Parameters
    ----------
    recordings : Recordings or paths
        What to judge on.
    models : one model, several, or several by name
        Models, paths of model files, or names of presets; the first is what the others are measured against.

    Returns
    -------
    Comparison
        `to_pandas()` has a row for each model.

    Raises
    ------
    ModelError
        Where there is no model, or a file is none.

    Examples
    --------
    >>> import odomcorrupt as oc
    >>> rec = oc.read_recordings("fixtures/mystery_other.mcap")
    >>> table = oc.compare(rec, ["typical", oc.Model(oc.Noise(alpha=(0.1, 0.1, 0.1, 0.1)))]).rows()
    >>> [row["model"] for row in table]
    ['typical', 'model 2']

    """
    named = _named_models(models)
    track = next((m.motion_model.track_m for m in named.values() if m.motion_model.track_m is not None), None)
    runs = require_travel(as_recordings(recordings).on_track(track))
    from odomcorrupt.study.validate.compare import compare as compare_models

    return Comparison(compare_models(runs, {name: model.motion_model for name, model in named.items()}))


def _named_models(models: ModelLike | Sequence[ModelLike] | Mapping[str, ModelLike]) -> dict[str, Model]:
    """Return models by name: that of a file alone where it tells them apart, of others their number."""
    from collections.abc import Mapping, Sequence

    if isinstance(models, Mapping):
        return {name: as_model(model) for name, model in models.items()}
    given = list(models) if isinstance(models, Sequence) and not isinstance(models, str) else [models]
    if not given:
        raise ModelError("no model given; name one or more .toml files that `odomcorrupt fit` wrote")
    full = [fspath(m) if isinstance(m, str | PathLike) else f"model {i}" for i, m in enumerate(given, start=1)]
    short = [Path(name).name for name in full]
    names = short if len(set(short)) == len(short) else full
    if len(set(names)) < len(names):
        raise ModelError(f"models: {', '.join(names)}; the same one is named twice")
    return {name: as_model(model) for name, model in zip(names, given, strict=True)}


class _Findings(Result):
    """What a search found, for `Diagnosis` and `Learned` alike."""

    __slots__ = ()

    @property
    def _search(self) -> Search:
        raise NotImplementedError

    @property
    def _advice(self) -> Advice:
        raise NotImplementedError

    @property
    def verdict(self) -> Literal["complete", "missing", "unknown"]:
        """Whether something was found; unknown where something is left that no known effect explains."""
        verdict: Literal["complete", "missing", "unknown"] = self.to_dict()["verdict"]
        return verdict

    @property
    def found(self) -> list[dict[str, Any]]:
        """What was found, as docs/json.md describes it: clocks, effects in order, noise."""
        found: list[dict[str, Any]] = self.to_dict()["found"]
        return found

    @property
    def missing(self) -> tuple[str, ...]:
        """Names of the effects that were found, the one with the most evidence first."""
        return self._search.added

    def rows(self) -> list[dict[str, Any]]:
        """Return a row for each parameter of what was found."""
        return [
            {
                "effect": one["effect"],
                "kind": one["kind"],
                "parameter": name,
                "value": number["value"],
                "standard_error": number["standard_error"],
                "unit": number["unit"],
                "confidence": one["confidence"],
            }
            for one in self.found
            for name, number in one["parameters"].items()
        ]

    def save_next_drive(self, path: str | PathLike[str], *, overwrite: bool = False) -> str:
        """Write the drive that settles most of what is open as /cmd_vel in an MCAP, and return it in words.

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
        plan = self._advice.best
        if plan is None:
            return ""
        write_bytes(target, drive_bag(plan))
        return drive_sentence(plan)


@dataclass(frozen=True, slots=True, repr=False)
class Diagnosis(_Findings):
    """What a model misses.

    recordings : what was looked at
    result : everything that was computed
    following : the command to type next
    """

    recordings: Recordings
    result: DiagnosedModel
    following: str = ""

    @property
    def _search(self) -> Search:
        return self.result.search

    @property
    def _advice(self) -> Advice:
        return self.result.advice

    @property
    def _judged(self) -> Any:
        # the sequence has no noise: what it rejects may be what was named
        return None if self.result.search.noise else self.result.sequence.judgements[-1]

    def summary(self) -> Summary:
        """Return what is missing, how large and how probable it is, and what it gains."""
        from odomcorrupt.report.text.brief import findings_brief

        found = self.result
        brief = findings_brief(
            found.search, found.advice, found.sequence, notes=self.recordings.notes, following=_next(self.following)
        )
        if all(run.positioned for run in self.recordings):
            return brief
        from odomcorrupt.report.text.summary import Line, Summary

        said = "cannot be known from wheels and a gyro alone: not testable are wheel_scale, speed_scale and the like"
        return Summary((*brief.lines, Line("travel", said, "warning")))

    def details(self) -> str:
        """Return the candidates, what was found, what each addition gains, and what is open."""
        from odomcorrupt.report.text.diagnosis import found_text, shares_text
        from odomcorrupt.report.text.tables import candidates_table

        found = self.result
        said = found_text(found.search, found.advice, judged=self._judged)
        parts = [candidates_table(found.search.rounds[0]), said]
        if found.search.added:
            parts.append(shares_text(found.sequence.judgements))
        return "\n\n".join([*parts, *([f"next: {self.following}"] if self.following else [])])

    def to_dict(self) -> dict[str, Any]:
        """Return what was found as docs/json.md describes it."""
        from odomcorrupt.report.json.diagnosis import learned_json

        found = self.result
        return learned_json(found.search, found.sequence.judgements, found.advice, judged=self._judged)

    def _figure(self) -> Figure:
        """Return the candidates with their evidence."""
        from odomcorrupt.report.plots.candidates import draw_candidates

        return draw_candidates(self.result.search)

    def report(self) -> str:
        """Return all of it as one page of HTML, pictures too."""
        from odomcorrupt import __version__
        from odomcorrupt.report.html.diagnosis import Story, found_html

        story = Story(self.result.search, self.result.sequence, self.result.advice, self.following)
        return found_html(story, version=__version__)


def diagnose(
    recordings: Recordings | PathLikes, model: ModelLike | None = None, *, watch: Watch = _silent
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
    runs = as_recordings(recordings).on_track(None if known is None else known.track_m)
    from odomcorrupt.study.pipeline import diagnose_model

    name = Path(fspath(model)).name if isinstance(model, str | PathLike) else "the model" if known else ""
    return Diagnosis(runs, diagnose_model(runs, known, name=name, watch=watch))


@dataclass(frozen=True, slots=True, repr=False)
class Learned(_Findings):
    """A robot's model with what was found on the way, and how it does on recordings it was not fitted to.

    recordings : what it was learned from
    result : everything that was computed
    following : the command to type next
    """

    recordings: Recordings
    result: LearnedRobot
    following: str = ""

    @property
    def _search(self) -> Search:
        return self.result.search

    @property
    def _advice(self) -> Advice:
        return self.result.advice

    @property
    def model(self) -> Model:
        """The model that was learned, as it can be used."""
        return Model.of(self.result.proof.model)

    @property
    def comparison(self) -> Comparison:
        """The model without and with what was found, on held-out recordings."""
        return Comparison(self.result.comparison)

    def summary(self) -> Summary:
        """Return what was found, how large and how probable it is, and the held-out errors without and with it."""
        from odomcorrupt.report.text.brief import findings_brief

        found = self.result
        return findings_brief(
            found.search,
            found.advice,
            found.comparison,
            fit=found.robot.fit,
            notes=(*found.dropped, *found.proof.changes, *self.recordings.notes),
            following=_next(self.following),
        )

    def details(self) -> str:
        """Return what was found, what is open, the fit, and the comparison in full."""
        from odomcorrupt.report.text.comparison import comparison_text
        from odomcorrupt.report.text.diagnosis import found_text
        from odomcorrupt.report.text.fit import fit_text

        found = self.result
        judged = found.comparison.judgements[-1]
        said = found_text(found.search, found.advice, judged=judged, fit=found.robot.fit)
        fitted = [fit_text(found.robot, clocks=False), *found.proof.changes]
        return "\n".join([said, *found.dropped, *fitted, "", comparison_text(found.comparison)])

    def to_dict(self) -> dict[str, Any]:
        """Return what was found, and the comparison, as docs/json.md describes them."""
        from odomcorrupt.report.json.diagnosis import learned_json

        found = self.result
        judged = found.comparison.judgements[-1]
        told = learned_json(found.search, found.sequence.judgements, found.advice, judged=judged, fit=found.robot.fit)
        return told | {"comparison": self.comparison.to_dict()}

    def draw(self, picture: str) -> Figure:
        """Return the errors without and with what was found; or another picture of a comparison by name."""
        return self.comparison.draw(picture)

    def report(self) -> str:
        """Return all of it as one page of HTML, pictures too."""
        from odomcorrupt import __version__
        from odomcorrupt.report.html.diagnosis import Story, found_html

        found = self.result
        return found_html(Story(found.search, found.sequence, found.advice, self.following), version=__version__)


def learn(
    recordings: Recordings | PathLikes,
    *,
    validate: Recordings | PathLikes = (),
    watch: Watch = _silent,
) -> Learned:
    """Learn which effects a robot has: fit, find what is missing, add it, until nothing is missing.

    Parameters
    ----------
    recordings : Recordings or paths
        Runs of one robot.
    validate : Recordings or paths, optional
        Recordings to judge the result on, read like the first ones; without any it is cross-validated.
    watch : callable
        Called with the name of each stage and the share of the work that is done.

    Returns
    -------
    Learned
        `model` is the robot's model; `print` says what was found and how the error changes.

    Raises
    ------
    FitError, RecordingError
        Where the recordings do not carry what a fit needs.

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
    others = as_recordings(held_out, like=runs) if held_out else ()
    from odomcorrupt.study.pipeline import learn_robot

    return Learned(runs, learn_robot(runs, others, watch=watch))
