"""The steps common to all runs of a batch: reading, odometry source, sorting by stamp."""

from __future__ import annotations

from typing import TYPE_CHECKING

from odomcorrupt.corruption.correction import Curve
from odomcorrupt.corruption.transform import Transform
from odomcorrupt.model.motion_model import MotionModel, Noise
from odomcorrupt.model.noise_laws import Coefficients

if TYPE_CHECKING:
    from odomcorrupt.bags.block import Block
    from odomcorrupt.corruption.patch import Target
    from odomcorrupt.corruption.path import PathSamples
    from odomcorrupt.corruption.reorder import Arrivals
    from odomcorrupt.corruption.transform import Options, _Held

__all__ = ["SharedTransform"]


class _Reach(Curve):
    """Extent in time of every run's C(t), without its values: it depends on stamps alone."""

    def __init__(self) -> None:
        super().__init__()
        self.until_ns: int | None = None

    @property
    def known_until_ns(self) -> int | None:
        """Last stamp of the current stretch; None while it is empty."""
        return self.until_ns

    def restart(self) -> None:
        """End the current stretch."""
        self.until_ns = None


class SharedTransform(Transform):
    """Transform that determines, for all runs, when a block is ready and its targets; patches nothing.

    growth : sorted odometry since it was last taken; None marks a restart of time
    taken : targets of the block that `blocks` yielded last
    """

    def __init__(self, options: Options) -> None:
        nothing = MotionModel(Noise("diffusion", Coefficients(0.0, 0.0, 0.0, 0.0)))
        super().__init__(nothing, 0, 0, options)
        self.growth: list[Arrivals | None] = []
        self.taken: list[Target] = []
        self._reach = _Reach()
        self._curve = self._reach
        self.watchers = [self]

    @property
    def first_ns(self) -> int:
        """First stamp, nanoseconds."""
        return self._first_ns or 0

    def restart(self) -> None:
        """Record a restart of time."""
        self.growth.append(None)

    def add(self, samples: PathSamples) -> None:
        """Do nothing: there is no path."""

    def _extend(self, ordered: Arrivals) -> None:
        if len(ordered):
            self.growth.append(ordered)
            self._reach.until_ns = int(ordered.stamps_ns[-1])

    def _patch(self, held: _Held) -> Block:
        self.taken = [] if self._first_ns is None else self._targets(held)
        if self.truth is not None:
            self.truth.add(held.block, [target for target in self.taken if self.odometry.is_odometry(target.channel)])
        return held.block
