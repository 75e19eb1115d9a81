"""Outputs of a run of a batch: a whole bag, an overlay of the changed topics, or its path; and assembly."""

from __future__ import annotations

import io
import zipfile
from abc import ABC, abstractmethod
from dataclasses import replace
from functools import partial
from itertools import groupby
from typing import TYPE_CHECKING, Any, NamedTuple, Self

import numpy as np
from mcap.opcode import Opcode as Op

from odomcorrupt.bags.block import BARE, Block, Message, ReaderView, without
from odomcorrupt.bags.mcap.chunk import McapFraming
from odomcorrupt.bags.mcap.writer import McapWriter
from odomcorrupt.bags.open import open_reader
from odomcorrupt.bags.output import Output, OutputContext
from odomcorrupt.bags.provenance import metadata_of
from odomcorrupt.bags.ros1.chunk import Ros1Framing
from odomcorrupt.corruption.run import provenance
from odomcorrupt.errors import BatchError
from odomcorrupt.geometry.se2 import yaw_from_quaternion
from odomcorrupt.input_files import open_input

if TYPE_CHECKING:
    from collections.abc import Container, Iterator, Sequence
    from pathlib import Path
    from types import TracebackType

    from numpy.typing import NDArray

    from odomcorrupt.bags.block import BagReader, BagWriter, Channel, Framing
    from odomcorrupt.bags.open import Target
    from odomcorrupt.bags.pipeline import Workers
    from odomcorrupt.batching.job import Job
    from odomcorrupt.batching.patch_batch import Portion
    from odomcorrupt.corruption.path import PathSamples
    from odomcorrupt.corruption.run import Container as BagContainer
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
    """A run written as a bag by a `writer`, with its model in the metadata where the format has any."""

    def __init__(self, job: Job, run: int, writer: BagWriter) -> None:
        self._job, self._run = job, run
        self.writer = writer

    @property
    def crc(self) -> int | None:
        """CRC-32 of the bag's file after the context's end; None for a directory, sqlite3 and ROS 1."""
        return self.writer.crc if isinstance(self.writer, OutputContext) else None

    @abstractmethod
    def write(self, portion: Portion, data: NDArray[np.uint8], added: Added = None) -> None:
        """Write a portion, given its data (size,) as patched by the run.

        added : for each block, messages of this run alone, appended after those of all runs
        """

    def __enter__(self) -> Self:
        self.writer.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None:
            try:
                batch = self._job.batch
                own = provenance(self._job.model_of(self._run), seed=batch.seed, run=self._run)
                within = {} if batch.condition is None else batch.condition.provenance()
                self.writer.provenance("odomcorrupt", own | within)
            except BaseException as failed:
                self.writer.__exit__(type(failed), failed, failed.__traceback__)
                raise
        self.writer.__exit__(kind, error, trace)


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
            self.writer.write(block)
        self.writer.settle()


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
            self.writer.write(Block(data, portion.table, McapFraming() if self._native else BARE))


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
                block if place is None else without(block, np.isin(np.arange(len(block.table)), place.rows))
                for block, place in zip(portion.blocks, portion.places, strict=True)
            ]
        return self._blocks

    def compress(self, how: Any, codec: str, data: NDArray[np.uint8], level: int | None) -> Any:
        """Return a chunk compressed as `how` does; data common to all runs is compressed once."""
        # a block of several chunks is compressed chunk by chunk
        key = (data.__array_interface__["data"][0], data.size, codec)
        if key in self._packed:
            return self._packed[key]
        chunk = how(codec, data, level)
        if any(np.may_share_memory(block.data, data) for block in self._blocks):
            self._packed[key] = chunk
        return chunk


class SplitSink(BagSink):
    """A whole bag with the changed messages in chunks of their own."""

    def __init__(self, job: Job, run: int, output: Target, rests: Rests) -> None:
        super().__init__(job, run, bag_writer(job, run, output))
        self._rests = rests

    def __enter__(self) -> Self:
        super().__enter__()
        for file in getattr(self.writer, "files", [self.writer]):
            if hasattr(file, "pack"):  # sqlite3 has no chunks
                file.pack = partial(self._rests.compress, file.pack)
        return self

    def write(self, portion: Portion, data: NDArray[np.uint8], added: Added = None) -> None:
        """Write the unchanged messages, then the changed and added ones."""
        blocks = self._rests.of(portion)
        first_row = first_byte = 0
        for _, numbers in groupby(range(len(blocks)), lambda number: portion.blocks[number].part):
            own = list(numbers)
            for number in own:
                self.writer.write(blocks[number])
            places = [place for number in own if (place := portion.places[number]) is not None]
            if not places:
                continue
            rows = slice(first_row, first_row + sum(len(place.rows) for place in places))
            size = sum(int((place.ends - place.begins).sum()) for place in places)
            more = [one for number in own for one in portion.blocks[number].added]
            more += [] if added is None else [one for number in own for one in added[number]]
            span = slice(first_byte, first_byte + size)
            self.writer.write(_changed(portion, own, rows, span, data[span], more))
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


def assemble_overlay(overlay: Path, source: Path, target: Path, container: BagContainer) -> int:
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
        replaced = 0

        def blocks(only: Container[int] | None) -> Iterator[Block]:
            nonlocal replaced
            for block in reader.blocks(only):
                replaced += _replace(block, reader, wanted, stream, source)
                yield block

        merged: Any = ReaderView(reader, blocks)
        if output.reader is not reader:
            # what is converted is the merged bag
            output = container.target(target, merged)
        with container.writer(target, output) as writer:
            for block in (merged if output.reader is reader else output.reader).blocks():
                writer.write(block)
            stream.require_end(source)
            if stream.provenance is not None:
                writer.provenance("odomcorrupt", stream.provenance)
    return replaced


def _replace(block: Block, reader: BagReader, wanted: set[int], stream: _Messages, source: Path) -> int:
    """Put the overlay's messages in place of a block's own; return their number."""
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
