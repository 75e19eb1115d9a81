"""A robot's model, learned from recordings."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from odomcorrupt.api.comparison import Comparison
from odomcorrupt.api.diagnosis import Findings
from odomcorrupt.api.model import Model
from odomcorrupt.api.recordings import PathLikes, Recordings, as_recordings, require_travel

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from odomcorrupt.study.estimate.gauss_newton import Fit as ModelFit
    from odomcorrupt.study.pipeline import LearnedRobot
    from odomcorrupt.study.validate.compare import Judgement
    from odomcorrupt.study.work import Watch
    from odomcorrupt.summary import Summary


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
    def _evaluated(self) -> Judgement:
        return self.result.comparison.judgements[-1]

    @property
    def _fit(self) -> ModelFit:
        return self.result.robot.fit

    def summary(self) -> Summary:
        """Return the findings, their size and probability, and the held-out errors without and with them."""
        from odomcorrupt.report.text.brief import findings_brief

        found = self.result
        return findings_brief(
            found.search,
            found.advice,
            found.comparison,
            fit=self._fit,
            robot=found.robot,
            reproduction=found.reproduction,
            written=found.proof.model,
            notes=(*found.dropped, *found.proof.changes, *replace(self.recordings, runs=tuple(found.recordings)).notes),
            alerts=self.recordings.alerts,
            following=self.following,
        )

    def details(self) -> str:
        """Return the findings, undecided alternatives, the fit, and the full comparison."""
        from odomcorrupt.report.text.comparison import comparison_text, reproduction_sentence
        from odomcorrupt.report.text.diagnosis import fit_text, found_text

        found = self.result
        said = found_text(found.search, found.advice, evaluated=self._evaluated, fit=self._fit)
        fitted = [fit_text(found.robot, clocks=False), *found.proof.changes]
        drifts = [one for one in (reproduction_sentence(found.reproduction),) if one]
        return "\n".join([said, *drifts, *found.dropped, *fitted, "", comparison_text(found.comparison)])

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


def learn(
    recordings: Recordings | PathLikes,
    *,
    validate: Recordings | PathLikes = (),
    watch: Watch = lambda _stage, _share: None,
) -> Learned:
    """Learn a robot's effects: fit, search for a missing effect, add it, and repeat until none is missing.

    Parameters
    ----------
    recordings : Recordings or paths
        Runs of one robot.
    validate : Recordings or paths, optional
        Recordings to evaluate the result on, read like the first ones; if none, the result is cross-validated.
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

    return Learned(runs, learn_robot(runs, others, watch=watch))
