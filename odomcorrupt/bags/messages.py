"""Reading and writing of the numbers in serialised messages, at their offsets.

Offsets depend on the strings before the numbers, so a layout is valid for one set of structural bytes (lengths,
strings, counts, CDR header) and is found by these, never by the message's length alone.
"""

from __future__ import annotations

import math
import struct
from functools import cache
from typing import TYPE_CHECKING, Any, BinaryIO, NamedTuple

import numpy as np

from odomcorrupt.bags.chunk import windows
from odomcorrupt.bags.source import ZSTD
from odomcorrupt.errors import BagError

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator, Mapping, Sequence

    from numpy.typing import NDArray

    from odomcorrupt.bags.block import BagReader, Block, Channel


_PLAIN_CDR = {0x00: (">", 8), 0x01: ("<", 8), 0x06: (">", 4), 0x07: ("<", 4), 0x10: (">", 4), 0x11: ("<", 4)}
"""Representation identifiers of plain encodings: byte order and largest alignment. XCDR2 aligns doubles to 4 bytes."""
_OTHER_CDR = frozenset({0x02, 0x03, 0x04, *range(0x08, 0x0C), *range(0x12, 0x16)})
"""Those of other encodings (parameter lists, XML, delimited) in OMG's DDS-XTypes 1.2 and 1.3."""

TRANSFORMS = frozenset({"tf2_msgs/msg/TFMessage", "tf/msg/tfMessage"})


class UnreadableEncodingError(BagError):
    """A message is in an encoding that is not read here; it need not be damaged."""


class Item(NamedTuple):
    """One stamped item of a message: the Odometry itself, or one transform of a TFMessage.

    frame_id, child_frame_id : as written in the message ("" where the type has none), leading slashes kept
    stamp : offset of the stamp (two 32-bit words, seconds and nanoseconds) from the message's start, bytes; -1 for none
    fields : name to (offset from the message's start in bytes, count of numbers): "position" 3, "orientation" 4
        (xyzw), "pose_covariance" 36, "twist" 6, "twist_covariance" 36, "lla" 3 (degrees, degrees, metres),
        "covariance" 9 (of a NavSatFix), "angular_velocity" and "linear_acceleration" 3 (of an Imu), "limits" 2 and
        "ranges" (of a LaserScan), of a JointState the position of each joint,
        1, by its name, and in a second item the velocity of each; "wheels" 1 or 2 (left, right) of ticks and speeds;
        in Odometry and TF, orientation follows position directly
    status : offset of the signed byte NavSatStatus.status of a NavSatFix, None elsewhere
    number : type of the numbers: "f8", or of scans, ticks and speeds of wheels "f4", "i4", "i8"
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
    order : byte order of its numbers, "<" or ">"
    unsigned_seconds : whether the stamp's seconds are unsigned (ROS 1)
    """

    items: tuple[Item, ...]
    structure: NDArray[np.uint8]
    mask: NDArray[np.uint8]
    size: int
    order: str
    unsigned_seconds: bool


def read_template(data: bytes, topic: str, msgtype: str, encoding: str) -> Template:
    """Return the layout of a serialised message."""
    cursor = cursor_of(data, topic, encoding)
    if msgtype not in PROGRAMS:
        raise BagError(f"{topic}: type {msgtype} has no layout here; choose a topic of {', '.join(sorted(PROGRAMS))}")
    items = PROGRAMS[msgtype](cursor)
    width = cursor.marked_to
    mask = np.frombuffer(cursor.mask, dtype=np.uint8)[:width].copy()
    structure = np.frombuffer(data, dtype=np.uint8)[:width] & mask
    return Template(items, structure, mask, cursor.at, cursor.order, encoding == "ros1")


def cursor_of(data: bytes, topic: str, encoding: str, advice: str = ", --recover leaves such messages out") -> Cursor:
    """Return the parser of a serialised message; `advice` is for the error where it is damaged."""
    if encoding not in ("ros1", "cdr"):
        raise UnreadableEncodingError(f"{topic}: encoding {encoding!r} cannot be read; only ros1 and cdr messages can")
    return _Ros1Cursor(data, topic, advice) if encoding == "ros1" else _CdrCursor(data, topic, advice)


class Cursor:
    """Parser of a message that marks the structural bytes."""

    order = "<"
    header_bytes = 0
    stamp_kind = "iI"

    def __init__(self, data: bytes, topic: str, advice: str) -> None:
        self.data = data
        self.topic = topic
        self.advice = advice
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
                f"counts say a field lies; the bag is damaged or the topic's type is not what it says{self.advice}"
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

    def numbers(self, kind: str, count: int = 1) -> list[Any]:
        """Read this many numbers of one struct type."""
        size = struct.calcsize(kind)
        self.align(size)
        return list(
            struct.unpack_from(f"{self.order}{count}{kind}", self.data, self.take(size * count, structural=False))
        )

    def sequence(self, kind: str) -> NDArray[Any]:
        """Read a sequence of numbers of one numpy type."""
        count, dtype = self.count(), np.dtype(self.order + kind)
        return np.frombuffer(self.data, dtype, count, self.take(count * dtype.itemsize, structural=False))

    def skip(self, size: int) -> int:
        """Skip a plain number that is not structural; return its offset."""
        self.align(size)
        return self.take(size, structural=False)

    def header(self) -> tuple[int, str]:
        """Read a std_msgs/Header; return the offset of the stamp, and the frame."""
        self.align(4)
        self.take(self.header_bytes, structural=False)
        return self.take(8, structural=False), self.string()


class _Ros1Cursor(Cursor):
    header_bytes = 4  # the sequence number
    stamp_kind = "II"


class _CdrCursor(Cursor):
    def __init__(self, data: bytes, topic: str, advice: str) -> None:
        super().__init__(data, topic, advice)
        self.take(4, structural=True)
        if data[0] != 0 or data[1] not in _PLAIN_CDR:
            if data[:4] == ZSTD:
                raise UnreadableEncodingError(
                    f"{topic}: its messages are compressed one by one (zstd), which a pipe does not say beforehand; "
                    "name the file or its directory"
                )
            said = f"{topic}: CDR representation 0x{data[:2].hex()} is not a plain one"
            if data[0] == 0 and data[1] in _OTHER_CDR:
                raise UnreadableEncodingError(said)
            raise BagError(f"{said}; the bag is damaged{advice}")
        self.order, self.largest = _PLAIN_CDR[data[1]]
        # The options (bytes 2, 3) give the padding after the message: they are not structural.
        self.mask[2:4] = b"\0\0"

    def align(self, size: int) -> None:
        self.take((4 - self.at) % min(size, self.largest), structural=False)


def _doubles(*, child: bool = False, **counts: int) -> Callable[[Cursor], tuple[Item, ...]]:
    """Return the reader of a message of a header, a child frame if it has one, and float64 numbers.

    counts : how many there are of each field, in order; those of a name that begins with _ are passed over
    """

    def read(cursor: Cursor) -> tuple[Item, ...]:
        stamp, frame = cursor.header()
        below = cursor.string() if child else ""
        fields = {name: cursor.doubles(count) for name, count in counts.items()}
        return (Item(frame, below, stamp, {name: at for name, at in fields.items() if name[0] != "_"}),)

    return read


_transform = _doubles(child=True, position=3, orientation=4)


def _transforms(cursor: Cursor) -> tuple[Item, ...]:
    items: list[Item] = []
    for _ in range(cursor.count()):
        items += _transform(cursor)
    return tuple(items)


def _nav_sat_fix(cursor: Cursor) -> tuple[Item, ...]:
    stamp, frame = cursor.header()
    status = cursor.skip(1)
    cursor.skip(2)  # service
    return (Item(frame, "", stamp, {"lla": cursor.doubles(3), "covariance": cursor.doubles(9)}, status),)


def _laser_scan(cursor: Cursor) -> tuple[Item, ...]:
    stamp, frame = cursor.header()
    start = cursor.skip(4)
    cursor.take(24, structural=False)
    count = cursor.count()
    ranges = {"ranges": (cursor.take(4 * count, structural=False), count)} if count else {}
    return (Item(frame, "", stamp, {"limits": (start + 20, 2), **ranges}, number="f4"),)


def _joint_state(cursor: Cursor) -> tuple[Item, ...]:
    stamp, frame = cursor.header()
    names = [cursor.string() for _ in range(cursor.count())]
    items = []
    for _ in ("position", "velocity"):
        count = cursor.count()
        start, _ = cursor.doubles(count) if count else (0, 0)
        items.append(Item(frame, "", stamp, {name: (start + 8 * i, 1) for i, name in enumerate(names[:count])}))
    return tuple(items)


def _wheels(number: str, before: int = 0, count: int = 2) -> Callable[[Cursor], tuple[Item, ...]]:
    """Return the reader of a message with the ticks or speeds of wheels.

    number, count : type of these numbers, and how many follow each other
    before : bytes between them and the header; -1 for no header
    """

    def read(cursor: Cursor) -> tuple[Item, ...]:
        stamp, frame = cursor.header() if before >= 0 else (-1, "")
        size = int(number[1])
        cursor.align(4 if before > 0 else size)
        cursor.take(max(before, 0), structural=False)
        start = cursor.skip(size)
        cursor.take(size * (count - 1), structural=False)
        return (Item(frame, "", stamp, {"wheels": (start, count)}, number=number),)

    return read


SCAN = "sensor_msgs/msg/LaserScan"

PROGRAMS: Mapping[str, Callable[[Cursor], tuple[Item, ...]]] = {
    "nav_msgs/msg/Odometry": _doubles(
        child=True, position=3, orientation=4, pose_covariance=36, twist=6, twist_covariance=36
    ),
    "tf2_msgs/msg/TFMessage": _transforms,
    "tf/msg/tfMessage": _transforms,
    "geometry_msgs/msg/PoseStamped": _doubles(position=3, orientation=4),
    "geometry_msgs/msg/PoseWithCovarianceStamped": _doubles(position=3, orientation=4, pose_covariance=36),
    "geometry_msgs/msg/PointStamped": _doubles(position=3),
    "geometry_msgs/msg/TransformStamped": _transform,
    "sensor_msgs/msg/NavSatFix": _nav_sat_fix,
    "sensor_msgs/msg/Imu": _doubles(
        orientation=4, _orientation_covariance=9, angular_velocity=3, _covariance=9, linear_acceleration=3
    ),
    SCAN: _laser_scan,
    "sensor_msgs/msg/JointState": _joint_state,
    "geometry_msgs/msg/TwistStamped": _doubles(twist=6),
    "geometry_msgs/msg/TwistWithCovarianceStamped": _doubles(twist=6),
    "irobot_create_msgs/msg/WheelTicks": _wheels("i4"),
    "irobot_create_msgs/msg/WheelVels": _wheels("f4"),
    "std_msgs/msg/Int32": _wheels("i4", -1, 1),
    "std_msgs/msg/Int64": _wheels("i8", -1, 1),
    "std_msgs/msg/Float32": _wheels("f4", -1, 1),
    "std_msgs/msg/Float64": _wheels("f8", -1, 1),
}
"""What can be read, by message type."""


READABLE = frozenset(PROGRAMS)
"""Message types, as `Channel.msgtype` names them, that `locate` knows."""

SECOND_NS = 1_000_000_000


class Layout(NamedTuple):
    """Messages of one channel in one block that share a layout.

    rows : (n,) indices into the block's table, ascending
    starts : (n,) offsets of the messages in the block's data, bytes
    items : one for an Odometry or pose, one per transform for a TFMessage (none for an empty one)
    order : byte order of the numbers, "<" or ">" (CDR only)
    unsigned_seconds : whether the stamps' seconds are unsigned, as in ROS 1
    """

    rows: NDArray[np.int64]
    starts: NDArray[np.int64]
    items: tuple[Item, ...]
    order: str
    unsigned_seconds: bool


def locate(block: Block, channel: Channel) -> list[Layout]:
    """Return the layouts of all messages of a channel in a block.

    Raises
    ------
    BagError
        If a message is shorter than its strings and numbers require, or its type or encoding is unknown.
    """
    return list(_layouts(block, channel))


def located(reader: BagReader, channels: Collection[Channel]) -> Iterator[tuple[Block, Channel, Layout]]:
    """Yield the layouts of all messages of some channels of a bag, each with its block and channel; see `locate`."""
    for block in reader.blocks():
        for channel in channels:
            for layout in locate(block, channel):
                yield block, channel, layout


def undecodable(block: Block, channel: Channel) -> dict[int, BagError]:
    """Return why messages of a channel in a block cannot be decoded, by row of the block's table.

    Those of types and encodings that are not read here are not among them.
    """
    failed: dict[int, BagError] = {}
    if channel.msgtype in PROGRAMS and channel.encoding in ("ros1", "cdr"):
        for _ in _layouts(block, channel, failed):
            pass
    return failed


def _layouts(block: Block, channel: Channel, failed: dict[int, BagError] | None = None) -> Iterator[Layout]:
    """Yield the layouts of a channel's messages; errors of single messages are put into `failed`, if given."""
    rows = np.flatnonzero(block.table["channel"] == channel.id)
    starts = block.table["offset"][rows]
    lengths = block.table["length"][rows]
    if np.any((starts < 0) | (lengths < 0) | (starts > block.data.size - lengths)):
        raise BagError(f"{channel.topic}: a message lies beyond its block of {block.data.size} bytes; damaged bag")
    while rows.size:
        first = block.data[starts[0] : starts[0] + lengths[0]].tobytes()
        try:
            template = read_template(first, channel.topic, channel.msgtype, channel.encoding)
        except BagError as error:
            if failed is None:
                raise
            if not isinstance(error, UnreadableEncodingError):
                failed[int(rows[0])] = error
            rows, starts, lengths = rows[1:], starts[1:], lengths[1:]
            continue
        same = _matches(block.data, starts, lengths, template)
        yield Layout(rows[same], starts[same], template.items, template.order, template.unsigned_seconds)
        rows, starts, lengths = rows[~same], starts[~same], lengths[~same]


def gather(block: Block, layout: Layout, item: Item, field: str) -> NDArray[np.float64]:
    """Return a copy (n, count) of a field of all messages of a layout.

    layout : n messages of the block with equal offsets
    item : the part of the message, such as one transform
    field : name of the field in `item.fields`
    """
    offset, count = item.fields[field]
    kind = np.dtype(layout.order + item.number)
    raw = windows(block.data, kind.itemsize * count)[layout.starts + offset]
    return raw.view(kind).reshape(-1, count).astype(np.float64, copy=False)


def scatter(block: Block, layout: Layout, item: Item, field: str, values: NDArray[np.float64]) -> None:
    """Write values (n, count) of a field of all messages of a layout into the block's data, in place; see `gather`."""
    offset, count = item.fields[field]
    raw = np.empty((layout.starts.size, count), layout.order + item.number)
    raw[:] = values
    width = raw.itemsize * count
    windows(block.data, width)[layout.starts + offset] = raw.view(f"V{width}")[:, 0]


def scatter_columns(
    block: Block, layout: Layout, item: Item, field: str, columns: Sequence[int], values: Sequence[NDArray[np.float64]],
    which: NDArray[np.bool_] | slice = slice(None),
) -> None:  # fmt: skip
    """Write some columns of a field, ascending, into the messages in `which`, in place; values are (n,) for each."""
    offset, _ = item.fields[field]
    chosen = layout._replace(starts=layout.starts[which])
    begin = 0
    while begin < len(columns):
        end = begin + 1
        while end < len(columns) and columns[end] == columns[end - 1] + 1:
            end += 1
        run = item._replace(fields={field: (offset + 8 * columns[begin], end - begin)})
        scatter(block, chosen, run, field, np.array([own[which] for own in values[begin:end]]).T)
        begin = end


def gather_stamps_ns(block: Block, layout: Layout, item: Item) -> NDArray[np.int64]:
    """Return the header stamps (n,) in nanoseconds since 1970; zeros where the type has none."""
    if item.stamp < 0:
        return np.zeros(layout.starts.size, dtype=np.int64)
    raw = windows(block.data, 8)[layout.starts + item.stamp].view(_stamp_type(layout.order, layout.unsigned_seconds))
    return raw["s"].astype(np.int64) * SECOND_NS + raw["ns"]


def stamps_or_log_ns(block: Block, layout: Layout, item: Item) -> NDArray[np.int64]:
    """Return header stamps (n,), log times where a stamp is zero."""
    stamps_ns = gather_stamps_ns(block, layout, item)
    if stamps_ns.all():
        return stamps_ns
    return np.where(stamps_ns == 0, block.table["log_ns"][layout.rows], stamps_ns)


def gather_status(block: Block, layout: Layout, item: Item) -> NDArray[np.int8]:
    """Return NavSatStatus.status (n,) of messages of a NavSatFix: -1 no fix, 0 fix, 1 SBAS, 2 GBAS."""
    assert item.status is not None  # noqa: S101 - asked of a NavSatFix alone
    raw = windows(block.data, 1)[layout.starts + item.status]
    return raw.view(np.int8).reshape(-1)


def scatter_stamps_ns(block: Block, layout: Layout, item: Item, stamps_ns: NDArray[np.int64]) -> None:
    """Write the header stamps (n,), in nanoseconds since 1970.

    Raises
    ------
    BagError
        If a stamp does not fit into the message's 32 bits of seconds.
    """
    seconds, nanoseconds = np.divmod(stamps_ns, SECOND_NS)
    kind = _stamp_type(layout.order, layout.unsigned_seconds)
    limits = np.iinfo(kind["s"])
    if np.any((seconds < limits.min) | (seconds > limits.max)):
        raise BagError(
            f"stamp: {seconds.min()} s to {seconds.max()} s do not fit a header (up to {limits.max} s from "
            f"{limits.min} s); shift stamps by less"
        )
    raw = np.empty(layout.starts.size, dtype=kind)
    raw["s"], raw["ns"] = seconds, nanoseconds
    windows(block.data, 8)[layout.starts + item.stamp] = raw.view("V8")


def _matches(
    data: NDArray[np.uint8], starts: NDArray[np.int64], lengths: NDArray[np.int64], template: Template
) -> NDArray[np.bool_]:
    """Return a mask (n,) of messages with a template's structural bytes and long enough for its numbers."""
    same = lengths >= template.size
    candidates = np.flatnonzero(same) if not same.all() else slice(None)
    width = template.mask.size
    if not width:
        return same
    # by 64-bit words, the last of which may overlap: eight bytes compare as fast as one
    step = 8 if width >= 8 else 1
    heads = windows(data, width)[starts[candidates]].view(np.uint8)
    for begin in (*range(0, width - step, step), width - step):
        mask = template.mask[begin : begin + step].view(f"u{step}")[0]
        if mask:
            words: NDArray[np.uint64] = np.ndarray((heads.size // width,), f"u{step}", heads, begin, (width,))
            same[candidates] &= (words & mask) == template.structure[begin : begin + step].view(f"u{step}")[0]
    return same


@cache
def _stamp_type(order: str, unsigned: bool) -> np.dtype[np.void]:  # noqa: FBT001 - for the cache
    return np.dtype([("s", order + "iu"[unsigned] + "4"), ("ns", order + "u4")])


def pack_transform(encoding: str, stamp_ns: int, frames: tuple[str, str], xyt: tuple[float, float, float]) -> bytes:
    """Return a TFMessage of one planar transform parent -> child, serialised as "ros1" or little-endian "cdr".

    frames : parent and child
    xyt : pose of the child in the parent, m, m, rad
    """
    x, y, turn = xyt
    numbers = struct.pack("<7d", x, y, 0.0, 0.0, 0.0, math.sin(turn / 2.0), math.cos(turn / 2.0))
    seconds, nanoseconds = divmod(stamp_ns, SECOND_NS)
    names = [frame.encode() for frame in frames]
    if encoding == "ros1":
        head = struct.pack("<IIII", 1, 0, seconds, nanoseconds)
        return head + b"".join(struct.pack("<I", len(name)) + name for name in names) + numbers
    out = bytearray(struct.pack("<IiI", 1, seconds, nanoseconds))
    for name in names:
        out += b"\0" * (-len(out) % 4) + struct.pack("<I", len(name) + 1) + name + b"\0"
    return b"\0\1\0\0" + bytes(out) + b"\0" * (-len(out) % 8) + numbers


def write_twists(target: BinaryIO, times_s: NDArray[np.float64], twist: NDArray[np.float64]) -> None:
    """Write an MCAP with one Twist message on /cmd_vel for each command.

    times_s : (n,) log times since the first command, seconds
    twist : (n, 3) forward and leftward speed, m/s, and turn rate, rad/s
    """
    from mcap.writer import CompressionType, Writer  # noqa: PLC0415 - only needed to plan a drive
    from rosbags.typesys import Stores, get_typestore  # noqa: PLC0415 - as above

    name = "geometry_msgs/msg/Twist"
    text, _ = get_typestore(Stores.ROS2_HUMBLE).generate_msgdef(name, ros_version=2)
    rows = np.zeros((len(times_s), 6), dtype="<f8")
    rows[:, [0, 1, 5]] = twist
    stamps_ns = SECOND_NS + np.rint(times_s * 1e9).astype(np.int64)
    writer: Any = Writer(target, compression=CompressionType.ZSTD)
    writer.start(profile="ros2", library="odomcorrupt")
    schema = writer.register_schema(name, "ros2msg", text.encode())
    channel = writer.register_channel("/cmd_vel", "cdr", schema)
    for number, (stamp_ns, row) in enumerate(zip(stamps_ns.tolist(), rows, strict=True)):
        data = b"\0\1\0\0" + row.tobytes()
        writer.add_message(channel, log_time=stamp_ns, publish_time=stamp_ns, sequence=number, data=data)
    writer.finish()
