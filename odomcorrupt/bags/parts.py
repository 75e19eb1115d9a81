"""Recordings of one or more files: directories of ROS 2 bags, split recordings of ROS 1, files packed by zstd."""

from __future__ import annotations

import glob
import re
from collections import Counter
from contextlib import ExitStack
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Self, cast, get_args

from odomcorrupt.bags.block import Channel, Kind, with_ids
from odomcorrupt.bags.mcap.reader import McapReader
from odomcorrupt.bags.record_reader import loss_of
from odomcorrupt.bags.ros1.reader import Ros1Reader
from odomcorrupt.bags.rosbag2.bounded_yaml import read_text
from odomcorrupt.bags.rosbag2.compression import SUFFIXES, Mode, UnpackedMessages, unpacked_files
from odomcorrupt.bags.rosbag2.metadata import differences, read_info
from odomcorrupt.bags.rosbag2.sqlite_reader import SqliteReader
from odomcorrupt.bags.source import MCAP, ROS1, SNIFFED, SQLITE, ZSTD, Source, unknown
from odomcorrupt.errors import BagError

if TYPE_CHECKING:
    from collections.abc import Container, Iterator, Mapping, Sequence
    from pathlib import Path

    from odomcorrupt.bags.block import Block, Definition

Part = SqliteReader | McapReader | Ros1Reader | UnpackedMessages


@dataclass(frozen=True, slots=True)
class BagFiles:
    """The files of a recording.

    files : in the order of recording
    metadata : text of metadata.yaml, or None without one
    info : the bag information in it, empty without one
    unlisted : names of other bags in the directory, and what is done with them
    mode : what of the bag is compressed
    losses : files that are not there, and an unreadable metadata.yaml, one sentence each, with recovery
    """

    files: list[Path]
    metadata: str | None = None
    info: Mapping[str, Any] = field(default_factory=dict)
    unlisted: str = ""
    mode: Mode = "none"
    losses: list[str] = field(default_factory=list)


def find_files(path: Path, *, recover: bool = False) -> BagFiles:
    """Return a recording's files: those that metadata.yaml lists, or that their names say are its parts.

    path : a directory, or a pattern such as run_*.bag
    recover : use the files that are there, where others are missing or metadata.yaml cannot be read

    Raises
    ------
    BagError
        If there are none, they are compressed in an unknown way, one is listed twice, or they do not belong to one
        recording.
    """
    metadata = path / "metadata.yaml"
    try:
        found = (_listed if metadata.exists() else _named)(path, recover=recover)
    except BagError as error:
        if not (recover and metadata.exists()):
            raise
        found = _named(path, recover=recover)
        found.losses.insert(0, f"{path}: {metadata.name} {loss_of(error).removeprefix(f'{metadata}: ')}")
    seen: dict[tuple[int, int], str] = {}
    for file in found.files:
        if not file.is_file():
            raise BagError(f"{file}: is not a regular file (but a directory, pipe or device); restore it")
        same = file.stat().st_dev, file.stat().st_ino
        if same in seen:
            raise BagError(
                f"{path}: {file.name} is the same file as {seen[same]}: every message would be there twice; "
                "remove the link, or the second entry of metadata.yaml"
            )
        seen[same] = file.name
    return found


def _listed(directory: Path, *, recover: bool) -> BagFiles:
    """Return the files that metadata.yaml lists; with recovery those that are there, and further parts."""
    metadata = directory / "metadata.yaml"
    info = read_info(metadata)
    mode = str(info.get("compression_mode") or "none").lower()
    mode = "none" if mode == "storage" else mode
    packed = str(info.get("compression_format") or "zstd").lower()
    if mode not in get_args(Mode) or (mode != "none" and packed != "zstd"):
        raise BagError(f"{directory}: is compressed by {mode} ({packed}), zstd is known; `ros2 bag convert` undoes it")
    # Old versions put the directory's own name before the files'.
    files = [directory / str(name).replace("\\", "/").rsplit("/", 1)[-1] for name in info["relative_file_paths"]]
    there = [file for file in files if file.exists()]
    missing = [file.name for file in files if not file.exists()]
    more = [file for file in bags_in(directory) if file not in files]
    held = _shortened([file.name for file in more])
    if not there or (missing and not recover):
        raise BagError(
            f"{metadata}: lists {_shortened(missing) or 'no file'}, which is not there{held and f' (but {held} is)'}; "
            "restore or rename the file, or remove metadata.yaml: the directory's files are then read by their names"
        )
    losses = [f"{directory}: {name} is listed in metadata.yaml and is not there" for name in missing]
    every = sorted([*there, *more], key=_counting)
    if recover and len({file.suffix for file in every}) == 1 and _missing_parts(every) is not None:
        there, held = every, held and f"{held}: read, as a part of the recording"
    elif held:
        held += ": left out; --recover reads what is a part of the recording"
    return BagFiles(there, read_text(metadata), info, held, cast("Mode", mode), losses)


def bags_in(path: Path) -> list[Path]:
    """Return the visible bags of a directory, or those that a pattern matches, in the order of the numbers in them."""
    visible = [
        one
        for one in (path.iterdir() if path.is_dir() else path.parent.glob(path.name))
        if not one.name.startswith(".") and _FILE.fullmatch(one.name)
    ]
    return sorted(visible, key=_counting)


def _counting(file: Path) -> list[str | int]:
    """Return a name's texts and numbers, for sorting."""
    return [int(part) if part.isdecimal() else part for part in _NUMBERS.split(file.name)]


def _named(path: Path, *, recover: bool) -> BagFiles:
    """Return the files of a directory without metadata.yaml, whose names must be those of one recording."""
    every = bags_in(path)
    packed = [one for one in every if one.suffix in SUFFIXES]
    files = [one for one in every if one.suffix in (".db3", ".mcap")]
    if files and packed:
        raise BagError(f"{path}: has no metadata.yaml, and holds {files[0].name} beside {packed[0].name}; name one")
    files = packed or files or every
    if not files:
        raise BagError(f"{path}: is a directory without a bag in it (metadata.yaml, .db3, .mcap or .bag files)")
    missing = _missing_parts(files)
    if missing is None or (missing and not recover):
        gap = f": part {missing[0]} is missing, --recover does without it" if missing else ""
        raise BagError(
            f"{path}: has no metadata.yaml, and holds {len(files)} bags that are not evidently parts of one recording "
            f"({_shortened([one.name for one in files])}){gap or '; name one of them'}"
        )
    losses = [f"{path}: part {number} of the recording is not there" for number in missing]
    return BagFiles(files, mode="file" if packed else "none", losses=losses)


def _shortened(names: list[str]) -> str:
    return ", ".join(names[:_SHOWN]) + (", ..." if len(names) > _SHOWN else "")


def _missing_parts(files: list[Path]) -> list[int] | None:
    """Return the numbers missing between those of files whose names differ in number and date only, else None."""
    if len(files) == 1:
        return []
    parts = [_COUNTED.fullmatch(one.name) for one in files]
    names = {(_DATE.sub("", part["stem"]), part["suffix"]) for part in parts if part}
    numbers = [int(part["number"]) for part in parts if part]
    if not all(parts) or len(names) > 1 or len(set(numbers)) < len(numbers) or numbers != sorted(numbers):
        return None
    missing = sorted(set(range(numbers[0], numbers[-1])) - set(numbers)) if numbers[-1] < _MOST_PARTS else [numbers[0]]
    return missing if len(missing) < len(files) else None


def pattern_of(files: Sequence[Path]) -> Path | None:
    """Return the pattern of the names of files that are parts of one recording, perhaps not all of them; else None."""
    if (first := _COUNTED.fullmatch(files[0].name)) is None:
        return None
    pattern = files[0].parent / f"{_DATE.sub('*', glob.escape(first['stem']))}[0-9]*{first['suffix']}"
    pattern = pattern.with_name(f"{pattern.name}*") if any(one.suffix != pattern.suffix for one in files) else pattern
    every = bags_in(pattern)
    return pattern if set(files) <= set(every) and _missing_parts(every) is not None else None


_NUMBERS = re.compile(r"([0-9]{1,18})")
_FILE = re.compile(r".*\.(db3|mcap|bag|bag\.active|(db3|mcap)\.(zstd|zst))", re.IGNORECASE)
"""Names of bags; rosbag record names the part that it writes .bag.active."""
_COUNTED = re.compile(r"(?P<stem>.*?)(?P<number>[0-9]{1,18})(?P<suffix>\.[a-z0-9]+)(\.active|\.zstd|\.zst)?")
_DATE = re.compile(r"[0-9]{4}(-[0-9]{2}){5}")
"""Of a part's beginning, as rosbag record writes it in front of the number."""
_MOST_PARTS = 1 << 20
_SHOWN = 6


class PartsReader:
    """A recording of one or more files, read one after the other; see `BagReader`.

    metadata : text of metadata.yaml, or None without one
    mode : what of the bag is compressed; `parts` read it decompressed
    parts : readers of the files
    numbers : for each file, the bag's channel id by the file's channel id
    """

    complete = True

    def __init__(self, path: Path, *, recover: bool = False) -> None:
        self.name = str(path)
        if path.is_file():
            with Source.of_file(path) as source:  # by its first bytes
                found = BagFiles([path], mode="file" if source.sniff(len(ZSTD)) == ZSTD else "none")
        else:
            found = find_files(path, recover=recover)
        self.directory = path if path.is_dir() else None
        self.metadata = found.metadata
        self.mode = found.mode
        self.paths = [path]
        self.parts: list[Part] = []
        self._found = found
        self._not_unpacked: list[str] = []
        with ExitStack() as opened:
            files = found.files
            if self.mode == "file":
                files = unpacked_files(files, opened, self._not_unpacked, recover=recover)
            failed: BagError | None = None
            for name, file in zip(found.files, files, strict=True):
                try:
                    part = open_part(file, str(name), recover=recover)
                except BagError as error:
                    if not recover:
                        raise
                    failed = failed or error
                    found.losses.append(f"{path}: {name.name} {loss_of(error).removeprefix(f'{name}: ')}")
                    continue
                opened.push(part)
                if self.mode == "none" and not isinstance(part, Ros1Reader) and part.packed:
                    self.mode = "message"
                self.parts.append(UnpackedMessages(part, recover=recover) if self.mode == "message" else part)
                self.paths.append(name)
            if not self.parts:
                raise failed or BagError(f"{path}: holds no file")
            self.kind: Kind = self.parts[0].kind
            if any(part.kind != self.kind for part in self.parts):
                raise BagError(f"{path}: mixes sqlite3, MCAP and ROS 1 files; name one of them")
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
        """Files, and parts of files, that could not be read, one sentence each."""
        return [*self._found.losses, *self._not_unpacked, *(loss for part in self.parts for loss in part.losses)]

    @property
    def remarks(self) -> list[str]:
        """What metadata.yaml states and the files do not hold, after a pass, one sentence each."""
        if not self.count or self.metadata is None:
            return []
        topics = [(channel.topic, channel.msgtype) for channel in self.channels.values()]
        unlisted = [f"metadata.yaml does not list {self._found.unlisted}"] if self._found.unlisted else []
        return [*unlisted, *differences(self._found.info, self.kind, self.count, topics)]

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
            for block in part.blocks(wanted):
                if index:
                    block.table, block.part = with_ids(block.table, numbers.__getitem__), index
                yield block

    def _number(self) -> None:
        """Assign channel ids: the first file's are kept, and a topic (of a publisher of ROS 1) has one in all files."""
        channels: dict[int, Channel] = {}
        same: dict[Any, int] = {}
        for part in self.parts:
            numbers: dict[int, int] = {}
            seen: Counter[Any] = Counter()
            for channel in part.channels.values():
                key = (channel.topic, channel.msgtype, channel.encoding)
                publisher = (*key, *channel.raw.fields.items()) if self.kind == "ros1" else key
                seen[publisher] += 1  # the first of its channels in a file is the first one in all of them
                number = channel.id if part is self.parts[0] else same.get((publisher, seen[publisher]))
                if number is None:
                    number = max(channels, default=0) + 1
                if number not in channels:
                    channels[number] = Channel(number, *key, raw=channel.raw)
                    self._origins[number] = (part, channel)
                same.setdefault((publisher, seen[publisher]), number)
                numbers[channel.id] = number
            self.numbers.append(numbers)
        self.channels = channels

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self._opened.close()


def open_part(path: Path, name: str, *, recover: bool = False) -> SqliteReader | McapReader | Ros1Reader:
    """Return a reader for a file of a bag, by its content; `name` is that in messages."""
    source = Source.of_file(path, name)
    try:
        begin = source.sniff(SNIFFED)
        if begin.startswith(MCAP):
            return McapReader(path, source, recover=recover)
        if begin.startswith(ROS1):
            return Ros1Reader(path, source, recover=recover)
    except BaseException:
        source.close()
        raise
    source.close()
    if begin.startswith(SQLITE):
        return SqliteReader(path, name, recover=recover)
    advice = "" if any(begin) else "; --recover leaves it out"
    raise BagError(f"{unknown(name, begin).message}{advice}")
