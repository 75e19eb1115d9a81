"""The correction C(t): noisy pose composed with the inverse of the clean pose, a rigid motion of the odom frame.

It is known at odometry stamps (where several poses have one stamp, from the first of them), interpolated in SE(2)
between them and held constant before and after. A message uses
only odometry that arrived at most `PATIENCE_NS` of log time after it and at most `MEMORY_NS` before it, so the curve
is the same for a file, a pipe and any division into blocks.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from odomcorrupt.corruption.covariance import SUMS
from odomcorrupt.geometry.se2 import interpolate, rotated, wrap

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from odomcorrupt.corruption.path import PathSamples
    from odomcorrupt.geometry.se2 import Array

PATIENCE_NS = 1_000_000_000
"""How far the odometry may lag behind a message, log time; putting it in order takes as long again."""

MEMORY_NS = 10_000_000_000
"""Log time for which samples of the curve are kept."""


class Correction(NamedTuple):
    """Correction at n stamps.

    xyt : (n, 3) motion of the odom frame, metres and radians
    sums : (SUMS or more, n) running sums for covariances, see `covariance`
    origin_xy : (2, n) origin of these sums, metres
    stretch : (n,) index of the stretch (time between two restarts) of each stamp, from 0
    held : (n,) whether the stamp lies after the end of the curve, so that the last value is held
    added : (n, 3) running sums of noisy minus clean body increments, metres and radians; (n, 0) where not asked for
    """

    xyt: Array
    sums: Array
    origin_xy: Array
    stretch: NDArray[np.int64]
    held: NDArray[np.bool_]
    added: Array

    def take(self, rows: slice | NDArray[np.int64]) -> Correction:
        """Return the correction at some of the stamps."""
        return Correction._make(one[:, rows] if i in _BY_COLUMN else one[rows] for i, one in enumerate(self))

    @classmethod
    def joined(cls, parts: Sequence[Correction]) -> Correction:
        """Return those at the stamps of several, one behind the other."""
        return cls._make(np.concatenate(one, int(i in _BY_COLUMN)) for i, one in enumerate(zip(*parts, strict=True)))


_BY_COLUMN = 1, 2
"""Fields of `Correction` whose second index counts the stamps."""


@dataclass(slots=True, eq=False, repr=False)
class _Stretch:
    number: int
    stamps_ns: NDArray[np.int64]
    time_ns: NDArray[np.int64]
    xyt: Array
    sums: Array
    origin_xy: Array
    first_ns: int
    began_ns: int
    own_sums: int
    clean: Array

    def extend(self, samples: PathSamples, time_ns: NDArray[np.int64], xyt: Array) -> None:
        self.stamps_ns = np.concatenate((self.stamps_ns, samples.stamps_ns))
        self.time_ns = np.concatenate((self.time_ns, time_ns))
        self.xyt = np.concatenate((self.xyt, xyt))
        sums = samples.sums
        if len(self.sums) > self.own_sums:
            self.clean = np.concatenate((self.clean[-1:], samples.clean_xyt))
            steps, _ = body_difference(self.clean, self.xyt[-len(self.clean) :])
            before = self.sums[self.own_sums :, -1:].T if self.sums.size else np.zeros((1, 3))
            added = np.cumsum(np.concatenate((before, steps)), axis=0)[-len(samples) :]
            sums = np.concatenate((sums, added.T))
        self.sums = np.concatenate((self.sums, sums), axis=1)

    def forget(self, before_ns: int) -> None:
        gone = min(int(np.searchsorted(self.time_ns, before_ns)), len(self.time_ns) - 1)
        if gone > len(self.time_ns) // 2:
            self.stamps_ns, self.time_ns = self.stamps_ns[gone:].copy(), self.time_ns[gone:].copy()
            self.xyt, self.sums = self.xyt[gone:].copy(), self.sums[:, gone:].copy()

    def at(self, stamps_ns: NDArray[np.int64], time_ns: NDArray[np.int64]) -> Correction:
        exact = self._exactly_at(stamps_ns, time_ns)
        if exact is not None:
            return self._correction(self.xyt[exact], self.sums[:, exact], np.zeros(len(stamps_ns), dtype=bool))
        last = np.maximum(np.searchsorted(self.time_ns, time_ns + PATIENCE_NS, side="right") - 1, 0)
        oldest = np.minimum(np.searchsorted(self.time_ns, time_ns - MEMORY_NS), last)
        inside_ns = np.clip(stamps_ns, self.stamps_ns[oldest], self.stamps_ns[last])
        i = np.minimum(np.searchsorted(self.stamps_ns, inside_ns, side="right") - 1, last)
        after, i = i + 1, np.maximum(np.searchsorted(self.stamps_ns, self.stamps_ns[i]), oldest)
        xyt, sums = self.xyt[i], self.sums[:, i]
        past_ns = inside_ns - self.stamps_ns[i]
        between = np.flatnonzero(past_ns)
        if len(between):
            k, after = i[between], after[between]
            fraction = past_ns[between] / (self.stamps_ns[after] - self.stamps_ns[k])
            xyt[between] = interpolate(self.xyt[k], self.xyt[after], fraction)
            sums[:, between] += fraction * (self.sums[:, after] - self.sums[:, k])
        return self._correction(xyt, sums, stamps_ns > self.stamps_ns[last])

    def _exactly_at(self, stamps_ns: NDArray[np.int64], time_ns: NDArray[np.int64]) -> NDArray[np.int64] | slice | None:
        """Return which samples are at exactly these stamps; None where a message has none that it may use."""
        i = np.minimum(np.searchsorted(self.stamps_ns, stamps_ns), len(self.stamps_ns) - 1)
        ahead_ns = self.time_ns[i] - time_ns
        exact = (self.stamps_ns[i] == stamps_ns) & (ahead_ns <= PATIENCE_NS) & (ahead_ns >= -MEMORY_NS)
        if not exact.all():
            return None
        # nearly always a row of samples, which need not be copied
        return slice(int(i[0]), int(i[-1]) + 1) if len(i) and (np.diff(i) == 1).all() else i

    def _correction(self, xyt: Array, sums: Array, held: NDArray[np.bool_]) -> Correction:
        origin, rows = np.repeat(self.origin_xy[:, None], len(xyt), axis=1), self.own_sums
        return Correction(xyt, sums[:rows], origin, np.full(len(xyt), self.number), held, sums[rows:].T)


def body_difference(clean_xyt: Array, correction_xyt: Array, turn_rad: Array | None = None) -> tuple[Array, Array]:
    """Return noisy minus clean body increments (n - 1, 3), each at its own mid heading, and the clean ones.

    Only changes of the correction enter: where it is held, all is zero. turn_rad : turns (n - 1,) where headings jump
    """
    (x, y, heading), (shift_x, shift_y, angle) = clean_xyt.T, correction_xyt.T
    turn, swing = wrap(np.diff(heading)) if turn_rad is None else turn_rad, np.diff(angle)
    middle = heading[:-1] + turn / 2.0 if turn_rad is None else heading[1:] - turn / 2.0
    shift = rotated(np.diff(shift_x), np.diff(shift_y), -angle[:-1])
    end = x[1:], y[1:]
    swung = rotated(*end, swing)
    noisy_less_clean = shift[0] + (swung[0] - end[0]), shift[1] + (swung[1] - end[1])
    body = rotated(np.diff(x), np.diff(y), -middle)
    less = rotated(*body, -swing / 2.0)
    more = rotated(*noisy_less_clean, -middle - swing / 2.0)
    difference = np.stack((less[0] - body[0] + more[0], less[1] - body[1] + more[1], swing)).T
    return difference, np.stack((*body, turn)).T


class Curve:
    """C(t) from the odometry read so far, in stretches between restarts of time.

    subtracted : the plain difference of the poses in place of C, as the article's listing publishes it: no rigid
        motion once the robot has turned, so nothing but a transform of that name may be made of it
    consistent : whether the errors of the body's motion are summed, too
    published_ns : stamp of the last transform made of it; None before the first
    """

    def __init__(self, *, subtracted: bool = False, consistent: bool = False) -> None:
        self.published_ns: int | None = None
        self._subtracted, self._consistent = subtracted, consistent
        self._stretches: list[_Stretch] = []
        self._count = 0
        self._open = False

    def restart(self) -> None:
        """End the current stretch."""
        self._open = False

    def extend(self, samples: PathSamples, time_ns: NDArray[np.int64]) -> None:
        """Append path samples to the current stretch; time_ns (n,) is the log time at which each became known."""
        if not len(samples):
            return
        more = 3 if self._consistent else 0
        if not self._open:
            none = np.zeros(0, dtype=np.int64)
            self._stretches.append(
                _Stretch(
                    self._count, none, none, np.zeros((3, 0)).T, np.zeros((len(samples.sums) + more, 0)),
                    samples.origin_xy.copy(), int(samples.stamps_ns[0]), int(time_ns[0]), len(samples.sums),
                    np.zeros((0, 3)),
                )
            )  # fmt: skip
            self._count += 1
            self._open = True
        xyt = samples.error_xyt if self._subtracted else samples.correction_xyt
        self._stretches[-1].extend(samples, time_ns, xyt)

    def forget(self, before_ns: int) -> None:
        """Drop samples that no message from log time `before_ns` on may use."""
        limit_ns = before_ns - MEMORY_NS
        while len(self._stretches) > 1 and self._stretches[1].began_ns < limit_ns:
            del self._stretches[0]
        for stretch in self._stretches:
            stretch.forget(limit_ns)

    def at(self, stamps_ns: NDArray[np.int64], time_ns: NDArray[np.int64]) -> Correction:
        """Return the correction at the header stamps (n,) of messages with log times (n,), nanoseconds."""
        if len(self._stretches) == 1:
            return self._stretches[0].at(stamps_ns, time_ns)
        if not self._stretches:
            n, more = len(stamps_ns), 3 if self._consistent else 0
            zeros = np.zeros((n, 3)), np.zeros((SUMS, n)), np.zeros((2, n)), np.zeros(n, np.int64), np.zeros(n, bool)
            return Correction(*zeros, np.zeros((n, more)))
        owner = self._owner(stamps_ns, time_ns)
        rows = [np.flatnonzero(owner == number) for number in np.unique(owner)]
        parts = [self._stretches[owner[own[0]]].at(stamps_ns[own], time_ns[own]) for own in rows]
        return Correction.joined(parts).take(np.argsort(np.concatenate(rows)))

    def _owner(self, stamps_ns: NDArray[np.int64], time_ns: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the index (n,) of each message's stretch: by log time, near a restart that with the nearer stamp."""
        began = np.array([s.began_ns for s in self._stretches], dtype=np.int64)
        owner = np.maximum(np.searchsorted(began, time_ns, side="right") - 1, 0)
        for new in range(1, len(self._stretches)):
            near = np.abs(time_ns - began[new]) <= PATIENCE_NS
            to_new = np.abs(stamps_ns - self._stretches[new].first_ns)
            to_old = np.abs(stamps_ns - self._stretches[new - 1].stamps_ns[-1])
            owner = np.where(near, np.where(to_new < to_old, new, new - 1), owner)
        return owner
