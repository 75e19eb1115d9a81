"""ROS 1 bag writer: message bytes, definitions, md5sums, callerids and latching are those of the input."""

from __future__ import annotations

import struct
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise, zip_longest
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.bags.block import TABLE, Message, require_all
from odomcorrupt.bags.codecs import compress_for_ros1
from odomcorrupt.bags.definition import OutputChannels, md5sum_of, retyped
from odomcorrupt.bags.messages import SECOND_NS
from odomcorrupt.bags.output import OutputContext
from odomcorrupt.bags.ros1.chunk import CODECS, INDEX_ENTRY, Connection, Op, Ros1Framing, pack_fields, pack_record
from odomcorrupt.bags.ros1.reader import Ros1Reader
from odomcorrupt.bags.source import ROS1 as MAGIC
from odomcorrupt.errors import BagError

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    from numpy.typing import NDArray

    from odomcorrupt.bags.block import BagReader, Block, Channel, Definition
    from odomcorrupt.bags.output import Original, Output
    from odomcorrupt.bags.pipeline import Workers


@dataclass(frozen=True, slots=True)
class Framed:
    """Records of messages, and of connections before them.

    data : (size,) uint8
    table : (n,) of dtype TABLE, its offsets counted from the start of data
    starts : (n,) offsets of the message records, bytes
    ends : where its chunks end in data, none for one chunk
    """

    data: NDArray[np.uint8]
    table: NDArray[np.void]
    starts: NDArray[np.int64]
    ends: tuple[int, ...] = ()

    def followed_by(self, other: Framed) -> Framed:
        """Return both, with the other one appended to the last chunk of this one."""
        moved = other.table.copy()
        moved["offset"] += self.data.size
        return Framed(
            np.concatenate([self.data, other.data]),
            np.concatenate([self.table, moved]),
            np.concatenate([self.starts, other.starts + self.data.size]),
            (*self.ends[:-1], self.data.size + other.data.size),
        )

    def chunks(self) -> Iterator[Framed]:
        """Yield its chunks, one by one."""
        begin = start = 0
        for end in self.ends[:-1]:
            stop = int(np.searchsorted(self.starts, end))
            yield self._part(begin, end, start, stop)
            begin, start = end, stop
        yield self._part(begin, self.data.size, start, len(self.starts)) if begin else self

    def _part(self, begin: int, end: int, start: int, stop: int) -> Framed:
        table = self.table[start:stop].copy()
        table["offset"] -= begin
        return Framed(self.data[begin:end], table, self.starts[start:stop] - begin)


def pack_time(log_ns: int) -> bytes:
    """Return a time in ROS 1's serialisation: seconds and nanoseconds as unsigned 32-bit words."""
    seconds, nanoseconds = divmod(log_ns, SECOND_NS)
    if not 0 <= seconds < 1 << 32:
        raise BagError(f"log time {log_ns} ns: does not fit a ROS 1 bag (0 to 2106); write an MCAP instead")
    return struct.pack("<II", seconds, nanoseconds)


def frame(before: bytes, messages: list[Message]) -> Framed:
    """Return records of messages, after records that must precede them."""
    pieces = [before]
    rows: list[tuple[int, int, int, int]] = []
    starts: list[int] = []
    at = len(before)
    for message in messages:
        fields = {
            "conn": struct.pack("<I", message.channel),
            "op": bytes([Op.MESSAGE]),
            "time": pack_time(message.log_ns),
        }
        pieces.append(pack_record(pack_fields(fields), message.data))
        starts.append(at)
        at += len(pieces[-1])
        rows.append((message.channel, message.log_ns, at - len(message.data), len(message.data)))
    data = np.frombuffer(b"".join(pieces), dtype=np.uint8)
    return Framed(data, np.array(rows, dtype=TABLE), np.array(starts, dtype=np.int64))


def indexes(framed: Framed) -> list[tuple[int, int, bytes]]:
    """Return (connection, count, index record) for each connection of a chunk, ascending."""
    order = np.argsort(framed.table["channel"], kind="stable")
    channels = framed.table["channel"][order]
    entries = np.empty(order.size, dtype=INDEX_ENTRY)
    entries["s"], entries["ns"] = np.divmod(framed.table["log_ns"][order], SECOND_NS)
    entries["offset"] = framed.starts[order]
    found: list[tuple[int, int, bytes]] = []
    bounds = [0, *(np.flatnonzero(channels[1:] != channels[:-1]) + 1).tolist(), order.size]
    for start, stop in pairwise(bounds if order.size else ()):
        connection = int(channels[start])
        header = pack_fields(
            {
                "conn": struct.pack("<I", connection),
                "count": struct.pack("<I", stop - start),
                "op": bytes([Op.INDEX]),
                "ver": struct.pack("<I", 1),
            }
        )
        found.append((connection, stop - start, pack_record(header, entries[start:stop].tobytes())))
    return found


class Connections(OutputChannels):
    """Ids and records of the connections of an output, and which of them are written.

    native : whether ids and records of the bag's own connections are kept
    """

    def __init__(self, reader: BagReader) -> None:
        super().__init__(reader)
        self.native = isinstance(reader, Ros1Reader)
        self._made: dict[int, Connection] = {}
        self._waiting: set[int] = set()
        if not self.native and reader.complete:
            for channel in reader.channels.values():
                self._make(channel, reader.definition(channel))

    def add(self, topic: str, msgtype: str, encoding: str, definition: Definition) -> Channel:
        """Add a channel with a given definition; return it."""
        channel = super().add(topic, msgtype, encoding, definition)
        self._make(channel, definition)
        return channel

    def take_records(self, channels: Iterable[int]) -> bytes:
        """Return the connection records that must precede messages of these channels."""
        needed: set[int] = set()
        for channel in set(channels):
            if self.native and channel in self._made and channel in self.reader.channels:
                raise BagError(f"connection {channel}: appeared after its id was given to a new topic; use a file")
            known, definition = self.described(channel)
            if not self.native and channel not in self._made:
                self._make(known, definition)
            if channel in self._waiting:
                needed.add(channel)
        self._waiting -= needed
        return b"".join(self._made[one].pack() for one in sorted(needed))

    def packed(self) -> list[bytes]:
        """Return all connection records, for the index."""
        own = [channel.raw for channel in self.reader.channels.values()] if self.native else []
        return [one.pack() for one in [*own, *self._made.values()]]

    def _make(self, channel: Channel, definition: Definition) -> None:
        if channel.encoding != "ros1":
            raise BagError(f"{channel.topic}: has {channel.encoding} messages, a ROS 1 bag holds ros1; write an MCAP")
        metadata = definition.metadata
        fields = {
            "topic": channel.topic.encode(),
            "type": definition.name.encode(),
            "md5sum": (metadata.get("md5sum") or md5sum_of(channel.msgtype, definition)).encode(),
            "message_definition": definition.text,
        }
        # what belongs to the publisher, not to the type
        fields |= {key: metadata[key].encode() for key in ("callerid", "latching") if key in metadata}
        self._made[channel.id] = Connection.build(channel.id, channel.topic, fields)
        self._waiting.add(channel.id)


_HEADER_BYTES = 4104
"""Size of the bag header's record as rosbag reserves it; it is overwritten once the index is known."""
_MOST_HEADER_BYTES = 1 << 16
_CHUNK_LIMIT = 1 << 32


class Ros1Writer(OutputContext):
    """A ROS 1 bag being written from the blocks of a reader.

    keeps_rest : whether only messages that may change need to be read of chunks that the kernel can copy
    codec : compression of the chunks; None keeps each chunk's own
    level : compression level; None is the default of the codec
    workers : threads for compression; written blocks must then not change
    pack : compression function of chunks, default `compress_for_ros1`; a batch compresses common chunks once
    """

    def __init__(
        self, output: Output, reader: BagReader, codec: str | None = None, level: int | None = None,
        workers: Workers | None = None,
    ) -> None:  # fmt: skip
        super().__init__(output, workers)
        output.summing = False  # a ROS 1 bag has no checksum of its own
        self._codec = codec
        self._level = level
        self.pack = compress_for_ros1
        self.keeps_rest = isinstance(reader, Ros1Reader) and reader.sparse
        self._connections = Connections(reader)
        self._reader = reader
        self._infos: list[bytes] = []
        # with the header size of a ROS 1 input its chunks keep their positions
        taken = reader.header_bytes if isinstance(reader, Ros1Reader) else _HEADER_BYTES
        self._header_bytes = taken if len(self._header(0, 0, 0)) <= taken <= _MOST_HEADER_BYTES else _HEADER_BYTES
        self._written = self._added = 0

    def add_channel(self, topic: str, msgtype: str, like: Channel) -> Channel:
        """Add a channel with the latching and callerid of another one; return it with a new id."""
        return self._connections.add(topic, msgtype, "ros1", retyped(self._reader, msgtype, like))

    def provenance(self, name: str, items: Mapping[str, str]) -> None:
        """Do nothing: a ROS 1 bag has no metadata."""

    def write(self, block: Block) -> None:
        """Write a block, its added messages last."""
        added = self._frame(block.added)
        self._added += len(block.added)
        if isinstance(block.raw, Ros1Framing) and self._connections.native:
            framed = Framed(block.data, block.table, block.raw.starts, block.ends)
        else:
            framed = self._framed(block)
        if added.data.size:
            framed = framed.followed_by(added)
        codec = self._codec or (block.raw.codec if block.raw.codec in CODECS else "lz4")
        if framed.data.size:
            for chunk, original in zip_longest(framed.chunks(), block.sparse):
                self._write_chunk(chunk, codec, original)

    def _frame(self, messages: list[Message]) -> Framed:
        return frame(self._connections.take_records(one.channel for one in messages), messages)

    def _framed(self, block: Block) -> Framed:
        """Return records of the messages of another format's block, with its division into chunks."""
        messages = _messages(block)
        stops = [*np.searchsorted(block.table["offset"], block.ends[:-1]).tolist(), len(messages)]
        framed = self._frame(messages[: stops[0]])
        for start, stop in pairwise(stops):
            chunk = self._frame(messages[start:stop])
            ends = (*(framed.ends or (framed.data.size,)), framed.data.size + chunk.data.size)
            framed = replace(framed.followed_by(chunk), ends=ends)
        return framed

    def _write_chunk(self, framed: Framed, codec: str, original: Original | None) -> None:
        if framed.data.size >= _CHUNK_LIMIT:
            raise BagError(f"{self._output.name}: a chunk of {framed.data.size} bytes is too large for a ROS 1 bag")
        self._written += len(framed.table)
        self._results.put(
            partial(self.pack, codec, framed.data, self._level),
            partial(self._write_packed, framed, codec, indexes(framed), original),
            framed.data.size,
            worth=codec != "none",
        )

    def _write_packed(
        self, framed: Framed, codec: str, found: list[tuple[int, int, bytes]], original: Original | None,
        packed: bytes | memoryview,
    ) -> None:  # fmt: skip
        """Write a compressed chunk and its indexes."""
        position = self._output.position
        size = struct.pack("<I", framed.data.size)
        header = pack_fields({"compression": codec.encode(), "op": bytes([Op.CHUNK]), "size": size})
        self._output.write(struct.pack("<I", len(header)) + header + struct.pack("<I", len(packed)))
        self._output.write_summed(packed, 0, original)
        self._output.write(b"".join(index for _, _, index in found))
        times = framed.table["log_ns"]
        info = pack_fields({
            "chunk_pos": struct.pack("<Q", position), "count": struct.pack("<I", len(found)),
            "end_time": pack_time(int(times.max(initial=0))), "op": bytes([Op.CHUNK_INFO]),
            "start_time": pack_time(int(times.min()) if times.size else 0), "ver": struct.pack("<I", 1),
        })  # fmt: skip
        counts = b"".join(struct.pack("<II", connection, count) for connection, count, _ in found)
        self._infos.append(pack_record(info, counts))

    def _header(self, index_at: int, connections: int, size: int) -> bytes:
        """Return the bag header's record, padded to a size in bytes."""
        header = pack_fields({
            "chunk_count": struct.pack("<I", len(self._infos)), "conn_count": struct.pack("<I", connections),
            "index_pos": struct.pack("<Q", index_at), "op": bytes([Op.BAG_HEADER]),
        })  # fmt: skip
        return pack_record(header, b" " * (size - 8 - len(header)))

    def _finish(self) -> None:
        self._results.finish()
        require_all(self._output.name, self._reader, self._written, self._added)
        index_at = self._output.position
        connections = self._connections.packed()
        self._output.write(*connections, *self._infos)
        self._output.rewrite(len(MAGIC), self._header(index_at, len(connections), self._header_bytes))

    def _begin(self) -> None:
        self._output.write(MAGIC, self._header(0, 0, self._header_bytes))


def _messages(block: Block) -> list[Message]:
    """Return the messages of another format's block, one by one."""
    view = block.data.data
    return [
        Message(channel, log_ns, bytes(view[offset : offset + length]))
        for channel, log_ns, offset, length in block.table.tolist()
    ]
