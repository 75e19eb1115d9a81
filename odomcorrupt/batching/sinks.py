"""Where one run of a batch goes: a whole bag, only what changed, or its path."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, Protocol, Self

import odomcorrupt
from odomcorrupt.bags.block import Block, Message, PartFraming
from odomcorrupt.bags.mcap.chunk import McapFraming
from odomcorrupt.bags.mcap.writer import McapWriter
from odomcorrupt.bags.open import open_writer
from odomcorrupt.bags.output import Output
from odomcorrupt.model.model_file import format_model

if TYPE_CHECKING:
    from collections.abc import Sequence
    from types import TracebackType

    import numpy as np
    from numpy.typing import NDArray

    from odomcorrupt.bags.block import BagReader, BagWriter, Channel
    from odomcorrupt.bags.pipeline import Workers
    from odomcorrupt.batching.job import Job
    from odomcorrupt.batching.patch_batch import Portion

__all__ = ["Added", "BagSink", "FullSink", "MultiSink", "OverlaySink", "Sink", "provenance"]


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
    own = {"version": odomcorrupt.__version__, "seed": str(job.seed), "run": str(run), "model": model}
    return own if job.condition is None else own | job.condition.provenance()


class BagSink:
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


class MultiSink:
    """The writers of all runs, as one to add channels to.

    keeps_rest : whether messages that do not change need not be read: their files have them, or nobody writes them
    """

    def __init__(self, writers: Sequence[BagWriter]) -> None:
        self._writers = writers
        self.keeps_rest = all(writer.keeps_rest for writer in writers)

    def add_channel(self, topic: str, msgtype: str, like: Channel) -> Channel:
        """Add a channel to every run; its id is the same in all of them."""
        added = [writer.add_channel(topic, msgtype, like) for writer in self._writers]
        return added[0]


class FullSink(BagSink):
    """A whole bag, the same bytes as of a run made alone."""

    def __init__(self, job: Job, run: int, reader: BagReader, workers: Workers) -> None:
        c = job.container
        writer = open_writer(
            job.path_of(run), reader, overwrite=True, compression=c.compression, level=c.level, workers=workers
        )
        super().__init__(job, run, writer)

    def put(self, portion: Portion, data: NDArray[np.uint8], added: Added = None) -> None:
        """Write the blocks, which the next run patches in its turn."""
        for number in range(len(portion.blocks)):
            block = portion.put_back(number, data)
            if added is not None:
                block = replace(block, added=block.added + added[number])
            self._writer.write(block)
        self._writer.settle()


class _Foreign:
    """A reader as if it were of another format, so that a writer gives ids and definitions anew."""

    complete = True

    def __init__(self, reader: BagReader) -> None:
        ros1 = all(channel.encoding == "ros1" for channel in reader.channels.values())
        self.kind = "ros1" if ros1 else reader.kind
        self.name, self.paths, self.channels = reader.name, reader.paths, reader.channels
        self.definition = reader.definition


class OverlaySink(BagSink):
    """An MCAP of the topics that changed, whole."""

    def __init__(self, job: Job, run: int, reader: BagReader) -> None:
        c = job.container
        foreign: Any = _Foreign(reader)
        codec = None if c.compression == "bz2" else c.compression
        output = Output(job.path_of(run), overwrite=True)
        super().__init__(job, run, McapWriter(output, foreign, codec, c.level, whole=False))
        self._native = _is_mcap(reader)

    def put(self, portion: Portion, data: NDArray[np.uint8], _added: Added = None) -> None:
        """Write what changed."""
        if len(portion.table):
            raw = McapFraming("chunk", "zstd") if self._native else None
            own = Block(data, portion.table, raw)
            self._writer.write(Block(data, portion.table, PartFraming(0, own)))


def _is_mcap(reader: BagReader) -> bool:
    return reader.kind == "mcap"
