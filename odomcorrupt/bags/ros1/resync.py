"""Resynchronisation in a damaged ROS 1 bag: the next plausible record, and the intact part of a truncated chunk."""

from __future__ import annotations

from typing import TYPE_CHECKING

from odomcorrupt.bags.ros1.chunk import CODECS, read_head
from odomcorrupt.bags.ros1.records import Op, number, parse_fields
from odomcorrupt.errors import BagError

if TYPE_CHECKING:
    from collections.abc import Container, Iterator

    import numpy as np
    from numpy.typing import NDArray

    from odomcorrupt.bags.ros1.chunk import Head
    from odomcorrupt.bags.source import Source

_WINDOW_BYTES = 1 << 20
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
        window = source.sniff(_WINDOW_BYTES + _LOOK_BYTES)
        hit = window.find(_OP)
        while 0 <= hit < _WINDOW_BYTES:
            kind = int.from_bytes(window[hit + len(_OP) : hit + len(_OP) + 1], "little")
            for start in range(hit - 4, max(-1, hit - _BACK_BYTES), -1) if kind in kinds else ():
                if begin + start < end and _kind_at(window, start, (source.size or 0) - begin - start) in kinds:
                    yield begin + start
                    break
            hit = window.find(_OP, hit + 1)
        if len(window) < _WINDOW_BYTES + _LOOK_BYTES:
            return
        begin += _WINDOW_BYTES - _BACK_BYTES


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
