"""Blocks in, blocks out: the correction of the odom frame drawn from the odometry and put into every message it moves.

A block waits until the correction is known at its messages, at most `WAIT_NS` of log time; then the correction is
held, and counted. What is decided depends on stamps and log times, never on where blocks end.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.bags.messages import gather, gather_stamps_ns, locate
from odomcorrupt.corrupt.correction import PATIENCE_NS, Curve
from odomcorrupt.corrupt.drift import DriftMeter
from odomcorrupt.corrupt.order import WINDOW_NS, Arrivals, TimeOrder
from odomcorrupt.corrupt.patch import Patcher, Target
from odomcorrupt.corrupt.path import NoisyPath
from odomcorrupt.corrupt.targets import (
    ENCODINGS,
    ODOMETRY,
    TRANSFORMS,
    drives,
    find_driver,
    plain,
    resolve_frames,
    side_of,
)
from odomcorrupt.errors import TopicError
from odomcorrupt.pose import yaw_from_quaternion

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from odomcorrupt.bags.block import BagReader, Block, Channel
    from odomcorrupt.bags.messages import Layout
    from odomcorrupt.corrupt.patch import Changes
    from odomcorrupt.corrupt.targets import Frames
    from odomcorrupt.model import MotionModel

__all__ = ["WAIT_NS", "Options", "Transform"]

WAIT_NS = PATIENCE_NS + WINDOW_NS
"""The longest that a block waits, log time."""


@dataclass(frozen=True, slots=True)
class Options:
    """What to move, and how.

    odom_topic : the odometry that drives the model, None to find it
    odom_frame, base_frame : frames, where the odometry's own are not the ones of TF
    keep_twist, keep_covariance : leave twists or covariances as they are
    """

    odom_topic: str | None = None
    odom_frame: str | None = None
    base_frame: str | None = None
    keep_twist: bool = False
    keep_covariance: bool = False


@dataclass(slots=True)
class _Held:
    block: Block
    parts: list[tuple[Channel, Layout]]
    time_ns: NDArray[np.int64]
    targets: list[Target] | None = None

    @property
    def seen_ns(self) -> int:
        return int(self.time_ns[-1]) if len(self.time_ns) else -(2**62)


class Transform:
    """One run of one model over one bag."""

    def __init__(self, model: MotionModel, seed: int, run: int = 0, options: Options | None = None) -> None:
        self.options = Options() if options is None else options
        self.model = model
        self.order = TimeOrder()
        self.drift = DriftMeter()
        self.driver: str | None = None
        self.frames: Frames | None = None
        self.unusable = 0
        self.seen: set[int] = set()
        self._path = NoisyPath(model, seed, run)
        self._curve = Curve()
        self._now_ns = -(2**62)
        self._first_ns: int | None = None
        self._patcher = Patcher(model, keep_twist=self.options.keep_twist, keep_covariance=self.options.keep_covariance)

    @property
    def changes(self) -> Changes:
        """What has been changed so far."""
        return self._patcher.changes

    def blocks(self, reader: BagReader, name: str) -> Iterator[Block]:
        """Yield the blocks of a bag, patched, in their order.

        Raises
        ------
        TopicError
            Where no odometry drives the model.

        """
        if self.driver is None:
            self.prepare(reader, name)
        waiting: deque[_Held] = deque()
        for block in reader.blocks():
            waiting.append(self._take(block, reader))
            while waiting and self._ready(waiting[0]):
                yield self._patch(waiting.popleft())
        self._extend(self.order.flush())
        while waiting:
            yield self._patch(waiting.popleft())
        if self._first_ns is None:
            find_driver(reader.channels.values(), self.driver, name)
            raise TopicError(f"{name}: {self.driver} has no message with a pose; name another topic with --odom-topic")

    def prepare(self, reader: BagReader, name: str) -> None:
        """Find the odometry that drives the model, before anything is read or written.

        Raises
        ------
        TopicError
            Where there is none, several, or no way to know yet.

        """
        asked = self.options.odom_topic
        if reader.complete:
            self.driver = find_driver(reader.channels.values(), asked, name)
        elif asked is None:
            raise TopicError(f"{name}: on a pipe topics are not known beforehand; name the odometry with --odom-topic")
        else:
            self.driver = asked

    def _take(self, block: Block, reader: BagReader) -> _Held:
        """Read what a block tells about the odometry, and let the curve grow."""
        time_ns = np.maximum.accumulate(np.concatenate(([self._now_ns], block.table["log_ns"])))[1:]
        parts = []
        present = set(np.unique(block.table["channel"]).tolist())
        self.seen |= present
        for number in sorted(present):
            channel = reader.channels[number]
            if channel.encoding in ENCODINGS and (channel.msgtype == ODOMETRY or channel.msgtype in TRANSFORMS):
                parts += [(channel, layout) for layout in locate(block, channel)]
        held = _Held(block, parts, time_ns)
        self._read_driver(held)
        if len(time_ns):
            self._now_ns = int(time_ns[-1])
        self._extend(self.order.release(self._now_ns))
        return held

    def _read_driver(self, held: _Held) -> None:
        driving = [(channel, layout) for channel, layout in held.parts if drives(channel, self.driver or "")]
        if not driving:
            return
        self.driver = driving[0][0].topic
        layouts = [layout for _, layout in driving]
        block, rows = held.block, np.concatenate([layout.rows for layout in layouts])
        if self.frames is None:
            first = min(layouts, key=lambda layout: int(layout.rows[0]))
            self.frames = resolve_frames(
                first.items[0], self.driver, odom_frame=self.options.odom_frame, base_frame=self.options.base_frame
            )
        stamps = np.concatenate([stamps_or_log_ns(block, layout, 0) for layout in layouts])
        position = np.concatenate([gather(block, layout, layout.items[0], "position") for layout in layouts])
        quat = np.concatenate([gather(block, layout, layout.items[0], "orientation") for layout in layouts])
        xyt = np.column_stack((position[:, :2], yaw_from_quaternion(quat)))
        new = Arrivals(stamps, held.time_ns[rows], xyt)
        if len(layouts) > 1:
            new = new.take(np.argsort(rows))
        finite = np.flatnonzero(np.isfinite(new.xyt).all(axis=1))
        if len(finite) < len(new):
            self.unusable += len(new) - len(finite)
            new = new.take(finite)
        if self._first_ns is None and len(new):
            self._first_ns = int(new.stamps_ns[0])
        for ended in self.order.add(new):
            self._extend(ended)
            self._path.restart()
            self._curve.restart()
            self.drift.restart()

    def _extend(self, ordered: Arrivals) -> None:
        if len(ordered):
            knots = self._path.feed(ordered.stamps_ns, ordered.xyt)
            self._curve.extend(knots, ordered.time_ns)
            self.drift.add(knots)

    def _ready(self, held: _Held) -> bool:
        """Whether nothing more can be learnt for a block."""
        age_ns = self._now_ns - held.seen_ns
        if age_ns >= WAIT_NS or not held.parts or (self.frames is not None and not self._targets(held)):
            return True
        until_ns = self._curve.known_until_ns
        if age_ns < PATIENCE_NS or until_ns is None:
            return False
        return all(int(target.stamps_ns.max()) <= until_ns for target in self._targets(held))

    def _targets(self, held: _Held) -> list[Target]:
        if held.targets is None:
            held.targets = [] if self.frames is None else self._find_targets(held, self.frames)
        return held.targets

    def _find_targets(self, held: _Held, frames: Frames) -> list[Target]:
        found = []
        for channel, layout in held.parts:
            for number, item in enumerate(layout.items):
                side = side_of(item.frame_id, item.child_frame_id, frames)
                if channel.msgtype == ODOMETRY:
                    moves = drives(channel, self.driver or "") or plain(item.frame_id) == frames.odom
                    side = "left" if moves else None
                if side is not None:
                    stamps_ns = stamps_or_log_ns(held.block, layout, number)
                    found.append(Target(channel, layout, item, side, stamps_ns, held.time_ns[layout.rows]))
        return found

    def _patch(self, held: _Held) -> Block:
        targets = self._targets(held)
        if targets and self._first_ns is not None:
            self._curve.forget(int(min(target.time_ns[0] for target in targets)))
            self._patcher.patch(held.block, targets, self._curve, self._first_ns)
        return held.block


def stamps_or_log_ns(block: Block, layout: Layout, number: int) -> NDArray[np.int64]:
    """Return header stamps (n,), log times where a stamp is zero."""
    stamps_ns = gather_stamps_ns(block, layout, layout.items[number])
    return np.where(stamps_ns == 0, block.table["log_ns"][layout.rows], stamps_ns)
