"""A motion model fitted to recordings, and effects fitted to drives that end where they began (a square test)."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import degrees
from typing import TYPE_CHECKING, Any

from odomcorrupt.api.model import Model, ModelLike, as_model
from odomcorrupt.api.recordings import PathLikes, Recordings, as_paths, as_recordings, require_travel
from odomcorrupt.api.result import Result
from odomcorrupt.errors import RecordingError
from odomcorrupt.extras import part_of_study
from odomcorrupt.summary import Line, Summary

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from odomcorrupt.study.estimate.calibrate import RobotFit
    from odomcorrupt.study.estimate.returns import ReturnsFit
    from odomcorrupt.study.validate.round_trip import RoundTrip


@dataclass(frozen=True, slots=True, repr=False)
class Fit(Result):
    """A motion model fitted to recordings.

    recordings : recordings fitted to
    result : model with confidence intervals, clocks, and the fit
    proof : the usable model, verified by reading it back, a correction and a corruption
    laws : fits of all laws if all were tried, the likeliest first
    following : suggested next command
    """

    recordings: Recordings
    result: RobotFit
    proof: RoundTrip
    laws: Mapping[str, RobotFit] = field(default_factory=dict)
    following: str = ""

    @property
    def model(self) -> Model:
        """The fitted model, in usable form."""
        return Model.of(self.proof.model)

    def summary(self) -> Summary:
        """Return the error on the fitted data, the noise and the effects."""
        from odomcorrupt.report.text.brief import fit_brief
        from odomcorrupt.report.text.limits import mistakes_first

        return mistakes_first(fit_brief(self.result, self.following), self.recordings.mistakes)

    def details(self) -> str:
        """Return all coefficients with their intervals, effects, clocks, and downweighted segments."""
        from odomcorrupt.report.text.diagnosis import fit_text, laws_table

        return "\n\n".join(
            [*([laws_table(self.laws)] if self.laws else []), fit_text(self.result), *self.proof.changes]
        )

    def to_dict(self) -> dict[str, Any]:
        """Return law, coefficients with intervals, effects, clocks and the error on the fitted data."""
        from odomcorrupt.report.json.diagnosis import fit_json

        return fit_json(self.result, self.laws)

    def rows(self) -> list[dict[str, Any]]:
        """Return one row per parameter: value and standard error."""
        errors = self.model.standard_errors
        return [
            {"parameter": name, "value": value, "standard_error": errors.get(name)}
            for name, value in self.model.parameters.items()
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

    Parameters
    ----------
    recordings : Recordings or paths
        Runs of one robot, each with its own clock offset.
    effects : str or sequence of str
        Names of effects to fit besides those of `start`.
    start : Model or path of a model file, optional
        Model that contributes effects to be refitted.
    law : str, optional
        Noise law, or "all" for the likeliest; by default that of `start`, or diffusion.

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
    from odomcorrupt.study.estimate.calibrate import effects_to_fit, fit_every_law, fit_robot
    from odomcorrupt.study.pipeline import LAW
    from odomcorrupt.study.validate.round_trip import verified_model

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
    from odomcorrupt.study.estimate.calibrate import effects_to_fit

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
        from odomcorrupt.effects.effect import amplitudes
        from odomcorrupt.model.motion_model import NOISE_FREE

        found = self.result
        names = [f"{e.name}.{p.name}" for e in found.effects for p in amplitudes(e)]
        return Model.of(
            replace(
                NOISE_FREE,
                effects=found.effects,
                track_m=found.recordings[0].track_m,
                standard_errors=dict(zip(names, map(float, found.standard_errors), strict=True)),
                source={"recordings": [r.name for r in found.recordings]},
            )
        )

    def summary(self) -> Summary:
        """Return the effects with standard errors, and the distance of the ends from the start before and after."""
        from odomcorrupt.report.findings import effects_with_errors
        from odomcorrupt.report.text.numbers import numbers_text

        found = self.result
        lines = [
            Line("" if i else "FITTED", f"{effect.name}  {', '.join(numbers_text(effect, errors))}", "good")
            for i, (effect, errors) in enumerate(effects_with_errors(found))
        ]
        before, after = (self._rms(ends) for ends in (found.before, found.after))
        lines.append(Line("ends", f"{before} -> {after} (RMS of {len(found.before)} drives)"))
        if all(abs(row["value"]) < 2.0 * row["standard_error"] for row in self.rows()):
            lines.append(Line("none", "no effect exceeds two standard errors: these ends show none", "warning"))
        unseen = "travel: a closed path does not show wheel_scale; drive a straight of measured length"
        return Summary((*lines, Line("open", unseen, "warning")))

    def details(self) -> str:
        """Return the summary, and the end of every drive before and after."""
        lines = [self.summary().text()]
        for drive, before, after in zip(self.result.recordings, self.result.before, self.result.after, strict=True):
            said = " -> ".join(self._end(end) for end in (before, after))
            lines.append(f"  {drive.name}: {said}")
        return "\n".join(lines)

    def to_dict(self) -> dict[str, Any]:
        """Return effects with standard errors, and the ends before and after, m and rad."""
        return {
            "schema": 2,
            "parameters": {row["parameter"]: row for row in self.rows()},
            "ends_before": self.result.before.tolist(),
            "ends_after": self.result.after.tolist(),
            "spread": self.result.spread,
        }

    def rows(self) -> list[dict[str, Any]]:
        """Return one row per parameter: value and standard error."""
        errors = self.model.standard_errors
        return [
            {"parameter": name, "value": value, "standard_error": errors[name]}
            for name, value in self.model.parameters.items()
            if name in errors
        ]

    @staticmethod
    def _end(end: Any) -> str:
        along, across, yaw = end.tolist()
        return f"{1e3 * along:.1f} mm along, {1e3 * across:.1f} mm across, {degrees(yaw):.2f} deg"

    @staticmethod
    def _rms(ends: Any) -> str:
        import numpy as np

        distance = float(np.sqrt(np.mean(np.sum(ends[:, :2] ** 2, axis=1))))
        return f"{1e3 * distance:.1f} mm, {np.degrees(np.sqrt(np.mean(ends[:, 2] ** 2))):.2f} deg"


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

    Parameters
    ----------
    paths : path or several
        Bags, TUM or CSV files with odometry, one drive each, in both directions of rotation.
    ends : sequence of (float, float, float)
        True end poses relative to the start: m, m, rad; one for all, or one for each.
    effects : str or sequence of str
        Effects to fit, unequal_wheels and wheelbase by default.
    odom : str, optional
        Topic of the odometry, if there are several.
    track_m : float, optional
        Nominal distance between the wheels, metres.
    scan : str, optional
        Topic of laser scans: the end is measured by matching the last sweeps with the first, instead of `ends`.

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
    import numpy as np

    from odomcorrupt.study.estimate.returns import USUAL, closed_drive
    from odomcorrupt.study.estimate.returns import fit_returns as fit_ends
    from odomcorrupt.study.io import Source
    from odomcorrupt.study.io.laser_truth import end_seen
    from odomcorrupt.study.io.reader import read_odometry

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
