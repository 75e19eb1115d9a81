"""ROS 2 bag writer: a directory with the input's files and an updated metadata.yaml."""

from __future__ import annotations

import os
import shutil
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Self

from odomcorrupt.bags.block import with_ids
from odomcorrupt.bags.definition import OutputChannels, retyped
from odomcorrupt.bags.mcap.writer import McapWriter
from odomcorrupt.bags.output import Output, beside, place, sweep
from odomcorrupt.bags.parts import PartsReader
from odomcorrupt.bags.rosbag2.compression import SUFFIXES, compress_file, compressed_block
from odomcorrupt.bags.rosbag2.metadata import TopicInfo, add_provenance, count, edited, generated
from odomcorrupt.bags.rosbag2.sqlite_reader import SqliteReader
from odomcorrupt.bags.rosbag2.sqlite_writer import NewSqliteWriter, SqliteWriter
from odomcorrupt.errors import BagError

if TYPE_CHECKING:
    from collections.abc import Mapping
    from types import TracebackType

    from odomcorrupt.bags.block import BagReader, Block, Channel, Kind
    from odomcorrupt.bags.pipeline import Workers
    from odomcorrupt.bags.rosbag2.compression import Mode


PartWriter = SqliteWriter | NewSqliteWriter | McapWriter


class Rosbag2Writer:
    """A directory being written under a temporary name, with the files of the reader's bag or a single new one.

    kind : storage of the files; None is that of the input
    codec : compression of the chunks of MCAP files; None keeps each chunk's own
    mode : what else is compressed; None is what the input had
    level : compression level; None is the default of the codec
    """

    def __init__(
        self, path: Path, reader: BagReader, codec: str | None = None, level: int | None = None, *, kind: Kind | None =
        None, mode: Mode | None = None, overwrite: bool = False, workers: Workers | None = None,
    ) -> None:  # fmt: skip
        self._workers = workers
        self._kind: Kind = reader.kind if kind is None else kind
        self._path = Path(os.path.realpath(path))
        self._partial = beside(self._path)
        self._overwrite = overwrite
        self._reader = reader
        self._codec = codec
        self._level = level
        self._stack = ExitStack()
        self._writers: list[PartWriter] = []
        self._channels = OutputChannels(reader, (1 << 32) - 1)
        self._provenance: list[tuple[str, Mapping[str, str]]] = []
        self._old = reader if isinstance(reader, PartsReader) else None
        self._mode: Mode = (self._old.mode if self._old else "none") if mode is None else mode
        self._parts: list[BagReader] = [reader]
        self._own: list[dict[int, int]] = [{}]
        if self._old is not None:
            self._parts = [*self._old.parts]
            self._own = [{number: own for own, number in numbers.items()} for numbers in self._old.numbers]
        self._native = self._mode != "message" and reader.kind == self._kind
        self.keeps_rest = self._native and all(
            isinstance(part, SqliteReader) and not part.damaged for part in self._parts
        )

    @property
    def files(self) -> list[PartWriter]:
        """The writers of the files, once the bag is open."""
        return self._writers

    def add_channel(self, topic: str, msgtype: str, like: Channel) -> Channel:
        """Add a topic with the encoding and QoS of another one; return it with a new id."""
        return self._channels.add(topic, msgtype, like.encoding, retyped(self._reader, msgtype, like))

    def provenance(self, name: str, items: Mapping[str, str]) -> None:
        """Write provenance metadata to custom_data and to the first file."""
        self._provenance.append((name, items))
        self._writers[0].provenance(name, items)

    def write(self, block: Block) -> None:
        """Write a block to the file it came from, its added messages last."""
        part, own = block.part, self._own[block.part]
        messages = [one._replace(channel=self._written_id(part, one.channel)) for one in block.added]
        table = with_ids(block.table, own.__getitem__) if part else block.table
        written = replace(block, table=table, added=messages, part=0)
        if self._mode == "message" and (len(table) or messages):
            written = compressed_block(written, self._level)
        self._writers[part].write(written)

    def settle(self) -> None:
        """Wait until all blocks passed to `write` are written and may change."""
        for writer in self._writers:
            writer.settle()

    def _written_id(self, part: int, number: int) -> int:
        """Return a channel's id in a file; the channel is added at its first use."""
        if self._old is None and number not in self._channels.added:
            return number
        if number not in self._own[part]:
            channel, definition = self._channels.described(number)
            made = self._writers[part].add_channel(channel.topic, channel.msgtype, channel, definition)
            self._own[part][number] = made.id
        return self._own[part][number]

    def _metadata(self) -> str:
        """Return the text of metadata.yaml: the input's with the contents that were counted, or a new one."""
        described = [self._channels.described(one) for one in [*self._reader.channels, *self._channels.added]]
        topics = [TopicInfo(channel.topic, channel.encoding, definition) for channel, definition in described]
        suffix = SUFFIXES[0] if self._mode == "file" else ""
        found = [writer.contents() for writer in self._writers]
        parts = [part._replace(name=part.name + suffix) for part in found]
        text = None if self._old is None else self._old.metadata
        if text is None:
            text = generated(self._kind, parts, topics, self._mode)
        else:
            text = edited(text, lambda info: count(info, self._kind, parts, topics, self._mode, self._path.name))
        for name, items in self._provenance:
            text = edited(text, lambda info, name=name, items=items: add_provenance(info, name, items))  # type: ignore[misc]
        return text

    def __enter__(self) -> Self:
        try:
            sweep(self._path.parent, self._path.name)
            self._partial.mkdir()
        except OSError as error:
            raise BagError(f"{self._path}: cannot be written: {error.strerror}") from error
        try:
            with ExitStack() as stack:
                for part, name in zip(self._parts, self._names(), strict=True):
                    writer = self._writer(part, self._partial / name)
                    stack.enter_context(writer)
                    self._writers.append(writer)
                self._stack = stack.pop_all()
        except BaseException:
            shutil.rmtree(self._partial)
            raise
        return self

    def _names(self) -> list[str]:
        """Return the names of the files, uncompressed: those of the input's, or a new one."""
        suffix = ".mcap" if self._kind == "mcap" else ".db3"
        if self._old is None:
            return [f"{self._path.name}_0{suffix}"]
        plain = [path.with_suffix("") if path.suffix.lower() in SUFFIXES else path for path in self._old.paths[1:]]
        return [path.with_suffix(suffix).name for path in plain]

    def _writer(self, part: BagReader, target: Path) -> PartWriter:
        if self._kind == "mcap":
            codec = "none" if self._codec is None and self._mode != "none" and not self._native else self._codec
            level = self._level if self._mode == "none" else None
            return McapWriter(Output(target), part, codec, level, workers=self._workers, native=self._native)
        if self._native and isinstance(part, SqliteReader):
            beside = len(self._names()) == 1 and self._workers is not None and self._workers.threads > 1
            return SqliteWriter(target, part, copying_thread=beside)
        return NewSqliteWriter(target, part)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if kind is not None:
                self._stack.__exit__(kind, error, trace)
                return
            with self._stack:
                (self._partial / "metadata.yaml").write_text(self._metadata(), encoding="utf8")
            if self._mode == "file":
                for name in self._names():
                    compress_file(self._partial / name, self._level)
            place(self._partial, self._path, overwrite=self._overwrite)
        finally:
            if self._partial.exists():
                shutil.rmtree(self._partial)
