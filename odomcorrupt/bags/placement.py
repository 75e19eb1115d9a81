"""Atomic outputs: written under a hidden name, renamed when complete, replacing a file only on request.

A killed process leaves its hidden file, whose name contains host and process; the next output of the same name
removes it if that process no longer exists.
"""

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
import zlib
from contextlib import suppress
from pathlib import Path

from odomcorrupt.errors import BagError

_BAG_SUFFIXES = (".yaml", ".db3", ".mcap", ".db3-wal", ".db3-shm", ".zstd", ".zst")
_LEFT = re.compile(r"\.(?P<name>.*)\.(?P<host>[0-9a-f]{8})\.(?P<pid>\d{1,9})\.[0-9a-f]{8}\.partial(?:-.*)?", re.DOTALL)
"""A hidden name, or that of what sqlite3 has beside it."""
_LONGEST_BYTES = 180
"""What is taken over of a name: file systems allow 255 bytes."""
_NO_REPLACE, _EXCHANGE = 1, 2
"""Flags of renameat2(2), as Linux's fs.h has them."""
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
        raise BagError(
            f"{path}: is {kinds[directory]}, {kinds[not directory]} will not replace it; name another output"
        )
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
        _rename_new(partial, path)
    except FileExistsError as error:
        if not overwrite:
            raise BagError(
                f"{path}: was written by another program in the meantime and is kept; name another output or give "
                "--overwrite"
            ) from error
        with suppress(FileNotFoundError):
            partial.chmod(stat.S_IMODE(path.stat().st_mode))
        _sync(partial)
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
    try:
        os.kill(pid, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        return True
    return True


def _rename_new(partial: Path, path: Path) -> None:
    """Rename without replacing; where the kernel cannot, the name is reserved first."""
    if _rename_flagged(partial, path, _NO_REPLACE):
        return
    if partial.is_dir():
        path.mkdir()
    else:
        os.close(os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY))
    partial.replace(path)


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


def _sync(path: Path) -> None:
    for file in path.iterdir() if path.is_dir() else [path]:
        with file.open("rb") as stream:
            os.fsync(stream.fileno())
