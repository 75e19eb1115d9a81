"""What all runs of a batch share: reading, finding and ordering, done once for all of them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from odomcorrupt.corruption.correction import Curve
from odomcorrupt.corruption.transform import Transform
from odomcorrupt.model.motion_model import MotionModel, Noise
from odomcorrupt.model.noise_laws import Coefficients

if TYPE_CHECKING:
    from odomcorrupt.bags.block import Block
    from odomcorrupt.corruption.patch import Target
    from odomcorrupt.corruption.path import Knots
    from odomcorrupt.corruption.reorder import Arrivals
    from odomcorrupt.corruption.transform import Options, _Held

__all__ = ["SharedTransform"]


class _Reach(Curve):
    """How far a curve would be known, without one: that depends on stamps alone, the same for all runs."""

    def __init__(self) -> None:
        super().__init__()
        self.until_ns: int | None = None

    @property
    def known_until_ns(self) -> int | None:
        """The last stamp of the present stretch, None while it has none."""
        return self.until_ns

    def restart(self) -> None:
        """End the present stretch."""
        self.until_ns = None


class SharedTransform(Transform):
    """Decides for all runs when a block is ready and what of it moves; moves nothing itself.

    growth : odometry in order since it was last taken; None where time began anew
    taken : the targets of the block that `blocks` has just given
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
        """When time began."""
        return self._first_ns or 0

    def restart(self) -> None:
        """Note that time began anew."""
        self.growth.append(None)

    def add(self, knots: Knots) -> None:
        """Ignore a path: there is none."""

    def _extend(self, ordered: Arrivals) -> None:
        if len(ordered):
            self.growth.append(ordered)
            self._reach.until_ns = int(ordered.stamps_ns[-1])

    def _patch(self, held: _Held) -> Block:
        self.taken = [] if self._first_ns is None else self._targets(held)
        if self.truth is not None:
            self.truth.add(held.block, [target for target in self.taken if self.driver.is_odometry(target.channel)])
        return held.block
