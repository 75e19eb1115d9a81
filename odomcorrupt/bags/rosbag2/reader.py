"""ROS 2 bag reader, for a directory of one or more storage files."""

from __future__ import annotations

import re
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Self, cast, get_args

import numpy as np

from odomcorrupt.bags import magic
from odomcorrupt.bags.block import Block, Channel, Kind, PartFraming
from odomcorrupt.bags.coalesce import joined
from odomcorrupt.bags.mcap.reader import McapReader
from odomcorrupt.bags.rosbag2.bounded_yaml import read_text
from odomcorrupt.bags.rosbag2.compression import SUFFIXES, Mode, UnpackedFiles, UnpackedMessages
from odomcorrupt.bags.rosbag2.metadata import read_info
from odomcorrupt.bags.rosbag2.sqlite_reader import SqliteReader
from odomcorrupt.bags.source import Source
from odomcorrupt.errors import BagError

if TYPE_CHECKING:
    from collections.abc import Container, Iterator, Mapping

    from odomcorrupt.bags.block import Definition

Part = SqliteReader | McapReader | UnpackedMessages


@dataclass(frozen=True, slots=True)
class BagFiles:
    """The files of a bag.

    files : in the order of recording
    metadata : text of metadata.yaml, or None without one
    mode : what of the bag is compressed
    """

    files: list[Path]
    metadata: str | None
    mode: Mode = "none"


def find_files(directory: Path) -> BagFiles:
    """Return a bag's files, listed in metadata.yaml or found by name.

    Raises
    ------
    BagError
        If there are none, they are compressed in an unknown way, one is listed twice, or they do not belong to one
        recording.
    """
    metadata = directory / "metadata.yaml"
    found = _listed(directory, metadata) if metadata.exists() else _named(directory)
    seen: dict[tuple[int, int], str] = {}
    for file in found.files:
        if not file.is_file():
            raise BagError(f"{file}: is not a regular file (but a directory, pipe or device); restore it")
        same = file.stat().st_dev, file.stat().st_ino
        if same in seen:
            raise BagError(
                f"{directory}: {file.name} is the same file as {seen[same]}: every message would be there twice; "
                "remove the link, or the second entry of metadata.yaml"
            )
        seen[same] = file.name
    return found


def _listed(directory: Path, metadata: Path) -> BagFiles:
    """Return the files that a metadata.yaml lists."""
    info = read_info(metadata)
    mode = str(info.get("compression_mode") or "none").lower()
    mode = "none" if mode == "storage" else mode
    packed = str(info.get("compression_format") or "zstd").lower()
    if mode not in get_args(Mode) or (mode != "none" and packed != "zstd"):
        raise BagError(
            f"{directory}: is compressed {mode} by {mode} ({packed}), zstd is known; `ros2 bag convert` can undo that"
        )
    # Old versions put the directory's own name before the files'.
    files = [directory / str(name).replace("\\", "/").rsplit("/", 1)[-1] for name in info["relative_file_paths"]]
    missing = [file.name for file in files if not file.exists()]
    if missing or not files:
        raise BagError(f"{metadata}: lists {', '.join(missing) or 'no file'}, which is not there; restore it")
    return BagFiles(files, read_text(metadata), cast("Mode", mode))


def _named(directory: Path) -> BagFiles:
    """Return the files of a directory without metadata.yaml, whose names must be those of one recording."""
    visible = [path for path in directory.iterdir() if not path.name.startswith(".")]
    names = sorted(visible, key=lambda path: [int(x) if x.isdecimal() else x for x in _PARTS.split(path.name)])
    files = [path for path in names if path.suffix in (".db3", ".mcap")]
    packed = [path for path in names if path.suffix in SUFFIXES and Path(path.stem).suffix in (".db3", ".mcap")]
    if files and packed:
        raise BagError(
            f"{directory}: has no metadata.yaml, and holds {files[0].name} beside {packed[0].name}; name one of them"
        )
    if packed:
        files = packed
    if files:
        if not _is_one_recording(files):
            held = ", ".join(path.name for path in files[:_SHOWN]) + (", ..." if len(files) > _SHOWN else "")
            raise BagError(
                f"{directory}: has no metadata.yaml, and holds {len(files)} bags that are not evidently parts of one "
                f"recording ({held}); name one of them"
            )
        return BagFiles(files, None, "file" if packed else "none")
    ros1 = [path.name for path in names if path.suffix == ".bag"]
    more = f"; it holds {ros1[0]}, name that" if ros1 else ""
    raise BagError(f"{directory}: is a directory without a bag in it (metadata.yaml, .db3 or .mcap files){more}")


def _is_one_recording(files: list[Path]) -> bool:
    """Return whether names differ only in their last, consecutive number, as in a bag split by rosbag2."""
    if len(files) == 1:
        return True
    parts = [_COUNTED.fullmatch(path.stem if path.suffix in SUFFIXES else path.name) for path in files]
    names = {(part["stem"], part["suffix"]) for part in parts if part}
    numbers = [int(part["number"]) for part in parts if part]
    return all(parts) and len(names) == 1 and numbers == list(range(numbers[0], numbers[0] + len(files)))


_PARTS = re.compile(r"([0-9]{1,18})")
_COUNTED = re.compile(r"(?P<stem>.*?)(?P<number>[0-9]{1,18})(?P<suffix>\.[a-z0-9]+)")
_SHOWN = 6


class Rosbag2Reader:
    """A directory, or a single sqlite3 file.

    metadata : text of metadata.yaml, or None without one
    mode : what of the bag is compressed; `parts` read it decompressed
    parts : readers of the files
    numbers : for each file, the bag's channel id by the file's channel id
    """

    complete = True

    def __init__(self, path: Path, *, recover: bool = False) -> None:
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
                part: Part = open_part(file, recover=recover)
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

    def __exit__(self, *_error: object) -> None:
        self._opened.close()


def _mode_of(path: Path) -> Mode:
    """Return how a single file is compressed, by its first bytes."""
    with Source.of_file(path) as source:
        return "file" if source.sniff(len(magic.ZSTD)) == magic.ZSTD else "none"


def open_part(path: Path, *, recover: bool = False) -> SqliteReader | McapReader:
    """Return a reader for a file of a bag, by its content."""
    source = Source.of_file(path)
    try:
        begin = source.sniff(16)
        if begin.startswith(magic.MCAP):
            return McapReader(path, source, recover=recover)
    except BaseException:
        source.close()
        raise
    source.close()
    if begin == magic.SQLITE:
        return SqliteReader(path, recover=recover)
    raise BagError(f"{path}: begins with {begin[:8]!r}, which is neither sqlite3 nor MCAP")
