"""Opening of bags: for reading by content, for writing by name.

A format is imported only when needed: all of them would add a tenth to the time for a short bag.
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any, BinaryIO, NamedTuple, cast

from odomcorrupt.bags.codecs import require_level
from odomcorrupt.bags.output import Output, is_stream, refuse_target
from odomcorrupt.bags.record_reader import RecordReader, loss_of
from odomcorrupt.bags.source import MCAP, ROS1, SNIFFED, SQLITE, ZSTD, Source, unknown
from odomcorrupt.errors import BagError

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from odomcorrupt.bags.block import BagReader, BagWriter, Kind
    from odomcorrupt.bags.convert.message_types import Generation
    from odomcorrupt.bags.parts import PartsReader
    from odomcorrupt.bags.pipeline import Workers
    from odomcorrupt.bags.rosbag2.compression import Mode

_CODECS: dict[Kind, tuple[str, ...]] = {
    "mcap": ("none", "lz4", "zstd"),
    "ros1": ("none", "lz4", "bz2"),
    "sqlite3": ("none",),
}
_MODES = ("file", "message")
"""What else of a ROS 2 bag's directory may be compressed, with zstd."""
_NAMES: dict[Kind, str] = {"mcap": "an MCAP", "ros1": "a ROS 1 bag", "sqlite3": "a sqlite3 bag"}
_GENERATIONS: dict[str, Generation] = {"ros1": 1, "cdr": 2}
"""Generation of ROS by the serialisation of its messages."""
_SUFFIXES: dict[str, Kind] = {".mcap": "mcap", ".bag": "ros1", ".db3": "sqlite3"}


def open_reader(path: Path | None, stream: BinaryIO | None = None, *, recover: bool = False) -> BagReader:
    """Return a reader for a bag, whose format is detected from its content.

    path : None or "-" for a pipe
    stream : the pipe; default stdin
    recover : read the intact parts of a damaged bag, and list the others in the reader's `losses`

    Raises
    ------
    BagError
        If it is no bag, or its beginning or end is damaged.
    """
    try:
        if path is None or str(path) == "-":
            source = Source(sys.stdin.buffer if stream is None else stream, "stdin")
            return _reader(None, source.spooled() if recover else source, recover=recover)
        if path.is_dir() or is_pattern(path):
            return _parts(path, recover=recover)
        return _reader(path, Source.of_file(path), recover=recover)
    except BagError as error:
        if recover:
            raise BagError(f"{loss_of(error)}; nothing can be recovered from it") from error
        raise


def _reader(path: Path | None, source: Source, *, recover: bool) -> BagReader:
    try:
        begin = source.sniff(SNIFFED)
        if begin.startswith(MCAP):
            from odomcorrupt.bags.mcap.reader import McapReader  # noqa: PLC0415 - see above

            mcap = McapReader(path, source, recover=recover)
            if not mcap.packed:
                return mcap
            from odomcorrupt.bags.rosbag2.compression import UnpackedMessages  # noqa: PLC0415 - see above

            return UnpackedMessages(mcap, recover=recover)
        if begin.startswith(ROS1):
            from odomcorrupt.bags.ros1.reader import Ros1Reader  # noqa: PLC0415 - see above

            return Ros1Reader(path, source, recover=recover)
    except BaseException:
        source.close()
        raise
    source.close()
    if path is not None and begin.startswith((SQLITE, ZSTD)):
        return _parts(path, recover=recover)
    raise unknown(source.name, begin)


def is_pattern(path: Path) -> bool:
    """Return whether a path names no file, but matches those of one recording, as in run_*.bag."""
    return not path.exists() and any(sign in path.name for sign in "*?[") and any(path.parent.glob(path.name))


def _parts(path: Path, *, recover: bool) -> PartsReader:
    from odomcorrupt.bags.parts import PartsReader  # noqa: PLC0415 - see above

    return PartsReader(path, recover=recover)


def _as_parts(reader: BagReader) -> PartsReader | None:
    """Return the reader if it is one of parts (only these have two paths or more: directory and files), else None."""
    if len(reader.paths) < 2:
        return None
    from odomcorrupt.bags.parts import PartsReader  # noqa: PLC0415 - see above

    return reader if isinstance(reader, PartsReader) else None


class Form(NamedTuple):
    """What an output is.

    kind : storage of its messages
    directory : whether it is a ROS 2 bag's directory
    ros : generation of ROS of its messages; None for that of the input
    """

    kind: Kind
    directory: bool
    ros: Generation | None


def form_of(path: Path | None, reader: BagReader, *, ros: Generation | None = None, storage: str | None = None) -> Form:
    """Return what an output becomes: as its name says, else as the input is.

    path : None or "-" for MCAP on a pipe; a suffix .bag, .mcap or .db3 selects the format, none is a directory
    reader : the input; what is a ROS 1 bag becomes a ROS 2 bag in an .mcap
    ros : generation of the messages, where the format leaves a choice
    storage : "mcap" or "sqlite3", of a directory

    Raises
    ------
    BagError
        If the name is that of no format, or the format cannot have these messages or this storage.
    """
    if path is None or str(path) == "-":
        return _with_storage(Form("mcap", directory=False, ros=ros), storage, "stdout")
    _refuse_suffix(path, directory=reader.kind != "ros1" and _as_parts(reader) is not None)
    kind = _SUFFIXES.get(path.suffix.lower())
    if kind is None and is_stream(path):
        return _with_storage(Form(reader.kind, directory=False, ros=ros), storage, str(path))
    if kind is None:
        kind = reader.kind if reader.kind in ("mcap", "sqlite3") else "mcap"
        only, directory = 2, True
    else:
        only, directory = {"ros1": 1, "sqlite3": 2, "mcap": 0}[kind], False
    if only and ros not in (None, only):
        raise BagError(
            f"{path}: {'a directory' if directory else _NAMES[kind]} holds messages of ROS {only}, not of ROS {ros}; "
            "leave --ros out, or end the name in .mcap, which can hold both"
        )
    if kind == "mcap" and ros is None and reader.kind == "ros1":
        ros = 2
    chosen = cast("Generation | None", only or ros)
    return _with_storage(Form(kind, directory, chosen), storage, str(path))


class Target(NamedTuple):
    """An output, and the input as it is written to it.

    reader : the input, converted where the output needs that
    form : what the output is
    """

    reader: BagReader
    form: Form


def target_of(
    path: Path | None, reader: BagReader, *, ros: Generation | None = None, storage: str | None = None, exclude:
    Sequence[str] = (), rename: Sequence[str] = (), recover: bool = False, scan_every: int = 1,
) -> Target:  # fmt: skip
    """Return an output, with a reader of the input that yields the messages as the output has them.

    path, ros, storage : as of `form_of`
    exclude : topics that are left out
    rename : "OLD=NEW" for topics that get another name
    recover : leave out messages that cannot be converted, and list them in the reader's `losses`
    scan_every : keep every N-th laser scan of a publisher

    Raises
    ------
    BagError
        If a topic's messages cannot be converted, or would become ROS 1 messages in an MCAP.
    TopicError
        If there is no such topic to be left out or renamed.
    """
    form = form_of(path, reader, ros=ros, storage=storage)
    strict = form.directory or form.kind != "mcap"
    if reader.complete:
        generations = {_GENERATIONS.get(channel.encoding) for channel in reader.channels.values()}
        fits = generations <= {form.ros} if strict else form.ros is None or generations <= {None, form.ros}
    else:
        fits = form.ros is None or (reader.kind == "ros1" and form.ros == 1)
    if form.kind == "mcap" and form.ros == 1 and not fits:
        name = "stdout" if path is None or str(path) == "-" else str(path)
        raise BagError(
            f"{name}: --ros 1 would convert messages of ROS 2 to an MCAP of ROS 1 messages, which rosbags-convert and "
            "rosbag refuse to read; end the name in .bag for ROS 1, or leave --ros out"
        )
    if fits and not exclude and not rename and scan_every == 1:
        return Target(reader, form)
    # the library takes a fifth of a second to import
    from odomcorrupt.bags.convert.reader import ConvertedReader  # noqa: PLC0415

    asked: Any = {"exclude": exclude, "rename": rename, "recover": recover, "scan_every": scan_every}
    converted = ConvertedReader(reader, form.ros, strict=strict, **asked)
    return Target(converted, form)


def _with_storage(form: Form, storage: str | None, name: str) -> Form:
    if storage is None:
        return form
    if storage not in ("mcap", "sqlite3"):
        raise BagError(f"--storage {storage}: is not a storage format of ROS 2 bags; choose mcap or sqlite3")
    if not form.directory and storage != form.kind:
        raise BagError(f"{name}: --storage {storage} is for directories; name the output without a suffix")
    return form._replace(kind=cast("Kind", storage))


def open_writer(
    path: Path | None, reader: BagReader, *, overwrite: bool = False, compression: str | None = None,
    level: int | None = None, stream: BinaryIO | None = None, workers: Workers | None = None, form: Form | None = None,
) -> BagWriter:  # fmt: skip
    """Return a writer for a bag, which appears under its name when the writer's context ends without an error.

    path : None or "-" for a pipe
    compression : "none", "lz4", "zstd" (MCAP), "bz2" (ROS 1), "file" and "message" (directories of ROS 2); None keeps
        that of the input
    level : compression level; None is the default of the codec
    stream : the pipe; default stdout
    workers : threads for compression; blocks must then not change after they are passed to `write`
    form : what the output is; by default as of `form_of`

    Raises
    ------
    BagError
        If the output exists and overwrite is false, is the input, or its format cannot store the input's messages.
    """
    if form is None:
        form = form_of(path, reader)
    kind = form.kind
    parts = _as_parts(reader)
    if form.directory or kind == "sqlite3":
        _require_generation(path, reader)
    _require_compression(form, parts, compression, level)
    if path is None or str(path) == "-":
        output = Output(None, stream or sys.stdout.buffer)
    else:
        refuse_target(path, reader.paths, overwrite=overwrite, directory=form.directory)
        output = Output(path, overwrite=overwrite)
    if form.directory and path is not None:
        from odomcorrupt.bags.rosbag2.writer import Rosbag2Writer  # noqa: PLC0415 - see above

        chunks = None if compression in _MODES else compression
        mode = cast("Mode | None", compression if compression in _MODES else chunks and "none")
        return Rosbag2Writer(path, reader, chunks, level, kind=kind, mode=mode, overwrite=overwrite, workers=workers)
    beside = workers is not None and workers.threads > 1
    if isinstance(reader, RecordReader) and path is not None and not is_stream(path) and str(path) != "-":
        # what the kernel copies in a thread need not be written from memory
        reader.sparse = beside and reader.kind == kind and compression in (None, "none") and sys.platform == "linux"
    # the reader of a bag's only file of the same kind: this file is rewritten
    part = parts.parts[0] if parts and len(parts.parts) == 1 and parts.kind == kind else None
    if kind == "mcap":
        from odomcorrupt.bags.mcap.writer import McapWriter  # noqa: PLC0415 - see above

        return McapWriter(output, part or reader, compression, level, workers=workers)
    if kind == "ros1":
        from odomcorrupt.bags.ros1.writer import Ros1Writer  # noqa: PLC0415 - see above

        return Ros1Writer(output, part or reader, compression, level, workers)
    from odomcorrupt.bags.rosbag2.sqlite_reader import SqliteReader  # noqa: PLC0415 - see above
    from odomcorrupt.bags.rosbag2.sqlite_writer import NewSqliteWriter, SqliteWriter  # noqa: PLC0415 - see above

    if path is None or is_stream(path):
        raise BagError(f"{path}: a sqlite3 file cannot go through a pipe; name the output .mcap, or a file")
    if isinstance(part, SqliteReader):
        return SqliteWriter(path, part, overwrite=overwrite, copying_thread=beside)
    return NewSqliteWriter(path, reader, overwrite=overwrite)


def _require_generation(path: Path | None, reader: BagReader) -> None:
    """Raise BagError for messages that are not of ROS 2."""
    for channel in reader.channels.values():
        if channel.encoding != "cdr":
            said = f"{channel.topic} has {channel.encoding} messages, but a ROS 2 bag holds cdr messages; convert them"
            raise BagError(f"{path}: {said}")


def _require_compression(form: Form, parts: PartsReader | None, compression: str | None, level: int | None) -> None:
    """Raise BagError for a compression or a level that an output cannot have."""
    known = _CODECS[form.kind] + (_MODES if form.directory else ())
    if compression is not None and compression not in known:
        storage = {"mcap": "MCAP"}.get(form.kind, form.kind)
        name = f"a directory of {storage} files" if form.directory else _NAMES[form.kind]
        raise BagError(f"compression {compression}: is not available for {name}; choose {', '.join(known)}")
    if form.directory and compression is None and parts is not None and parts.mode != "none":
        compression = parts.mode
    if compression is not None or form.kind == "sqlite3":
        require_level("zstd" if compression in _MODES else compression or "none", level)


def _refuse_suffix(path: Path | None, *, directory: bool) -> None:
    """Raise BagError for an output name with the suffix of no format; for directories only if it resembles one."""
    suffix = "" if path is None else path.suffix.lower()
    if not suffix or suffix in _SUFFIXES:
        return
    import difflib  # noqa: PLC0415 - slow to import, for a message only

    meant = "".join(f" (did you mean {one}?)" for one in difflib.get_close_matches(suffix, _SUFFIXES, 1, 0.5))
    if meant or not directory:
        raise BagError(f"{path}: {suffix} is not a bag format{meant}; end the name in {', '.join(_SUFFIXES)}")
