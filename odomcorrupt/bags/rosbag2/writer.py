"""ROS 2 bag writer: a directory with the input's files and an updated metadata.yaml."""

from __future__ import annotations

import os
import shutil
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Self

from odomcorrupt.bags.block import Block, Channel, PartFraming
from odomcorrupt.bags.definition import retyped
from odomcorrupt.bags.mcap.reader import McapReader
from odomcorrupt.bags.mcap.writer import McapWriter
from odomcorrupt.bags.output import Output
from odomcorrupt.bags.placement import beside, place, sweep
from odomcorrupt.bags.rosbag2.metadata import Addition, TopicInfo, add_provenance, added, edited, generated
from odomcorrupt.bags.rosbag2.sqlite_reader import SqliteReader
from odomcorrupt.bags.rosbag2.sqlite_writer import SqliteWriter
from odomcorrupt.errors import BagError

if TYPE_CHECKING:
    from collections.abc import Mapping
    from types import TracebackType

    from odomcorrupt.bags.definition import Definition
    from odomcorrupt.bags.pipeline import Workers
    from odomcorrupt.bags.rosbag2.reader import Rosbag2Reader

__all__ = ["Rosbag2Writer"]


class Rosbag2Writer:
    """A directory being written under a temporary name, with the files of the reader's bag."""

    def __init__(
        self,
        path: Path,
        reader: Rosbag2Reader,
        codec: str | None = None,
        level: int | None = None,
        *,
        overwrite: bool = False,
        workers: Workers | None = None,
    ) -> None:
        self._workers = workers
        self.keeps_rest = all(isinstance(part, SqliteReader) and not part.damaged for part in reader.parts)
        self._path = Path(os.path.realpath(path))
        self._partial = beside(self._path)
        self._overwrite = overwrite
        self._reader = reader
        self._codec = codec
        self._level = level
        self._stack = ExitStack()
        self._writers: list[SqliteWriter | McapWriter] = []
        self._additions = [Addition() for _ in reader.parts]
        self._fresh: dict[int, tuple[Channel, Definition]] = {}
        self._own = [{number: own for own, number in reversed(numbers.items())} for numbers in reader.numbers]
        self._provenance: list[tuple[str, Mapping[str, str]]] = []

    @property
    def files(self) -> list[SqliteWriter | McapWriter]:
        """The writers of the files, once the bag is open."""
        return self._writers

    def add_channel(self, topic: str, msgtype: str, like: Channel) -> Channel:
        """Add a topic with the encoding and QoS of another one; return it with a new id."""
        definition = self._reader.definition(like)
        if msgtype != like.msgtype:
            definition = retyped(self._reader, msgtype, like.encoding, definition)
        channel = Channel(max([*self._reader.channels, *self._fresh], default=0) + 1, topic, msgtype, like.encoding)
        self._fresh[channel.id] = (channel, definition)
        return channel

    def provenance(self, name: str, items: Mapping[str, str]) -> None:
        """Write provenance metadata to custom_data and to the first file."""
        self._provenance.append((name, items))
        self._writers[0].provenance(name, items)

    def write(self, block: Block) -> None:
        """Write a block to the file it came from, its added messages last."""
        part, own = (block.raw.part, block.raw.own) if isinstance(block.raw, PartFraming) else (0, block)
        messages = [replace(one, channel=self._written_id(part, one.channel)) for one in block.added]
        for one in block.added:
            self._additions[part].note(self._described(one.channel).name, one.log_ns)
        self._writers[part].write(Block(block.data, own.table, own.raw, messages, own.ends))

    def settle(self) -> None:
        """Wait until all blocks passed to `write` are written and may change."""
        for writer in self._writers:
            writer.settle()

    def _described(self, channel: int) -> TopicInfo:
        if channel in self._fresh:
            known, definition = self._fresh[channel]
        elif channel in self._reader.channels:
            known = self._reader.channels[channel]
            definition = self._reader.definition(known)
        else:
            raise BagError(f"channel {channel}: is neither in the bag nor added to it")
        return TopicInfo(known.topic, known.encoding, definition)

    def _written_id(self, part: int, channel: int) -> int:
        """Return a channel's id in a file; the channel is added at its first use."""
        if channel not in self._own[part]:
            info = self._described(channel)
            msgtype = (self._fresh[channel][0] if channel in self._fresh else self._reader.channels[channel]).msgtype
            made = self._writers[part].add_defined(info.name, msgtype, info.encoding, info.definition)
            self._own[part][channel] = made.id
        return self._own[part][channel]

    def _metadata(self) -> str:
        """Return the text of metadata.yaml: the input's where nothing was added."""
        text = self._reader.metadata
        if text is None or self._reader.losses:
            topics = [self._described(one) for one in [*self._reader.channels, *self._fresh]]
            parts = [writer.contents() for writer in self._writers]
            text = generated(self._reader.kind, parts, topics, "")
        elif any(addition.counts for addition in self._additions):
            topics_by_name = {info.name: info for info in map(self._described, [*self._reader.channels, *self._fresh])}
            text = edited(text, lambda info: added(info, self._additions, topics_by_name))
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
                for part in self._reader.parts:
                    writer = self._writer(part)
                    stack.enter_context(writer)
                    self._writers.append(writer)
                self._stack = stack.pop_all()
        except BaseException:
            shutil.rmtree(self._partial)
            raise
        return self

    def _writer(self, part: McapReader | SqliteReader) -> SqliteWriter | McapWriter:
        target = self._partial / part.paths[0].name
        if isinstance(part, McapReader):
            return McapWriter(Output(target), part, self._codec, self._level, workers=self._workers)
        alone = len(self._reader.parts) == 1 and self._workers is not None and self._workers.threads > 1
        return SqliteWriter(target, part, copying_thread=alone)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if kind is not None:
                self._stack.__exit__(kind, error, trace)
                return
            with self._stack:
                (self._partial / "metadata.yaml").write_text(self._metadata(), encoding="utf8")
            place(self._partial, self._path, overwrite=self._overwrite)
        finally:
            if self._partial.exists():
                shutil.rmtree(self._partial)
