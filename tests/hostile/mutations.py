"""Ways to damage bytes: anywhere, in the lengths of records, and inside of chunks whose checksums then are right."""

from __future__ import annotations

import bz2
import struct
import zlib
from typing import TYPE_CHECKING

import lz4.frame
import numpy as np
import zstandard

if TYPE_CHECKING:
    from collections.abc import Callable

Rng = np.random.Generator
LIES = (0, 1, 2, 7, 255, 2**15, 2**31 - 1, 2**31, 2**32 - 1, 2**40, 2**62, 2**63, 2**64 - 1)
_MCAP = b"\x89MCAP0\r\n"
_ROS1 = b"#ROSBAG V2.0\n"


def mutated(data: bytes, other: bytes, rng: Rng) -> tuple[str, bytes]:
    """Return what was done to data, and the result; other is what may be spliced in."""
    ways: list[str] = list(_ANYWHERE)
    if data.startswith((_MCAP, _ROS1)):
        ways += ["record", "record", "chunk", "chunk", "chunk", "swap"]
    way = ways[int(rng.integers(len(ways)))]
    if way in _ANYWHERE:
        return way, _ANYWHERE[way](data, other, rng)
    if data.startswith(_MCAP):
        out = _mcap_structure(data, other, rng, way)
        return way, with_true_sums(out) if rng.random() < 0.7 else out
    return way, _ros1_structure(data, other, rng, way)


def _place(data: bytes, rng: Rng) -> int:
    return int(rng.integers(max(len(data), 1)))


def _flip(data: bytes, _other: bytes, rng: Rng) -> bytes:
    out = bytearray(data)
    for _ in range(int(rng.integers(1, 4))):
        if out:
            out[_place(out, rng)] ^= int(rng.integers(1, 256))
    return bytes(out)


def _lie(data: bytes, _other: bytes, rng: Rng) -> bytes:
    width, order = (1, 2, 4, 8)[int(rng.integers(4))], ("little", "big")[int(rng.random() < 0.2)]
    value = LIES[int(rng.integers(len(LIES)))] % (1 << 8 * width)
    at = _place(data, rng)
    return (data[:at] + value.to_bytes(width, order) + data[at + width :])[: max(len(data), at + width)]  # type: ignore[arg-type]


def _span(data: bytes, rng: Rng) -> tuple[int, int]:
    begin = _place(data, rng)
    return begin, min(len(data), begin + int(2 ** rng.uniform(0, 12)))


def _cut(data: bytes, _other: bytes, rng: Rng) -> bytes:
    return data[: _place(data, rng)]


def _delete(data: bytes, _other: bytes, rng: Rng) -> bytes:
    begin, end = _span(data, rng)
    return data[:begin] + data[end:]


def _fill(data: bytes, _other: bytes, rng: Rng) -> bytes:
    begin, end = _span(data, rng)
    return data[:begin] + bytes([(0, 255, 32)[int(rng.integers(3))]]) * (end - begin) + data[end:]


def _repeat(data: bytes, _other: bytes, rng: Rng) -> bytes:
    begin, end = _span(data, rng)
    return data[:end] + data[begin:]


def _noise(data: bytes, _other: bytes, rng: Rng) -> bytes:
    begin, end = _span(data, rng)
    return data[:begin] + rng.bytes(end - begin) + data[(end if rng.random() < 0.5 else begin) :]


def _splice(data: bytes, other: bytes, rng: Rng) -> bytes:
    return data[: _place(data, rng)] + other[_place(other, rng) :]


def _graft(data: bytes, other: bytes, rng: Rng) -> bytes:
    at = _place(data, rng)
    begin, end = _span(other, rng)
    return data[:at] + other[begin:end] + data[at:]


_ANYWHERE: dict[str, Callable[[bytes, bytes, Rng], bytes]] = {
    "flip": _flip, "lie": _lie, "cut": _cut, "delete": _delete, "fill": _fill, "repeat": _repeat, "noise": _noise,
    "splice": _splice, "graft": _graft,
}  # fmt: skip


def mcap_records(data: bytes) -> list[tuple[int, int, int]]:
    """Return (opcode, begin, end) of the records of an MCAP's bytes."""
    found, at = [], len(_MCAP)
    while at + 9 <= len(data) - len(_MCAP):
        opcode, length = struct.unpack_from("<BQ", data, at)
        found.append((opcode, at, at + 9 + length))
        at += 9 + length
    return found


def with_true_sums(data: bytes) -> bytes:
    """Return an MCAP whose checksums of sections are those of its bytes, as far as these still have a structure."""
    out = bytearray(data)
    if not data.startswith(_MCAP) or not data.endswith(_MCAP):
        return data
    try:
        places = mcap_records(data)
    except struct.error:
        return data
    ends = [begin for opcode, begin, end in places if (opcode, end - begin) == (15, 13)]
    if ends:
        out[ends[-1] + 9 : ends[-1] + 13] = struct.pack("<I", zlib.crc32(data[: ends[-1]]))
    opcode, begin, end = places[-1]
    if (opcode, end - begin) == (2, 29) and end == len(data) - len(_MCAP):
        start = int.from_bytes(data[begin + 9 : begin + 17], "little")
        out[end - 4 : end] = struct.pack("<I", zlib.crc32(data[start : end - 4]))
    return bytes(out)


def _mcap_structure(data: bytes, other: bytes, rng: Rng, way: str) -> bytes:
    places = mcap_records(data)
    if way == "chunk":
        chunks = [place for place in places if place[0] == 6]
        if not chunks:
            way = "record"
        else:
            _, begin, end = chunks[int(rng.integers(len(chunks)))]
            return data[:begin] + _mcap_chunk(data[begin:end], other, rng) + data[end:]
    if way == "swap":
        i, j = sorted(rng.integers(len(places), size=2).tolist())
        pieces = [data[begin:end] for _, begin, end in places]
        pieces[i], pieces[j] = pieces[j], pieces[i]
        return data[:8] + b"".join(pieces) + data[-8:]
    _, begin, end = places[int(rng.integers(len(places)))]
    # the length itself, or a number among the first fields
    at = begin + 1 if rng.random() < 0.4 else begin + 9 + int(rng.integers(0, max(1, min(60, end - begin - 9))))
    return _lied(data, at, 8 if at == begin + 1 else (2, 4, 8)[int(rng.integers(3))], rng)


def _lied(data: bytes, at: int, width: int, rng: Rng) -> bytes:
    true = int.from_bytes(data[at : at + width], "little")
    near = (true + 1, true - 1, true * 2, true + 9, true ^ 1 << int(rng.integers(8 * width)))
    value = (*LIES, *near)[int(rng.integers(len(LIES) + len(near)))] % (1 << 8 * width)
    return data[:at] + value.to_bytes(width, "little") + data[at + width :]


def _mcap_chunk(chunk: bytes, other: bytes, rng: Rng) -> bytes:
    """Mutate what a chunk holds, and pack it again with true sizes and checksum, or with one lie."""
    start, end, size, _, named = struct.unpack_from("<QQQII", chunk, 9)
    name = chunk[41 : 41 + named]
    packed = chunk[41 + named + 8 :]
    inner = {b"zstd": _unzstd, b"lz4": lz4.frame.decompress}.get(name, bytes)(packed)
    inner = _ANYWHERE[list(_ANYWHERE)[int(rng.integers(len(_ANYWHERE)))]](inner, other, rng)
    size = len(inner)
    if rng.random() < 0.1:
        size = LIES[int(rng.integers(len(LIES)))]
    again = {b"zstd": zstandard.ZstdCompressor().compress, b"lz4": lz4.frame.compress}.get(name, bytes)(inner)
    crc = 0 if rng.random() < 0.2 else zlib.crc32(inner)
    content = struct.pack("<QQQII", start, end, size, crc, named) + name + struct.pack("<Q", len(again)) + again
    return struct.pack("<BQ", 6, len(content)) + content


def _unzstd(data: bytes) -> bytes:
    return zstandard.ZstdDecompressor().decompress(data)


def ros1_records(data: bytes) -> list[tuple[int, int, int]]:
    """Return (begin of the header, begin of the data's length, end) of the records of a ROS 1 bag's bytes."""
    found, at = [], len(_ROS1)
    while at + 8 <= len(data):
        (length,) = struct.unpack_from("<I", data, at)
        (size,) = struct.unpack_from("<I", data, at + 4 + length)
        found.append((at, at + 4 + length, at + 8 + length + size))
        at += 8 + length + size
    return found


def ros1_headers(data: bytes) -> list[bytes]:
    """Return the headers of the records of a ROS 1 bag's chunks."""
    found = []
    for begin, middle, end in ros1_records(data):
        header = data[begin + 4 : middle]
        if b"op=\x05" in header:
            codec = header.partition(b"compression=")[2][:3]
            unpack = {b"bz2": bz2.decompress, b"lz4": lz4.frame.decompress}.get(codec, bytes)
            inner = _ROS1 + unpack(data[middle + 4 : end])
            found += [inner[at + 4 : after] for at, after, _ in ros1_records(inner)]
    return found


def _ros1_structure(data: bytes, other: bytes, rng: Rng, way: str) -> bytes:
    places = ros1_records(data)
    if way == "swap":
        i, j = sorted(rng.integers(1, len(places), size=2).tolist())
        pieces = [data[begin:end] for begin, _, end in places]
        pieces[i], pieces[j] = pieces[j], pieces[i]
        return _ROS1 + b"".join(pieces)
    if way == "chunk":
        chunks = [place for place in places if b"op=\x05" in data[place[0] : place[1]]]
        return _ros1_chunk(data, chunks[int(rng.integers(len(chunks)))], other, rng)
    begin, middle, _ = places[int(rng.integers(len(places)))]
    what = rng.random()
    if what < 0.3:
        return _lied(data, begin, 4, rng)
    if what < 0.6:
        return _lied(data, middle, 4, rng)
    return _lied(data, begin + 4 + int(rng.integers(max(1, middle - begin - 4))), (1, 4, 8)[int(rng.integers(3))], rng)


def _ros1_chunk(data: bytes, place: tuple[int, int, int], other: bytes, rng: Rng) -> bytes:
    """Mutate what a chunk holds, and pack it again; the bag header then says where the index is now."""
    begin, middle, end = place
    header, content = data[begin + 4 : middle], data[middle + 4 : end]
    codec = header.partition(b"compression=")[2]
    unpack: Callable[[bytes], bytes] = bytes
    pack: Callable[[bytes], bytes] = bytes
    if codec.startswith(b"bz2"):
        unpack, pack = bz2.decompress, bz2.compress
    elif codec.startswith(b"lz4"):
        unpack = lz4.frame.decompress
        pack = lambda one: lz4.frame.compress(one, block_linked=False, store_size=False, content_checksum=True)  # noqa: E731
    inner = _ANYWHERE[list(_ANYWHERE)[int(rng.integers(len(_ANYWHERE)))]](unpack(content), other, rng)
    again = pack(inner)
    size = len(inner) if rng.random() < 0.9 else LIES[int(rng.integers(len(LIES)))] % 2**32
    at = header.index(b"size=") + 5
    header = header[:at] + struct.pack("<I", size) + header[at + 4 :]
    out = data[:begin] + struct.pack("<I", len(header)) + header + struct.pack("<I", len(again)) + again + data[end:]
    at = out.index(b"index_pos=") + 10
    (index,) = struct.unpack_from("<Q", out, at)
    return out[:at] + struct.pack("<Q", index + len(again) - len(content)) + out[at + 8 :]
