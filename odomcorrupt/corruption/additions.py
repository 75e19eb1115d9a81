"""Messages added to a bag: the clean odometry on a topic of its own, and the correction as a TF edge."""

from __future__ import annotations

import math
import re
import struct
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from odomcorrupt.bags.block import Message
from odomcorrupt.corruption.odometry_source import ODOMETRY, TRANSFORMS, plain
from odomcorrupt.errors import TopicError

if TYPE_CHECKING:
    from odomcorrupt.bags.block import BagReader, BagWriter, Block, Channel
    from odomcorrupt.corruption.correction import Curve
    from odomcorrupt.corruption.patch import Target

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
            for row in block.table[target.layout.rows]:
                start, stop = int(row["offset"]), int(row["offset"]) + int(row["length"])
                block.added.append(Message(self._channel.id, int(row["log_ns"]), block.data[start:stop].tobytes()))
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


def pack_transform(encoding: str, stamp_ns: int, frames: tuple[str, str], xyt: tuple[float, float, float]) -> bytes:
    """Return a TFMessage of one planar transform parent -> child, serialised as "ros1" or little-endian "cdr".

    frames : parent and child
    xyt : pose of the child in the parent, m, m, rad
    """
    x, y, turn = xyt
    numbers = struct.pack("<7d", x, y, 0.0, 0.0, 0.0, math.sin(turn / 2.0), math.cos(turn / 2.0))
    seconds, nanoseconds = divmod(stamp_ns, 1_000_000_000)
    names = [frame.encode() for frame in frames]
    if encoding == "ros1":
        head = struct.pack("<IIII", 1, 0, seconds, nanoseconds)
        return head + b"".join(struct.pack("<I", len(name)) + name for name in names) + numbers
    out = bytearray(struct.pack("<IiI", 1, seconds, nanoseconds))
    for name in names:
        out += b"\0" * (-len(out) % 4) + struct.pack("<I", len(name) + 1) + name + b"\0"
    return b"\0\1\0\0" + bytes(out) + b"\0" * (-len(out) % 8) + numbers
