"""Reading and writing of the numbers in serialised messages, at their offsets.

Offsets depend on the strings before the numbers, so a layout is valid for one set of structural bytes (lengths,
strings, counts, CDR header) and is found by these, never by the message's length alone.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, BinaryIO, NamedTuple

import numpy as np

from odomcorrupt.bags.chunk import windows
from odomcorrupt.bags.layouts import PROGRAMS, Item, Template, UnreadableEncodingError, read_template
from odomcorrupt.errors import BagError

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from odomcorrupt.bags.block import Block, Channel


READABLE = frozenset(PROGRAMS)
"""Message types, as `Channel.msgtype` names them, that `locate` knows."""

_SECOND_NS = 1_000_000_000


class Layout(NamedTuple):
    """Messages of one channel in one block that share a layout.

    rows : (n,) indices into the block's table, ascending
    starts : (n,) offsets of the messages in the block's data, bytes
    items : one for an Odometry or pose, one per transform for a TFMessage (none for an empty one)
    big_endian : whether numbers are stored big-endian (CDR only)
    unsigned_seconds : whether the stamps' seconds are unsigned, as in ROS 1
    size : bytes from a message's start to the end of its last number
    """

    rows: NDArray[np.int64]
    starts: NDArray[np.int64]
    items: tuple[Item, ...]
    big_endian: bool = False
    unsigned_seconds: bool = False
    size: int = 0


def locate(block: Block, channel: Channel) -> list[Layout]:
    """Return the layouts of all messages of a channel in a block.

    Raises
    ------
    BagError
        If a message is shorter than its strings and numbers require, or its type or encoding is unknown.
    """
    return list(_layouts(block, channel))


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
        kind = (template.items, template.big_endian, template.unsigned_seconds, template.size)
        yield Layout(rows[same], starts[same], *kind)
        rows, starts, lengths = rows[~same], starts[~same], lengths[~same]


def gather(block: Block, layout: Layout, item: Item, field: str) -> NDArray[np.float64]:
    """Return a copy (n, count) of a field of all messages of a layout.

    layout : n messages of the block with equal offsets
    item : the part of the message, such as one transform
    field : name of the field in `item.fields`
    """
    offset, count = item.fields[field]
    kind = np.dtype(_order(layout) + item.number)
    raw = windows(block.data, kind.itemsize * count)[layout.starts + offset]
    return raw.view(kind).reshape(-1, count).astype(np.float64, copy=False)


def scatter(block: Block, layout: Layout, item: Item, field: str, values: NDArray[np.float64]) -> None:
    """Write values (n, count) of a field of all messages of a layout into the block's data, in place; see `gather`."""
    offset, count = item.fields[field]
    rows = np.broadcast_to(values, (layout.starts.size, count))
    _put(block, layout, layout.starts + offset, rows, item.number)


def scatter_columns(
    block: Block, layout: Layout, item: Item, field: str, columns: Sequence[int], values: Sequence[NDArray[np.float64]],
    which: NDArray[np.bool_] | slice = slice(None),
) -> None:  # fmt: skip
    """Write some columns of a field, ascending, into the messages in `which`, in place; values are (n,) for each."""
    offset, _ = item.fields[field]
    starts = layout.starts[which] + offset
    begin = 0
    while begin < len(columns):
        end = begin + 1
        while end < len(columns) and columns[end] == columns[end - 1] + 1:
            end += 1
        run = np.empty((len(starts), end - begin))
        for column, own in enumerate(values[begin:end]):
            run[:, column] = own[which]
        _put(block, layout, starts + 8 * columns[begin], run)
        begin = end


def _put(
    block: Block, layout: Layout, places: NDArray[np.int64], values: NDArray[np.float64], number: str = "f8"
) -> None:
    """Write rows of numbers (n, k) of a type at offsets (n,) of the block's data."""
    raw = np.ascontiguousarray(values, dtype=_order(layout) + number)
    width = raw.itemsize * raw.shape[1]
    windows(block.data, width)[places] = raw.view(f"V{width}")[:, 0]


def gather_stamps_ns(block: Block, layout: Layout, item: Item) -> NDArray[np.int64]:
    """Return the header stamps (n,) in nanoseconds since 1970; zeros where the type has none."""
    if item.stamp < 0:
        return np.zeros(layout.starts.size, dtype=np.int64)
    raw = windows(block.data, 8)[layout.starts + item.stamp].view(_stamp_type(layout))
    return raw["s"].astype(np.int64) * _SECOND_NS + raw["ns"]


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
    seconds, nanoseconds = np.divmod(stamps_ns, _SECOND_NS)
    kind = _stamp_type(layout)
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


def _order(layout: Layout) -> str:
    return ">" if layout.big_endian else "<"


def _stamp_type(layout: Layout) -> np.dtype[np.void]:
    order = _order(layout)
    return np.dtype([("s", order + ("u4" if layout.unsigned_seconds else "i4")), ("ns", order + "u4")])


START_NS = 1_000_000_000
"""Log time of the first command: 0 would be taken for no time at all."""
_TYPE = "geometry_msgs/msg/Twist"
_CDR = b"\x00\x01\x00\x00"


def write_twists(
    target: BinaryIO, times_s: NDArray[np.float64], twist: NDArray[np.float64], topic: str = "/cmd_vel"
) -> None:
    """Write an MCAP with one Twist message for each command.

    target : a binary stream
    times_s : (n,) times since the first command, seconds; used as log times
    twist : (n, 3) forward and leftward speed, m/s, and turn rate, rad/s
    topic : of the commands
    """
    from mcap.writer import CompressionType, Writer  # noqa: PLC0415 - only needed to plan a drive
    from rosbags.typesys import Stores, get_typestore  # noqa: PLC0415 - as above

    text, _ = get_typestore(Stores.ROS2_HUMBLE).generate_msgdef(_TYPE, ros_version=2)
    rows = np.zeros((len(times_s), 6), dtype="<f8")
    rows[:, [0, 1, 5]] = twist
    stamps_ns = START_NS + np.rint(times_s * 1e9).astype(np.int64)
    writer: Any = Writer(target, compression=CompressionType.ZSTD)
    writer.start(profile="ros2", library="odomcorrupt")
    schema = writer.register_schema(_TYPE, "ros2msg", text.encode())
    channel = writer.register_channel(topic, "cdr", schema)
    for number, (stamp_ns, row) in enumerate(zip(stamps_ns.tolist(), rows, strict=True)):
        data = _CDR + row.tobytes()
        writer.add_message(channel, log_time=stamp_ns, publish_time=stamp_ns, sequence=number, data=data)
    writer.finish()


__all__ = ["READABLE", "Item", "Layout", "gather", "gather_stamps_ns", "gather_status", "locate", "scatter",
           "scatter_columns", "scatter_stamps_ns", "stamps_or_log_ns", "undecodable"]  # fmt: skip
