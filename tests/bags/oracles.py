"""What other people's readers see in a bag, and bags written by other people's writers."""

import io
import os
import struct
import threading
from functools import lru_cache
from itertools import product
from pathlib import Path
from typing import NamedTuple
from unittest.mock import patch

import numpy as np
from mcap.reader import NonSeekingReader, SeekingReader, make_reader
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, IndexType
from mcap.writer import Writer as McapLibraryWriter
from rosbags.rosbag1 import Reader as Ros1LibraryReader
from rosbags.typesys import Stores, get_typestore
from ruamel.yaml import YAML

from odomcorrupt.bags.block import Message
from odomcorrupt.bags.chunk import Chunk
from odomcorrupt.bags.messages import gather, locate, scatter
from odomcorrupt.bags.open import open_reader, open_writer

FIXTURES = Path(__file__).parents[2] / "fixtures"
OFFICE = FIXTURES / "office_ros2"
OFFICE_DB = OFFICE / "office_ros2.db3"
OFFICE_MCAP = FIXTURES / "office.mcap"
OFFICE_BAG = FIXTURES / "office.bag"
SHIFT = np.array([10.0, 20.0, 30.0])


class Seen(NamedTuple):
    """A message and everything a bag says about it."""

    topic: str
    type: tuple
    publisher: tuple
    times: tuple
    data: bytes


def mcap_messages(path, *, seek=False):
    """Return the messages of an MCAP as the mcap library reads them, straight or by indexes; checksums are checked."""
    return list(_mcap_messages(path, path.stat().st_mtime_ns, seek))


@lru_cache(maxsize=4)
def _mcap_messages(path, _changed_ns, seek):
    with path.open("rb") as stream:
        reader = (SeekingReader if seek else NonSeekingReader)(stream, validate_crcs=True)
        return [
            Seen(
                channel.topic,
                (schema.name, schema.encoding, schema.data) if schema else (),
                (channel.message_encoding, *sorted(channel.metadata.items())),
                (message.log_time, message.publish_time, message.sequence),
                message.data,
            )
            for schema, channel, message in reader.iter_messages(log_time_order=seek)
        ]


def mcap_records(path):
    """Return the records of an MCAP in file order, chunks opened, checksums validated."""
    with path.open("rb") as stream:
        return list(StreamReader(stream, validate_crcs=True).records)


def mcap_extras(path):
    """Return what an MCAP has besides messages."""
    with path.open("rb") as stream:
        reader = make_reader(stream)
        attachments = [(a.name, a.media_type, a.log_time, a.create_time, a.data) for a in reader.iter_attachments()]
        return reader.get_header(), attachments, [(m.name, m.metadata) for m in reader.iter_metadata()]


def ros1_messages(path):
    """Return the messages of a ROS 1 bag as the rosbags library reads them."""
    with Ros1LibraryReader(path) as reader:
        return [
            Seen(
                connection.topic,
                (connection.msgtype, connection.digest, connection.msgdef.data),
                (connection.ext.callerid, connection.ext.latching),
                (time_ns,),
                bytes(data),
            )
            for connection, time_ns, data in reader.messages()
        ]


def info_of(path):
    """Return what the metadata.yaml of a ROS 2 bag says."""
    return YAML(typ="safe").load((path / "metadata.yaml").read_text())["rosbag2_bagfile_information"]


def count_of(path):
    """Return how many messages this package reads from a bag."""
    with open_reader(path) as reader:
        return sum(len(block.table) for block in reader.blocks())


def rewritten(reader, writer, *, seconds=None, order=list, kept=lambda _: True):
    """Write a bag again by the rosbags library: its first seconds, and of these the messages whose number is kept.

    order : of the topics; the messages of topics that it leaves out are left out, too
    """
    with reader, writer:
        made = {}
        for one in order(reader.connections):
            if isinstance(reader, Ros1LibraryReader):
                facts = {"md5sum": one.digest, "callerid": one.ext.callerid, "latching": one.ext.latching}
            else:
                facts = {"rihs01": one.digest, "offered_qos_profiles": one.ext.offered_qos_profiles}
            made[one.id] = writer.add_connection(one.topic, one.msgtype, msgdef=one.msgdef.data, **facts)
        stop = None if seconds is None else reader.start_time + seconds * 10**9
        for number, (one, log_ns, data) in enumerate(reader.messages(stop=stop)):
            if one.id in made and kept(number):
                writer.write(made[one.id], log_ns, data)


def copy(source, target, change=None, *, stdin=None, **options):
    """Pass a bag's blocks from reader to writer."""
    with open_reader(source, stdin) as reader, open_writer(target, reader, **options) as writer:
        for block in reader.blocks():
            if change:
                change(reader, writer, block)
            writer.write(block)
    return target


def by_chunk(path):
    with patch.object(Chunk, "goes_on_with", lambda *_: False), open_reader(path) as reader:
        return [block for block in reader.blocks() if getattr(block.raw, "kind", "chunk") == "chunk"]


def shift(reader, _writer, block):
    """Move the positions of all odometry."""
    for channel in reader.channels.values():
        if channel.msgtype == "nav_msgs/msg/Odometry":
            for layout in locate(block, channel):
                values = gather(block, layout, layout.items[0], "position")
                scatter(block, layout, layout.items[0], "position", values + SHIFT)


def positions(messages, ros=2):
    """Return the positions (n, 3) of /odom among messages, whose first entry is the topic and whose last the bytes."""
    store = get_typestore(Stores.ROS1_NOETIC if ros == 1 else Stores.ROS2_HUMBLE)
    decode = store.deserialize_ros1 if ros == 1 else store.deserialize_cdr
    odometry = [decode(one[-1], "nav_msgs/msg/Odometry").pose.pose.position for one in messages if one[0] == "/odom"]
    return np.array([[point.x, point.y, point.z] for point in odometry])


def require_shifted(before, after, ros=2):
    """Require that another decoder reads shifted positions, and all else as it was."""
    np.testing.assert_array_equal(positions(after, ros), positions(before, ros) + SHIFT)
    assert [one for one in after if one[0] != "/odom"] == [one for one in before if one[0] != "/odom"]


def adding(like, twin, data):
    """Return a change that adds a message to each block on a topic, on a twin of it, and on one of another type."""
    made = {}

    def add(reader, writer, block):
        if not len(block.table):
            return
        if not made:
            made["like"] = next(channel for channel in reader.channels.values() if channel.topic == like)
            made["twin"] = writer.add_channel(twin, made["like"].msgtype, made["like"])
            made["pose"] = writer.add_channel("/pose", "geometry_msgs/msg/PoseStamped", made["like"])
        log_ns = int(block.table["log_ns"][0]) + 1
        block.added += [Message(channel.id, log_ns, data) for channel in made.values()]

    return add


def copy_through_pipes(source, target, change=None):
    """Pass a bag through real pipes, in and out."""
    feed, mouth = os.pipe()
    drain, tail = os.pipe()

    def push():
        with os.fdopen(mouth, "wb") as stream:
            stream.write(source.read_bytes())

    def pull():
        with os.fdopen(drain, "rb") as stream:
            target.write_bytes(stream.read())

    threads = [threading.Thread(target=push), threading.Thread(target=pull)]
    for thread in threads:
        thread.start()
    with os.fdopen(feed, "rb") as stdin, os.fdopen(tail, "wb") as stdout:
        with open_reader(None, stdin) as reader, open_writer(None, reader, stream=stdout) as writer:
            assert not reader.complete
            for block in reader.blocks():
                if change:
                    change(reader, writer, block)
                writer.write(block)
        stdin.read()
    for thread in threads:
        thread.join()
    return target


NO_SUMMARY = {
    **dict.fromkeys(("use_statistics", "use_summary_offsets", "repeat_channels", "repeat_schemas"), False),
    "index_types": IndexType.NONE,
}
VARIANTS = {
    "zstd": {}, "lz4": {"compression": CompressionType.LZ4}, "none": {"compression": CompressionType.NONE},
    "unchunked": {"use_chunking": False}, "without indexes": {"index_types": IndexType.NONE},
    "without summary": NO_SUMMARY, "unchunked, without summary": {"use_chunking": False, **NO_SUMMARY},
    "without channels in the summary": {"repeat_channels": False, "repeat_schemas": False},
    "without checksums": {"enable_crcs": False},
}  # fmt: skip
"""Kinds of MCAP that the mcap library's writer can be asked for."""


def office_variant(path, seconds=60.0, **options):
    """Write the first seconds of the office MCAP in another way."""
    with OFFICE_MCAP.open("rb") as source, path.open("wb") as stream:
        reader = make_reader(source)
        writer = McapLibraryWriter(stream, **{"chunk_size": 100_000, **options})
        writer.start(profile="ros2", library="a test")
        writer.add_metadata("first", {"a": "1", "b": ""})
        end_ns = reader.get_summary().statistics.message_start_time + seconds * 1e9
        schemas, channels = {}, {}
        for schema, channel, message in reader.iter_messages(log_time_order=False):
            if channel.id not in channels:
                if schema.id not in schemas:
                    schemas[schema.id] = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.id] = writer.register_channel(
                    channel.topic, channel.message_encoding, schemas[schema.id], channel.metadata
                )
            writer.add_message(
                channels[channel.id], message.log_time, message.data, message.publish_time, message.sequence
            )
            if message.log_time > end_ns:
                break
            if message.sequence == round(seconds * 50.0 / 3.0):
                writer.add_attachment(7, 8, f"in the middle {channel.topic}", "x/y", b"\1\2" * 1000)
        writer.finish()
    return path


def mcap_record_places(data):
    """Return (opcode, begin, end) of the top-level records of an MCAP's bytes."""
    places, at = [], 8
    while at < len(data) - 8:
        opcode, length = struct.unpack_from("<BQ", data, at)
        places.append((opcode, at, at + 9 + length))
        at += 9 + length
    return places


def mcap_record(opcode, *parts):
    return struct.pack("<BQ", opcode, sum(map(len, parts))) + b"".join(parts)


MCAP_MAGIC = b"\x89MCAP0\r\n"


def mcap_rewritten(data, change):
    """Return an MCAP whose records were changed one by one; without a summary, whose offsets would be wrong."""
    out = [MCAP_MAGIC]
    for opcode, begin, end in mcap_record_places(data):
        out += [mcap_record(*one) for one in change(opcode, data[begin + 9 : end])]
        if opcode == 15:
            break
    return b"".join([*out, mcap_record(2, bytes(20)), MCAP_MAGIC])


def damaged_copies_fail(source, tmp_path, offsets, suffix, *, piped=True):
    """Cut a bag at offsets, in a file and in a pipe; return those cuts that went through or left something behind."""
    data = source.read_bytes()
    cut, target = tmp_path / f"cut{suffix}", tmp_path / f"out{suffix}"
    wrong = []
    for offset, through in product(offsets, [cut, None] if piped else [cut]):
        cut.write_bytes(data[:offset])
        try:
            copy(through, target, stdin=None if through else io.BytesIO(data[:offset]))
        except Exception as error:  # noqa: BLE001 - which error it is, is the question
            if type(error).__name__ != "BagError" or (str(tmp_path) if through else "stdin") not in str(error):
                wrong.append((offset, repr(error)))
        else:
            wrong.append((offset, "went through"))
        if {one.name for one in tmp_path.iterdir()} != {cut.name}:
            wrong.append((offset, "left something behind"))
    return wrong


def pipe_of(data):
    """Return bytes as a stream that cannot seek."""
    stream = io.BytesIO(data)
    stream.seekable = lambda: False
    return stream
