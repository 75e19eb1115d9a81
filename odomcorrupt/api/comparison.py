"""Comparison of models on measurements."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from os import PathLike, fspath
from pathlib import Path
from typing import TYPE_CHECKING, Any

from odomcorrupt.api.model import Model, ModelLike, as_model
from odomcorrupt.api.recordings import PathLikes, Recordings, as_recordings, require_travel
from odomcorrupt.api.result import Result
from odomcorrupt.errors import ModelError, OdomCorruptError
from odomcorrupt.extras import part_of_study

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from odomcorrupt.model.motion_model import Origin
    from odomcorrupt.study.io.recording import Mistake
    from odomcorrupt.study.validate.compare import Comparison as ModelComparison
    from odomcorrupt.summary import Summary


@dataclass(frozen=True, slots=True, repr=False)
class Comparison(Result):
    """Comparison of models with measurements: measured and expected errors, and each model's lack of fit.

    result : complete numerical result
    following : suggested next command
    mistakes : plain mistakes of wiring, units, signs and axes in the recordings
    """

    result: ModelComparison
    following: str = ""
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
        from odomcorrupt.study.validate.compare import agreement_of

        return agreement_of(self.result).verdict == "worse"

    def summary(self) -> Summary:
        """Return whether the last model is better than the first by all measures, and one line per model."""
        from odomcorrupt.report.text.comparison import comparison_brief
        from odomcorrupt.report.text.limits import mistakes_first

        return mistakes_first(comparison_brief(self.result, self.following), self.mistakes)

    def details(self) -> str:
        """Return clocks, the table of horizons, the models in order, and all lack of fit."""
        from odomcorrupt.report.text.comparison import comparison_text
        from odomcorrupt.report.text.numbers import clock_lines

        lines = clock_lines(self.result.recordings, self.result.clocks)
        return "\n".join([*lines, comparison_text(self.result)])

    def to_dict(self) -> dict[str, Any]:
        """Return the comparison as docs/json.md describes it."""
        from odomcorrupt.report.json.comparison import comparison_json

        return comparison_json(self.result)

    def rows(self) -> list[dict[str, Any]]:
        """Return one row per model: errors in metres, log likelihood in nats per metre, whether it is rejected."""
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
            for j in self.result.evaluations
        ]

    def report(self) -> str:
        """Return the comparison as a self-contained HTML page with tables and figures, usable offline."""
        from odomcorrupt import __version__
        from odomcorrupt.report.html.comparison import report_html

        return report_html(self.result, version=__version__)

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

    Parameters
    ----------
    recordings : Recordings or paths
        Recordings to evaluate on.
    models : one model, several, or several by name
        Models, paths of model files, or names of presets; the others are compared with the first.

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
    track = next((m.motion_model.track_m for m in named.values() if m.motion_model.track_m is not None), None)
    drive_type = next((m.motion_model.setup.drive_type for m in named.values() if m.motion_model.setup.drive_type), "")
    runs = (
        require_travel(as_recordings(recordings))
        .on_track(track)
        .of_drive_type(drive_type)
        .in_frame(_shared_origin(named))
    )
    from odomcorrupt.study.validate.compare import compare as compare_models

    found = compare_models(runs, {name: model.motion_model for name, model in named.items()})
    return Comparison(found, mistakes=runs.mistakes)


def _shared_origin(models: Mapping[str, Model]) -> Origin | None:
    """Return the common origin of the positions in all models; None if no model states one."""
    origins = {name: m.motion_model.setup.origin for name, m in models.items() if m.motion_model.setup.origin}
    placed = {origins[n] for n in origins if any(e.reads_places for e in models[n].motion_model.effects)}
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
