"""A motion model fitted to recordings."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from odomcorrupt.api.model import Model, ModelLike, as_model
from odomcorrupt.api.recordings import PathLikes, Recordings, as_recordings, require_travel
from odomcorrupt.api.result import Result
from odomcorrupt.extras import require

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from odomcorrupt.study.estimate.calibrate import RobotFit
    from odomcorrupt.study.validate.round_trip import RoundTrip
    from odomcorrupt.summary import Summary


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

        return fit_brief(self.result, self.following)

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


def fit(
    recordings: Recordings | PathLikes,
    effects: Sequence[str] = (),
    *,
    start: ModelLike | None = None,
    law: str | None = None,
) -> Fit:
    """Fit a robot's motion model to recordings: noise, noise of the truth, clocks, set-up, and the requested effects.

    Parameters
    ----------
    recordings : Recordings or paths
        Runs of one robot, each with its own clock offset.
    effects : sequence of str
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
    wanted = effects_to_fit(begin, effects)
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


def require_effects(start: Model | None, effects: Sequence[str]) -> None:
    """Raise EffectError if one of the effects cannot be fitted; called before recordings are read."""
    require("scipy", "the study needs it", "study")
    from odomcorrupt.study.estimate.calibrate import effects_to_fit

    effects_to_fit(None if start is None else start.motion_model, effects)
