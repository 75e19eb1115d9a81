"""Odometry and TF of a bag: stamps, poses and twists from one pass over its blocks."""

from __future__ import annotations

from collections import Counter, defaultdict
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.bags.messages import TRANSFORMS, Layout, gather, gather_stamps_ns, locate, stamps_or_log_ns
from odomcorrupt.corruption.odometry_source import ENCODINGS, ODOMETRY, PLANAR, frame_of, plain
from odomcorrupt.corruption.patch import PLANAR_BLOCK
from odomcorrupt.corruption.pose_faults import PoseFaults
from odomcorrupt.corruption.se2_on_se3 import planar_poses, poses_in

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from numpy.typing import NDArray

    from odomcorrupt.bags.block import BagReader, Block, Channel
    from odomcorrupt.geometry.se2 import Array


@dataclass(slots=True)
class CovarianceCheck:
    """Faults of many 6 x 6 covariances in x, y and yaw."""

    count: int = 0
    largest: float = 0.0
    zero: bool = True
    senseless: bool = False
    crooked: bool = False
    changed: bool = False
    _first: Array | None = None

    def take(self, flat: Array) -> None:
        """Check covariances (n, 36), row-major 6 x 6."""
        planar = flat[:, PLANAR_BLOCK]
        if not len(planar):
            return
        if self._first is None:
            self._first = planar[0].copy()
        self.count += len(planar)
        self.changed |= not bool(np.array_equal(planar, np.broadcast_to(self._first, planar.shape), equal_nan=True))
        self.zero &= not bool(planar.any())
        square = planar.reshape(-1, 3, 3)
        diagonal = np.diagonal(square, axis1=1, axis2=2)
        if not np.isfinite(planar).all() or (diagonal < 0.0).any():
            self.senseless = True
            return
        self.largest = max(self.largest, float(diagonal.max()))
        off = np.abs(square - square.transpose(0, 2, 1)).max(axis=(1, 2))
        # tolerance of the symmetry and positive-semidefiniteness checks, relative to the largest variance
        allowed = 1e-9 * diagonal.max(axis=1)
        self.crooked |= bool((off > allowed).any() or (np.linalg.eigvalsh(square)[:, 0] < -allowed).any())

    def oddity(self, *, never_changes: bool) -> str | None:
        """Return a warning, or None; never_changes: whether constant covariances deserve one."""
        if self.zero:
            return "are all zero" if self.count else None
        if self.senseless:
            return "are negative or not numbers"
        # smallest variance that means "unknown", m^2 or rad^2
        if self.largest >= 1e3:
            return f'mean "unknown" (up to {self.largest:.3g})'
        if self.crooked:
            return "are not symmetric, or not positive"
        if never_changes and self.count > 1 and not self.changed:
            return "never change"
        return None


@dataclass(slots=True)
class TopicRecord:
    """A topic: type, number of messages, first and last log time, and the longest time between two messages."""

    topic: str
    msgtype: str
    count: int = 0
    first_ns: int = 2**62
    last_ns: int = -(2**62)
    longest_gap_ns: int = 0

    @property
    def rate_hz(self) -> float | None:
        """Mean rate, Hz; None for fewer than two messages or no time between them."""
        span_ns = self.last_ns - self.first_ns
        return (self.count - 1) * 1e9 / span_ns if self.count > 1 and span_ns > 0 else None


@dataclass(frozen=True, slots=True)
class OdometryRecord:
    """All messages of an odometry topic, or transforms of a TF edge used as odometry, in the order of arrival.

    frame, child : frames of its first message
    stamps_ns (n,); xyt (n, 3) metres, radians; twist (n, 3) forward and leftward m/s, yaw rad/s, None for TF
    pose_covariance, twist_covariance : checks of the covariances
    zero_stamps : number of zero stamps
    faults : counts of unusable poses
    """

    topic: str
    frame: str
    child: str
    stamps_ns: NDArray[np.int64]
    xyt: Array
    twist: Array | None
    pose_covariance: CovarianceCheck
    twist_covariance: CovarianceCheck
    zero_stamps: int
    faults: PoseFaults = field(default_factory=PoseFaults)


@dataclass(frozen=True, slots=True)
class EdgeRecord:
    """All transforms of one TF edge on one topic, in the order of arrival: stamps_ns (n,), xyt (n, 3); zero stamps."""

    topic: str
    parent: str
    child: str
    stamps_ns: NDArray[np.int64]
    xyt: Array
    zero_stamps: int


@dataclass(frozen=True, slots=True)
class BagScan:
    """Topics by name, odometry, TF edges and frames by channel id (see `frame_of`) of a bag."""

    topics: dict[str, TopicRecord]
    odometry: tuple[OdometryRecord, ...]
    edges: tuple[EdgeRecord, ...]
    channels: tuple[Channel, ...]
    placed: Mapping[int, str]


@dataclass(slots=True)
class _Odometry:
    frame: str = ""
    child: str = ""
    pose_covariance: CovarianceCheck = field(default_factory=CovarianceCheck)
    twist_covariance: CovarianceCheck = field(default_factory=CovarianceCheck)
    faults: PoseFaults = field(default_factory=PoseFaults)
    columns: defaultdict[str, list[NDArray[np.generic]]] = field(default_factory=lambda: defaultdict(list))


def scan_bag(reader: BagReader, watch: Callable[[Block], None] = lambda _: None) -> BagScan:
    """Return the topics, odometry and TF edges of a bag, from one pass; `watch` is called with every block.

    Raises
    ------
    BagError
        If the bag cannot be read.
    """
    topics: dict[str, TopicRecord] = {}
    odometry: dict[str, _Odometry] = {}
    edges: dict[tuple[str, str, str], list[tuple[NDArray[np.int64], Array, int]]] = defaultdict(list)
    seen: Counter[int] = Counter()
    placed: dict[int, str] = {}
    for block in reader.blocks():
        watch(block)
        for number, count in zip(*np.unique(block.table["channel"], return_counts=True), strict=True):
            channel = reader.channels[int(number)]
            frame = None if channel.id in seen else frame_of(block, channel)
            placed |= {} if frame is None else {channel.id: frame}
            seen[channel.id] += int(count)
            _count(topics, channel, block)
            if channel.encoding not in ENCODINGS:
                continue
            if channel.msgtype == ODOMETRY:
                for layout in locate(block, channel):
                    _take_odometry(odometry.setdefault(channel.topic, _Odometry()), block, layout)
            elif channel.msgtype in TRANSFORMS:
                for layout in locate(block, channel):
                    for item in layout.items:
                        key = (channel.topic, plain(item.frame_id), plain(item.child_frame_id))
                        zeros = int(np.count_nonzero(gather_stamps_ns(block, layout, item) == 0))
                        stamps_ns = stamps_or_log_ns(block, layout, item)
                        edges[key].append((stamps_ns, planar_poses(poses_in(block, layout, item)), zeros))
    return BagScan(
        dict(sorted(topics.items())),
        tuple(_odometry(topic, taken) for topic, taken in sorted(odometry.items())),
        tuple(
            EdgeRecord(
                *key,
                np.concatenate([s for s, _, _ in parts]),
                np.concatenate([p for _, p, _ in parts]),
                sum(z for _, _, z in parts),
            )
            for key, parts in sorted(edges.items())
        ),
        tuple(reader.channels[number] for number in sorted(seen)),
        placed,
    )


def _count(topics: dict[str, TopicRecord], channel: Channel, block: Block) -> None:
    record = topics.setdefault(channel.topic, TopicRecord(channel.topic, channel.msgtype))
    times = block.table["log_ns"][block.table["channel"] == channel.id]
    # blocks of a bag may overlap in time: only a message later than all before it ends a gap
    known = times if record.count == 0 else np.append(record.last_ns, times)
    record.longest_gap_ns = max(record.longest_gap_ns, int(np.diff(np.maximum.accumulate(known)).max(initial=0)))
    record.count += len(times)
    record.first_ns = min(record.first_ns, int(times.min()))
    record.last_ns = max(record.last_ns, int(times.max()))


def _take_odometry(taken: _Odometry, block: Block, layout: Layout) -> None:
    item = layout.items[0]
    if not taken.columns:
        taken.frame, taken.child = item.frame_id, item.child_frame_id
    columns = taken.columns
    poses = poses_in(block, layout, item)
    stamps_ns, xyt = stamps_or_log_ns(block, layout, item), planar_poses(poses)
    twist = gather(block, layout, item, "twist")[:, PLANAR]
    columns["stamps"].append(stamps_ns)
    columns["zero"].append(gather_stamps_ns(block, layout, item) == 0)
    columns["xyt"].append(xyt)
    columns["twist"].append(twist)
    taken.faults.take(poses.position, poses.quat_xyzw)
    taken.faults.twists.take(stamps_ns, xyt, twist)
    taken.pose_covariance.take(gather(block, layout, item, "pose_covariance"))
    taken.twist_covariance.take(gather(block, layout, item, "twist_covariance"))


def _odometry(topic: str, taken: _Odometry) -> OdometryRecord:
    whole = {name: np.concatenate(parts) for name, parts in taken.columns.items()}
    taken.faults.paths.take(whole["xyt"][np.argsort(whole["stamps"], kind="stable")])
    return OdometryRecord(
        topic, taken.frame, taken.child, whole["stamps"], whole["xyt"], whole["twist"],
        taken.pose_covariance, taken.twist_covariance, int(np.count_nonzero(whole["zero"])), taken.faults,
    )  # fmt: skip
