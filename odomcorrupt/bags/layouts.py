"""Layout of a serialised message: the offsets of its numbers.

All bytes but stamps, sequence numbers, padding and plain numbers are structural. A template holds those bytes and a
mask; a message with the same structural bytes has its numbers at the same offsets.
"""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from odomcorrupt.errors import BagError

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from numpy.typing import NDArray

_PLAIN_CDR = {0x00: (">", 8), 0x01: ("<", 8), 0x06: (">", 4), 0x07: ("<", 4), 0x10: (">", 4), 0x11: ("<", 4)}
"""Representation identifiers of plain encodings: byte order and largest alignment. XCDR2 aligns doubles to 4 bytes."""
_OTHER_CDR = frozenset({0x02, 0x03, 0x04, *range(0x08, 0x0C), *range(0x12, 0x16)})
"""Those of other encodings (parameter lists, XML, delimited) in OMG's DDS-XTypes 1.2 and 1.3."""

_ZSTD = b"\x28\xb5\x2f\xfd"


class UnreadableEncodingError(BagError):
    """A message is in an encoding that is not read here; it need not be damaged."""


class Item(NamedTuple):
    """One stamped item of a message: the Odometry itself, or one transform of a TFMessage.

    frame_id, child_frame_id : as written in the message ("" where the type has none), leading slashes kept
    stamp : offset of the stamp (two 32-bit words, seconds and nanoseconds) from the message's start, bytes; -1 for none
    fields : name to (offset from the message's start in bytes, count of numbers): "position" 3, "orientation" 4
        (xyzw), "pose_covariance" 36, "twist" 6, "twist_covariance" 36, "lla" 3 (degrees, degrees, metres),
        "covariance" 9 (of a NavSatFix), "angular_velocity" 3 (of an Imu), of a JointState the position of each joint,
        1, by its name, and in a second item the velocity of each; "wheels" 1 or 2 (left, right) of ticks and speeds;
        in Odometry and TF, orientation follows position directly
    status : offset of the signed byte NavSatStatus.status of a NavSatFix, None elsewhere
    number : type of the numbers: "f8", or of ticks and speeds of wheels "f4", "i4", "i8"
    """

    frame_id: str
    child_frame_id: str
    stamp: int
    fields: Mapping[str, tuple[int, int]]
    status: int | None = None
    number: str = "f8"


class Template(NamedTuple):
    """Layout common to all messages with these structural bytes.

    structure : (w,) uint8, the first w bytes of such a message, other than structural ones zeroed
    mask : (w,) uint8, 255 where a byte is structural
    size : bytes from the message's start to the end of its last number
    unsigned_seconds : whether the stamp's seconds are unsigned (ROS 1)
    """

    items: tuple[Item, ...]
    structure: NDArray[np.uint8]
    mask: NDArray[np.uint8]
    size: int
    big_endian: bool
    unsigned_seconds: bool


def read_template(data: bytes, topic: str, msgtype: str, encoding: str) -> Template:
    """Return the layout of a serialised message."""
    if encoding not in ("ros1", "cdr"):
        raise UnreadableEncodingError(f"{topic}: encoding {encoding!r} cannot be read; only ros1 and cdr messages can")
    if msgtype not in PROGRAMS:
        raise BagError(f"{topic}: type {msgtype} has no layout here; choose a topic of {', '.join(sorted(PROGRAMS))}")
    cursor = _Ros1Cursor(data, topic) if encoding == "ros1" else _CdrCursor(data, topic)
    items = PROGRAMS[msgtype](cursor)
    width = cursor.marked_to
    mask = np.frombuffer(cursor.mask, dtype=np.uint8)[:width].copy()
    structure = np.frombuffer(data, dtype=np.uint8)[:width] & mask
    return Template(items, structure, mask, cursor.at, cursor.order == ">", encoding == "ros1")


class _Cursor:
    """Parser of a message that marks the structural bytes."""

    order = "<"
    header_bytes = 0

    def __init__(self, data: bytes, topic: str) -> None:
        self.data = data
        self.topic = topic
        self.at = 0
        self.mask = bytearray(len(data))
        self.marked_to = 0

    def align(self, size: int) -> None:
        """Skip the padding before a number of this size."""

    def take(self, size: int, *, structural: bool) -> int:
        """Skip bytes; return their offset."""
        start, end = self.at, self.at + size
        if end > len(self.data):
            raise BagError(
                f"{self.topic}: a message of {len(self.data)} bytes ends before byte {end}, where its strings and "
                "counts say a field lies; the bag is damaged or the topic's type is not what it says, --recover leaves "
                "such messages out"
            )
        if structural:
            self.mask[start:end] = b"\xff" * size
            self.marked_to = end
        self.at = end
        return start

    def count(self) -> int:
        """Read a length or count, four bytes."""
        self.align(4)
        start = self.take(4, structural=True)
        return int(struct.unpack_from(self.order + "I", self.data, start)[0])

    def string(self) -> str:
        """Read a string; zero-terminated in CDR only."""
        length = self.count()
        start = self.take(length, structural=True)
        return self.data[start : start + length].removesuffix(b"\0").decode(errors="replace")

    def doubles(self, count: int) -> tuple[int, int]:
        """Skip float64 numbers; return their offset and count."""
        self.align(8)
        return self.take(8 * count, structural=False), count

    def skip(self, size: int) -> int:
        """Skip a plain number that is not structural; return its offset."""
        self.align(size)
        return self.take(size, structural=False)

    def header(self) -> tuple[int, str]:
        """Read a std_msgs/Header; return the offset of the stamp, and the frame."""
        self.align(4)
        self.take(self.header_bytes, structural=False)
        return self.take(8, structural=False), self.string()


class _Ros1Cursor(_Cursor):
    header_bytes = 4  # the sequence number


class _CdrCursor(_Cursor):
    def __init__(self, data: bytes, topic: str) -> None:
        super().__init__(data, topic)
        self.take(4, structural=True)
        if data[0] != 0 or data[1] not in _PLAIN_CDR:
            if data[:4] == _ZSTD:
                raise UnreadableEncodingError(
                    f"{topic}: its messages are compressed one by one (zstd), which a pipe does not say beforehand; "
                    "name the file or its directory"
                )
            said = f"{topic}: CDR representation 0x{data[:2].hex()} is not a plain one"
            if data[0] == 0 and data[1] in _OTHER_CDR:
                raise UnreadableEncodingError(said)
            raise BagError(f"{said}; the bag is damaged, --recover leaves such messages out")
        self.order, self.largest = _PLAIN_CDR[data[1]]
        # The options (bytes 2, 3) give the padding after the message: they are not structural.
        self.mask[2:4] = b"\0\0"

    def align(self, size: int) -> None:
        self.take((4 - self.at) % min(size, self.largest), structural=False)


def _odometry(cursor: _Cursor) -> tuple[Item, ...]:
    stamp, frame = cursor.header()
    child = cursor.string()
    fields = {"position": cursor.doubles(3), "orientation": cursor.doubles(4), "pose_covariance": cursor.doubles(36)}
    return (Item(frame, child, stamp, fields | {"twist": cursor.doubles(6), "twist_covariance": cursor.doubles(36)}),)


def _transform(cursor: _Cursor) -> tuple[Item, ...]:
    stamp, frame = cursor.header()
    child = cursor.string()
    return (Item(frame, child, stamp, {"position": cursor.doubles(3), "orientation": cursor.doubles(4)}),)


def _transforms(cursor: _Cursor) -> tuple[Item, ...]:
    items: list[Item] = []
    for _ in range(cursor.count()):
        items += _transform(cursor)
    return tuple(items)


def _point(cursor: _Cursor) -> tuple[Item, ...]:
    stamp, frame = cursor.header()
    return (Item(frame, "", stamp, {"position": cursor.doubles(3)}),)


def _pose(cursor: _Cursor) -> tuple[Item, ...]:
    stamp, frame = cursor.header()
    return (Item(frame, "", stamp, {"position": cursor.doubles(3), "orientation": cursor.doubles(4)}),)


def _pose_with_covariance(cursor: _Cursor) -> tuple[Item, ...]:
    (item,) = _pose(cursor)
    fields = {**item.fields, "pose_covariance": cursor.doubles(36)}
    return (Item(item.frame_id, "", item.stamp, fields),)


def _nav_sat_fix(cursor: _Cursor) -> tuple[Item, ...]:
    stamp, frame = cursor.header()
    status = cursor.skip(1)
    cursor.skip(2)  # service
    return (Item(frame, "", stamp, {"lla": cursor.doubles(3), "covariance": cursor.doubles(9)}, status),)


def _imu(cursor: _Cursor) -> tuple[Item, ...]:
    stamp, frame = cursor.header()
    orientation, _ = cursor.doubles(4), cursor.doubles(9)
    return (Item(frame, "", stamp, {"orientation": orientation, "angular_velocity": cursor.doubles(3)}),)


def _joint_state(cursor: _Cursor) -> tuple[Item, ...]:
    stamp, frame = cursor.header()
    names = [cursor.string() for _ in range(cursor.count())]
    items = []
    for _ in ("position", "velocity"):
        count = cursor.count()
        start, _ = cursor.doubles(count) if count else (0, 0)
        items.append(Item(frame, "", stamp, {name: (start + 8 * i, 1) for i, name in enumerate(names[:count])}))
    return tuple(items)


def _twist(cursor: _Cursor) -> tuple[Item, ...]:
    stamp, frame = cursor.header()
    return (Item(frame, "", stamp, {"twist": cursor.doubles(6)}),)


def _wheels(number: str, before: int = 0, count: int = 2) -> Callable[[_Cursor], tuple[Item, ...]]:
    """Return the reader of a message with the ticks or speeds of wheels.

    number, count : type of these numbers, and how many follow each other
    before : bytes between them and the header; -1 for no header
    """

    def read(cursor: _Cursor) -> tuple[Item, ...]:
        stamp, frame = cursor.header() if before >= 0 else (-1, "")
        size = int(number[1])
        cursor.align(4 if before > 0 else size)
        cursor.take(max(before, 0), structural=False)
        start = cursor.skip(size)
        cursor.take(size * (count - 1), structural=False)
        return (Item(frame, "", stamp, {"wheels": (start, count)}, number=number),)

    return read


PROGRAMS: Mapping[str, Callable[[_Cursor], tuple[Item, ...]]] = {
    "nav_msgs/msg/Odometry": _odometry,
    "tf2_msgs/msg/TFMessage": _transforms,
    "tf/msg/tfMessage": _transforms,
    "geometry_msgs/msg/PoseStamped": _pose,
    "geometry_msgs/msg/PoseWithCovarianceStamped": _pose_with_covariance,
    "geometry_msgs/msg/PointStamped": _point,
    "geometry_msgs/msg/TransformStamped": _transform,
    "sensor_msgs/msg/NavSatFix": _nav_sat_fix,
    "sensor_msgs/msg/Imu": _imu,
    "sensor_msgs/msg/JointState": _joint_state,
    "geometry_msgs/msg/TwistStamped": _twist,
    "geometry_msgs/msg/TwistWithCovarianceStamped": _twist,
    "irobot_create_msgs/msg/WheelTicks": _wheels("i4"),
    "irobot_create_msgs/msg/WheelVels": _wheels("f4"),
    "std_msgs/msg/Int32": _wheels("i4", -1, 1),
    "std_msgs/msg/Int64": _wheels("i8", -1, 1),
    "std_msgs/msg/Float32": _wheels("f4", -1, 1),
    "std_msgs/msg/Float64": _wheels("f8", -1, 1),
}
"""What can be read, by message type."""
