"""Correction of systematic errors in measured odometry."""

from __future__ import annotations

from dataclasses import dataclass
from os import PathLike, fspath
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Unpack

import numpy as np

from odomcorrupt.api.bag_options import BagOptions, bag_path, split_options
from odomcorrupt.api.model import ModelLike, as_model
from odomcorrupt.api.result import Result
from odomcorrupt.correction.run import NOISE_FREE, Corrected, correct_bag, require_start
from odomcorrupt.correction.summary import brief, correction_summary
from odomcorrupt.errors import OdomCorruptError
from odomcorrupt.report.json.numbers import finite

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from matplotlib.figure import Figure

    from odomcorrupt.bags.block import Block
    from odomcorrupt.corruption.drift import Drift
    from odomcorrupt.summary import Summary


@dataclass(frozen=True, slots=True, repr=False)
class Correction(Result):
    """Result of a correction of measured odometry.

    source, target : the bags
    outcome : complete result
    """

    source: str
    target: str
    outcome: Corrected

    @property
    def drift(self) -> Drift:
        """Change of the odometry (`drawn`), and remaining error expected from the noise (`expected`)."""
        return self.outcome.run.drift

    @property
    def losses(self) -> tuple[str, ...]:
        """Unreadable parts of a damaged input, in sentences."""
        return self.outcome.run.losses

    def summary(self) -> Summary:
        """Return the effects removed, how far that moved the odometry, and the remaining error."""
        return brief(self.outcome, self.target)

    def details(self) -> str:
        """Return the complete result in one paragraph."""
        return correction_summary(self.outcome)

    def to_dict(self) -> dict[str, Any]:
        """Return the effects removed and left, the messages modified, and the change of the odometry."""
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
                "drift": outcome.run.drift._asdict(),
                "losses": list(outcome.run.losses),
            }
        )

    def rows(self) -> list[dict[str, Any]]:
        """Return one row per effect, and whether it was removed."""
        undone, left = self.outcome.effects.undone, self.outcome.effects.left
        return [{"effect": e.name, "taken_out": e in undone} for e in (*undone, *left)]

    def _figure(self) -> Figure:
        """Return a figure of the measured path and the corrected one, read from the two bags."""
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
    """Remove the systematic effects of a model from measured odometry.

    Parameters
    ----------
    source, target : path
        Bags; the source is read twice and cannot be a pipe, the target may be "-".
    model : Model or path of a model file
        Model from `fit` or `learn`; None copies the bag.
    start_xyt : (3,) or "odom", optional
        Start pose of the odometry in the frame of position-dependent effects, metres and radians; "odom" if that
        frame is the odometry's own. Required for a learned model with such effects.
    watch : callable
        Called with every block written.
    **options
        See `BagOptions`.

    Returns
    -------
    Correction
        Effects removed, effects that cannot be, and the change of the odometry.

    Raises
    ------
    BagError, TopicError, EffectError
        If a bag cannot be read or written, has no odometry, or no true motion explains its odometry; if
        position-dependent effects were learned and `start_xyt` is missing.

    Examples
    --------
    >>> import odomcorrupt as oc
    >>> model = oc.Model(effects=["wheelbase:e=2%"], track_m=0.3)
    >>> done = oc.correct("fixtures/office.mcap", "corrected.mcap", model=model, overwrite=True)
    >>> [effect.name for effect in done.outcome.effects.undone]
    ['wheelbase']
    """
    before = bag_path(source)
    if before is None:
        raise OdomCorruptError("-: correction reads a bag twice, which is impossible on a pipe; name a file")
    moved, container = split_options(options)
    robot = NOISE_FREE if model is None else as_model(model).motion_model
    if start_xyt is None:
        require_start(robot)
    start = None if start_xyt is None or start_xyt == "odom" else np.array(start_xyt, dtype=np.float64)
    outcome = correct_bag(
        before, bag_path(target), robot, options=moved, container=container, start_xyt=start, watch=watch
    )
    return Correction(fspath(source), fspath(target), outcome)
