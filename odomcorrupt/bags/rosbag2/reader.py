"""ROS 2 bag reader for one or more files."""

from __future__ import annotations

from contextlib import ExitStack
from typing import TYPE_CHECKING, Self

import numpy as np

from odomcorrupt.bags import magic
from odomcorrupt.bags.block import Block, Channel, Kind, PartFraming
from odomcorrupt.bags.coalesce import joined
from odomcorrupt.bags.mcap.reader import McapReader
from odomcorrupt.bags.rosbag2.compression import UnpackedFiles, UnpackedMessages
from odomcorrupt.bags.rosbag2.parts import BagFiles, find_files
from odomcorrupt.bags.rosbag2.sqlite_reader import SqliteReader
from odomcorrupt.bags.source import Source
from odomcorrupt.errors import BagError

if TYPE_CHECKING:
    from collections.abc import Container, Iterator, Mapping
    from pathlib import Path
    from types import TracebackType

    from odomcorrupt.bags.definition import Definition
    from odomcorrupt.bags.rosbag2.compression import Mode

__all__ = ["Part", "Rosbag2Reader", "open_part"]

Part = SqliteReader | McapReader | UnpackedMessages


class Rosbag2Reader:
    """A directory, or a single sqlite3 file.

    metadata : text of metadata.yaml, or None without one
    mode : what of the bag is compressed; `parts` read it decompressed
    parts : readers of the files
    numbers : for each file, the bag's channel id by the file's channel id
    """

    complete = True

    def __init__(self, path: Path, *, recover: bool = False, threads: int = 1) -> None:
        self.name = str(path)
        found = find_files(path) if path.is_dir() else BagFiles([path], None, _mode_of(path))
        self.directory = path if path.is_dir() else None
        self.metadata = found.metadata
        self.mode = found.mode
        self.paths = [path, *found.files]
        self.parts: list[Part] = []
        self._unpacked: UnpackedFiles | None = None
        with ExitStack() as opened:
            files = found.files
            if self.mode == "file":
                self._unpacked = UnpackedFiles(files, recover=recover)
                opened.callback(self._unpacked.close)
                files = self._unpacked.files
            for file in files:
                part: Part = open_part(file, recover=recover, threads=threads)
                opened.push(part)
                if self.mode == "none" and isinstance(part, SqliteReader) and part.packed:
                    self.mode = "message"
                self.parts.append(UnpackedMessages(part, recover=recover) if self.mode == "message" else part)
            self.kind: Kind = self.parts[0].kind
            if any(part.kind != self.kind for part in self.parts):
                raise BagError(f"{path}: mixes sqlite3 and MCAP files; name one of them")
            self._opened = opened.pop_all()
        self._reading = 0
        self.channels: Mapping[int, Channel] = self.parts[0].channels
        self.numbers: list[dict[int, int]] = []
        self._origins: dict[int, tuple[Part, Channel]] = {}
        self._number()

    def definition(self, channel: Channel) -> Definition:
        """Return the definition of a channel's type in the first file that has the channel."""
        part, own = self._origins[channel.id]
        return part.definition(own)

    @property
    def losses(self) -> list[str]:
        """Parts of the files that could not be read, one sentence each."""
        packed = [] if self._unpacked is None else self._unpacked.losses
        return [*packed, *(loss for part in self.parts for loss in part.losses)]

    @property
    def count(self) -> int:
        """Number of messages of the last pass."""
        return sum(part.count for part in self.parts)

    @property
    def part_read(self) -> float | None:
        """Part of the files read in this pass, 0 to 1, with equal weights; None where unknown."""
        now = self.parts[self._reading]
        part = None if isinstance(now, SqliteReader) else now.part_read
        return None if part is None else (self._reading + part) / len(self.parts)

    def blocks(self, only: Container[int] | None = None) -> Iterator[Block]:
        """Yield the blocks, file after file."""
        for index, (part, numbers) in enumerate(zip(self.parts, self.numbers, strict=True)):
            self._reading = index
            wanted = None if only is None else {own for own, number in numbers.items() if number in only}
            if len(self.parts) == 1:
                yield from part.blocks(wanted)
                continue
            for block in joined(part.blocks(wanted)):
                table = block.table.copy()
                known, places = np.unique(table["channel"], return_inverse=True)
                table["channel"] = np.array([numbers[one] for one in known.tolist()], dtype=np.uint32)[places]
                yield Block(block.data, table, PartFraming(index, block), ends=block.ends)

    def _number(self) -> None:
        """Assign channel ids: the first file's are kept, and a topic has the same id in all files."""
        channels: dict[int, Channel] = {}
        same: dict[tuple[str, str, str], int] = {}
        for part in self.parts:
            numbers: dict[int, int] = {}
            for channel in part.channels.values():
                key = (channel.topic, channel.msgtype, channel.encoding)
                number = channel.id if part is self.parts[0] else same.get(key)
                if number is None:
                    number = max(channels, default=0) + 1
                if number not in channels:
                    channels[number] = Channel(number, *key, raw=channel.raw)
                    self._origins[number] = (part, channel)
                same.setdefault(key, number)
                numbers[channel.id] = number
            self.numbers.append(numbers)
        self.channels = channels

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._opened.close()


def _mode_of(path: Path) -> Mode:
    """Return how a single file is compressed, by its first bytes."""
    with Source.of_file(path) as source:
        return "file" if source.sniff(len(magic.ZSTD)) == magic.ZSTD else "none"


def open_part(path: Path, *, recover: bool = False, threads: int = 1) -> SqliteReader | McapReader:
    """Return a reader for a file of a bag, by its content."""
    source = Source.of_file(path)
    try:
        begin = source.sniff(16)
        if begin.startswith(magic.MCAP):
            return McapReader(path, source, recover=recover, threads=threads)
    except BaseException:
        source.close()
        raise
    source.close()
    if begin == magic.SQLITE:
        return SqliteReader(path, recover=recover)
    raise BagError(f"{path}: begins with {begin[:8]!r}, which is neither sqlite3 nor MCAP")
