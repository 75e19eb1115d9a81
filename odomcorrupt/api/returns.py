"""Square test: effects estimated from drives that end where they began, with odometry alone."""

from __future__ import annotations

from dataclasses import dataclass
from math import degrees
from typing import TYPE_CHECKING, Any

from odomcorrupt.api.model import Model
from odomcorrupt.api.recordings import PathLikes, as_paths
from odomcorrupt.api.result import Result
from odomcorrupt.errors import RecordingError
from odomcorrupt.extras import require
from odomcorrupt.summary import Line, Summary

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.study.estimate.returns import ReturnsFit

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
        from odomcorrupt.model.motion_model import MotionModel, Noise
        from odomcorrupt.model.noise_laws import Coefficients

        found = self.result
        names = [f"{e.name}.{p.name}" for e in found.effects for p in amplitudes(e)]
        return Model.of(
            MotionModel(
                noise=Noise("diffusion", Coefficients(0.0, 0.0, 0.0, 0.0)),
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


def fit_returns(
    paths: PathLikes,
    ends: Sequence[tuple[float, float, float]] = (END,),
    *,
    effects: Sequence[str] = (),
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
    effects : sequence of str
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
    require("scipy", "the study needs it", "study")
    import numpy as np

    from odomcorrupt.study.estimate.returns import USUAL, closed_drive
    from odomcorrupt.study.estimate.returns import fit_returns as fit
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
    return SquareTest(fit(drives, effects or USUAL))
