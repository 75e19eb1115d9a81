"""Read a ROS 1 bag as blocks, one per chunk, from a file or a pipe."""

from __future__ import annotations

from typing import TYPE_CHECKING, Self

import numpy as np

from odomcorrupt.bags.block import Block, Channel
from odomcorrupt.bags.definition import Definition
from odomcorrupt.bags.losses import loss_of
from odomcorrupt.bags.ros1.chunk import Chunk, Head, Ros1Framing, read_chunk, read_head
from odomcorrupt.bags.ros1.contents import read_contents
from odomcorrupt.bags.ros1.records import (
    BAG_HEADER,
    CHUNK,
    CHUNK_INFO,
    CONNECTION,
    INDEX,
    MAGIC,
    MESSAGE,
    Connection,
    number,
    pack_record,
)
from odomcorrupt.bags.source import Source
from odomcorrupt.errors import BagError

if TYPE_CHECKING:
    from collections.abc import Container, Iterator, Mapping
    from pathlib import Path
    from types import TracebackType

    from odomcorrupt.bags.block import Kind

__all__ = ["Ros1Reader"]

_BATCH_BYTES = 1 << 20


class Ros1Reader:
    """A ROS 1 bag, file or pipe.

    losses : what could not be read, one sentence each, where recovery was asked for
    """

    kind: Kind = "ros1"

    def __init__(self, path: Path | None, source: Source, *, recover: bool = False) -> None:
        self.name = source.name
        self.paths = [] if path is None else [path]
        self.complete = path is not None and source.size is not None
        self._channels: dict[int, Channel] = {}
        self.channels: Mapping[int, Channel] = self._channels
        self.losses: list[str] = []
        self._recover = recover
        self._source = source
        self._begun = False
        if source.read(len(MAGIC), "magic") != MAGIC:
            raise BagError(f"{self.name}: does not begin as a ROS 1 bag of version 2.0 does")
        head = read_head(source)
        if head.op != BAG_HEADER:
            raise BagError(f"{self.name}: its first record is {head.op:#04x}, not a bag header; the bag is damaged")
        source.read(head.size, head.what)
        if head.fields.get("encryptor"):
            raise BagError(f"{self.name}: is encrypted ({head.fields['encryptor']!r}); decrypt it with rosbag first")
        self._index_at = number(head.fields, "index_pos", self.name)
        self._chunk_count = number(head.fields, "chunk_count", self.name)
        self._connection_count = number(head.fields, "conn_count", self.name)
        self._data_start = source.position
        if recover:
            if self.complete:
                for _ in self.blocks():
                    pass
            return
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
        self.losses.clear()
        if self.complete:
            with Source.of_file(self.paths[0]) as source:
                source.seek(self._data_start)
                yield from self._blocks(source)
            return
        if self._begun:
            raise BagError(f"{self.name}: a pipe can be read once only; write it to a file first")
        self._begun = True
        yield from self._blocks(self._source)
        if not self._recover:
            self._read_index(self._source)

    def _blocks(self, source: Source) -> Iterator[Block]:
        chunk: Chunk | None = None
        for head in self._heads(source):
            if chunk and not (head.op == INDEX or (head.op == MESSAGE and 0 < len(chunk.open) < _BATCH_BYTES)):
                done, chunk = chunk, None
                yield from self._finished(done)
            end = source.position + head.size
            try:
                if head.op == CHUNK:
                    chunk = read_chunk(source, head)
                else:
                    chunk = self._take(head, source.read(head.size, head.what), chunk)
            except BagError as error:
                self._lose(error)
                if not source.skip_to(end):
                    break
        if chunk:
            yield from self._finished(chunk)

    def _heads(self, source: Source) -> Iterator[Head]:
        """Yield the records of the data section up to their data, which the caller reads; all there are, to recover."""
        try:
            while source.position < self._index_at if not self._recover else not source.at_end():
                yield read_head(source)
        except BagError as error:
            self._lose(error)
        if source.position != self._index_at and not self._recover:
            raise BagError(f"{self.name}: chunks reach beyond the index at byte {self._index_at}; the bag is damaged")

    def _take(self, head: Head, data: bytes, chunk: Chunk | None) -> Chunk | None:
        """Take note of a record between chunks; return the chunk that is being collected."""
        if head.op == INDEX:
            if chunk:
                chunk.indexes.append(data)
        elif head.op == CONNECTION:
            self._learn(head.header, data)
        elif head.op == MESSAGE and self._recover:
            # The recorder died while it wrote this chunk: its messages stand outside of it.
            chunk = chunk or Chunk(np.empty(0, dtype=np.uint8), "none", f"{self.name}: {head.what}")
            chunk.open.extend(pack_record(head.header, data))
        elif not (head.op == CHUNK_INFO and self._recover):
            raise BagError(
                f"{self.name}: {head.what} is of kind {head.op:#04x}, which belongs into a chunk or the index; the bag "
                "is damaged, --recover saves what is whole"
            )
        return chunk

    def _finished(self, chunk: Chunk) -> Iterator[Block]:
        try:
            yield self._block(chunk)
        except BagError as error:
            self._lose(error)

    def _lose(self, error: BagError) -> None:
        """Note what cannot be read, or give up where that was not asked for."""
        if not self._recover:
            raise error
        self.losses.append(loss_of(error))

    def _block(self, chunk: Chunk) -> Block:
        data = np.frombuffer(chunk.open, dtype=np.uint8) if chunk.open else chunk.data
        contents = read_contents(data, chunk.indexes, chunk.what)
        for header, fields in contents.connections:
            self._learn(header, fields)
        unknown = set(np.unique(contents.table["channel"]).tolist()) - self.channels.keys()
        if unknown:
            raise BagError(f"{chunk.what}: messages of connection {min(unknown)}, which is not defined; damaged bag")
        return Block(data, contents.table, Ros1Framing(chunk.codec, contents.starts))

    def _learn(self, header: bytes, data: bytes) -> None:
        connection = Connection.parse(header, data, self.name)
        msgtype = connection.type.replace("/", "/msg/", 1)
        self._channels.setdefault(
            connection.id, Channel(connection.id, connection.topic, msgtype, "ros1", raw=connection)
        )

    def _read_index(self, source: Source) -> None:
        """Read connections and chunk infos at the bag's end: that they are all there tells that nothing was cut."""
        for _ in range(self._connection_count + self._chunk_count):
            head = read_head(source)
            data = source.read(head.size, head.what)
            if head.op == CONNECTION:
                self._learn(head.header, data)
            elif head.op != CHUNK_INFO:
                raise BagError(f"{self.name}: {head.what} is of kind {head.op:#04x} in the index; the bag is damaged")

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._source.close()
