"""Read a ROS 1 bag as blocks, one per chunk, from a file or a pipe."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple, Self

import numpy as np

from odomcorrupt.bags.block import Block, Channel
from odomcorrupt.bags.codecs import decompress
from odomcorrupt.bags.definition import Definition
from odomcorrupt.bags.ros1.contents import read_contents
from odomcorrupt.bags.ros1.records import (
    BAG_HEADER,
    CHUNK,
    CHUNK_INFO,
    CONNECTION,
    INDEX,
    MAGIC,
    Connection,
    number,
    parse_fields,
)
from odomcorrupt.bags.source import Source
from odomcorrupt.errors import BagError

if TYPE_CHECKING:
    from collections.abc import Container, Iterator, Mapping
    from pathlib import Path
    from types import TracebackType

    from numpy.typing import NDArray

    from odomcorrupt.bags.block import Kind

__all__ = ["Ros1Framing", "Ros1Reader"]

_CODECS = ("none", "lz4", "bz2")
_HEADER_LIMIT = 1 << 24


@dataclass(frozen=True, slots=True)
class Ros1Framing:
    """How a block stood in its bag.

    codec : of the chunk
    starts : (n,) offsets of the message records in the block's data, bytes
    """

    codec: str
    starts: NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class _Chunk:
    data: NDArray[np.uint8]
    codec: str
    what: str
    indexes: list[bytes] = field(default_factory=list)


class _Head(NamedTuple):
    """A record up to its data, which the caller reads."""

    op: int
    header: bytes
    fields: dict[str, bytes]
    size: int
    what: str


class Ros1Reader:
    """A ROS 1 bag, file or pipe."""

    kind: Kind = "ros1"

    def __init__(self, path: Path | None, source: Source) -> None:
        self.name = source.name
        self.paths = [] if path is None else [path]
        self.complete = path is not None and source.size is not None
        self._channels: dict[int, Channel] = {}
        self.channels: Mapping[int, Channel] = self._channels
        self._source = source
        self._begun = False
        if source.read(len(MAGIC), "magic") != MAGIC:
            raise BagError(f"{self.name}: does not begin as a ROS 1 bag of version 2.0 does")
        head = self._head(source)
        if head.op != BAG_HEADER:
            raise BagError(f"{self.name}: its first record is {head.op:#04x}, not a bag header; the bag is damaged")
        source.read(head.size, head.what)
        if head.fields.get("encryptor"):
            raise BagError(f"{self.name}: is encrypted ({head.fields['encryptor']!r}); decrypt it with rosbag first")
        self._index_at = number(head.fields, "index_pos", self.name)
        self._chunk_count = number(head.fields, "chunk_count", self.name)
        self._connection_count = number(head.fields, "conn_count", self.name)
        self._data_start = source.position
        if not self._index_at:
            raise BagError(f"{self.name}: is not indexed, its recording was never closed; --recover reads it")
        if self.complete:
            source.require(self._index_at - self._data_start, "index")
            source.seek(self._index_at)
            self._read_index(source)

    def definition(self, channel: Channel) -> Definition:
        """Return what the bag says of a channel's type."""
        connection: Connection = channel.raw
        kept = {key: value.decode(errors="replace") for key, value in connection.fields.items()}
        kept.pop("message_definition", None)
        return Definition(connection.type, "ros1msg", connection.fields.get("message_definition", b""), kept)

    def blocks(self, only: Container[int] | None = None) -> Iterator[Block]:  # noqa: ARG002 - all is as cheap
        """Yield the blocks in file order; of a file as often as asked for, of a pipe once."""
        if self.complete:
            with Source.of_file(self.paths[0]) as source:
                source.seek(self._data_start)
                yield from self._blocks(source)
            return
        if self._begun:
            raise BagError(f"{self.name}: a pipe can be read once only; write it to a file first")
        self._begun = True
        yield from self._blocks(self._source)
        self._read_index(self._source)

    def _blocks(self, source: Source) -> Iterator[Block]:
        chunk: _Chunk | None = None
        while source.position < self._index_at:
            head = self._head(source)
            if head.op == INDEX:
                index = source.read(head.size, head.what)
                if chunk:
                    chunk.indexes.append(index)
                continue
            if chunk:
                yield self._block(chunk)
                chunk = None
            if head.op == CHUNK:
                chunk = self._read_chunk(source, head)
            elif head.op == CONNECTION:
                self._learn(head.header, source.read(head.size, head.what))
            else:
                raise BagError(
                    f"{self.name}: {head.what} is of kind {head.op:#04x}, which belongs into a chunk or the index; the "
                    "bag is damaged, --recover saves what is whole"
                )
        if chunk:
            yield self._block(chunk)
        if source.position != self._index_at:
            raise BagError(f"{self.name}: chunks reach beyond the index at byte {self._index_at}; the bag is damaged")

    def _read_chunk(self, source: Source, head: _Head) -> _Chunk:
        named = f"{self.name}: {head.what}"
        codec = head.fields.get("compression", b"").decode(errors="replace")
        size = number(head.fields, "size", named)
        if codec not in _CODECS:
            raise BagError(f"{named}: compression {codec!r} is not known (none, lz4, bz2); recompress the bag")
        if codec == "none":
            data = source.read_array(head.size, head.what)
            if size != head.size:
                raise BagError(f"{named}: says it holds {size} bytes, but has {head.size}; the bag is damaged")
        else:
            data = decompress(codec, source.read_scratch(head.size, head.what), size, named)
        return _Chunk(data, codec, named)

    def _block(self, chunk: _Chunk) -> Block:
        contents = read_contents(chunk.data, chunk.indexes, chunk.what)
        for header, data in contents.connections:
            self._learn(header, data)
        unknown = set(np.unique(contents.table["channel"]).tolist()) - self.channels.keys()
        if unknown:
            raise BagError(f"{chunk.what}: messages of connection {min(unknown)}, which is not defined; damaged bag")
        return Block(chunk.data, contents.table, Ros1Framing(chunk.codec, contents.starts))

    def _learn(self, header: bytes, data: bytes) -> None:
        connection = Connection.parse(header, data, self.name)
        msgtype = connection.type.replace("/", "/msg/", 1)
        self._channels.setdefault(
            connection.id, Channel(connection.id, connection.topic, msgtype, "ros1", raw=connection)
        )

    def _read_index(self, source: Source) -> None:
        """Read connections and chunk infos at the bag's end: that they are all there tells that nothing was cut."""
        for _ in range(self._connection_count + self._chunk_count):
            head = self._head(source)
            data = source.read(head.size, head.what)
            if head.op == CONNECTION:
                self._learn(head.header, data)
            elif head.op != CHUNK_INFO:
                raise BagError(f"{self.name}: {head.what} is of kind {head.op:#04x} in the index; the bag is damaged")

    def _head(self, source: Source) -> _Head:
        what = f"record at byte {source.position}"
        length = int.from_bytes(source.read(4, what), "little")
        if length > _HEADER_LIMIT:
            raise BagError(f"{self.name}: {what} claims a header of {length} bytes; the bag is damaged, try --recover")
        header = source.read(length, what)
        fields = parse_fields(header, f"{self.name}: {what}")
        size = int.from_bytes(source.read(4, what), "little")
        source.require(size, what)
        return _Head(number(fields, "op", f"{self.name}: {what}"), header, fields, size, what)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._source.close()
