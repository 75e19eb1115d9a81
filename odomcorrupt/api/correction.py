"""Measured odometry without its systematic errors."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from os import PathLike, fspath
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Unpack

from odomcorrupt.api.bag_options import bag_path, split_options
from odomcorrupt.api.model import as_model
from odomcorrupt.api.result import Result
from odomcorrupt.errors import OdomCorruptError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from matplotlib.figure import Figure

    from odomcorrupt.api.bag_options import BagOptions
    from odomcorrupt.api.model import ModelLike
    from odomcorrupt.bags.block import Block
    from odomcorrupt.correction.run import Corrected
    from odomcorrupt.corruption.drift import Drift
    from odomcorrupt.report.text.summary import Summary

__all__ = ["Correction", "correct"]


@dataclass(frozen=True, slots=True, repr=False)
class Correction(Result):
    """What correction took out of measured odometry.

    source, target : the bags
    outcome : all that is known of it
    """

    source: str
    target: str
    outcome: Corrected

    @property
    def drift(self) -> Drift:
        """By how much the odometry was moved (drawn), and what the noise is still expected to do (expected)."""
        return self.outcome.run.drift

    @property
    def losses(self) -> tuple[str, ...]:
        """What could not be read of a damaged input, in sentences."""
        return self.outcome.run.losses

    def summary(self) -> Summary:
        """Return what was taken out, how far that moved the odometry, and what remains."""
        from odomcorrupt.correction.summary import brief

        return brief(self.outcome, self.target)

    def details(self) -> str:
        """Return all of it in one paragraph."""
        from odomcorrupt.correction.summary import correction_summary

        return correction_summary(self.outcome)

    def to_dict(self) -> dict[str, Any]:
        """Return the effects taken out and left, what was moved, and by how much."""
        from odomcorrupt.report.json.numbers import finite

        outcome = self.outcome
        return finite(
            {
                "schema": 2,
                "input": self.source,
                "output": self.target,
                "taken_out": [effect.name for effect in outcome.effects.undone],
                "left": [effect.name for effect in outcome.effects.left],
                "odometry": outcome.run.odometry,
                "moved": {**outcome.run.changes.odometry, **outcome.run.changes.edges},
                "drift": asdict(outcome.run.drift),
                "losses": list(outcome.run.losses),
            }
        )

    def rows(self) -> list[dict[str, Any]]:
        """Return each effect and whether it was taken out."""
        undone, left = self.outcome.effects.undone, self.outcome.effects.left
        return [{"effect": e.name, "taken_out": e in undone} for e in (*undone, *left)]

    def _figure(self) -> Figure:
        """Return the measured path and the corrected one, read from the two bags."""
        from odomcorrupt.report.plots.paths import draw_corruption
        from odomcorrupt.trajectories.reader import read_drive

        before, after = (read_drive(Path(path), self.outcome.run.odometry) for path in (self.source, self.target))
        return draw_corruption(before.xyt, after.xyt, Path(self.target).name, names=("measured", "corrected"))


def correct(
    source: str | PathLike[str],
    target: str | PathLike[str],
    *,
    model: ModelLike | None = None,
    start_xyt: Sequence[float] | Literal["odom"] | None = None,
    watch: Callable[[Block], None] = lambda _: None,
    **options: Unpack[BagOptions],
) -> Correction:
    """Take the systematic effects of a model out of measured odometry.

    Parameters
    ----------
    source, target : path
        Bags; the source is read twice and cannot be a pipe, the target may be "-".
    model : Model or path of a model file
        As `fit` and `learn` make it; None copies the bag.
    start_xyt : (3,) or "odom", optional
        Where the odometry begins in the frame whose places effects read, metres and radians; "odom": that frame is the
        odometry's own. Needed for a learned model with such effects.
    watch : callable
        Called with every block written.
    **options
        See `BagOptions`.

    Returns
    -------
    Correction
        What was taken out and what cannot be, and by how much that moved the odometry.

    Raises
    ------
    BagError, TopicError, EffectError
        Where a bag cannot be read or written, there is no odometry, or no true motion explains it; where effects of
        places were learned and no start is given.

    Examples
    --------
    >>> import odomcorrupt as oc
    >>> model = oc.Model(effects=["wheelbase:e=2%"], track_m=0.3)
    >>> done = oc.correct("fixtures/office.mcap", "corrected.mcap", model=model, overwrite=True)
    >>> [effect.name for effect in done.outcome.effects.undone]
    ['wheelbase']

    """
    import numpy as np

    from odomcorrupt.correction.run import SILENT, correct_bag, require_start

    before = bag_path(source)
    if before is None:
        raise OdomCorruptError("-: correction reads a bag twice, which a pipe cannot give; name a file")
    moved, container = split_options(options)
    robot = SILENT if model is None else as_model(model).motion_model
    if start_xyt is None:
        require_start(robot)
    start = None if start_xyt is None or start_xyt == "odom" else np.array(start_xyt, dtype=np.float64)
    outcome = correct_bag(
        before, bag_path(target), robot, options=moved, container=container, start_xyt=start, watch=watch
    )
    return Correction(fspath(source), fspath(target), outcome)
