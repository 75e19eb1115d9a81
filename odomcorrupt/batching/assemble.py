"""Merge of an overlay with its original bag, equal to the bag of a full run."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from odomcorrupt.bags.mcap.chunk import McapFraming
from odomcorrupt.bags.mcap.records import METADATA, RECORD_HEADER_BYTES
from odomcorrupt.bags.open import open_reader, open_writer
from odomcorrupt.bags.provenance import mapping_of
from odomcorrupt.batching.manifest import BatchError

if TYPE_CHECKING:
    from collections.abc import Container, Iterator
    from pathlib import Path

    from odomcorrupt.bags.block import BagReader, Block
    from odomcorrupt.corruption.run import Container as BagContainer

__all__ = ["assemble"]


def assemble(overlay: Path, source: Path, target: Path, container: BagContainer) -> int:
    """Write the original with the overlay's messages in place of its own; return the number of replaced messages.

    Raises
    ------
    BatchError
        If the overlay does not belong to this original.

    """
    with open_reader(source, recover=container.recover) as reader, open_reader(overlay) as changed:
        output = container.target(target, reader)
        topics = {(one.topic, one.msgtype) for one in changed.channels.values()}
        wanted = {one.id for one in reader.channels.values() if (one.topic, one.msgtype) in topics}
        if len({(reader.channels[one].topic, reader.channels[one].msgtype) for one in wanted}) < len(topics):
            raise BatchError(f"{overlay}: has topics that {source} has not; name the input it was made from")
        stream = _Messages(changed, overlay)
        merged = _Merged(reader, wanted, stream, source)
        if output.reader is not reader:
            # what is converted is the merged bag
            output = container.target(target, merged)
        writer = open_writer(
            target,
            output.reader,
            overwrite=container.overwrite,
            compression=container.compression,
            level=container.level,
            form=output.form,
        )
        with writer:
            for block in (merged if output.reader is reader else output.reader).blocks():
                writer.write(block)
            stream.require_end(source)
            if stream.provenance is not None:
                writer.provenance("odomcorrupt", stream.provenance)
    return merged.replaced


class _Merged:
    """The original with the overlay's messages in place of its own; otherwise equal to its reader.

    replaced : number of replaced messages
    """

    def __init__(self, reader: BagReader, wanted: set[int], stream: _Messages, source: Path) -> None:
        self._reader, self._wanted, self._stream, self._source = reader, wanted, stream, source
        self.replaced = 0

    def __getattr__(self, name: str) -> Any:
        return getattr(self._reader, name)

    def blocks(self, only: Container[int] | None = None) -> Iterator[Block]:
        """Yield the blocks with the overlay's messages."""
        for block in self._reader.blocks(only):
            self.replaced += _replace(block, self._reader, self._wanted, self._stream, self._source)
            yield block


def _replace(block: Block, reader: BagReader, wanted: set[int], stream: _Messages, source: Path) -> int:
    rows = np.flatnonzero(np.isin(block.table["channel"], list(wanted)))
    for row in block.table[rows]:
        channel = reader.channels[int(row["channel"])]
        topic, log_ns, data = stream.take()
        start, stop = int(row["offset"]), int(row["offset"]) + int(row["length"])
        if (topic, log_ns, len(data)) != (channel.topic, int(row["log_ns"]), stop - start):
            raise BatchError(
                f"{source}: has {channel.topic} at {row['log_ns']} ns where the overlay has {topic or 'nothing'} at "
                f"{log_ns} ns; name the input the overlay was made from"
            )
        block.data[start:stop] = np.frombuffer(data, dtype=np.uint8)
    return len(rows)


class _Messages:
    """An overlay's messages one by one, in the order of the original.

    provenance : the overlay's metadata on its origin, complete at its end
    """

    def __init__(self, reader: BagReader, path: Path) -> None:
        self.provenance: dict[str, str] | None = None
        self._reader = reader
        self._path = path
        self._stream = self._messages()

    def _messages(self) -> Iterator[tuple[str, int, memoryview]]:
        for block in self._reader.blocks():
            if isinstance(block.raw, McapFraming) and block.raw.opcode == METADATA:
                self.provenance = mapping_of(block.data.tobytes()[RECORD_HEADER_BYTES:])
            for channel, log_ns, offset, length in block.table.tolist():
                yield self._reader.channels[channel].topic, log_ns, block.data.data[offset : offset + length]

    def take(self) -> tuple[str, int, memoryview]:
        """Return the next message: topic, log time, data; an empty one at the end."""
        return next(self._stream, ("", 0, memoryview(b"")))

    def require_end(self, source: Path) -> None:
        """Raise BatchError where the overlay has messages that its original lacks."""
        left = sum(1 for _ in self._stream)
        if left:
            raise BatchError(f"{self._path}: has {left} messages more than {source}; name the input it was made from")
