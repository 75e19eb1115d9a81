"""A loop over messages with rosbags, as people write it today.

python benchmarks/loop_rosbags.py IN OUT
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from loop_noise import MOVED, shake
from rosbags.highlevel import AnyReader
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer


def loop(source: Path, target: Path) -> None:
    """Rewrite with rosbags, in the format of the input."""
    with AnyReader([source]) as reader:
        store = reader.typestore
        if source.suffix == ".bag":
            writer: Any = Writer1(target)
            writer.set_compression(Writer1.CompressionFormat.LZ4)
            unpack, pack = store.deserialize_ros1, store.serialize_ros1
        else:
            plugin = StoragePlugin.MCAP if source.suffix == ".mcap" else StoragePlugin.SQLITE3
            writer = Writer(target, version=9 if source.suffix == ".mcap" else 8, storage_plugin=plugin)
            if "zstd" in source.name:
                writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
            unpack, pack = store.deserialize_cdr, store.serialize_cdr
        with writer:
            out = {c.id: writer.add_connection(c.topic, c.msgtype, typestore=store) for c in reader.connections}
            for connection, time_ns, data in reader.messages():
                if connection.msgtype in MOVED:
                    message = unpack(data, connection.msgtype)
                    shake(message)
                    data = pack(message, connection.msgtype)  # noqa: PLW2901 - as people write it
                writer.write(out[connection.id], time_ns, data)


if __name__ == "__main__":
    loop(Path(sys.argv[1]), Path(sys.argv[2]))
