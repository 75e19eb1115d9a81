"""The study: a model fitted to recordings, models compared on measurements, and the effects that a model lacks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import degrees
from os import PathLike, fspath
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from odomcorrupt.api.model import Model, ModelLike, as_model
from odomcorrupt.api.recordings import PathLikes, Recordings, as_paths, as_recordings, require_travel
from odomcorrupt.api.result import Result
from odomcorrupt.effects.effect import amplitudes
from odomcorrupt.errors import ModelError, OdomCorruptError, RecordingError
from odomcorrupt.extras import part_of_study
from odomcorrupt.model.motion_model import NOISE_FREE
from odomcorrupt.report import findings as texts
from odomcorrupt.report.comparison import comparison_brief, comparison_json, comparison_text, reproduction_sentence
from odomcorrupt.report.plain import picked
from odomcorrupt.result_files import refuse_existing, write_file
from odomcorrupt.study.design.plan import drive_bag
from odomcorrupt.study.estimate.calibrate import effects_to_fit, fit_every_law, fit_robot
from odomcorrupt.study.estimate.returns import USUAL, closed_drive
from odomcorrupt.study.estimate.returns import fit_returns as fit_ends
from odomcorrupt.study.io import Source
from odomcorrupt.study.io.laser_truth import end_seen
from odomcorrupt.study.io.reader import read_odometry
from odomcorrupt.study.pipeline import LAW, diagnose_model, learn_robot
from odomcorrupt.study.select.decisions import DECISIONS
from odomcorrupt.study.validate.compare import agreement_of
from odomcorrupt.study.validate.compare import compare as compare_models
from odomcorrupt.study.validate.round_trip import verified_model
from odomcorrupt.summary import Line, Summary

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from odomcorrupt.model.motion_model import MotionModel, Origin
    from odomcorrupt.study.estimate.calibrate import RobotFit
    from odomcorrupt.study.estimate.returns import ReturnsFit
    from odomcorrupt.study.io.recording import Mistake
    from odomcorrupt.study.pipeline import DiagnosedModel, LearnedRobot
    from odomcorrupt.study.select.decisions import Decisions
    from odomcorrupt.study.select.selection import Watch
    from odomcorrupt.study.validate.compare import Comparison as ModelComparison
    from odomcorrupt.study.validate.compare import ModelEvaluation
    from odomcorrupt.study.validate.round_trip import RoundTrip


@dataclass(frozen=True, slots=True, repr=False)
class Fit(Result):
    """A motion model fitted to recordings.

    recordings : recordings fitted to
    result : model with confidence intervals, clocks, and the fit
    proof : the usable model, verified by reading it back, a correction and a corruption
    laws : fits of all laws if all were tried, the likeliest first
    """

    recordings: Recordings
    result: RobotFit
    proof: RoundTrip
    laws: Mapping[str, RobotFit] = field(default_factory=dict)

    @property
    def model(self) -> Model:
        """The fitted model, in usable form."""
        return Model.of(self.proof.model)

    def summary(self) -> Summary:
        """Return the error on the fitted data, the noise and the effects."""
        return texts.mistakes_first(texts.fit_brief(self.result), self.recordings.mistakes)

    def details(self) -> str:
        """Return all coefficients with their intervals, effects, clocks, and downweighted segments."""
        table = [texts.laws_table(self.laws)] if self.laws else []
        return "\n\n".join([*table, texts.fit_text(self.result), *self.proof.changes])

    def _values(self) -> dict[str, Any]:
        return texts.fit_json(self.result, self.laws)

    def rows(self) -> list[dict[str, Any]]:
        """Return one row per parameter: value and standard error."""
        return _parameters(self.model)


def _parameters(model: Model) -> list[dict[str, Any]]:
    errors = model.standard_errors
    return [
        {"parameter": name, "value": value, "standard_error": errors.get(name)}
        for name, value in model.parameters.items()
    ]


@part_of_study
def fit(
    recordings: Recordings | PathLikes,
    effects: str | Sequence[str] = (),
    *,
    start: ModelLike | None = None,
    law: str | None = None,
) -> Fit:
    """Fit a robot's motion model to recordings: noise, noise of the truth, clocks, set-up, and the requested effects.

    recordings : runs of one robot, each with its own clock offset
    effects : names of effects to fit besides those of `start`
    start : model or model file that contributes effects to be refitted
    law : noise law, or "all" for the likeliest; by default that of `start`, or diffusion

    Returns
    -------
    Fit
        `model` is the model; `to_pandas()` its parameters with standard errors.

    Raises
    ------
    EffectError
        If an effect is unknown or cannot be fitted in this way.
    FitError
        If the recordings are not sufficient for a fit.

    Examples
    --------
    >>> import odomcorrupt as oc
    >>> result = oc.fit("fixtures/mystery.mcap", ["wheel_scale"])
    >>> "wheel_scale.e" in result.model.parameters
    True
    """
    begin = None if start is None else as_model(start).motion_model
    wanted = effects_to_fit(begin, (effects,) if isinstance(effects, str) else effects)
    law_name = law or (LAW if begin is None else begin.noise.law_name)
    runs = require_travel(as_recordings(recordings))
    if begin is not None:
        runs = runs.on_track(begin.track_m).of_drive_type(begin.setup.drive_type).in_frame(begin.setup.origin)
    if law_name == "all":
        laws = fit_every_law(runs, wanted, start=begin)
        best = next(iter(laws.values()))
        return Fit(runs, best, verified_model(best.model, runs), laws)
    best = fit_robot(runs, wanted, law_name=law_name, start=begin)
    return Fit(runs, best, verified_model(best.model, runs))


@part_of_study
def require_effects(start: Model | None, effects: Sequence[str]) -> None:
    """Raise EffectError if one of the effects cannot be fitted; called before recordings are read."""
    effects_to_fit(None if start is None else start.motion_model, effects)


END = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True, repr=False)
class SquareTest(Result):
    """Systematic errors estimated from the end poses of drives.

    result : complete numerical result
    """

    result: ReturnsFit

    @property
    def model(self) -> Model:
        """The effects as a model without noise, which a few end poses cannot determine."""
        found = self.result
        names = [f"{e.name}.{p.name}" for e in found.effects for p in amplitudes(e)]
        errors = dict(zip(names, map(float, found.standard_errors), strict=True))
        source = {"recordings": [r.name for r in found.recordings]}
        track_m = found.recordings[0].track_m
        model = replace(NOISE_FREE, effects=found.effects, track_m=track_m, standard_errors=errors, source=source)
        return Model.of(model)

    def summary(self) -> Summary:
        """Return the effects with standard errors, and the distance of the ends from the start before and after."""
        found = self.result
        lines = [
            Line("" if i else "FITTED", f"{effect.name}  {', '.join(texts.numbers_text(effect, errors))}", "good")
            for i, (effect, errors) in enumerate(texts.effects_with_errors(found))
        ]
        before, after = (_rms(ends) for ends in (found.before, found.after))
        lines.append(Line("ends", f"{before} -> {after} (RMS of {len(found.before)} drives)"))
        if all(abs(row["value"]) < 2.0 * row["standard_error"] for row in self.rows()):
            lines.append(Line("none", "no effect exceeds two standard errors: these ends show none", "warning"))
        unseen = "travel: a closed path does not show wheel_scale; drive a straight of measured length"
        return Summary((*lines, Line("open", unseen, "warning")))

    def details(self) -> str:
        """Return the summary, and the end of every drive before and after."""
        lines = [self.summary().text()]
        for drive, before, after in zip(self.result.recordings, self.result.before, self.result.after, strict=True):
            said = " -> ".join(_end(end) for end in (before, after))
            lines.append(f"  {drive.name}: {said}")
        return "\n".join(lines)

    def _values(self) -> dict[str, Any]:
        return {
            "parameters": {row["parameter"]: row for row in self.rows()},
            "ends_before": self.result.before,
            "ends_after": self.result.after,
            "spread": self.result.spread,
        }

    def rows(self) -> list[dict[str, Any]]:
        """Return one row per parameter: value and standard error."""
        return [row for row in _parameters(self.model) if row["standard_error"] is not None]


def _end(end_xyt: Any) -> str:
    along, across, yaw = end_xyt.tolist()
    return f"{1e3 * along:.1f} mm along, {1e3 * across:.1f} mm across, {degrees(yaw):.2f} deg"


def _rms(ends_xyt: Any) -> str:
    distance = float(np.sqrt(np.mean(np.sum(ends_xyt[:, :2] ** 2, axis=1))))
    return f"{1e3 * distance:.1f} mm, {np.degrees(np.sqrt(np.mean(ends_xyt[:, 2] ** 2))):.2f} deg"


@part_of_study
def fit_returns(
    paths: PathLikes,
    ends: Sequence[tuple[float, float, float]] = (END,),
    *,
    effects: str | Sequence[str] = (),
    odom: str | None = None,
    track_m: float | None = None,
    scan: str | None = None,
) -> SquareTest:
    """Fit systematic errors to drives that end where they began, or at a known pose: a square test on any path.

    paths : bags, TUM or CSV files with odometry, one drive each, in both directions of rotation
    ends : true end poses relative to the start: m, m, rad; one for all, or one for each
    effects : effects to fit, unequal_wheels and wheelbase by default
    odom : topic of the odometry, if there are several
    track_m : nominal distance between the wheels, metres
    scan : topic of laser scans: the end is measured by matching the last sweeps with the first, instead of `ends`

    Returns
    -------
    SquareTest
        `model` has the effects; `details()` the end of every drive before and after.

    Raises
    ------
    FitError
        If the drives do not separate the effects.
    RecordingError
        If the last sweeps of a drive do not match its first.
    """
    files = as_paths(paths)
    if len(ends) not in (1, len(files)):
        raise RecordingError(f"{len(ends)} ends for {len(files)} drives; give one for all, or one for each")
    each = list(ends) if len(ends) > 1 else list(ends) * len(files)
    drives = []
    for path, end in zip(files, each, strict=True):
        odometry, track = read_odometry(Source(path, odom=odom, track_m=track_m))
        real = np.array(end) if scan is None else end_seen(path, path.name, odom, scan)
        drives.append(closed_drive(path.name, odometry, real, track))
    return SquareTest(fit_ends(drives, (effects,) if isinstance(effects, str) else effects or USUAL))


@dataclass(frozen=True, slots=True, repr=False)
class Comparison(Result):
    """Comparison of models with measurements: measured and expected errors, and each model's lack of fit.

    result : complete numerical result
    mistakes : plain mistakes of wiring, units, signs and axes in the recordings
    """

    result: ModelComparison
    mistakes: tuple[Mistake, ...] = ()

    @property
    def rejected(self) -> bool:
        """Whether the data reject the last model, however small the deviation."""
        return self.result.evaluations[-1].verdict.rejected

    @property
    def fails(self) -> bool:
        """Whether the deviation matters: errors are 1.25 times larger or smaller than the last model predicts."""
        return self.result.evaluations[-1].verdict.fails

    @property
    def worse(self) -> bool:
        """Whether the last model predicts these data worse than the first, by some measures and better by none."""
        return agreement_of(self.result).verdict == "worse"

    def summary(self) -> Summary:
        """Return whether the last model is better than the first by all measures, and one line per model."""
        return texts.mistakes_first(comparison_brief(self.result), self.mistakes)

    def details(self) -> str:
        """Return clocks, the table of horizons, the models in order, and all lack of fit."""
        lines = texts.clock_lines(self.result.recordings, self.result.clocks)
        return "\n".join([*lines, comparison_text(self.result)])

    def _values(self) -> dict[str, Any]:
        return comparison_json(self.result)

    def rows(self) -> list[dict[str, Any]]:
        """Return one row per model: errors in metres, log likelihood in nats per metre, whether it is rejected."""
        names = {"model": "name", "error_10s_m": "ten_second_error_m", "nats_per_m": "nats.per_m"}
        names |= {"nats_per_m_error": "nats.error", "ate_m": "trajectory.ate_m", "rpe_1m_m": "trajectory.rpe_m"}
        return [picked(j, **names, rejected="verdict.rejected") for j in self.result.evaluations]

    def report(self) -> str:
        """Return the comparison as a self-contained HTML page with tables and figures, usable offline."""
        from odomcorrupt.report.html import report_html

        return report_html(self.result)

    def draw(self, picture: str) -> Figure:
        """Return a figure by name: error (against distance; also ""), path, nees, residuals, map or pit."""
        from odomcorrupt.report.plots.comparison import PICTURES

        if (picture or "error") not in PICTURES:
            raise OdomCorruptError(f"no picture is called {picture!r}; there are {', '.join(PICTURES)}")
        return PICTURES[picture or "error"].draw(self.result)


@part_of_study
def compare(
    recordings: Recordings | PathLikes, models: ModelLike | Sequence[ModelLike] | Mapping[str, ModelLike]
) -> Comparison:
    """Compare models with measurements, and locate their lack of fit.

    Recordings to which a model was fitted, under any name, cross-validate it: it is refitted without each of them, or
    without each half of the only one, and evaluated on it.

    recordings : recordings to evaluate on
    models : models, paths of model files, or names of presets; the others are compared with the first

    Returns
    -------
    Comparison
        `to_pandas()` has one row per model.

    Raises
    ------
    ModelError
        If there is no model, or a file is not a model.

    Examples
    --------
    >>> import odomcorrupt as oc
    >>> rec = oc.read_recordings("fixtures/mystery_other.mcap")
    >>> table = oc.compare(rec, ["typical", oc.Model(oc.Noise(alpha=(0.1, 0.1, 0.1, 0.1)))]).rows()
    >>> [row["model"] for row in table]
    ['typical', 'model 2']
    """
    named = named_models(models)
    robots = {name: model.motion_model for name, model in named.items()}
    track = next((robot.track_m for robot in robots.values() if robot.track_m is not None), None)
    drive_type = next((robot.setup.drive_type for robot in robots.values() if robot.setup.drive_type), "")
    runs = require_travel(as_recordings(recordings)).on_track(track).of_drive_type(drive_type)
    runs = runs.in_frame(_shared_origin(robots))
    found = compare_models(runs, robots)
    return Comparison(found, mistakes=runs.mistakes)


def _shared_origin(models: Mapping[str, MotionModel]) -> Origin | None:
    """Return the common origin of the positions in all models; None if no model states one."""
    origins = {name: model.setup.origin for name, model in models.items() if model.setup.origin}
    placed = {origins[n] for n in origins if any(e.reads_places for e in models[n].effects)}
    if len(placed) > 1:
        raise ModelError(
            f"{', '.join(origins)}: position-dependent effects with different origins; compare one model at a time"
        )
    return next(iter([*placed, *origins.values()]), None)


def named_models(models: ModelLike | Sequence[ModelLike] | Mapping[str, ModelLike]) -> dict[str, Model]:
    """Return models by name: for files the file name if unique, else the path; "model N" for others."""
    if isinstance(models, Mapping):
        return {name: as_model(model) for name, model in models.items()}
    given = list(models) if isinstance(models, Sequence) and not isinstance(models, str) else [models]
    if not given:
        raise ModelError("no model given; name one or more .toml files that `odomcorrupt fit` wrote")
    full = [fspath(m) if isinstance(m, str | PathLike) else f"model {i}" for i, m in enumerate(given, start=1)]
    short = [Path(name).name for name in full]
    names = short if len(set(short)) == len(short) else full
    if len(set(names)) < len(names):
        raise ModelError(f"models: {', '.join(names)}; the same model is named twice")
    return {name: as_model(model) for name, model in zip(names, given, strict=True)}


@dataclass(frozen=True, slots=True, repr=False)
class Findings(Result):
    """Result of a search for missing effects; base class of `Diagnosis` and `Learned`.

    recordings : recordings searched
    result : complete numerical result
    """

    recordings: Recordings
    result: DiagnosedModel | LearnedRobot

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

        path : MCAP to write
        overwrite : whether an existing file is replaced

        Returns
        -------
        str
            Description of the drive; "" if no drive would decide anything, in which case no file is written.
        """
        target = Path(fspath(path))
        refuse_existing(target, overwrite=overwrite)
        plan = self.result.advice.best
        if plan is None:
            return ""
        write_file(target, drive_bag(plan))
        return texts.drive_sentence(plan)

    def report(self) -> str:
        """Return the findings as a self-contained HTML page with tables and figures, usable offline."""
        from odomcorrupt.report.html import found_html

        return found_html(self.result.search, self.result.sequence, self.result.advice, self.following, self.summary())


@dataclass(frozen=True, slots=True, repr=False)
class Diagnosis(Findings):
    """Effects that a model lacks."""

    result: DiagnosedModel

    @property
    def _evaluated(self) -> ModelEvaluation | None:
        # the sequence contains no noise term: its lack of fit may be due to the noise found
        return None if self.result.search.noise else self.result.sequence.evaluations[-1]

    def _values(self) -> dict[str, Any]:
        found = self.result
        return texts.learned_json(found.search, found.sequence.evaluations, found.advice, evaluated=self._evaluated)

    def summary(self) -> Summary:
        """Return the missing effects, their size and probability, and the gain of each."""
        found = self.result
        notes, alerts = self.recordings.notes, self.recordings.alerts
        brief = texts.findings_brief(found.search, found.advice, found.sequence, notes=notes, alerts=alerts)
        brief = texts.mistakes_first(brief, self.recordings.mistakes)
        if all(run.positioned for run in self.recordings):
            return brief
        said = "wheels and a gyro alone do not show it: wheel_scale, speed_scale and similar effects are not testable"
        return brief._replace(lines=(*brief.lines, Line("travel", said, "warning")))

    def details(self) -> str:
        """Return the candidates, the findings, the gain of each addition, and undecided alternatives."""
        found = self.result
        said = texts.found_text(found.search, found.advice, evaluated=self._evaluated)
        shares = texts.shares_text(found.sequence.evaluations)
        return "\n\n".join(filter(None, [texts.candidates_table(found.search.rounds[0]), said, shares]))

    def _figure(self) -> Figure:
        from odomcorrupt.report.plots.comparison import draw_candidates

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

    recordings : runs of one robot
    model : model or model file, the known part of the model; None for noise alone
    decisions : thresholds of inclusion, replacement and removal of effects; None for the
        defaults, `odomcorrupt.study.select.decisions.DECISIONS`
    watch : called with the name of each stage and the completed share of the work

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
    runs = require_travel(as_recordings(recordings), turns=True)
    if known is not None:
        runs = runs.on_track(known.track_m).of_drive_type(known.setup.drive_type).in_frame(known.setup.origin)
    name = Path(fspath(model)).name if isinstance(model, str | PathLike) else "the model" if known else ""
    return Diagnosis(runs, diagnose_model(runs, known, name=name, decisions=decisions or DECISIONS, watch=watch))


@dataclass(frozen=True, slots=True, repr=False)
class Learned(Findings):
    """Learned model of a robot, the findings of the search, and its held-out evaluation."""

    result: LearnedRobot

    @property
    def model(self) -> Model:
        """The learned model, in usable form."""
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

    def summary(self) -> Summary:
        """Return the findings, their size and probability, and the held-out errors without and with them."""
        found = self.result
        notes = replace(self.recordings, runs=tuple(found.recordings)).notes
        brief = texts.findings_brief(
            found.search, found.advice, found.comparison, robot=found.robot, reproduction=found.reproduction,
            written=found.proof.model, notes=(*found.dropped, *found.proof.changes, *notes),
            alerts=(*found.alerts, *self.recordings.alerts),
        )  # fmt: skip
        return texts.mistakes_first(brief, self.recordings.mistakes)

    def details(self) -> str:
        """Return the findings, undecided alternatives, the fit, and the full comparison."""
        found = self.result
        said = texts.found_text(found.search, found.advice, **self._final)
        fitted = [texts.fit_text(found.robot, clocks=False), *found.proof.changes]
        drifts = [one for one in (reproduction_sentence(found.reproduction),) if one]
        return "\n".join([said, *drifts, *found.alerts, *found.dropped, *fitted, "", comparison_text(found.comparison)])

    def _values(self) -> dict[str, Any]:
        found = self.result
        values = texts.learned_json(found.search, found.sequence.evaluations, found.advice, **self._final)
        values["reproduction"] = texts.reproduction_json(found.reproduction)
        return values | {"comparison": self.comparison.to_dict()}

    @property
    def _final(self) -> dict[str, Any]:
        return {"evaluated": self.result.comparison.evaluations[-1], "fit": self.result.robot.fit}

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

    recordings : runs of one robot
    validate : recordings to evaluate the result on, read like the first ones; if none, the result is cross-validated
    decisions : thresholds of inclusion, replacement and removal of effects; None for the
        defaults, `odomcorrupt.study.select.decisions.DECISIONS`
    watch : called with the name of each stage and the completed share of the work

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
    return Learned(runs, learn_robot(runs, others, decisions=decisions or DECISIONS, watch=watch))
