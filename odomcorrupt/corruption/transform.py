"""Block-wise corruption: draws the correction of the odom frame and applies it to every message that depends on it.

A block is delayed until the correction is known at its messages, at most `WAIT_NS` of log time; then the last value
is held, and counted. Decisions depend on stamps and log times, never on block boundaries.
"""

from __future__ import annotations

import re
from collections import deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from odomcorrupt.bags.block import Message
from odomcorrupt.bags.messages import TRANSFORMS, locate, pack_transform, stamps_or_log_ns
from odomcorrupt.corruption.correction import PATIENCE_NS, Curve
from odomcorrupt.corruption.odometry_source import (
    ENCODINGS,
    ODOMETRY,
    PLACED_TYPES,
    OdometrySource,
    can_be_consistent,
    contains_truth,
    find_odometry,
    frame_of,
    has_poses,
    localisation_side_of,
    plain,
    says_truth,
    side_of,
)  # fmt: skip
from odomcorrupt.corruption.patch import Patcher, Target
from odomcorrupt.corruption.path import DriftMeter, NoisyPath
from odomcorrupt.corruption.pose_faults import FAR_M, W_FIRST, ZERO
from odomcorrupt.corruption.reorder import WINDOW_NS, Arrivals, TimeOrder
from odomcorrupt.errors import TopicError
from odomcorrupt.sensors import SENSORS, SensorNoise, find_relations

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from numpy.typing import NDArray

    from odomcorrupt.bags.block import BagReader, BagWriter, Block, Channel
    from odomcorrupt.bags.messages import Item, Layout
    from odomcorrupt.corruption.inverse import SystematicEffects
    from odomcorrupt.corruption.odometry_source import Frames, Side
    from odomcorrupt.corruption.path import PathSource, PathWatcher
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.model.motion_model import MotionModel
    from odomcorrupt.sensors import ImuNoise, Relations


TOPIC = re.compile(r"[/~]?[A-Za-z_]\w*(/\w+)*", re.ASCII)

TF = "tf2_msgs/msg/TFMessage"


@dataclass(slots=True, eq=False, repr=False)
class TruthTopic:
    """Copy of the clean odometry on another topic: same bytes, same log times, same QoS."""

    topic: str
    reader: BagReader
    writer: BagWriter
    count: int = 0
    _channel: Channel | None = field(default=None, init=False)

    def __post_init__(self) -> None:
        if not TOPIC.fullmatch(self.topic):
            raise TopicError(f"{self.topic!r}: is not a topic name; use letters, digits, _ and /, as in /odom_true")
        if any(plain(c.topic) == plain(self.topic) for c in self.reader.channels.values()):
            raise TopicError(f"{self.topic}: is in the bag already; keep the truth under another name")

    def add(self, block: Block, targets: list[Target]) -> None:
        """Append copies of the targets' messages to a block, before they are patched."""
        for target in targets:
            if self._channel is None:
                self._channel = self.writer.add_channel(self.topic, ODOMETRY, target.channel)
            for row in target.layout.rows.tolist():
                block.added.append(Message(self._channel.id, int(block.table["log_ns"][row]), block.message(row)))
            self.count += len(target.layout.rows)


@dataclass(slots=True, eq=False, repr=False)
class CorrectionEdge:
    """TF edge from a new frame to odom that carries the correction, one transform for each stamp of the odometry."""

    frame: str
    reader: BagReader
    writer: BagWriter
    count: int = 0
    _channel: Channel | None = field(default=None, init=False)

    def add(self, block: Block, targets: list[Target], curve: Curve, odom: str) -> None:
        """Append one transform for each of the targets' messages to a block, those repeated at one stamp left out.

        Raises
        ------
        TopicError
            If the new frame is the odom frame itself, or empty.
        """
        if plain(self.frame) in ("", odom):
            raise TopicError(
                f"--new-odom-frame {self.frame!r}: must be a new frame, the parent of {odom}; name another one"
            )
        for target in targets:
            if self._channel is None:
                self._channel = self._open(target.channel)
            rows = block.table[target.layout.rows]
            at = curve.at(target.stamps_ns, target.time_ns)
            for row, stamp_ns, (x, y, turn) in zip(rows, target.stamps_ns.tolist(), at.xyt.tolist(), strict=True):
                if stamp_ns == curve.published_ns:
                    continue
                curve.published_ns = stamp_ns
                self.count += 1
                data = pack_transform(self._channel.encoding, stamp_ns, (self.frame, odom), (x, y, turn))
                block.added.append(Message(self._channel.id, int(row["log_ns"]), data))

    def _open(self, odometry: Channel) -> Channel:
        """Return the channel of the transforms: with the encoding and QoS of the bag's own /tf, where it has one."""
        for channel in self.reader.channels.values():
            if channel.msgtype in TRANSFORMS and "static" not in channel.topic:
                return self.writer.add_channel(channel.topic, channel.msgtype, channel)
        return self.writer.add_channel("/tf", TF, odometry)


WAIT_NS = PATIENCE_NS + WINDOW_NS
"""The longest that a block waits, log time."""

_NAMED = 6
"""Edges named in an error."""


class Options(NamedTuple):
    """Options of the corruption, as `odomcorrupt.api.bag_options.BagOptions` describes them; `imu` has been read."""

    odom_topic: str | None = None
    odom_frame: str | None = None
    base_frame: str | None = None
    keep_twist: bool = False
    keep_covariance: bool = False
    keep_truth: str | None = None
    keep_localisation: bool = False
    new_odom_frame: str | None = None
    subtracted: bool = False
    consistent: bool = False
    scan_noise: float = 0.0
    scan_keep: float = 1.0
    imu: ImuNoise | None = None

    @property
    def degrades(self) -> bool:
        """Whether scans or IMUs get noise."""
        return bool(self.scan_noise or self.scan_keep < 1.0 or self.imu is not None)


class Run:
    """One run over a bag: its path, the correction C(t), and the messages changed by it.

    path : corrupted path, instead of the noisy path that the model draws
    systematic : the model's systematic effects, shared with other runs of the same model
    watchers : receive the path, too
    drift : meter of its error
    edge : TF edge that carries the correction, if one is published
    known_until_ns : last stamp at which C(t) is known in the current stretch; None while it is empty
    """

    def __init__(
        self, model: MotionModel, seed: int, run: int, options: Options, watchers: Iterable[PathWatcher] = (), *,
        path: PathSource | None = None, systematic: SystematicEffects | None = None,
    ) -> None:  # fmt: skip
        self.drift = DriftMeter()
        self.watchers: list[PathWatcher] = [self.drift, *watchers]
        self.curve = Curve(subtracted=options.subtracted, consistent=options.consistent)
        self.noise = SensorNoise(*options[-3:], seed, run)
        self.patcher = Patcher(model, keep_twist=options.keep_twist, keep_covariance=options.keep_covariance)
        self.patcher.changes.noisy = self.noise.counts
        self._path: PathSource = NoisyPath(model, seed, run, systematic=systematic) if path is None else path
        self._moves = options.new_odom_frame is None
        self.edge: CorrectionEdge | None = None
        self.known_until_ns: int | None = None

    def restart(self) -> None:
        """Begin a new stretch: the stamps have jumped back."""
        self.known_until_ns = None
        self._path.restart()
        self.curve.restart()
        for watcher in self.watchers:
            watcher.restart()

    def extend(self, ordered: Arrivals) -> None:
        """Draw the next part of the path."""
        self.known_until_ns = int(ordered.stamps_ns[-1])
        samples = self._path.feed(ordered.stamps_ns, ordered.xyt)
        self.curve.extend(samples, ordered.time_ns)
        for watcher in self.watchers:
            watcher.add(samples)

    def apply(self, block: Block, targets: list[Target], first_ns: int) -> None:
        """Change the targets of a block in place; first_ns is the first stamp, the origin of clock effects."""
        if targets:
            self.curve.forget(int(min(target.time_ns[0] for target in targets)))
        if self._moves:
            self.patcher.patch(block, targets, self.curve, first_ns)
        for target in targets:
            if target.follows is not None:
                self.noise.add(block, target.channel, target.layout, target.stamps_ns)

    def publish(self, block: Block, driving: list[Target], odom: str) -> None:
        """Add the transforms of the edge to a block, at the odometry's messages."""
        if self.edge is not None:
            self.edge.add(block, driving, self.curve, odom)


@dataclass(slots=True, eq=False, repr=False)
class _Held:
    block: Block
    parts: list[tuple[Channel, Layout]]
    time_ns: NDArray[np.int64]
    targets: list[Target] | None = None


class Transform:
    """One run of a model over a bag.

    run : what is drawn, and applied to the messages; `shared` in place of one of its own
    drift, watchers, changes : those of the run
    seen : channels that carried messages; placed : frames in which their data are given, see `frame_of`
    stayed : topics of the TF edges that are not moved; true_edges : those that contain the true motion
    frame_met : whether some odometry message or transform has the odom frame
    """

    def __init__(
        self,
        model: MotionModel,
        seed: int,
        run: int = 0,
        options: Options | None = None,
        *,
        path: PathSource | None = None,
        shared: Run | None = None,
    ) -> None:
        self.options = Options() if options is None else options
        self.model = model
        self.seed = seed
        self.run = Run(model, seed, run, self.options, path=path) if shared is None else shared
        self.drift, self.watchers, self.changes = self.run.drift, self.run.watchers, self.run.patcher.changes
        self.order = TimeOrder()
        asked = self.options
        self.odometry = OdometrySource(asked.odom_topic, asked.odom_frame, asked.base_frame, model.odometry_topic)
        self.unusable = 0
        self.seen: set[int] = set()
        self._met: set[str] = set()
        self.placed: dict[int, str] = {}
        self.stayed: dict[str, str] = {}
        self.true_edges: set[str] = set()
        self.frame_met = False
        self.truth: TruthTopic | None = None
        self._follows: dict[int, Relations] = {}
        self._now_ns = -(2**62)
        self._first_ns: int | None = None

    def require_source(self) -> None:
        """Raise TopicError where the requested frame is nowhere, or the poses read are not those of a planar robot."""
        faults = self.odometry.faults
        for msgtype in self.run.noise.msgtypes - self._met:
            raise TopicError(f"the bag has no {msgtype}; leave --scan-noise, --scan-keep or --imu out")
        if faults.order.w_first:
            raise TopicError(f"{self.odometry.name}: {W_FIRST}{self.odometry.elsewhere}")
        if faults.paths.alternates:
            raise TopicError(f"{self.odometry.name}: {faults.paths.sentence()}; {self.odometry.one_publisher}")
        if faults.twists.poses_stand_still:
            raise TopicError(f"{self.odometry.name}: {faults.twists.still()}")
        asked = self.options.odom_frame
        if asked is not None and not self.frame_met:
            found = ", ".join(sorted(self.stayed)[:_NAMED]) or "no edge"
            raise TopicError(
                f"--odom-frame {asked}: no odometry message and no transform has this frame (TF has {found}); name "
                "one that is there"
            )

    def blocks(
        self, reader: BagReader, name: str, writer: BagWriter | None = None, before: Iterator[Block] | None = None
    ) -> Iterator[Block]:
        """Yield the blocks of a bag with changed messages, in file order.

        name : name of the bag in messages
        writer : receives added channels, if options request some
        before : blocks that the transform of another robot has changed, instead of the bag's own

        Raises
        ------
        TopicError
            If there is no odometry source, or a topic to be added exists already.
        """
        self.odometry.prepare(reader, name)
        if self.options.keep_truth is not None and writer is not None:
            self.truth = TruthTopic(self.options.keep_truth, reader, writer)
        if self.options.new_odom_frame is not None and writer is not None:
            self.run.edge = CorrectionEdge(self.options.new_odom_frame, reader, writer)
        if self.options.consistent:
            self._follows = self.relations(reader)
        waiting: deque[_Held] = deque()
        only = None
        if writer is not None and writer.keeps_rest and (reader.kind == "sqlite3" or not (self.truth or self.run.edge)):
            # sensors: the transform of another robot behind this one may change them
            read = PLACED_TYPES | SENSORS if self.options.consistent else PLACED_TYPES
            only = {n for n, channel in reader.channels.items() if self.may_move(channel) or channel.msgtype in read}
        given = reader.blocks(only) if before is None else before
        for block in given:
            waiting.append(self._take(block, reader))
            while waiting and self._ready(waiting[0]):
                yield self._patch(waiting.popleft())
        self._extend(self.order.flush())
        while waiting:
            yield self._patch(waiting.popleft())
        if self._first_ns is None:
            if not self.odometry.by_edge:
                find_odometry(reader.channels.values(), self.odometry.topic, name)
            zero = self.odometry.faults.no_orientation
            why = f" ({zero} {ZERO})" if zero else ""
            raise TopicError(f"{name}: {self.odometry.name} has no message with a pose{why}{self.odometry.elsewhere}")

    def may_move(self, channel: Channel) -> bool:
        """Return whether a channel's messages may be changed."""
        noisy = channel.encoding in ENCODINGS and channel.msgtype in self.run.noise.msgtypes
        return noisy or has_poses(channel) or channel.id in self._follows

    def relations(self, reader: BagReader) -> dict[int, Relations]:
        """Return how other sensors follow the odometry, by channel id, from a pass over the bag.

        Raises
        ------
        TopicError
            If that cannot be known.
        """
        if not reader.complete:
            raise TopicError("--consistent: reads the bag beforehand, which is impossible on a pipe; name a file")
        source = OdometrySource(*self.options[:3], self.model.odometry_topic)
        source.prepare(reader, reader.name)

        def poses_of(block: Block) -> Array:
            found = source.read_block(block, reader)
            return np.column_stack((found.stamps_ns * np.float64(1e-9), found.xyt))

        channels = reader.channels.values()
        sensors = [c for c in channels if can_be_consistent(c) and source.shares_tree(c)]
        return find_relations(reader, sensors, poses_of, {c.id for c in channels if has_poses(c)})

    def _take(self, block: Block, reader: BagReader) -> _Held:
        """Read the odometry of a block and extend C(t)."""
        time_ns = np.maximum.accumulate(np.concatenate(([self._now_ns], block.table["log_ns"])))[1:]
        present = block.present()
        for number in present - self.seen:
            frame = frame_of(block, reader.channels[number])
            if frame is not None:
                self.placed[number] = frame
        self.seen |= present
        self._met |= {reader.channels[number].msgtype for number in present}
        parts = []
        for number in sorted(present):
            channel = reader.channels[number]
            if self.may_move(channel):
                parts += [(channel, layout) for layout in locate(block, channel)]
        if poses := [part for part in parts if has_poses(part[0])]:
            self._add(self.odometry.read(block, poses, time_ns))
        if len(time_ns):
            self._now_ns = int(time_ns[-1])
        self._extend(self.order.release(self._now_ns))
        return _Held(block, parts, time_ns)

    def _add(self, new: Arrivals) -> None:
        # of the heading only whether it is finite
        if not (np.abs(new.xyt) < FAR_M).all():
            usable = np.flatnonzero((np.abs(new.xyt) < FAR_M).all(axis=1))
            self.unusable += len(new) - len(usable)
            new = new.take(usable)
        if self._first_ns is None and len(new):
            self._first_ns = int(new.stamps_ns[0])
        for ended in self.order.add(new):
            self._extend(ended)
            self.run.restart()

    def _extend(self, ordered: Arrivals) -> None:
        if len(ordered):
            self.odometry.faults.paths.take(ordered.xyt)
            self.run.extend(ordered)

    def _ready(self, held: _Held) -> bool:
        """Return whether C(t) at a block's messages is final."""
        age_ns = self._now_ns - (int(held.time_ns[-1]) if len(held.time_ns) else -(2**62))
        if age_ns >= WAIT_NS or not held.parts or (self.odometry.frames is not None and not self._targets(held)):
            return True
        until_ns = self.run.known_until_ns
        if until_ns is None:
            return False
        ahead_ns = until_ns - max((int(target.stamps_ns.max()) for target in self._targets(held)), default=until_ns)
        # constant log times must not fill the memory
        return ahead_ns >= (0 if age_ns >= PATIENCE_NS else 2 * WAIT_NS)

    def _targets(self, held: _Held) -> list[Target]:
        if held.targets is None:
            held.targets = [] if self.odometry.frames is None else self._find_targets(held, self.odometry.frames)
        return held.targets

    def _find_targets(self, held: _Held, frames: Frames) -> list[Target]:
        found = []
        for channel, layout in held.parts:
            if not has_poses(channel):
                times = stamps_or_log_ns(held.block, layout, layout.items[0]), held.time_ns[layout.rows]
                follows = self._follows.get(channel.id, {})
                found.append(Target(channel, layout, layout.items[0], "left", *times, follows))
                continue
            shares = self.odometry.shares_tree(channel)
            for item in layout.items:
                self.frame_met |= shares and frames.odom in (plain(item.frame_id), plain(item.child_frame_id))
                side = self._side(channel, item, frames) if shares else None
                if side is None and channel.msgtype in TRANSFORMS:
                    edge = f"{plain(item.frame_id)} -> {plain(item.child_frame_id)}"
                    self.stayed.setdefault(edge if shares else f"{edge} on {channel.topic}", channel.topic)
                    if shares and contains_truth(channel.topic, item.frame_id, item.child_frame_id, frames):
                        self.true_edges.add(f"{channel.topic} {edge}")
                if side is not None:
                    stamps_ns = stamps_or_log_ns(held.block, layout, item)
                    found.append(Target(channel, layout, item, side, stamps_ns, held.time_ns[layout.rows]))
        return found

    def _side(self, channel: Channel, item: Item, frames: Frames) -> Side | None:
        """Return from which side the correction acts on an item; None where it stays."""
        driving = self.odometry.is_odometry(channel)
        if self.options.new_odom_frame is not None:
            ends = item.frame_id, item.child_frame_id
            if channel.msgtype in TRANSFORMS and localisation_side_of(*ends, frames) == "right":
                raise TopicError(
                    f"{channel.topic}: {frames.odom} already has a parent, {item.frame_id}, and a frame has but one; "
                    "correct the odometry itself, with --tf odometry"
                )
            return "left" if driving else None
        if channel.msgtype == ODOMETRY:
            here = plain(item.frame_id) == frames.odom and not says_truth(channel.topic)
            return "left" if driving or here else None
        side = side_of(item.frame_id, item.child_frame_id, frames)
        if side is None and self.options.keep_localisation:
            side = localisation_side_of(item.frame_id, item.child_frame_id, frames)
        return side

    def _patch(self, held: _Held) -> Block:
        targets = self._targets(held)
        if self._first_ns is None:
            targets = []
        driving = [target for target in targets if self.odometry.is_odometry(target.channel)]
        if self.truth is not None:
            self.truth.add(held.block, driving)
        self.run.apply(held.block, targets, self._first_ns or 0)
        if self.odometry.frames is not None:
            self.run.publish(held.block, driving, self.odometry.frames.odom)
        return held.block
