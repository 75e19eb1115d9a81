"""State of each run of a batch: its noisy path, correction C(t), patches, and the meters of its error."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.bags.block import Block
from odomcorrupt.corruption.correction import Curve
from odomcorrupt.corruption.drift import MARKS_M, DriftMeter
from odomcorrupt.corruption.patch import Patcher
from odomcorrupt.corruption.path import NoisyPath

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from odomcorrupt.bags.block import Message
    from odomcorrupt.batching.patch_batch import Portion
    from odomcorrupt.corruption.additions import CorrectionEdge
    from odomcorrupt.corruption.drift import PathWatcher
    from odomcorrupt.corruption.inverse import SystematicEffects
    from odomcorrupt.corruption.path import PathSamples, PathSource
    from odomcorrupt.corruption.reorder import Arrivals
    from odomcorrupt.corruption.transform import Options
    from odomcorrupt.model.motion_model import MotionModel


class MarkMeter:
    """Errors of the last stretch after each of the distances `MARKS_M` and at the end.

    marks : (distance in metres, noisy minus clean x and y in metres, heading in radians)
    """

    def __init__(self) -> None:
        self.restart()

    def restart(self) -> None:
        """Start a new stretch: the stamps have jumped back."""
        self.marks: list[tuple[float, float, float, float]] = []
        self._last: tuple[float, float, float, float] | None = None

    def add(self, samples: PathSamples) -> None:
        """Process the next part of the path."""
        if not len(samples):
            return
        while len(self.marks) < len(MARKS_M) and samples.travelled_m[-1] >= MARKS_M[len(self.marks)]:
            mark_m = MARKS_M[len(self.marks)]
            self.marks.append((mark_m, *_error(samples, int(np.searchsorted(samples.travelled_m, mark_m)))))
        self._last = (float(samples.travelled_m[-1]), *_error(samples, len(samples) - 1))

    def result(self) -> list[tuple[float, float, float, float]]:
        """Return the errors at the marks, the last of them at the end."""
        return [*self.marks, *([self._last] if self._last is not None else [])]


def _error(samples: PathSamples, i: int) -> tuple[float, float, float]:
    x, y, turn = samples.error_xyt[i].tolist()
    return x, y, turn


class RunState:
    """One run of a batch, over a bag that is read once for many runs.

    path : corrupted path, instead of the noisy path that the model draws
    systematic : the model's systematic effects, shared with the other runs of the same model
    drift, marks : meters of its error
    """

    def __init__(
        self,
        model: MotionModel,
        seed: int,
        run: int,
        options: Options,
        watchers: Iterable[PathWatcher] = (),
        *,
        path: PathSource | None = None,
        systematic: SystematicEffects | None = None,
    ) -> None:
        self.model = model
        self.run = run
        self.drift = DriftMeter()
        self.marks = MarkMeter()
        self._watchers: list[PathWatcher] = [self.drift, self.marks, *watchers]
        self._path: PathSource = NoisyPath(model, seed, run, systematic=systematic) if path is None else path
        self._curve = Curve(subtracted=options.subtracted, consistent=options.consistent)
        self._new_frame = options.new_odom_frame is not None
        self._patcher = Patcher(model, keep_twist=options.keep_twist, keep_covariance=options.keep_covariance)

    def grow(self, parts: Iterable[Arrivals | None]) -> None:
        """Draw the next parts of the path; None marks a restart of time."""
        for part in parts:
            if part is None:
                self._path.restart()
                self._curve.restart()
            else:
                samples = self._path.feed(part.stamps_ns, part.xyt)
                self._curve.extend(samples, part.time_ns)
            for watcher in self._watchers:
                if part is None:
                    watcher.restart()
                else:
                    watcher.add(samples)

    def edges(self, portion: Portion, edge: CorrectionEdge, odom: str) -> list[list[Message]]:
        """Return, for each block of a portion, the transforms with this run's correction."""
        found = []
        for block, targets in zip(portion.blocks, portion.own_targets, strict=True):
            beside = Block(block.data, block.table)
            edge.add(beside, targets, self._curve, odom)
            found.append(beside.added)
        return found

    def patched(self, portion: Portion) -> NDArray[np.uint8]:
        """Return a portion's data (size,) with this run's correction applied to its targets."""
        self._curve.forget(portion.oldest_ns)
        if self._new_frame:
            return portion.data
        block = Block(portion.data.copy(), portion.table)
        self._patcher.patch(block, portion.targets, self._curve, portion.first_ns)
        return block.data
