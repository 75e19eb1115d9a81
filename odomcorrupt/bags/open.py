"""Opening of bags: for reading by content, for writing by name.

A format is imported only when needed: all of them would add a tenth to the time for a short bag.
"""

from __future__ import annotations

import difflib
import sys
from typing import TYPE_CHECKING, BinaryIO

from odomcorrupt.bags import magic
from odomcorrupt.bags.codecs import require_level
from odomcorrupt.bags.output import Output
from odomcorrupt.bags.placement import refuse_target
from odomcorrupt.bags.recovery_report import loss_of
from odomcorrupt.bags.source import Source
from odomcorrupt.errors import BagError

if TYPE_CHECKING:
    from pathlib import Path

    from odomcorrupt.bags.block import BagReader, BagWriter, Kind
    from odomcorrupt.bags.pipeline import Workers
    from odomcorrupt.bags.rosbag2.reader import Rosbag2Reader

__all__ = ["kind_of", "open_reader", "open_writer"]

_CODECS: dict[Kind, tuple[str, ...]] = {
    "mcap": ("none", "lz4", "zstd"),
    "ros1": ("none", "lz4", "bz2"),
    "sqlite3": ("none",),
}
_NAMES: dict[Kind, str] = {"mcap": "an MCAP", "ros1": "a ROS 1 bag", "sqlite3": "a sqlite3 bag"}
_PACKED = {
    b"\x28\xb5\x2f\xfd": ("zstd", "zstd -d"),
    b"\x1f\x8b": ("gzip", "gunzip"),
    b"BZh": ("bzip2", "bunzip2"),
    b"\xfd7zXZ\0": ("xz", "unxz"),
    b"\x04\x22\x4d\x18": ("lz4", "lz4 -d"),
}
"""Files that are compressed as a whole, by their first bytes: by what, and what undoes it."""
_SUFFIXES: dict[str, Kind] = {".mcap": "mcap", ".bag": "ros1", ".db3": "sqlite3"}


def open_reader(
    path: Path | None, stream: BinaryIO | None = None, *, recover: bool = False, threads: int = 1
) -> BagReader:
    """Return a reader for a bag, whose format is detected from its content.

    path : None or "-" for a pipe
    stream : the pipe; default stdin
    recover : read the intact parts of a damaged bag, and list the others in the reader's `losses`
    threads : with more than one, files are read and decompressed ahead

    Raises
    ------
    BagError
        If it is no bag, or its beginning or end is damaged.

    """
    try:
        if path is None or str(path) == "-":
            source = Source(sys.stdin.buffer if stream is None else stream, "stdin")
            return _reader(None, source.spooled() if recover else source, recover=recover)
        if path.is_dir():
            return _rosbag2(path, recover=recover, threads=threads)
        return _reader(path, Source.of_file(path), recover=recover, threads=threads)
    except BagError as error:
        if recover:
            raise BagError(f"{loss_of(error)}; nothing can be recovered of it") from error
        raise


def _reader(path: Path | None, source: Source, *, recover: bool, threads: int = 1) -> BagReader:
    try:
        begin = source.sniff(16)
        if begin.startswith(magic.MCAP):
            from odomcorrupt.bags.mcap.reader import McapReader  # noqa: PLC0415 - see above

            return McapReader(path, source, recover=recover, threads=threads)
        if begin.startswith(magic.ROS1):
            from odomcorrupt.bags.ros1.reader import Ros1Reader  # noqa: PLC0415 - see above

            return Ros1Reader(path, source, recover=recover, threads=threads)
    except BaseException:
        source.close()
        raise
    source.close()
    if path is not None and begin == magic.SQLITE:
        return _rosbag2(path, recover=recover, threads=threads)
    raise _unknown(source.name, begin)


def _rosbag2(path: Path, *, recover: bool, threads: int) -> Rosbag2Reader:
    from odomcorrupt.bags.rosbag2.reader import Rosbag2Reader  # noqa: PLC0415 - see above

    return Rosbag2Reader(path, recover=recover, threads=threads)


def _as_rosbag2(reader: BagReader) -> Rosbag2Reader | None:
    """Return the reader if it is of a ROS 2 bag (only these have two paths or more: directory and files), else None."""
    if len(reader.paths) < 2:
        return None
    from odomcorrupt.bags.rosbag2.reader import Rosbag2Reader  # noqa: PLC0415 - see above

    return reader if isinstance(reader, Rosbag2Reader) else None


def _unknown(name: str, begin: bytes) -> BagError:
    if not begin:
        return BagError(f"{name}: is empty; nothing was recorded, or nothing came through the pipe")
    if begin.startswith(b"#ROSBAG V1"):
        return BagError(
            f"{name}: is a ROS 1 bag of version {begin[9:12].decode()}; `rosbag migrate` makes it a 2.0 one"
        )
    for first, (kind, command) in _PACKED.items():
        if begin.startswith(first):
            return BagError(f"{name}: is a {kind}-compressed file; decompress it first (`{command}`)")
    if begin == magic.SQLITE:
        return BagError(f"{name}: a sqlite3 bag cannot come through a pipe; name the file or directory")
    return BagError(f"{name}: begins with {begin[:8]!r}, which is no MCAP, ROS 1 bag or ROS 2 bag")


def open_writer(
    path: Path | None,
    reader: BagReader,
    *,
    overwrite: bool = False,
    compression: str | None = None,
    level: int | None = None,
    stream: BinaryIO | None = None,
    workers: Workers | None = None,
) -> BagWriter:
    """Return a writer for a bag, which appears under its name when the writer's context ends without an error.

    path : None or "-" for MCAP on a pipe; a suffix .mcap or .bag selects that format, others keep the input's
    compression : "none", "lz4", "zstd" (MCAP) or "bz2" (ROS 1); None keeps that of the input
    level : compression level; None is the default of the codec
    stream : the pipe; default stdout
    workers : threads for compression; blocks must then not change after they are passed to `write`

    Raises
    ------
    BagError
        If the output exists and overwrite is false, is the input, or its format cannot store the input's messages.

    """
    kind = kind_of(path, reader)
    rosbag2 = _as_rosbag2(reader)
    _refuse_suffix(path, directory=rosbag2 is not None)
    if compression is not None and compression not in _CODECS[kind]:
        raise BagError(
            f"compression {compression}: is not one that {_NAMES[kind]} can have; choose {', '.join(_CODECS[kind])}"
        )
    if compression is not None or kind == "sqlite3":
        require_level(compression or "none", level)
    if path is not None and str(path) != "-":
        named = path.suffix.lower() in _SUFFIXES
        refuse_target(path, reader.paths, overwrite=overwrite, directory=rosbag2 is not None and not named)
        if rosbag2 is not None and not named:
            from odomcorrupt.bags.rosbag2.writer import Rosbag2Writer  # noqa: PLC0415 - see above

            return Rosbag2Writer(path, rosbag2, compression, level, overwrite=overwrite, workers=workers)
    piped = path is None or str(path) == "-"
    output = Output(None, stream or sys.stdout.buffer) if piped else Output(path, overwrite=overwrite)
    # the reader of a bag's only file of the same kind: this file is rewritten
    part = rosbag2.parts[0] if rosbag2 and len(rosbag2.parts) == 1 and rosbag2.kind == kind else None
    if kind == "mcap":
        from odomcorrupt.bags.mcap.writer import McapWriter  # noqa: PLC0415 - see above

        return McapWriter(output, part or reader, compression, level, workers=workers)
    if kind == "ros1":
        from odomcorrupt.bags.ros1.writer import Ros1Writer  # noqa: PLC0415 - see above

        return Ros1Writer(output, reader, compression, level, workers)
    from odomcorrupt.bags.rosbag2.sqlite_reader import SqliteReader  # noqa: PLC0415 - see above
    from odomcorrupt.bags.rosbag2.sqlite_writer import SqliteWriter  # noqa: PLC0415 - see above

    if path is None or not isinstance(part, SqliteReader):
        raise BagError(f"{path}: {reader.name} cannot become a single sqlite3 file; name the output .mcap")
    return SqliteWriter(path, part, overwrite=overwrite, copying_thread=workers is not None and workers.threads > 1)


def _refuse_suffix(path: Path | None, *, directory: bool) -> None:
    """Raise BagError for an output name with the suffix of no format; for directories only if it resembles one."""
    suffix = "" if path is None else path.suffix.lower()
    if not suffix or suffix in _SUFFIXES:
        return
    near = difflib.get_close_matches(suffix, _SUFFIXES, 1, 0.5)
    if near or not directory:
        meant = f" (did you mean {near[0]}?)" if near else ""
        raise BagError(f"{path}: {suffix} is no format of bags{meant}; end the name in {', '.join(_SUFFIXES)}")


def kind_of(path: Path | None, reader: BagReader) -> Kind:
    """Return the format of an output's suffix, or that of the input."""
    if path is None or str(path) == "-":
        return "mcap"
    return _SUFFIXES.get(path.suffix.lower(), reader.kind)
