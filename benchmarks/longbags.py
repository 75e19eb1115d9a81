"""Bags of very many odometry messages, made fast: a chunk is laid out at once, its stamps and poses put in by numpy.

The robot drives on a circle, 50 times a second.
"""

from __future__ import annotations

import struct
import subprocess
import sys
import zlib
from typing import TYPE_CHECKING

import numpy as np
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.records import Channel, Chunk, ChunkIndex, DataEnd, Footer, Header, MessageIndex, Schema, Statistics
from smallbags import Office, definition

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from numpy.typing import NDArray

ODOMETRY = "nav_msgs/msg/Odometry"
START_NS = 1_700_000_000 * 10**9
STEP_NS = 20_000_000
LATE_NS = 10**6
CHUNK = 2000
MAGIC = b"\x89MCAP0\r\n"


class Template:
    """Odometry messages, each behind a head of its own.

    log : how the log time stands in the head, and where
    """

    def __init__(self, head: bytes = b"", log: dict[str, tuple[str, int]] | None = None) -> None:
        data = bytes(Office(2).odometry(START_NS, np.zeros(3), np.array([0.5, 0.125])))
        pose = data.index(b"base_link") + 10
        places = {
            "stamp": ("<2u4", len(head) + 4), "pose": ("<7f8", len(head) + pose + (4 - pose) % 8), **(log or {}),
        }  # fmt: skip
        self.size = len(data)
        self.one = np.frombuffer(head + data, dtype=np.uint8)
        self._dtype = np.dtype(
            {
                "names": list(places),
                "formats": [form for form, _ in places.values()],
                "offsets": [at for _, at in places.values()],
                "itemsize": len(self.one),
            }
        )
        self._logged = tuple(log or ())

    def rows(self, first: int, count: int) -> tuple[NDArray[np.int64], bytes]:
        """Return log times, and the bytes of so many messages."""
        data = np.tile(self.one, count)
        rows = data.view(self._dtype)
        number = np.arange(first, first + count)
        stamps_ns = START_NS + number * STEP_NS
        rows["stamp"] = np.stack(np.divmod(stamps_ns, 10**9), axis=1)
        angle = 0.125 * 0.02 * number
        none = np.zeros(count)
        x, y = 4 * np.sin(angle), 4 - 4 * np.cos(angle)
        rows["pose"] = np.stack((x, y, none, none, none, np.sin(angle / 2), np.cos(angle / 2)), axis=1)
        log_ns = stamps_ns + LATE_NS
        for name in self._logged:
            rows[name] = log_ns
        return log_ns, data.tobytes()


def _spans(count: int) -> Iterator[tuple[int, int]]:
    return ((first, min(CHUNK, count - first)) for first in range(0, count, CHUNK))


def long_mcap(path: Path, count: int) -> None:
    """Write an MCAP with zstd chunks, indexes and statistics."""
    office, build = Office(2), RecordBuilder()
    head = struct.pack("<BQHIQQ", 5, 22 + Template().size, 1, 0, 0, 0)
    template = Template(head, {"log": ("<u8", 15), "published": ("<u8", 23)})
    schema = Schema(id=1, name=ODOMETRY, encoding="ros2msg", data=definition(office, ODOMETRY)[0].encode())
    channel = Channel(id=1, schema_id=1, topic="/odom", message_encoding="cdr", metadata={})
    codec = zstandard.ZstdCompressor(level=1)
    chunks: list[ChunkIndex] = []

    def take(*records: Header | Schema | Channel | Chunk | MessageIndex | DataEnd | Statistics | ChunkIndex) -> bytes:
        for one in records:
            one.write(build)
        return bytes(build.end())

    with path.open("wb") as stream:
        stream.write(MAGIC + take(Header("ros2", "long"), schema, channel))
        for first, many in _spans(count):
            log_ns, data = template.rows(first, many)
            start, end = int(log_ns[0]), int(log_ns[-1])
            packed, at = codec.compress(data), stream.tell()
            chunk = take(Chunk("zstd", packed, end, start, zlib.crc32(data), len(data)))
            offsets = np.arange(many) * len(template.one)
            index = take(MessageIndex(1, list(zip(log_ns.tolist(), offsets.tolist(), strict=True))))
            stream.write(chunk + index)
            chunks.append(
                ChunkIndex(len(chunk), at, "zstd", len(packed), end, len(index), {1: at + len(chunk)}, start, len(data))
            )
        stream.write(take(DataEnd(0)))
        summary = stream.tell()
        last_ns = START_NS + (count - 1) * STEP_NS + LATE_NS
        told = Statistics(0, 1, {1: count}, len(chunks), count, last_ns, START_NS + LATE_NS, 0, 1)
        stream.write(take(schema, channel, told, *chunks))
        Footer(summary, 0, 0).write(build)
        stream.write(bytes(build.end()) + MAGIC)


def converted(path: Path, count: int) -> None:
    """Write a ROS 1 bag without compression, or a .db3 file, of these messages: the MCAP, converted by our command."""
    source = path.with_name("long.mcap")
    long_mcap(source, count)
    words = [str(source), str(path), "--effect", "wheel_scale:e=0", "-q"]
    words += ["--compression", "none"] if path.suffix == ".bag" else []
    subprocess.run([sys.executable, "-m", "odomcorrupt", *words], check=True)
    source.unlink()


LONG = {".mcap": long_mcap, ".bag": converted, ".db3": converted}
