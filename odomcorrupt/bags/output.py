"""Output of a bag's bytes to a pipe, or to a file that appears only when complete; the kernel copies what is equal."""

from __future__ import annotations

import ctypes
import errno
import glob
import os
import platform
import re
import shutil
import stat
import sys
import threading
import zlib
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, Self

from odomcorrupt.bags.checksum import combined, crc32
from odomcorrupt.bags.pipeline import OrderedResults
from odomcorrupt.errors import BagError

if TYPE_CHECKING:
    from odomcorrupt.bags.pipeline import Workers

_BAG_SUFFIXES = (".yaml", ".db3", ".mcap", ".db3-wal", ".db3-shm", ".zstd", ".zst")
_LEFT = re.compile(r"\.(?P<name>.*)\.(?P<host>[0-9a-f]{8})\.(?P<pid>\d{1,9})\.[0-9a-f]{8}\.partial(?:-.*)?", re.DOTALL)
"""A hidden name, or that of what sqlite3 has beside it."""
_LONGEST_BYTES = 180
"""What is taken over of a name: file systems allow 255 bytes."""
_NO_REPLACE, _EXCHANGE, _KEEP_SIZE = 1, 2, 1
"""Flags of renameat2(2) and of fallocate(2), as Linux's fs.h and falloc.h have them."""
_HERE = -100
"""AT_FDCWD: paths are relative to the working directory."""
_UNKNOWN = (errno.ENOSYS, errno.EINVAL, errno.EOPNOTSUPP, errno.EPERM)
"""What a system or a file system says that has no such rename."""


def refuse_target(path: Path, inputs: list[Path], *, overwrite: bool, directory: bool) -> None:
    """Raise BagError for an output that exists, is or lies in one of the inputs, or whose directory is missing.

    path, inputs : the output, and the bags that are read
    overwrite : whether an existing output may be replaced
    directory : whether the output is a directory
    """
    if not path.parent.is_dir():
        raise BagError(f"{path}: the directory {path.parent} does not exist; create it first")
    for source in inputs:
        if source.is_dir() and Path(os.path.realpath(path)).is_relative_to(os.path.realpath(source)):
            if path.exists() and path.samefile(source):
                break
            raise BagError(f"{path}: lies in the input {source}, which stays as it is; name an output elsewhere")
    if not path.exists() or is_stream(path):
        return
    if any(source.exists() and source.samefile(path) for source in inputs):
        raise BagError(f"{path}: is the input; a bag is not rewritten in place, name another output")
    if not overwrite:
        raise BagError(f"{path}: exists already; name another output or give --overwrite")
    if path.is_dir() != directory:
        kinds = ("a directory", "a file")
        raise BagError(f"{path}: is {kinds[directory]}, {kinds[not directory]} will not replace it; name another")
    if directory and not all(one.suffix in _BAG_SUFFIXES and one.is_file() for one in path.iterdir()):
        raise BagError(f"{path}: contains more than a ROS 2 bag and is not replaced; name another output")


def is_stream(path: Path) -> bool:
    """Return whether a path is a device or named pipe, which must not be replaced."""
    return path.exists() and not path.is_file() and not path.is_dir()


def beside(path: Path) -> Path:
    """Return a hidden temporary path in the same directory."""
    return path.with_name(f".{_stem(path)}.{_host()}.{os.getpid()}.{os.urandom(4).hex()}.partial")


def place(partial: Path, path: Path, *, overwrite: bool) -> None:
    """Rename a complete file or directory, `partial`, to its final name, `path`, atomically.

    A replacement keeps the permissions of the old file and is flushed to disk first; a new file is not flushed.

    Raises
    ------
    BagError
        If the name is taken by now and overwrite is false.
    """
    try:
        if not _rename_flagged(partial, path, _NO_REPLACE):  # the name is reserved first
            if partial.is_dir():
                path.mkdir()
            else:
                os.close(os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY))
            partial.replace(path)
    except FileExistsError as error:
        if not overwrite:
            raise BagError(
                f"{path}: was written by another program in the meantime and is kept; name another output or give "
                "--overwrite"
            ) from error
        with suppress(FileNotFoundError):
            partial.chmod(stat.S_IMODE(path.stat().st_mode))
        for file in partial.iterdir() if partial.is_dir() else [partial]:
            with file.open("rb") as stream:
                os.fsync(stream.fileno())
        _replace(partial, path)


def remove(path: Path) -> None:
    """Remove a hidden file or directory, and sqlite3's files beside it."""
    for one in [path, *path.parent.glob(f"{glob.escape(path.name)}-*")]:
        if one.is_dir() and not one.is_symlink():
            shutil.rmtree(one, ignore_errors=True)
        else:
            one.unlink(missing_ok=True)


def sweep(directory: Path, name: str | None = None) -> None:
    """Remove incomplete outputs of processes of this machine that no longer exist.

    name : name of the output; None for any
    """
    if not directory.is_dir():
        return
    stem = None if name is None else _stem(directory / name)
    with os.scandir(directory) as entries:
        hidden = [entry.name for entry in entries if entry.name.startswith(".") and ".partial" in entry.name]
    for left in hidden:
        found = _LEFT.fullmatch(left)
        if found and stem in (None, found["name"]) and found["host"] == _host() and not _alive(int(found["pid"])):
            with suppress(OSError):
                remove(directory / left)


def _stem(path: Path) -> str:
    return os.fsencode(path.name)[:_LONGEST_BYTES].decode(errors="replace")


def _host() -> str:
    return f"{zlib.crc32(platform.node().encode()):08x}"


def _alive(pid: int) -> bool:
    with suppress(PermissionError):
        try:
            os.kill(pid, 0)
        except (ProcessLookupError, OverflowError):
            return False
    return True


def _replace(partial: Path, path: Path) -> None:
    if not path.is_dir():
        partial.replace(path)
    elif _rename_flagged(partial, path, _EXCHANGE):
        shutil.rmtree(partial)
    else:
        older = beside(path)
        path.replace(older)
        partial.replace(path)
        shutil.rmtree(older)


def _rename_flagged(partial: Path, path: Path, flag: int) -> bool:
    """Rename by renameat2; return whether the call exists."""
    call = getattr(ctypes.CDLL(None, use_errno=True), "renameat2", None) if sys.platform == "linux" else None
    if call is None:
        return False
    if call(_HERE, os.fsencode(partial), _HERE, os.fsencode(path), flag) == 0:
        return True
    code = ctypes.get_errno()
    if code in _UNKNOWN:
        return False
    raise OSError(code, os.strerror(code), str(path))


_AT_ONCE_BYTES = 16 << 20
"""Bytes copied by one system call; an interrupt waits for the end of a call."""


def state_of(descriptor: int) -> list[int]:
    """Return size, device, inode and modification time of an open file: some differ once it is replaced or changed."""
    now = os.fstat(descriptor)
    return [now.st_size, now.st_dev, now.st_ino, now.st_mtime_ns]


_CHANGED = "changed while it was read; the output is discarded, run again once the recording is complete"


class FileCopy:
    """Running copy of a file, from one position to the end; ends early if the system has no such call, or it fails.

    source : file to be copied
    target : descriptor of the file that is written. Its file offset does not change
    begin : position of the first byte to copy
    state : state of the source when it was read; by default its present state
    paused : lock without which no call begins. What is written over the copy is written under it, many pieces at once:
        each would wait for the lock of the file until a call ends

    Raises
    ------
    OSError
        If the source cannot be opened, or is not the file that was read.
    """

    def __init__(
        self, source: Path, target: int, begin: int = 0, state: list[int] | None = None,
        paused: threading.Lock | None = None,
    ) -> None:  # fmt: skip
        self._path = source
        self._source, self._target = os.open(source, os.O_RDONLY | getattr(os, "O_BINARY", 0)), target
        self._state = state_of(self._source)
        if state not in (None, self._state):
            os.close(self._source)
            raise OSError(errno.ESTALE, os.strerror(errno.ESTALE), str(source))
        self._position = begin
        self._ended = self._stopped = False
        self._progress = threading.Condition()
        self._paused = paused or threading.Lock()
        # with its room reserved, a copy takes half the kernel's time on ext4; posix_fallocate writes where it cannot
        if reserve := getattr(ctypes.CDLL(None), "fallocate", None) if sys.platform == "linux" else None:
            reserve(target, _KEEP_SIZE, ctypes.c_long(0), ctypes.c_long(self._state[0]))
        self._thread = threading.Thread(target=self._run, name="copy", daemon=True)
        self._thread.start()

    def reaches(self, end: int | None = None) -> bool:
        """Wait until the bytes before `end`, or all, are copied, or the copy has ended; return whether they are."""
        end = self._state[0] if end is None else end
        if self._position < end:
            with self._progress:
                self._progress.wait_for(lambda: self._position >= end or self._ended)
        return self._position >= end

    def stop(self) -> None:
        """End the copy early."""
        self._stopped = True
        self._thread.join()

    def close(self) -> None:
        """End the copy, and close the source."""
        self.stop()
        os.close(self._source)

    def require_unchanged(self) -> None:
        """Raise BagError if the source was replaced or written to since it was read."""
        if state_of(self._source) != self._state:
            raise BagError(f"{self._path}: {_CHANGED}")

    def _run(self) -> None:
        with suppress(OSError, AttributeError):
            while not self._stopped and (left := self._state[0] - self._position) > 0:
                at = self._position
                with self._paused:
                    pass
                done = os.copy_file_range(self._source, self._target, min(left, _AT_ONCE_BYTES), at, at)
                if not done:
                    break
                with self._progress:
                    self._position += done
                    self._progress.notify_all()
        with self._progress:
            self._ended = True
            self._progress.notify_all()


_AT_POSITIONS = hasattr(os, "pwrite")
"""Whether several threads can write to a file."""


def _write_at(descriptor: int, pieces: list[tuple[int, bytearray | memoryview]], alone: threading.Lock) -> None:
    """Write pieces of a file, each at its position."""
    with alone:
        for position, piece in pieces:
            view, at = memoryview(piece), position
            while view:
                if not _AT_POSITIONS:
                    os.lseek(descriptor, at, os.SEEK_SET)
                done = os.pwrite(descriptor, view, at) if _AT_POSITIONS else os.write(descriptor, view)
                view, at = view[done:], at + done


_BUFFER_BYTES = 1 << 16
"""Number of bytes of a file that are collected; larger pieces are not copied."""

_KEPT_BYTES = 4 << 20
"""The same of bytes written over the kernel's copy, which each write holds up; and how many wait for other threads."""


@dataclass(slots=True, eq=False, repr=False)
class Original:
    """Bytes of the input file that the output repeats, except for spans that may change, which alone are in memory.

    path, descriptor, state : the input file, open, and its state when it was read
    position, crc : of the first of these bytes in the file, and the CRC-32 of all
    spans : begin and end of each span, relative to `position`
    spans_crc : CRC-32 of the spans as they were, see `crc_of_spans`
    """

    path: Path
    descriptor: int
    state: list[int]
    position: int
    crc: int
    spans: list[tuple[int, int]]
    spans_crc: int

    def crc_with(self, piece: memoryview) -> int:
        """Return the CRC-32 of the bytes with the spans of a piece: a CRC is affine in the bytes."""
        return self.crc ^ self.spans_crc ^ crc_of_spans(piece, self.spans)

    def with_rest(self, piece: memoryview) -> memoryview:
        """Return a piece with the bytes between its spans, which are read again."""
        whole = memoryview(bytearray(len(piece)))
        if os.preadv(self.descriptor, [whole], self.position) < len(piece) or crc32(whole) != self.crc:
            raise BagError(f"{self.path}: {_CHANGED}")
        for begin, end in self.spans:
            whole[begin:end] = piece[begin:end]
        return whole


def crc_of_spans(piece: memoryview, spans: list[tuple[int, int]]) -> int:
    """Return the CRC-32 of spans, which differs from that of other bytes in them as that of the whole piece would."""
    crc = last = 0
    for begin, end in spans:
        crc = combined(crc, crc32(piece[begin:end]), end - last)
        last = end
    return combined(crc, 0, len(piece) - last)


class Output:
    """A file or stream being written.

    name : name in error messages
    overwrite : whether it may replace a file
    position : bytes written so far
    summing : whether the CRC is computed
    writes : how bytes are written to a file: with threads, what is passed to `write` must not change before `settle`
    crc : CRC-32 of the bytes since the last call of `restart_crc`
    """

    def __init__(self, path: Path | None, stream: BinaryIO | None = None, *, overwrite: bool = False) -> None:
        self.overwrite = overwrite
        self.name = "stdout" if path is None else str(path)
        self.position = 0
        self.summing = True
        self.crc = 0
        self._earlier_crc = self._crc_begin = 0
        self._path = path
        self._partial: Path | None = None
        self._stream = stream
        self._kept: list[tuple[int, bytearray | memoryview]] = []  # pieces not yet written, and where they belong
        self._kept_bytes = 0
        self.writes = OrderedResults(None)
        self._alone = threading.Lock()  # two threads that write to one file would burn time until one may
        self._copy: FileCopy | None = None
        self._over: FileCopy | None = None  # the same, as long as bytes are written over it

    def open(self) -> None:
        """Open a hidden temporary file in the target's directory, or the stream itself; discard it if that fails."""
        if self._path is None:
            return
        if is_stream(self._path):
            try:
                self._stream = self._path.open("wb")
            except OSError as error:
                raise self._failed(error) from error
            return
        self._path = Path(os.path.realpath(self._path))
        self._partial = beside(self._path)
        try:
            sweep(self._path.parent, self._path.name)
            # Not tempfile: its files are readable by their owner only, and keep that when renamed.
            self._stream = self._partial.open("xb", buffering=0)
        except OSError as error:
            raise BagError(f"{self.name}: cannot be written: {error.strerror}") from error

    @property
    def crc_of_all(self) -> int | None:
        """CRC-32 of all bytes written; None if it was not computed."""
        if not self.summing or not self._crc_begin:
            return self.crc if self.summing else None
        return combined(self._earlier_crc, self.crc, self.position - self._crc_begin)

    def restart_crc(self) -> None:
        """Begin a CRC of the bytes that follow."""
        self._earlier_crc, self._crc_begin, self.crc = self.crc_of_all or 0, self.position, 0

    def write(self, *pieces: bytes | memoryview) -> None:
        """Write bytes, all of them."""
        for piece in pieces:
            if self.summing:
                self.crc = crc32(piece, self.crc)
            self._put(memoryview(piece))

    def write_summed(self, piece: bytes | memoryview, crc: int, original: Original | None = None) -> None:
        """Write bytes whose CRC-32 is known; if they are copied from an original, write only its spans."""
        if self.summing:
            self.crc = combined(self.crc, crc, len(piece))
        self._put(memoryview(piece), original)

    def _put(self, view: memoryview, original: Original | None = None) -> None:
        stream = self._stream
        if stream is None:
            raise BagError(f"{self.name}: is not open")
        try:
            over = self._over if original is None else self._copied(original, stream)
            if over is not None and over.reaches(self.position + len(view)):
                for begin, end in [(0, len(view))] if original is None else original.spans:
                    self._keep(self.position + begin, view[begin:end])
                self.position += len(view)
                return
            if self._over is not None:  # from now on all bytes are written
                self._flush()
                self._over = None
            view = view if original is None else original.with_rest(view)
            if self._partial is not None:
                self._keep(self.position, view)
                self.position += len(view)
                return
            while view:  # an unbuffered stdout may take a part only
                done = stream.write(view)
                self.position += done
                view = view[done:]
        except BagError:
            raise
        except OSError as error:
            raise self._failed(error) from error

    def _keep(self, position: int, view: memoryview) -> None:
        """Write bytes to a file, now or later."""
        begin, last = self._kept[-1] if self._kept else (0, view)
        if len(view) > _BUFFER_BYTES:
            self._kept.append((position, view))
        elif isinstance(last, bytearray) and begin + len(last) == position:
            last.extend(view)
        else:
            self._kept.append((position, bytearray(view)))
        self._kept_bytes += len(view)
        if self._kept_bytes > (_BUFFER_BYTES if self._over is None else _KEPT_BYTES):
            self._flush()

    def _flush(self) -> None:
        """Write what was kept, or have a thread do it."""
        if self._kept and self._stream is not None:
            write = partial(_write_at, self._stream.fileno(), self._kept, self._alone)
            size, self._kept, self._kept_bytes = self._kept_bytes, [], 0
            self.writes.put(write, lambda _: None, size)

    def settle(self) -> None:
        """Wait until all bytes passed to `write` are written."""
        try:
            self._flush()
            self.writes.finish()
        except OSError as error:
            raise self._failed(error) from error

    def _copied(self, original: Original, stream: BinaryIO) -> FileCopy | None:
        """Return the copy that is written over, if an original's bytes are here in it; the first call starts it."""
        if self._partial is None or original.position != self.position:
            if self._copy is not None:
                self._copy.stop()
            return None
        if self._copy is None:
            self._flush()
            with suppress(OSError):  # the input was moved or replaced; the reader's open file is still valid
                copied = original.path, stream.fileno(), self.position, original.state
                self._copy = self._over = FileCopy(*copied, self._alone)
        return self._over

    def rewrite(self, position: int, data: bytes) -> None:
        """Overwrite bytes of a file."""
        if self._partial is None:
            raise BagError(f"{self.name}: cannot seek; write this format to a file")
        self.settle()
        self._kept.append((position, bytearray(data)))

    def commit(self) -> None:
        """Close the file and rename it to its final name."""
        if self._stream is None:
            return
        try:
            if self._copy is not None:
                self._copy.stop()
                self.settle()
                self._copy.require_unchanged()
                self._stream.truncate(self.position)
            self.settle()
            self._stream.flush()
            if self._partial is not None and self._path is not None:
                self._stream.close()
                place(self._partial, self._path, overwrite=self.overwrite)
            elif self._path is not None:
                self._stream.close()
        except BagError:
            raise
        except OSError as error:
            raise self._failed(error) from error

    def discard(self) -> None:
        """Remove the temporary file, also where an interrupt came before it was known to be open."""
        self.writes.drop()
        if self._copy is not None:
            self._copy.close()
            self._copy = None
        if self._path is None:
            return
        with suppress(OSError):
            if self._stream is not None:
                self._stream.close()
        if self._partial is not None:
            self._partial.unlink(missing_ok=True)

    def _failed(self, error: OSError) -> BagError:
        if isinstance(error, BrokenPipeError):
            return BagError(f"{self.name}: closed by its reader after {self.position} bytes")
        return BagError(f"{self.name}: cannot be written: {error.strerror} (after {self.position} bytes)")


class OutputContext:
    """Base class of writers of one output, which appears when the context ends without an error, else nothing does.

    workers : threads for compression and writing; what is written must then not change before `settle`
    """

    def __init__(self, output: Output, workers: Workers | None = None) -> None:
        self._output = output
        self._results = OrderedResults(workers)
        output.writes = OrderedResults(workers if _AT_POSITIONS else None, _KEPT_BYTES)

    def settle(self) -> None:
        """Wait until all blocks passed to `write` are written and may change."""
        self._results.finish()
        self._output.settle()

    @property
    def crc(self) -> int | None:
        """CRC-32 of the whole output after the context's end; None if it was not computed."""
        return self._output.crc_of_all

    def _begin(self) -> None:
        """Write what the output begins with."""

    def _finish(self) -> None:
        """Write what it ends with."""

    def __enter__(self) -> Self:
        try:
            self._output.open()
            self._begin()
        except BaseException:
            self._output.discard()
            raise
        return self

    def __exit__(self, kind: type[BaseException] | None, *_error: object) -> None:
        try:
            if kind is None:
                self._finish()
                self._output.commit()
        finally:
            # After a commit there is nothing left to discard.
            self._output.discard()
