"""Outputs of a run of a batch: a whole bag, an overlay of the changed topics, or its path."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, Protocol, Self

import odomcorrupt
from odomcorrupt.bags.block import Block, Message, PartFraming
from odomcorrupt.bags.mcap.chunk import McapFraming
from odomcorrupt.bags.mcap.writer import McapWriter
from odomcorrupt.bags.open import open_writer
from odomcorrupt.bags.output import Output
from odomcorrupt.bags.rosbag2.writer import Foreign
from odomcorrupt.model.model_file import format_model

if TYPE_CHECKING:
    from collections.abc import Sequence
    from types import TracebackType

    import numpy as np
    from numpy.typing import NDArray

    from odomcorrupt.bags.block import BagReader, BagWriter, Channel
    from odomcorrupt.bags.open import Target
    from odomcorrupt.bags.pipeline import Workers
    from odomcorrupt.batching.job import Job
    from odomcorrupt.batching.patch_batch import Portion

__all__ = ["Added", "BagSink", "FullSink", "MultiSink", "OverlaySink", "Sink", "provenance"]


Added = list[list[Message]] | None


class Sink(Protocol):
    """The output of one run; it appears when its context ends without an error."""

    def put(self, portion: Portion, data: NDArray[np.uint8], added: Added = None) -> None:
        """Write a portion, given its data (size,) as patched by the run.

        added : for each block, messages of this run alone, appended after those of all runs
        """

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


def provenance(job: Job, run: int) -> dict[str, str]:
    """Return the metadata of a run's bag: seed, run, version, model."""
    model = format_model(job.model_of(run))
    own = {"version": odomcorrupt.__version__, "seed": str(job.seed), "run": str(run), "model": model}
    return own if job.condition is None else own | job.condition.provenance()


class BagSink:
    """A run written as a bag, with its model in the metadata where the format has any."""

    def __init__(self, job: Job, run: int, writer: Any) -> None:
        self._job, self._run = job, run
        self._writer = writer

    @property
    def writer(self) -> BagWriter:
        """Writer of the bag."""
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
    """Writers of all runs, addressed as one to add channels.

    keeps_rest : whether unchanged messages need not be read: the file is copied, or they are not written
    """

    def __init__(self, writers: Sequence[BagWriter]) -> None:
        self._writers = writers
        self.keeps_rest = all(writer.keeps_rest for writer in writers)

    def add_channel(self, topic: str, msgtype: str, like: Channel) -> Channel:
        """Add a channel to every run; its id is the same in all of them."""
        added = [writer.add_channel(topic, msgtype, like) for writer in self._writers]
        return added[0]


class FullSink(BagSink):
    """A whole bag, byte-identical to that of a single run."""

    def __init__(self, job: Job, run: int, output: Target, workers: Workers) -> None:
        c = job.container
        writer = open_writer(
            job.path_of(run),
            output.reader,
            overwrite=True,
            compression=c.compression,
            level=c.level,
            workers=workers,
            form=output.form,
        )
        super().__init__(job, run, writer)

    def put(self, portion: Portion, data: NDArray[np.uint8], added: Added = None) -> None:
        """Write the blocks; the next run patches the same ones."""
        for number in range(len(portion.blocks)):
            block = portion.put_back(number, data)
            if added is not None:
                block = replace(block, added=block.added + added[number])
            self._writer.write(block)
        self._writer.settle()


class OverlaySink(BagSink):
    """An MCAP with all messages of the changed topics."""

    def __init__(self, job: Job, run: int, reader: BagReader) -> None:
        c = job.container
        foreign: Any = Foreign(reader)
        codec = None if c.compression in ("bz2", "file", "message") else c.compression
        output = Output(job.path_of(run), overwrite=True)
        super().__init__(job, run, McapWriter(output, foreign, codec, c.level, whole=False))
        self._native = _is_mcap(reader)

    def put(self, portion: Portion, data: NDArray[np.uint8], _added: Added = None) -> None:
        """Write the changed topics."""
        if len(portion.table):
            raw = McapFraming("chunk", "zstd") if self._native else None
            own = Block(data, portion.table, raw)
            self._writer.write(Block(data, portion.table, PartFraming(0, own)))


def _is_mcap(reader: BagReader) -> bool:
    """Whether blocks hold the records of an MCAP, which bare messages decompressed one by one are not."""
    return reader.kind == "mcap" and getattr(reader, "mode", "none") != "message"
