"""Provenance metadata of a bag: seed, run, version and model of earlier corruptions."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING

from mcap.opcode import Opcode as Op

from odomcorrupt.bags.mcap.chunk import RECORD_HEADER_BYTES, McapFraming
from odomcorrupt.errors import BagError

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from odomcorrupt.bags.block import Block

NAME = "odomcorrupt"
"""Of the metadata record of an MCAP, and the prefix of keys in a rosbag2's custom_data."""


class ProvenanceWatcher:
    """Collects the metadata of earlier corruptions from blocks; a ROS 1 bag has none.

    watch : also called with every block
    """

    def __init__(self, watch: Callable[[Block], None] = lambda _: None) -> None:
        self._watch = watch
        self._found: list[dict[str, str]] = []

    def __call__(self, block: Block) -> None:
        """Read the metadata of a block."""
        if isinstance(block.raw, McapFraming) and block.raw.opcode == Op.METADATA:
            content = block.data.tobytes()[RECORD_HEADER_BYTES:]
            try:
                if content[4 : 4 + struct.unpack_from("<I", content)[0]].decode() == NAME:
                    self._found.append(mapping_of(content))
            except (struct.error, UnicodeDecodeError, ValueError):
                pass  # a record of another program with this name
        self._watch(block)

    def provenance(self, source: Path | None) -> tuple[dict[str, str], ...]:
        """Return the metadata, latest corruption last; of a rosbag2 directory, that in its metadata.yaml."""
        if self._found or source is None or not source.is_dir():
            return tuple(self._found)
        from odomcorrupt.bags.rosbag2.bounded_yaml import read_text  # noqa: PLC0415 - YAML is slow to import
        from odomcorrupt.bags.rosbag2.metadata import read_info  # noqa: PLC0415 - as above

        path = source / "metadata.yaml"
        try:
            if f"{NAME}." not in read_text(path):
                return ()
            custom = read_info(path).get("custom_data") or {}
        except (OSError, ValueError, BagError):
            return ()
        own = {str(key)[len(NAME) + 1 :]: str(v) for key, v in custom.items() if str(key).startswith(f"{NAME}.")}
        return (own,) if own else ()


def mapping_of(content: bytes) -> dict[str, str]:
    """Return the key-value strings of a metadata record's content."""
    words: list[str] = []
    at = 4 + struct.unpack_from("<I", content)[0]
    at += 4
    while at < len(content):
        (size,) = struct.unpack_from("<I", content, at)
        words.append(content[at + 4 : at + 4 + size].decode())
        at += 4 + size
    return dict(zip(words[::2], words[1::2], strict=True))
