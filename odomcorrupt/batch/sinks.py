"""Where one run of a batch goes: a whole bag, only what changed, or its path."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, Protocol, Self

import numpy as np

import odomcorrupt
from odomcorrupt.bags.block import Block, Message, PartFraming
from odomcorrupt.bags.codecs import compress, compress_for_ros1
from odomcorrupt.bags.mcap.chunk import McapFraming
from odomcorrupt.bags.mcap.writer import McapWriter
from odomcorrupt.bags.open import open_writer
from odomcorrupt.bags.output import Output
from odomcorrupt.bags.ros1.chunk import Ros1Framing
from odomcorrupt.bags.ros1.writer import Ros1Writer
from odomcorrupt.modelfile import format_model

if TYPE_CHECKING:
    from collections.abc import Sequence
    from types import TracebackType

    from numpy.typing import NDArray

    from odomcorrupt.bags.block import BagReader, BagWriter, Channel
    from odomcorrupt.batch.job import Job
    from odomcorrupt.batch.portion import Place, Portion

__all__ = ["Fan", "FullSink", "OverlaySink", "Rests", "Sink", "SplitSink", "provenance"]


Added = list[list[Message]] | None


class Sink(Protocol):
    """The output of one run; it appears when its context ends without an error."""

    def put(self, portion: Portion, data: NDArray[np.uint8], added: Added = None) -> None:
        """Take a portion, and the portion's data (size,) as the run has patched it.

        added : for each block messages of this run alone, behind those that all runs add
        """

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


def provenance(job: Job, run: int) -> dict[str, str]:
    """Return what a run's bag says of how it came about."""
    model = format_model(job.model_of(run))
    return {"version": odomcorrupt.__version__, "seed": str(job.seed), "run": str(run), "model": model}


class _BagSink:
    """A run that is written as a bag; the model is said in it where the format has a place."""

    def __init__(self, job: Job, run: int, writer: Any) -> None:
        self._job, self._run = job, run
        self._writer = writer

    @property
    def writer(self) -> BagWriter:
        """What writes the bag."""
        writer: BagWriter = self._writer
        return writer

    def __enter__(self) -> Self:
        self._writer.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None:
            try:
                self._writer.provenance("odomcorrupt", provenance(self._job, self._run))
            except BaseException as failed:
                self._writer.__exit__(type(failed), failed, failed.__traceback__)
                raise
        self._writer.__exit__(kind, error, trace)


class Fan:
    """The writers of all runs, as one to add channels to."""

    def __init__(self, writers: Sequence[BagWriter]) -> None:
        self._writers = writers

    def add_channel(self, topic: str, msgtype: str, like: Channel) -> Channel:
        """Add a channel to every run; its id is the same in all of them."""
        return [writer.add_channel(topic, msgtype, like) for writer in self._writers][0]


class FullSink(_BagSink):
    """A whole bag, the same bytes as of a run made alone."""

    def __init__(self, job: Job, run: int, reader: BagReader) -> None:
        c = job.container
        path = job.path_of(run)
        super().__init__(job, run, open_writer(path, reader, overwrite=True, compression=c.compression, level=c.level))

    def put(self, portion: Portion, data: NDArray[np.uint8], added: Added = None) -> None:
        """Write the blocks."""
        for number in range(len(portion.blocks)):
            block = portion.put_back(number, data)
            if added is not None:
                block = replace(block, added=block.added + added[number])
            self._writer.write(block)


class Rests:
    """What is left of a portion's blocks without the messages that change, cut out and compressed once for all runs."""

    def __init__(self) -> None:
        self._portion: Portion | None = None
        self._blocks: list[Block] = []
        self._packed: dict[tuple[int, int, str], bytes | memoryview] = {}

    def of(self, portion: Portion) -> list[Block]:
        """Return the blocks of a portion."""
        if self._portion is not portion:
            self._portion = portion
            self._packed.clear()
            self._blocks = [
                block if place is None else _without(block, place)
                for block, place in zip(portion.blocks, portion.places, strict=True)
            ]
        return self._blocks

    def compress(self, codec: str, data: NDArray[np.uint8], level: int | None) -> bytes | memoryview:
        """Compress for an MCAP, what all runs share once."""
        return self._once(compress, codec, data, level)

    def compress_for_ros1(self, codec: str, data: NDArray[np.uint8], level: int | None) -> bytes | memoryview:
        """Compress for a ROS 1 bag, what all runs share once."""
        return self._once(compress_for_ros1, codec, data, level)

    def _once(self, how: Any, codec: str, data: NDArray[np.uint8], level: int | None) -> bytes | memoryview:
        # a block of several chunks is packed chunk by chunk
        if not any(np.may_share_memory(block.data, data) for block in self._blocks):
            fresh: bytes | memoryview = how(codec, data, level)
            return fresh
        key = (data.__array_interface__["data"][0], data.size, codec)
        if key not in self._packed:
            self._packed[key] = how(codec, data, level)
        return self._packed[key]


def _without(block: Block, place: Place) -> Block:
    """Return a block without some of its messages; what is no message stays."""
    edge = np.zeros(block.data.size + 1, dtype=np.int8)
    edge[place.begins] += 1
    edge[place.ends] -= 1  # records that touch cancel each other out
    kept = np.cumsum(edge[:-1], dtype=np.int8) == 0
    gone_before = np.concatenate(([0], np.cumsum(place.ends - place.begins)))
    rest = np.ones(len(block.table), dtype=bool)
    rest[place.rows] = False
    table = block.table[rest].copy()
    table["offset"] -= gone_before[np.searchsorted(place.begins, table["offset"])]
    framing = block.raw
    if isinstance(framing, Ros1Framing):
        starts = framing.starts[rest]
        starts = starts - gone_before[np.searchsorted(place.begins, starts)]
        framing = Ros1Framing(framing.codec, starts)
    ends = np.array(block.ends, dtype=np.int64)
    ends -= gone_before[np.searchsorted(place.begins, ends)]
    return Block(block.data[kept], table, framing, ends=tuple(ends.tolist()))


class SplitSink(_BagSink):
    """A whole bag with the changed messages in chunks of their own."""

    def __init__(self, job: Job, run: int, reader: BagReader, rests: Rests) -> None:
        c = job.container
        path = job.path_of(run)
        writer = open_writer(path, reader, overwrite=True, compression=c.compression, level=c.level)
        if isinstance(writer, McapWriter):
            writer.pack = rests.compress
        elif isinstance(writer, Ros1Writer):
            writer.pack = rests.compress_for_ros1
        super().__init__(job, run, writer)
        self._rests = rests

    def put(self, portion: Portion, data: NDArray[np.uint8], added: Added = None) -> None:
        """Write what stays, and behind it what changed and what is added."""
        rests = self._rests.of(portion)
        for block in rests:
            self._writer.write(block)
        if not len(portion.table):
            return
        more = [one for block in portion.blocks for one in block.added]
        more += [one for messages in added or [] for one in messages]
        first = next(b for b, place in zip(portion.blocks, portion.places, strict=True) if place is not None)
        if isinstance(first.raw, Ros1Framing):
            starts = np.concatenate([mine for p in portion.places if p is not None for _, _, mine in p.moves])
            starts.sort()
            self._writer.write(Block(data, portion.table, Ros1Framing(first.raw.codec, starts), more))
        else:
            self._writer.write(Block(data, portion.table, McapFraming("chunk", first.raw.codec), more))


class _Foreign:
    """A reader as if it were of another format, so that a writer gives ids and definitions anew."""

    complete = True

    def __init__(self, reader: BagReader) -> None:
        ros1 = all(channel.encoding == "ros1" for channel in reader.channels.values())
        self.kind = "ros1" if ros1 else reader.kind
        self.name, self.paths, self.channels = reader.name, reader.paths, reader.channels
        self.definition = reader.definition


class OverlaySink(_BagSink):
    """An MCAP of the topics that changed, whole."""

    def __init__(self, job: Job, run: int, reader: BagReader) -> None:
        c = job.container
        foreign: Any = _Foreign(reader)
        codec = None if c.compression == "bz2" else c.compression
        super().__init__(job, run, McapWriter(Output(job.path_of(run)), foreign, codec, c.level))
        self._native = _is_mcap(reader)

    def put(self, portion: Portion, data: NDArray[np.uint8], _added: Added = None) -> None:
        """Write what changed."""
        if len(portion.table):
            raw = McapFraming("chunk", "zstd") if self._native else None
            own = Block(data, portion.table, raw)
            self._writer.write(Block(data, portion.table, PartFraming(0, own)))


def _is_mcap(reader: BagReader) -> bool:
    return reader.kind == "mcap"
