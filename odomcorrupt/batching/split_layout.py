"""Whole bags with changed messages in chunks of their own, and overlays assembled with their original bag."""

from __future__ import annotations

from itertools import groupby
from typing import TYPE_CHECKING, Any

import numpy as np
from mcap.opcode import Opcode as Op

from odomcorrupt.bags.block import Block, ReaderView, without
from odomcorrupt.bags.codecs import compress_for_ros1
from odomcorrupt.bags.mcap.chunk import McapFraming
from odomcorrupt.bags.mcap.writer import McapWriter, Packed, packed
from odomcorrupt.bags.open import open_reader
from odomcorrupt.bags.provenance import metadata_of
from odomcorrupt.bags.ros1.chunk import Ros1Framing
from odomcorrupt.batching.sinks import BagSink, bag_writer
from odomcorrupt.errors import BatchError

if TYPE_CHECKING:
    from collections.abc import Container, Iterator
    from pathlib import Path
    from typing import Self

    from numpy.typing import NDArray

    from odomcorrupt.bags.block import BagReader, Framing, Message
    from odomcorrupt.bags.open import Target
    from odomcorrupt.batching.job import Job
    from odomcorrupt.batching.patch_batch import Place, Portion
    from odomcorrupt.batching.sinks import Added
    from odomcorrupt.corruption.run import Container as BagContainer


class Rests:
    """A portion's blocks without the messages that change, extracted and compressed once for all runs."""

    def __init__(self) -> None:
        self._portion: Portion | None = None
        self._blocks: list[Block] = []
        self._packed: dict[tuple[int, int, str], Any] = {}

    def of(self, portion: Portion) -> list[Block]:
        """Return the blocks of a portion."""
        if self._portion is not portion:
            self._portion = portion
            self._packed.clear()
            self._blocks = [
                block if place is None else _rest(block, place)
                for block, place in zip(portion.blocks, portion.places, strict=True)
            ]
        return self._blocks

    def compress(self, codec: str, data: NDArray[np.uint8], level: int | None) -> Packed:
        """Return a chunk compressed for an MCAP, with checksums; data common to all runs is compressed once."""
        return self._once(packed, codec, data, level)

    def compress_for_ros1(self, codec: str, data: NDArray[np.uint8], level: int | None) -> bytes | memoryview:
        """Return a chunk compressed for a ROS 1 bag; data common to all runs is compressed once."""
        return self._once(compress_for_ros1, codec, data, level)

    def _once(self, how: Any, codec: str, data: NDArray[np.uint8], level: int | None) -> Any:
        # a block of several chunks is compressed chunk by chunk
        key = (data.__array_interface__["data"][0], data.size, codec)
        if key in self._packed:
            return self._packed[key]
        chunk = how(codec, data, level)
        if any(np.may_share_memory(block.data, data) for block in self._blocks):
            self._packed[key] = chunk
        return chunk


def _rest(block: Block, place: Place) -> Block:
    """Return a block without the messages that change."""
    changing = np.zeros(len(block.table), dtype=bool)
    changing[place.rows] = True
    return without(block, changing)


class SplitSink(BagSink):
    """A whole bag with the changed messages in chunks of their own."""

    def __init__(self, job: Job, run: int, output: Target, rests: Rests) -> None:
        super().__init__(job, run, bag_writer(job, run, output))
        self._rests = rests

    def __enter__(self) -> Self:
        super().__enter__()
        for file in getattr(self._writer, "files", [self._writer]):
            if isinstance(file, McapWriter):
                file.pack = self._rests.compress
            elif hasattr(file, "pack"):  # a ROS 1 bag; sqlite3 has no chunks
                file.pack = self._rests.compress_for_ros1
        return self

    def write(self, portion: Portion, data: NDArray[np.uint8], added: Added = None) -> None:
        """Write the unchanged messages, then the changed and added ones."""
        blocks = self._rests.of(portion)
        first_row = first_byte = 0
        for _, numbers in groupby(range(len(blocks)), lambda number: portion.blocks[number].part):
            own = list(numbers)
            for number in own:
                self._writer.write(blocks[number])
            places = [place for number in own if (place := portion.places[number]) is not None]
            if not places:
                continue
            rows = slice(first_row, first_row + sum(len(place.rows) for place in places))
            size = sum(int((place.ends - place.begins).sum()) for place in places)
            more = [one for number in own for one in portion.blocks[number].added]
            more += [] if added is None else [one for number in own for one in added[number]]
            span = slice(first_byte, first_byte + size)
            self._writer.write(_changed(portion, own, rows, span, data[span], more))
            first_row, first_byte = rows.stop, span.stop


def _changed(
    portion: Portion, numbers: list[int], rows: slice, span: slice, data: NDArray[np.uint8], added: list[Message]
) -> Block:
    """Return the changed messages of some blocks of one file of a bag as one chunk.

    numbers : blocks of the portion
    rows, span : rows of the portion's table and bytes of its data that are their changed messages
    data : these bytes as patched by a run
    """
    table = portion.table[rows].copy()
    held = [(portion.blocks[number], place) for number in numbers if (place := portion.places[number])]
    table["offset"] -= span.start
    first = held[0][0]
    if isinstance(first.raw, Ros1Framing):
        starts = np.concatenate([mine for _, place in held for _, _, mine in place.moves])
        starts.sort()
        raw: Framing = Ros1Framing(first.raw.codec, starts - span.start)
    else:
        raw = McapFraming(first.raw.codec)
    return Block(data, table, raw, added, part=first.part)


def assemble(overlay: Path, source: Path, target: Path, container: BagContainer) -> int:
    """Write the original with the overlay's messages in place of its own; return the number of replaced messages.

    overlay : MCAP with the modified topics of a run
    source : the bag that it was made from
    target : whole bag to write
    container : how bags are read and written

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
            raise BatchError(f"{overlay}: has topics that {source} lacks; name the input it was made from")
        stream = _Messages(changed, overlay)
        merged = _Merged(reader, wanted, stream, source)
        if output.reader is not reader:
            # what is converted is the merged bag
            output = container.target(target, merged)
        with container.writer(target, output) as writer:
            for block in (merged if output.reader is reader else output.reader).blocks():
                writer.write(block)
            stream.require_end(source)
            if stream.provenance is not None:
                writer.provenance("odomcorrupt", stream.provenance)
    return merged.replaced


class _Merged(ReaderView):
    """The original with the overlay's messages in place of its own.

    replaced : number of replaced messages
    """

    def __init__(self, reader: BagReader, wanted: set[int], stream: _Messages, source: Path) -> None:
        super().__init__(reader)
        self._wanted, self._stream, self._source = wanted, stream, source
        self.replaced = 0

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
            if isinstance(block.raw, McapFraming) and block.raw.opcode == Op.METADATA:
                self.provenance = metadata_of(block)
            for channel, log_ns, offset, length in block.table.tolist():
                yield self._reader.channels[channel].topic, log_ns, block.data.data[offset : offset + length]

    def take(self) -> tuple[str, int, memoryview]:
        """Return the next message: topic, log time, data; an empty one at the end."""
        return next(self._stream, ("", 0, memoryview(b"")))

    def require_end(self, source: Path) -> None:
        """Raise BatchError where the overlay has messages that its original lacks."""
        left = sum(1 for _ in self._stream)
        if left:
            raise BatchError(f"{self._path}: has {left} more messages than {source}; name the input it was made from")
