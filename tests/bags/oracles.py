"""What other people's readers see in a bag, and bags written by other people's writers."""

import io
import os
import struct
import threading
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

from mcap.reader import NonSeekingReader, SeekingReader, make_reader
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, IndexType
from mcap.writer import Writer as McapLibraryWriter
from rosbags.rosbag1 import Reader as Ros1LibraryReader

from odomcorrupt.bags.open import open_reader, open_writer

ROOT = Path(__file__).parents[2]
FIXTURES = ROOT / "fixtures"
OFFICE_MCAP = FIXTURES / "office.mcap"
OFFICE_BAG = FIXTURES / "office.bag"


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


def copy(source, target, change=None, *, stdin=None, **options):
    """Pass a bag's blocks from reader to writer."""
    with open_reader(source, stdin) as reader, open_writer(target, reader, **options) as writer:
        for block in reader.blocks():
            if change:
                change(reader, writer, block)
            writer.write(block)
    return target


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


VARIANTS = {
    "zstd": {},
    "lz4": {"compression": CompressionType.LZ4},
    "none": {"compression": CompressionType.NONE},
    "unchunked": {"use_chunking": False},
    "without indexes": {"index_types": IndexType.NONE},
    "without summary": {
        "index_types": IndexType.NONE,
        "use_statistics": False,
        "use_summary_offsets": False,
        "repeat_channels": False,
        "repeat_schemas": False,
    },
    "unchunked, without summary": {
        "use_chunking": False,
        "index_types": IndexType.NONE,
        "use_statistics": False,
        "use_summary_offsets": False,
        "repeat_channels": False,
        "repeat_schemas": False,
    },
    "without channels in the summary": {"repeat_channels": False, "repeat_schemas": False},
    "without checksums": {"enable_crcs": False},
}
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


def damaged_copies_fail(source, tmp_path, offsets, suffix):
    """Cut a bag at offsets; return those cuts that went through or left something behind."""
    data = source.read_bytes()
    cut, target = tmp_path / f"cut{suffix}", tmp_path / f"out{suffix}"
    wrong = []
    for offset in offsets:
        cut.write_bytes(data[:offset])
        try:
            copy(cut, target)
        except Exception as error:  # noqa: BLE001 - which error it is, is the question
            if type(error).__name__ != "BagError" or str(tmp_path) not in str(error):
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
