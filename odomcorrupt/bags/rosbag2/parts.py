"""Find the files of a ROS 2 bag."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

from odomcorrupt.bags.rosbag2.metadata import read_info
from odomcorrupt.errors import BagError

if TYPE_CHECKING:
    from pathlib import Path

__all__ = ["BagFiles", "find_files"]


@dataclass(frozen=True, slots=True)
class BagFiles:
    """The files of a bag.

    files : in the order of recording
    metadata : text of metadata.yaml, or None without one
    """

    files: list[Path]
    metadata: str | None


def find_files(directory: Path) -> BagFiles:
    """Find a bag's files, by metadata.yaml or by their names.

    Raises
    ------
    BagError
        Where there are none, or they are compressed as a whole or message by message.

    """
    metadata = directory / "metadata.yaml"
    if metadata.exists():
        info = read_info(metadata)
        mode = str(info.get("compression_mode") or "none").lower()
        if mode != "none":
            raise BagError(
                f"{directory}: is compressed {mode} by {mode} ({info.get('compression_format')}); `ros2 bag convert` "
                "can undo that"
            )
        # Old versions put the directory's own name before the files'.
        files = [directory / str(name).replace("\\", "/").rsplit("/", 1)[-1] for name in info["relative_file_paths"]]
        missing = [file.name for file in files if not file.exists()]
        if missing or not files:
            raise BagError(f"{metadata}: lists {', '.join(missing) or 'no file'}, which is not there; restore it")
        return BagFiles(files, metadata.read_text(encoding="utf8"))
    names = sorted(
        directory.iterdir(), key=lambda path: [int(x) if x.isdigit() else x for x in _PARTS.split(path.name)]
    )
    for suffix in (".db3", ".mcap"):
        files = [path for path in names if path.suffix == suffix]
        if files:
            return BagFiles(files, None)
    packed = [path.name for path in names if path.suffix in (".zstd", ".zst")]
    if packed:
        raise BagError(f"{directory}: {packed[0]} is compressed as a whole; decompress it first (`zstd -d`)")
    raise BagError(f"{directory}: is a directory without a bag in it (metadata.yaml, .db3 or .mcap files)")


_PARTS = re.compile(r"(\d+)")
