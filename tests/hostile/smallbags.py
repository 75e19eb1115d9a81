"""Small bags of every format, by other people's writers: a few seconds of the office, for tests that need thousands."""

import shutil
import sys
from collections import Counter
from pathlib import Path
from typing import NamedTuple

import lz4.frame
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Ros2Writer

FIXTURES = Path(__file__).parents[2] / "fixtures"
sys.path.append(str(FIXTURES))

from make_fixtures import definition, qos  # noqa: E402 - a script beside the bags it makes
from office_messages import START_NS, TOPICS, Office, Recorded, record  # noqa: E402 - as above

CHUNK_BYTES = 6_000
STANDING_S = 8
"""How long the robot stands first."""
THINNED = {"/odom": 3, "/tf": 3, "/imu": 10, "/scan": 4}
"""Every how manieth message is kept."""


class Small(NamedTuple):
    """A bag: a file or a directory, and how many messages it has."""

    path: Path
    count: int


def messages(ros: int, seconds: float = 1.3) -> list[Recorded]:
    """Return the messages of a while in which the robot drives, thinned."""
    seen: Counter[str] = Counter()
    kept = []
    for message in record(ros, STANDING_S + seconds):
        if message.topic != "/tf_static" and message.log_ns < START_NS + STANDING_S * 10**9:
            continue
        if seen[message.topic] % THINNED.get(message.topic, 1) == 0:
            kept.append(message)
        seen[message.topic] += 1
    return kept


def make_small_bags(directory: Path, seconds: float = 1.3) -> dict[str, Small]:
    """Write the bags, by what they are."""
    topics = TOPICS
    one, two = (messages(ros, seconds) for ros in (1, 2))
    bags = {}
    for codec in ("zstd", "lz4", "none"):
        bags[f"mcap {codec}"] = _mcap(
            directory / f"{codec}.mcap", 2, two, topics, compression=CompressionType[codec.upper()]
        )
        codec1 = {"zstd": "bz2"}.get(codec, codec)
        bags[f"ros1 {codec1}"] = _ros1(directory / f"{codec1}.bag", one, topics, codec1)
    bags["mcap unchunked"] = _mcap(directory / "unchunked.mcap", 2, two, topics, use_chunking=False)
    bags["mcap of ros1"] = _mcap(directory / "ros1.mcap", 1, one, topics, compression=CompressionType.ZSTD)
    bags["sqlite3 directory"] = _sqlite3(directory / "sqlite3", two, topics)
    alone = directory / "alone.db3"
    shutil.copyfile(directory / "sqlite3" / "sqlite3.db3", alone)
    bags["sqlite3 file"] = Small(alone, len(two))
    bags["mcap directory"] = _split(directory / "split", two, topics)
    return bags


def _mcap(path: Path, ros: int, recorded: list[Recorded], topics: dict[str, str], **options: object) -> Small:
    office = Office(ros)
    with path.open("wb") as stream:
        writer = McapWriter(stream, chunk_size=CHUNK_BYTES, enable_data_crcs=True, **options)  # type: ignore[arg-type]
        writer.start(profile=f"ros{ros}", library="small")
        channels = {}
        for topic, msgtype in topics.items():
            text, digest = definition(office, msgtype)
            name = msgtype if ros == 2 else msgtype.replace("/msg/", "/")
            schema = writer.register_schema(name, "ros2msg" if ros == 2 else "ros1msg", text.encode())
            said = {"offered_qos_profiles": qos(topic)} if ros == 2 else {"md5sum": digest, "callerid": "/office"}
            channels[topic] = writer.register_channel(topic, "cdr" if ros == 2 else "ros1", schema, said)
        for number, message in enumerate(recorded):
            writer.add_message(channels[message.topic], message.log_ns, message.data, message.log_ns, number)
        writer.add_attachment(0, 0, "plan.txt", "text/plain", b"a corridor\n")
        writer.add_metadata("office", {"floor": "3"})
        writer.finish()
    return Small(path, len(recorded))


def _ros1(path: Path, recorded: list[Recorded], topics: dict[str, str], codec: str) -> Small:
    office = Office(1)
    writer = Ros1Writer(path)
    if codec != "none":
        writer.set_compression(Ros1Writer.CompressionFormat[codec.upper()])
    if codec == "lz4":
        writer.compressor = lambda data: lz4.frame.compress(  # type: ignore[assignment]
            data, block_linked=False, store_size=False, content_checksum=True
        )
    writer.chunk_threshold = CHUNK_BYTES
    with writer:
        connections = {}
        for topic, msgtype in topics.items():
            text, md5sum = definition(office, msgtype)
            connections[topic] = writer.add_connection(topic, msgtype, msgdef=text, md5sum=md5sum, callerid="/office")
        for message in recorded:
            writer.write(connections[message.topic], message.log_ns, message.data)
    return Small(path, len(recorded))


def _sqlite3(path: Path, recorded: list[Recorded], topics: dict[str, str]) -> Small:
    office = Office(2)
    with Ros2Writer(path, version=8, storage_plugin=StoragePlugin.SQLITE3) as writer:
        connections = {}
        for topic, msgtype in topics.items():
            text, digest = definition(office, msgtype)
            connections[topic] = writer.add_connection(topic, msgtype, msgdef=text, rihs01=digest)
        for message in recorded:
            writer.write(connections[message.topic], message.log_ns, message.data)
    return Small(path, len(recorded))


def _split(path: Path, recorded: list[Recorded], topics: dict[str, str]) -> Small:
    path.mkdir()
    half = len(recorded) // 2
    for number, part in enumerate((recorded[:half], recorded[half:])):
        _mcap(path / f"split_{number}.mcap", 2, part, topics, compression=CompressionType.ZSTD)
    return Small(path, len(recorded))
