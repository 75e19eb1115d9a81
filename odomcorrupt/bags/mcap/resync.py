"""Find the way back in a damaged MCAP: where a record begins that can be believed, and what a cut chunk holds."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.bags.block import Block
from odomcorrupt.bags.codecs import beginning
from odomcorrupt.bags.mcap.chunk import CODECS, Chunk, read_chunk
from odomcorrupt.bags.mcap.contents import read_contents
from odomcorrupt.bags.mcap.records import (
    ATTACHMENT,
    CHANNEL,
    CHUNK,
    DATA_END,
    FOOTER,
    MESSAGE,
    MESSAGE_HEADER_BYTES,
    MESSAGE_INDEX,
    METADATA,
    RECORD_HEADER_BYTES,
    SCHEMA,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Container

    from numpy.typing import NDArray

    from odomcorrupt.bags.source import Source

__all__ = ["next_record", "only_known", "read_chunk_or_beginning", "stands_here", "whole_records"]

_WINDOW_BYTES = 1 << 20
_LOOK_BYTES = 64
_SHORTEST = {MESSAGE: 22, SCHEMA: 14, CHANNEL: 16, MESSAGE_INDEX: 6, ATTACHMENT: 36, METADATA: 8}
_EXACT = {DATA_END: 4, FOOTER: 20}
_STRONG = (CHUNK, DATA_END)
"""Records whose first bytes alone tell that they are no accident."""
_PRIVATE = 0x80


def stands_here(source: Source) -> bool:
    """Tell whether the next bytes of a file can be a record of the data section, or its end."""
    return _believable(source.sniff(_LOOK_BYTES), 0, _left(source))


def next_record(source: Source, begin: int) -> bool:
    """Go to the first record behind byte `begin`, itself a record that led astray; return whether there is one.

    In the bytes of a chunk only other chunks are looked for: its messages have no checksum of their own.
    """
    source.seek(begin)
    inside_chunk = source.sniff(1)[:1] == bytes([CHUNK]) and stands_here(source)
    at = begin + 1
    while True:
        source.seek(at)
        window = source.sniff(_WINDOW_BYTES + _LOOK_BYTES)
        found = _search(window, _left(source), lambda opcode: opcode in _STRONG or not inside_chunk)
        if found is not None:
            source.seek(at + found)
            return True
        if len(window) < _WINDOW_BYTES + _LOOK_BYTES:
            return False
        at += _WINDOW_BYTES


def read_chunk_or_beginning(source: Source, length: int, what: str) -> tuple[Chunk, str]:
    """Read a chunk record, or of one that the file's end cuts what is whole; return it and what is lost, if any.

    Raises
    ------
    BagError
        Where the chunk is damaged in another way.

    """
    left = _left(source)
    if length <= left:
        return read_chunk(source, length, what), ""
    content = source.read(left, what)
    name_length = int.from_bytes(content[28:32], "little")
    name = content[32 : 32 + name_length].decode(errors="replace")
    data = np.frombuffer(bytearray(beginning(name or "none", content[40 + name_length :])), dtype=np.uint8)
    lost = f"{source.name}: {what} needs {length} bytes, {left} are left: the bag is truncated in a chunk"
    return Chunk(whole_records(data), name or "none", f"{source.name}: {what}"), lost


def whole_records(data: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the records (size,) that are whole, up to the first one that is not."""
    view, at = data.data, 0
    while at + RECORD_HEADER_BYTES <= data.size:
        opcode, length = struct.unpack_from("<BQ", view, at)
        if length > data.size - at - RECORD_HEADER_BYTES or (opcode == MESSAGE and length < _SHORTEST[MESSAGE]):
            break
        at += RECORD_HEADER_BYTES + length
    return data[:at]


def only_known(block: Block, channels: Container[int]) -> Block:
    """Return a block of message records without the messages of channels that nobody defined."""
    known = np.array([number in channels for number in block.table["channel"].tolist()], dtype=bool)
    if known.all():
        return block
    keep = np.ones(block.data.size, dtype=bool)
    for offset, length in block.table[["offset", "length"]][~known].tolist():
        keep[offset - MESSAGE_HEADER_BYTES : offset + length] = False
    data = block.data[keep]
    return Block(data, read_contents(data, [], "").table, block.raw)


def _left(source: Source) -> int:
    return (source.size or 0) - source.position


def _search(window: bytes, left: int, wanted: Callable[[int], bool]) -> int | None:
    data = np.frombuffer(window, dtype=np.uint8)
    count = max(0, data.size - _LOOK_BYTES) or max(0, data.size - RECORD_HEADER_BYTES + 1)
    # lengths are less than 2^40, so three of their bytes are zero
    quiet = (data[6 : 6 + count] | data[7 : 7 + count] | data[8 : 8 + count]) == 0
    for at in np.flatnonzero(quiet & (data[:count] > 1) & (data[:count] <= DATA_END)).tolist():
        if wanted(window[at]) and _believable(window, at, left - at) and _chained(window, at, left - at):
            return int(at)
    return None


def _believable(window: bytes, at: int, left: int) -> bool:
    if left < RECORD_HEADER_BYTES or len(window) < at + RECORD_HEADER_BYTES:
        return False
    opcode, length = struct.unpack_from("<BQ", window, at)
    if opcode == CHUNK:
        return _is_chunk(window[at : at + _LOOK_BYTES], length)
    if opcode in _EXACT:
        return bool(length == _EXACT[opcode])
    fits = bool(length <= left - RECORD_HEADER_BYTES)
    return fits and (opcode >= _PRIVATE or length >= _SHORTEST.get(opcode, 1 << 64))


def _is_chunk(head: bytes, length: int) -> bool:
    name_length = int.from_bytes(head[37:41], "little")
    if len(head) < 49 + name_length or name_length > 4:
        return False
    (packed,) = struct.unpack_from("<Q", head, 41 + name_length)
    name = head[41 : 41 + name_length].decode(errors="replace")
    return bool(length == 40 + name_length + packed) and (name or "none") in CODECS


def _chained(window: bytes, at: int, left: int) -> bool:
    """Tell whether two more records follow one that is not known by itself, as far as can be seen."""
    for _ in range(2):
        opcode, length = struct.unpack_from("<BQ", window, at)
        step = RECORD_HEADER_BYTES + length
        if opcode in _STRONG or step == left or at + step + _LOOK_BYTES > len(window):
            return True
        at, left = at + step, left - step
        if not _believable(window, at, left):
            return False
    return True
