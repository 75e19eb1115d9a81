"""A loop over messages with mcap and mcap-ros2-support, as people write it today.

python benchmarks/loop_mcap.py IN OUT
"""

from __future__ import annotations

import sys
from pathlib import Path

from loop_noise import MOVED, shake
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from mcap_ros2._dynamic import generate_dynamic, serialize_dynamic


def loop(source: Path, target: Path) -> None:
    """Rewrite with mcap and mcap-ros2-support."""
    codec = next(c for c in CompressionType if c.name.lower() in source.name)
    with source.open("rb") as stream, target.open("wb") as sink:
        writer = Writer(sink, compression=codec)
        writer.start(profile="ros2", library="loop")
        channels: dict[int, int] = {}
        pack, unpack = {}, {}
        for schema, channel, message in make_reader(stream).iter_messages(log_time_order=False):
            if channel.id not in channels:
                number = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.id] = writer.register_channel(channel.topic, "cdr", number, channel.metadata)
                if schema.name in MOVED:
                    text = schema.data.decode()
                    pack[channel.id] = serialize_dynamic(schema.name, text)[schema.name]
                    unpack[channel.id] = generate_dynamic(schema.name, text)[schema.name]
            data = message.data
            if channel.id in pack:
                decoded = unpack[channel.id](data)
                shake(decoded)
                data = pack[channel.id](decoded)
            writer.add_message(channels[channel.id], message.log_time, data, message.publish_time, message.sequence)
        writer.finish()


if __name__ == "__main__":
    loop(Path(sys.argv[1]), Path(sys.argv[2]))
