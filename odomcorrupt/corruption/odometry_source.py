"""The odometry source: the odometry topic, or else the TF edge, whose poses the model is applied to."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.bags.messages import gather, gather_stamps_ns
from odomcorrupt.corruption.pose_faults import PoseFaults
from odomcorrupt.corruption.reorder import Arrivals
from odomcorrupt.corruption.se2_on_se3 import SpatialPoses, inverted
from odomcorrupt.corruption.targets import (
    ENCODINGS,
    ODOMETRY,
    TRANSFORMS,
    Frames,
    find_odometry,
    plain,
    resolve_frames,
    side_of,
)  # fmt: skip
from odomcorrupt.errors import TopicError
from odomcorrupt.geometry.se2 import yaw_from_quaternion

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from odomcorrupt.bags.block import BagReader, Block, Channel
    from odomcorrupt.bags.messages import Item, Layout

__all__ = ["OdometrySource", "stamps_or_log_ns"]


class OdometrySource:
    """Odometry source of a bag: finds its topic and reads its poses.

    topic : its topic, as requested until the first message; None for any TF topic
    frames : of its first message, or of the options
    by_edge : whether the source is a TF edge
    zero_stamps : number of zero stamps, replaced by log times
    faults : counts of unusable poses
    """

    def __init__(self, topic: str | None, odom_frame: str | None, base_frame: str | None) -> None:
        self.topic = topic
        self.frames: Frames | None = None
        self._asked = topic
        self._odom_frame = odom_frame
        self._base_frame = base_frame
        self.by_edge = False
        self.zero_stamps = 0
        self.faults = PoseFaults()
        self._edges: set[str] = set()

    @property
    def elsewhere(self) -> str:
        """Advice to name another topic, or an edge of TF with its frames, as the end of an error message."""
        if self.by_edge and self._edges:
            return (
                f" (TF has {', '.join(sorted(self._edges)[:12])}); name one of these with --odom-frame and --base-frame"
            )
        return "; name another topic with --odom-topic"

    @property
    def name(self) -> str:
        """Name of the source for messages to the user."""
        if self.by_edge and self.frames is not None:
            return f"TF {self.frames.odom} -> {self.frames.base}"
        return self.topic or ""

    def prepare(self, reader: BagReader, name: str) -> None:
        """Find the source's topic before anything is read or written.

        Raises
        ------
        TopicError
            If there is none, or several, or the channels of a pipe do not decide it yet.

        """
        if not reader.complete:
            if self._asked is None:
                raise TopicError(
                    f"{name}: on a pipe topics are not known beforehand; name the odometry with --odom-topic"
                )
            return
        channels = reader.channels.values()
        if self._odom_frame is not None and self._base_frame is not None and self._only_transforms(channels):
            self._use_edge()
        else:
            self.topic = find_odometry(channels, self._asked, name)

    def _only_transforms(self, channels: Iterable[Channel]) -> bool:
        readable = [c for c in channels if c.encoding in ENCODINGS]
        asked = [c for c in readable if self._asked is None or plain(c.topic) == plain(self._asked)]
        return any(c.msgtype in TRANSFORMS for c in asked) and not any(c.msgtype == ODOMETRY for c in asked)

    def _use_edge(self) -> None:
        self.by_edge = True
        self.frames = Frames(plain(self._odom_frame or ""), plain(self._base_frame or ""))

    def is_odometry(self, channel: Channel) -> bool:
        """Whether a channel carries the odometry source."""
        return channel.msgtype == ODOMETRY and self.topic is not None and plain(channel.topic) == plain(self.topic)

    def read(self, block: Block, parts: list[tuple[Channel, Layout]], time_ns: NDArray[np.int64]) -> Arrivals:
        """Return the source's poses in a block, in the order of its messages."""
        if self.frames is None and not self.by_edge:
            self._recognise(parts)
        found = []
        for channel, layout in parts:
            if self.by_edge:
                self._edges |= {f"{plain(item.frame_id)} -> {plain(item.child_frame_id)}" for item in layout.items}
                asked = self._asked is None or plain(channel.topic) == plain(self._asked)
                items = [(number, item) for number, item in enumerate(layout.items) if asked and self._is_edge(item)]
            else:
                items = [(0, layout.items[0])] if self.is_odometry(channel) else []
            found += [(layout.rows, self._poses(block, layout, number, time_ns)) for number, _ in items]
        if not found:
            none = np.zeros(0, dtype=np.int64)
            return Arrivals(none, none, np.zeros((0, 3)))
        poses = found[0][1]
        for _, more in found[1:]:
            poses = poses.followed_by(more)
        if len(found) > 1:
            poses = poses.take(np.argsort(np.concatenate([rows for rows, _ in found]), kind="stable"))
        return poses

    def _recognise(self, parts: list[tuple[Channel, Layout]]) -> None:
        """Set topic and frames from the first odometry message, or from the TF edge where there is none."""
        driving = [(channel, layout) for channel, layout in parts if self.is_odometry(channel)]
        if driving:
            channel, layout = min(driving, key=lambda part: int(part[1].rows[0]))
            self.topic = channel.topic
            self.frames = resolve_frames(
                layout.items[0], channel.topic, odom_frame=self._odom_frame, base_frame=self._base_frame
            )
        elif self._odom_frame is not None and self._base_frame is not None and self._asked is not None:
            asked = plain(self._asked)
            if any(channel.msgtype in TRANSFORMS and plain(channel.topic) == asked for channel, _ in parts):
                self._use_edge()

    def _is_edge(self, item: Item) -> bool:
        """Whether a transform is the edge between odom and base, in either direction."""
        frames = self.frames
        if frames is None:
            return False
        ends = plain(item.frame_id), plain(item.child_frame_id)
        return ends in {(frames.odom, frames.base), (frames.base, frames.odom)}

    def _poses(self, block: Block, layout: Layout, number: int, time_ns: NDArray[np.int64]) -> Arrivals:
        item = layout.items[number]
        poses = SpatialPoses(gather(block, layout, item, "position"), gather(block, layout, item, "orientation"))
        if self.frames is not None and side_of(item.frame_id, item.child_frame_id, self.frames) == "right":
            poses = inverted(poses)
        xyt = np.column_stack((poses.position[:, :2], yaw_from_quaternion(poses.quat_xyzw)))
        self.faults.take(poses.position, poses.quat_xyzw)
        stamps_ns = gather_stamps_ns(block, layout, item)
        self.zero_stamps += len(stamps_ns) - int(np.count_nonzero(stamps_ns))
        return Arrivals(_or_log_ns(stamps_ns, block, layout), time_ns[layout.rows], xyt)


def stamps_or_log_ns(block: Block, layout: Layout, number: int) -> NDArray[np.int64]:
    """Return header stamps (n,), log times where a stamp is zero."""
    return _or_log_ns(gather_stamps_ns(block, layout, layout.items[number]), block, layout)


def _or_log_ns(stamps_ns: NDArray[np.int64], block: Block, layout: Layout) -> NDArray[np.int64]:
    if stamps_ns.all():
        return stamps_ns
    return np.where(stamps_ns == 0, block.table["log_ns"][layout.rows], stamps_ns)
