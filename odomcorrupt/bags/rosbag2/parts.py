"""The files of a ROS 2 bag directory."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import cast, get_args

from odomcorrupt.bags.rosbag2.bounded_yaml import read_text
from odomcorrupt.bags.rosbag2.compression import SUFFIXES, Mode
from odomcorrupt.bags.rosbag2.metadata import read_info
from odomcorrupt.errors import BagError

__all__ = ["BagFiles", "find_files"]


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
            raise BagError(f"{file}: is no file (a directory, pipe or device); restore it")
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
