"""Bags of very many odometry messages, made fast: a chunk is laid out at once, its stamps and poses put in by numpy.

The robot drives on a circle, 50 times a second.
"""

from __future__ import annotations

import shutil
import sqlite3
import struct
import tempfile
import zlib
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.records import Channel, Chunk, ChunkIndex, DataEnd, Footer, Header, MessageIndex, Schema, Statistics
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Ros2Writer
from smallbags import Office, definition

if TYPE_CHECKING:
    from collections.abc import Iterator
    from typing import BinaryIO

    from numpy.typing import NDArray

ODOMETRY = "nav_msgs/msg/Odometry"
START_NS = 1_700_000_000 * 10**9
STEP_NS = 20_000_000
LATE_NS = 10**6
CHUNK = 2000
MAGIC = b"\x89MCAP0\r\n"


class Template:
    """Odometry messages of one ROS, each behind a head of its own.

    log : how the log time stands in the head, and where
    """

    def __init__(self, ros: int, head: bytes, log: dict[str, tuple[str, int]]) -> None:
        data = bytes(Office(ros).odometry(START_NS, np.zeros(3), np.array([0.5, 0.125])))
        pose = data.index(b"base_link") + (10 if ros == 2 else 9)
        pose += (4 - pose) % 8 if ros == 2 else 0
        places = {"stamp": ("<2u4", len(head) + 4), "pose": ("<7f8", len(head) + pose), **log}
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
        self._logged = tuple(log)

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
            rows[name] = log_ns if rows[name].ndim == 1 else np.stack(np.divmod(log_ns, 10**9), axis=1)
        return log_ns, data.tobytes()


def _spans(count: int) -> Iterator[tuple[int, int]]:
    return ((first, min(CHUNK, count - first)) for first in range(0, count, CHUNK))


def long_mcap(path: Path, count: int) -> None:
    """Write an MCAP with zstd chunks, indexes and statistics."""
    office, build = Office(2), RecordBuilder()
    template = Template(2, b"", {})
    head = struct.pack("<BQHIQQ", 5, 22 + template.size, 1, 0, 0, 0)
    template = Template(2, head, {"log": ("<u8", 15), "published": ("<u8", 23)})
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


def _fields(**fields: bytes) -> bytes:
    parts = [name.encode() + b"=" + value for name, value in fields.items()]
    return b"".join(struct.pack("<I", len(part)) + part for part in parts)


def _record(header: bytes, data: bytes) -> bytes:
    return struct.pack("<I", len(header)) + header + struct.pack("<I", len(data)) + data


def long_ros1(path: Path, count: int) -> None:
    """Write a ROS 1 bag without compression."""
    office = Office(1)
    text, md5sum = definition(office, ODOMETRY)
    head = _fields(op=b"\x02", conn=bytes(4), time=bytes(8))
    template = Template(1, b"", {})
    head = struct.pack("<I", len(head)) + head + struct.pack("<I", template.size)
    template = Template(1, head, {"log": ("<2u4", len(head) - 12)})
    about = _fields(topic=b"/odom", type=b"nav_msgs/Odometry", md5sum=md5sum.encode(), message_definition=text.encode())
    connection = _record(_fields(op=b"\x07", conn=bytes(4), topic=b"/odom"), about)
    infos = []

    def bag_header(stream: BinaryIO, index_at: int, chunks: int) -> None:
        fields = {"chunk_count": struct.pack("<I", chunks), "conn_count": struct.pack("<I", 1)}
        header = _fields(op=b"\x03", index_pos=struct.pack("<Q", index_at), **fields)
        stream.write(_record(header, b" " * (4096 - len(header))))

    with path.open("wb") as stream:
        stream.write(b"#ROSBAG V2.0\n")
        begin = stream.tell()
        bag_header(stream, 0, 0)
        for first, many in _spans(count):
            log_ns, data = template.rows(first, many)
            before = b"" if first else connection
            at = stream.tell()
            size = struct.pack("<I", len(before) + len(data))
            stream.write(_record(_fields(op=b"\x05", compression=b"none", size=size), before + data))
            times = np.stack(np.divmod(log_ns, 10**9), axis=1)
            offsets = len(before) + np.arange(many) * len(template.one)
            index = np.column_stack((times, offsets)).astype("<u4").tobytes()
            told = {"conn": bytes(4), "count": struct.pack("<I", many)}
            stream.write(_record(_fields(op=b"\x04", ver=struct.pack("<I", 1), **told), index))
            start, end = (struct.pack("<II", *time) for time in times[[0, -1]].tolist())
            info = {"chunk_pos": struct.pack("<Q", at), "start_time": start, "end_time": end}
            info |= {"ver": struct.pack("<I", 1), "count": struct.pack("<I", 1)}
            infos.append(_record(_fields(op=b"\x06", **info), bytes(4) + struct.pack("<I", many)))
        index_at = stream.tell()
        stream.write(connection + b"".join(infos))
        stream.seek(begin)
        bag_header(stream, index_at, len(infos))


def long_sqlite3(path: Path, count: int) -> None:
    """Write a .db3 file as rosbag2 has it."""
    template = Template(2, b"", {})
    with tempfile.TemporaryDirectory(dir=path.parent) as room:
        with Ros2Writer(Path(room) / "bag", version=8, storage_plugin=StoragePlugin.SQLITE3) as writer:
            text, digest = definition(Office(2), ODOMETRY)
            writer.add_connection("/odom", ODOMETRY, msgdef=text, rihs01=digest)
        shutil.move(next((Path(room) / "bag").glob("*.db3")), path)
    with sqlite3.connect(path, isolation_level=None) as database:
        database.execute("PRAGMA synchronous=OFF")
        topic = database.execute("SELECT id FROM topics").fetchone()[0]
        database.execute("BEGIN")
        for first, many in _spans(count):
            log_ns, data = template.rows(first, many)
            step = template.size
            rows = [(topic, time, data[i * step : (i + 1) * step]) for i, time in enumerate(log_ns.tolist())]
            database.executemany("INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)", rows)
        database.execute("COMMIT")
    database.close()


LONG = {".mcap": long_mcap, ".bag": long_ros1, ".db3": long_sqlite3}
