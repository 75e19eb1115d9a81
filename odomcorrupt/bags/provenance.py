"""Provenance metadata of a bag: seed, run, version and model of earlier corruptions."""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING

from mcap.opcode import Opcode as Op

from odomcorrupt.bags.mcap.chunk import RECORD_HEADER_BYTES, Fields, McapFraming
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
            # a damaged record, or one of another program, tells nothing
            with suppress(BagError):
                self._found += filter(None, [metadata_of(block)])
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


def metadata_of(block: Block) -> dict[str, str]:
    """Return the metadata in a block that is a record of an MCAP, {} for those of another name.

    Raises
    ------
    BagError
        If the record is damaged.
    """
    fields = Fields(block.data[RECORD_HEADER_BYTES:].tobytes(), "metadata")
    return fields.mapping() if fields.string() == NAME else {}
