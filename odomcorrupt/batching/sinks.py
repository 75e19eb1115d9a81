"""Outputs of a run of a batch: a whole bag, an overlay of the changed topics, or its path as TUM and npz."""

from __future__ import annotations

import io
import zipfile
from abc import ABC, abstractmethod
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple, Self

import numpy as np

from odomcorrupt.bags.block import BARE, Block, Message
from odomcorrupt.bags.mcap.chunk import McapFraming
from odomcorrupt.bags.mcap.writer import McapWriter
from odomcorrupt.bags.output import Output, OutputContext
from odomcorrupt.corruption.run import provenance
from odomcorrupt.geometry.se2 import yaw_from_quaternion
from odomcorrupt.input_files import open_input

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path
    from types import TracebackType

    from numpy.typing import NDArray

    from odomcorrupt.bags.block import BagReader, BagWriter, Channel
    from odomcorrupt.bags.open import Target
    from odomcorrupt.bags.pipeline import Workers
    from odomcorrupt.batching.job import Job
    from odomcorrupt.batching.patch_batch import Portion
    from odomcorrupt.corruption.path import PathSamples
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.model.motion_model import MotionModel

_LINE = "%d.%09d %.9f %.9f 0 0 0 %.12f %.12f\n"


class TumPath(NamedTuple):
    """A path: stamps_ns (n,), xyt (n, 3) in metres and radians."""

    stamps_ns: NDArray[np.int64]
    xyt: Array


def format_tum(stamps_ns: NDArray[np.int64], xyt: Array) -> bytes:
    """Return TUM lines (time, position, unit quaternion) of planar poses xyt (n, 3), metres and radians."""
    seconds, rest = np.divmod(stamps_ns, 1_000_000_000)
    half = xyt[:, 2] / 2.0
    columns = (seconds, rest, xyt[:, 0], xyt[:, 1], np.sin(half), np.cos(half))
    values = [value for row in zip(*(column.tolist() for column in columns), strict=True) for value in row]
    return (_LINE * len(stamps_ns) % tuple(values)).encode()


def read_tum(path: Path) -> TumPath:
    """Return the planar poses of a TUM file, with stamps to the nanosecond."""
    with open_input(path) as stream:
        text = stream.read()
    stamps = [line.split(b" ", 1)[0] for line in text.splitlines()]
    numbers = np.loadtxt(io.BytesIO(text), ndmin=2)
    whole = np.array([int(stamp.replace(b".", b"")) for stamp in stamps], dtype=np.int64)
    return TumPath(whole, np.column_stack((numbers[:, 1:3], yaw_from_quaternion(numbers[:, 4:8]))))


class TumSink(OutputContext):
    """TUM file of one run's path, or without a model of the clean path; clock effects shift the stamps as in a bag."""

    def __init__(self, path: Path, model: MotionModel | None) -> None:
        super().__init__(Output(path, overwrite=True))
        self._clean = model is None
        self._clocks = () if model is None else tuple(e for e in model.effects if e.clock and e.acts)
        self._waiting: list[PathSamples] = []

    def restart(self) -> None:
        """Do nothing: a TUM file has no stretches."""

    def add(self, samples: PathSamples) -> None:
        """Take the next part of the path."""
        self._waiting.append(samples)

    def write(self, portion: Portion, _data: NDArray[np.uint8], _added: object = None) -> None:
        """Write the path so far."""
        for samples in self._waiting:
            xyt = samples.clean_xyt if self._clean else samples.clean_xyt + samples.error_xyt
            t_s = (samples.stamps_ns - portion.first_ns) * np.float64(1e-9)
            shift_s = sum((effect.stamp_shift_s(t_s) for effect in self._clocks), start=np.zeros(len(samples)))
            stamps_ns = samples.stamps_ns + np.rint(shift_s * 1e9).astype(np.int64)
            self._output.write(format_tum(stamps_ns, xyt))
        self._waiting.clear()


def write_npz(path: Path, clean: TumPath, runs: Sequence[int], files: Sequence[Path]) -> None:
    """Write all paths of a batch to an npz file, with one run in memory at a time.

    Arrays: runs (k,), stamps_ns (n,), clean_xyt (n, 3), xyt (k, n, 3), metres and radians.

    path : file to write
    clean : path without noise
    runs : numbers of the runs
    files : their TUM files, in the same order
    """
    output = Output(path, overwrite=True)
    try:
        output.open()
        with zipfile.ZipFile(_OutputStream(output), "w", zipfile.ZIP_STORED) as archive:
            for name, array in (("runs", np.array(runs)), ("stamps_ns", clean.stamps_ns), ("clean_xyt", clean.xyt)):
                with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                    np.lib.format.write_array(member, np.ascontiguousarray(array), allow_pickle=False)
            with archive.open("xyt.npy", "w", force_zip64=True) as member:
                shape = (len(files), *clean.xyt.shape)
                head = {"descr": "<f8", "fortran_order": False, "shape": shape}
                np.lib.format.write_array_header_2_0(member, head)
                for file in files:
                    member.write(np.ascontiguousarray(read_tum(file).xyt, dtype="<f8").tobytes())
        output.commit()
    finally:
        output.discard()


class _OutputStream(io.RawIOBase):
    """An output as a stream without seeking, for zip files."""

    def __init__(self, output: Output) -> None:
        self._output = output

    def writable(self) -> bool:
        return True

    def write(self, data: object, /) -> int:
        view = memoryview(data)  # type: ignore[arg-type]  # zipfile passes bytes
        self._output.write(view)
        return len(view)


Added = list[list[Message]] | None


class BagSink(ABC):
    """A run written as a bag, with its model in the metadata where the format has any."""

    def __init__(self, job: Job, run: int, writer: Any) -> None:
        self._job, self._run = job, run
        self._writer = writer

    @property
    def writer(self) -> BagWriter:
        """Writer of the bag."""
        return self._writer

    @property
    def crc(self) -> int | None:
        """CRC-32 of the bag's file after the context's end; None for a directory, sqlite3 and ROS 1."""
        return self._writer.crc if isinstance(self._writer, OutputContext) else None

    @abstractmethod
    def write(self, portion: Portion, data: NDArray[np.uint8], added: Added = None) -> None:
        """Write a portion, given its data (size,) as patched by the run.

        added : for each block, messages of this run alone, appended after those of all runs
        """

    def __enter__(self) -> Self:
        self._writer.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None:
            try:
                batch = self._job.batch
                own = provenance(self._job.model_of(self._run), seed=batch.seed, run=self._run)
                within = {} if batch.condition is None else batch.condition.provenance()
                self._writer.provenance("odomcorrupt", own | within)
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
        self.keeps_rest = all(writer.keeps_rest and not isinstance(writer, OutputContext) for writer in writers)

    def add_channel(self, topic: str, msgtype: str, like: Channel) -> Channel:
        """Add a channel to every run; its id is the same in all of them."""
        added = [writer.add_channel(topic, msgtype, like) for writer in self._writers]
        return added[0]


def bag_writer(job: Job, run: int, output: Target, workers: Workers | None = None) -> Any:
    """Return the writer of a run's whole bag, which compresses in `workers`."""
    return replace(job.batch.container, overwrite=True).writer(job.path_of(run), output, workers)


class FullSink(BagSink):
    """A whole bag, byte-identical to that of a single run."""

    def __init__(self, job: Job, run: int, output: Target, workers: Workers) -> None:
        super().__init__(job, run, bag_writer(job, run, output, workers))

    def write(self, portion: Portion, data: NDArray[np.uint8], added: Added = None) -> None:
        """Write the blocks; the next run patches the same ones."""
        for number in range(len(portion.blocks)):
            block = portion.patched_block(number, data)
            if added is not None:
                block = replace(block, added=block.added + added[number])
            self._writer.write(block)
        self._writer.settle()


class OverlaySink(BagSink):
    """An MCAP with all messages of the changed topics."""

    def __init__(self, job: Job, run: int, reader: BagReader) -> None:
        c = job.batch.container
        codec = None if c.compression in ("bz2", "file", "message") else c.compression
        output = Output(job.path_of(run), overwrite=True)
        super().__init__(job, run, McapWriter(output, reader, codec, c.level, native=False, whole=False))
        # blocks hold the records of an MCAP, which bare messages decompressed one by one are not
        self._native = reader.kind == "mcap" and getattr(reader, "mode", "none") != "message"

    def write(self, portion: Portion, data: NDArray[np.uint8], _added: Added = None) -> None:
        """Write the changed topics."""
        if len(portion.table):
            self._writer.write(Block(data, portion.table, McapFraming() if self._native else BARE))
