"""ROS 1 bag reader: one block per chunk, from a file or a pipe."""

from __future__ import annotations

from contextlib import nullcontext, suppress
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.bags.block import Block, Channel, Definition
from odomcorrupt.bags.chunk import BATCH_BYTES, Chunk, beginning_of_chunk, read_chunks
from odomcorrupt.bags.record_reader import WINDOW_BYTES, RecordReader
from odomcorrupt.bags.ros1.chunk import (
    CODECS,
    Connection,
    Head,
    Op,
    Ros1Framing,
    chunk_head,
    number,
    pack_record,
    parse_fields,
    read_contents,
    read_head,
    record_bytes,
)
from odomcorrupt.bags.source import ROS1 as MAGIC
from odomcorrupt.bags.source import Budget
from odomcorrupt.errors import BagError

if TYPE_CHECKING:
    from collections.abc import Container, Iterator, Mapping
    from pathlib import Path

    from numpy.typing import NDArray

    from odomcorrupt.bags.block import Kind
    from odomcorrupt.bags.ros1.chunk import Head
    from odomcorrupt.bags.source import Source


_LOOK_BYTES = 1 << 13
_BACK_BYTES = 256
"""How far before its kind a record may begin: other fields of its header stand there."""
_OP = b"\x04\0\0\0op="
_STRONG = (Op.CHUNK, Op.INDEX)
"""What is looked for in the bytes of a chunk: its messages may be damaged, too."""
_IN_CHUNKS = (Op.MESSAGE, Op.CONNECTION)
_KINDS = (Op.MESSAGE, Op.INDEX, Op.CHUNK, Op.CHUNK_INFO, Op.CONNECTION)


def stands_here(source: Source) -> bool:
    """Return whether the next bytes are a plausible record."""
    return _here(source) is not None


def stands_behind(source: Source, begin: int, *, failed: bool = False) -> bool:
    """Return whether the next bytes are a plausible successor of the record at byte `begin`, or the file's end.

    If bytes are missing from a chunk, its stated length ends inside the next one, possibly at a message, or at its
    end.

    failed : whether the record at `begin` could not be read
    """
    here = source.position
    if source.at_end():
        return True
    kind = _here(source)
    if kind is None or (kind not in _IN_CHUNKS and not failed):
        return kind is not None
    source.seek(begin)
    claimed = _here(source) == Op.CHUNK
    swallowed = claimed and any(_leads_to(source, at, here) for at in _found(source, begin + 1, here, (Op.CHUNK,)))
    source.seek(here)
    return not swallowed


def _leads_to(source: Source, at: int, here: int) -> bool:
    """Return whether consecutive records lead from byte `at` to or past byte `here`."""
    while at < here:
        source.seek(at)
        if _here(source) is None:
            return False
        head = read_head(source, whole=False)
        at = source.position + head.size
    return True


def next_record(source: Source, begin: int) -> bool:
    """Seek to the first plausible record after byte `begin`, or to the end; return whether there is one."""
    size = source.size or 0
    source.seek(begin)
    at = next(_found(source, begin + 1, size, _STRONG if _here(source) == Op.CHUNK else _KINDS), size)
    source.seek(at)
    return at < size


def loss_of_cut_chunk(source: Source, head: Head) -> str:
    """Return a sentence on a chunk that is truncated by the file's end.

    Raises
    ------
    BagError
        If the chunk is damaged otherwise: its length covers later records.
    """
    here, left = source.position, (source.size or 0) - source.position
    lost = f"{source.name}: {head.what} needs {head.size} bytes, {left} are left: the bag is truncated in a chunk"
    if next_record(source, here - 8 - len(head.header)):
        raise BagError(lost)
    source.seek(here)
    return lost


def whole_records(data: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the bytes (size,) of the intact records before the first damaged one."""
    view, at = data.tobytes(), 0
    while (kind := _kind_at(view, at, len(view) - at)) in (Op.MESSAGE, Op.CONNECTION):
        middle = at + 4 + int.from_bytes(view[at : at + 4], "little")
        after = middle + 4 + int.from_bytes(view[middle : middle + 4], "little")
        if after > len(view) or (kind == Op.MESSAGE and not _is_message(view[at + 4 : middle])):
            break
        at = after
    return data[:at]


def _is_message(header: bytes) -> bool:
    try:
        fields = parse_fields(header, "")
        number(fields, "conn", "")
        number(fields, "time", "")
    except BagError:
        return False
    return True


def _found(source: Source, begin: int, end: int, kinds: Container[int]) -> Iterator[int]:
    """Yield the offsets of plausible records of some kinds between bytes `begin` and `end`."""
    while begin < end:
        source.seek(begin)
        window = source.sniff(WINDOW_BYTES + _LOOK_BYTES)
        hit = window.find(_OP)
        while 0 <= hit < WINDOW_BYTES:
            kind = int.from_bytes(window[hit + len(_OP) : hit + len(_OP) + 1], "little")
            for start in range(hit - 4, max(-1, hit - _BACK_BYTES), -1) if kind in kinds else ():
                if begin + start < end and _kind_at(window, start, (source.size or 0) - begin - start) in kinds:
                    yield begin + start
                    break
            hit = window.find(_OP, hit + 1)
        if len(window) < WINDOW_BYTES + _LOOK_BYTES:
            return
        begin += WINDOW_BYTES - _BACK_BYTES


def _here(source: Source) -> int | None:
    return _kind_at(source.sniff(_LOOK_BYTES), 0, (source.size or 0) - source.position)


def _kind_at(window: bytes, at: int, left: int) -> int | None:
    """Return the kind of a plausible record at a byte; None for none."""
    length = int.from_bytes(window[at : at + 4], "little")
    if not 9 <= length <= _LOOK_BYTES - 8 or len(window) < at + 4 + length or left < length + 8:
        return None
    header = window[at + 4 : at + 4 + length]
    try:
        fields = parse_fields(header, "")
        kind = number(fields, "op", "")
        size = int.from_bytes(window[at + 4 + length : at + 8 + length], "little")
        if kind == Op.CHUNK:
            number(fields, "size", "")
            return kind if fields.get("compression", b"").decode(errors="replace") in CODECS else None
    except BagError:
        return None
    return kind if kind in _KINDS and size <= left - length - 8 else None


class Ros1Reader(RecordReader):
    """A ROS 1 bag, file or pipe.

    header_bytes : size of the bag header's record, padding included; 0 if it is damaged
    """

    kind: Kind = "ros1"
    _stated_by = "index states"

    def __init__(self, path: Path | None, source: Source, *, recover: bool = False) -> None:
        super().__init__(path, source, recover=recover)
        self._channels: dict[int, Channel] = {}
        self.channels: Mapping[int, Channel] = self._channels
        if source.read(len(MAGIC), "magic") != MAGIC:
            raise BagError(f"{self.name}: does not begin as a ROS 1 bag of version 2.0 does")
        self.header_bytes = 0
        self._index_at = self._chunk_count = self._connection_count = self.stated = self._seen = 0
        try:
            self._read_header(source)
        except BagError:
            if not recover:
                raise
            # The records are read from the data section.
            self.losses.append(f"{self.name}: its header is damaged")
            next_record(source, len(MAGIC))
        if recover and not self.losses and not (source.at_end() or stands_here(source)):
            self.losses.append(f"{self.name}: its header does not have the stated length")
            next_record(source, len(MAGIC))
        self._data_start = source.position
        self._first_losses = len(self.losses)
        if recover:
            for _ in self._pass(source):
                pass
            source.seek(self._data_start)
            source.budget = Budget()
            return
        if not self._index_at:
            raise BagError(f"{self.name}: is not indexed, its recording was never closed; --recover reads it")
        if self.complete:
            source.require(self._index_at - self._data_start, "index")
            source.seek(self._index_at)
            self._read_end(source)

    def _read_header(self, source: Source) -> None:
        head = read_head(source)
        if head.op != Op.BAG_HEADER:
            raise BagError(f"{self.name}: its first record is {head.op:#04x}, not a bag header; the bag is damaged")
        source.read(head.size, head.what)
        if head.fields.get("encryptor"):
            raise BagError(f"{self.name}: is encrypted ({head.fields['encryptor']!r}); decrypt it with rosbag first")
        self._index_at = number(head.fields, "index_pos", self.name)
        self._chunk_count = number(head.fields, "chunk_count", self.name)
        self._connection_count = number(head.fields, "conn_count", self.name)
        self.header_bytes = source.position - len(MAGIC)

    def definition(self, channel: Channel) -> Definition:
        """Return the bag's definition of a channel's type."""
        connection: Connection = channel.raw
        kept = {key: value.decode(errors="replace") for key, value in connection.fields.items()}
        kept.pop("message_definition", None)
        return Definition(connection.type, "ros1msg", connection.fields.get("message_definition", b""), kept)

    def _parts(self, source: Source) -> Iterator[Chunk]:
        """Yield chunks, and register the connections between them."""
        chunk: Chunk | None = None
        for head in self._heads(source):
            if chunk and not (head.op == Op.INDEX or (head.op == Op.MESSAGE and 0 < len(chunk.loose) < BATCH_BYTES)):
                done, chunk = chunk, None
                yield done
            begin, end = source.position - 8 - len(head.header), source.position + head.size
            try:
                if head.op == Op.CHUNK:
                    for part in self._chunks(source, head):
                        if chunk:
                            yield chunk
                        chunk = part
                else:
                    chunk = self._take(head, source.read(head.size, head.what), chunk)
            except BagError as error:
                self._lose(error)
                if not (source.skip_to(end) and stands_behind(source, begin, failed=True)):
                    next_record(source, begin)
        if chunk:
            yield chunk

    def _heads(self, source: Source) -> Iterator[Head]:
        """Yield record headers of the data section (with recovery, of the whole file); the caller reads the data."""
        self._seen = 0
        last, op = source.position, Op.BAG_HEADER
        while self._recover and not source.at_end():
            if not (stands_behind(source, last) if op == Op.CHUNK else stands_here(source)):
                self.losses.append(
                    f"{self.name}: record at byte {source.position} is invalid: the bag is truncated or damaged"
                )
                if not next_record(source, last):
                    return
            last = source.position
            head = read_head(source, whole=False)
            op = head.op
            yield head
        if self._recover:
            self.stated = self._seen
            return
        while source.position < self._index_at:
            yield read_head(source)
        if source.position != self._index_at:
            raise BagError(f"{self.name}: chunks reach beyond the index at byte {self._index_at}; the bag is damaged")

    def _chunks(self, source: Source, head: Head) -> Iterator[Chunk]:
        if not self._recover or source.position + head.size <= (source.size or 0):
            yield from read_chunks(source, chunk_head(source, head), record_bytes, verify=self._recover)
        else:
            self.losses.append(loss_of_cut_chunk(source, head))
            for chunk in beginning_of_chunk(source, chunk_head(source, head), record_bytes):
                yield replace(chunk, data=whole_records(chunk.data))

    def _take(self, head: Head, data: bytes, chunk: Chunk | None) -> Chunk | None:
        """Process a record between chunks; return the chunk being collected."""
        if head.op == Op.INDEX:
            if chunk:
                chunk.indexes.append((0, data))
        elif head.op == Op.CONNECTION:
            self._learn(head.header, data)
        elif head.op == Op.MESSAGE and self._recover:
            # The recorder died while it wrote this chunk: its messages stand outside of it.
            chunk = chunk or Chunk(f"{self.name}: {head.what}")
            chunk.loose.extend(pack_record(head.header, data))
        elif head.op == Op.CHUNK_INFO and self._recover:
            self._seen += _counted(data)
        else:
            raise BagError(
                f"{self.name}: {head.what} has op {head.op:#04x}, which belongs in a chunk or in the index; the "
                "bag is damaged, --recover saves the intact part"
            )
        return chunk

    def _block(self, data: NDArray[np.uint8], part: Chunk, *, salvage: bool = False) -> Block:
        contents = read_contents(part, data)
        for header, fields in contents.connections:
            # an unreadable one matters only if messages use it
            with suppress(BagError) if salvage else nullcontext():
                self._learn(header, fields)
        return Block(data, contents.table, Ros1Framing(part.codec, contents.starts), ends=part.ends)

    _whole_records = staticmethod(whole_records)

    def _learn(self, header: bytes, data: bytes) -> None:
        connection = Connection.parse(header, data, self.name)
        msgtype = connection.type.replace("/", "/msg/", 1)
        channel = Channel(connection.id, connection.topic, msgtype, "ros1", raw=connection)
        if self._channels.setdefault(connection.id, channel) != channel:
            topics = f"{self._channels[connection.id].topic} and {connection.topic}"
            raise BagError(f"{self.name}: connection {connection.id} is defined twice ({topics}); the bag is damaged")

    def _read_end(self, source: Source) -> None:
        """Read connections and chunk infos at the bag's end; if they are complete, the bag is not truncated."""
        for _ in range(self._connection_count + self._chunk_count):
            head = read_head(source)
            data = source.read(head.size, head.what)
            if head.op == Op.CONNECTION:
                self._learn(head.header, data)
            elif head.op == Op.CHUNK_INFO:
                self.stated = (self.stated or 0) + _counted(data)
            else:
                raise BagError(f"{self.name}: {head.what} has op {head.op:#04x} in the index; the bag is damaged")
        source.require_end()


def _counted(data: bytes) -> int:
    """Return the number of messages in a chunk info."""
    return int(np.frombuffer(data[: len(data) // 8 * 8], dtype="<u4")[1::2].sum())
