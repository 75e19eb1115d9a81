"""Small input files, which must be regular files.

Maps, models, trajectories, tables of defaults, metadata and a batch's own files are opened here. A pipe, device or
socket in their place is refused, because reading it could block for ever. Bags are opened in `bags`.
"""

from __future__ import annotations

import os
import stat
from itertools import islice
from typing import TYPE_CHECKING, Any, BinaryIO

from odomcorrupt.errors import OdomCorruptError

if TYPE_CHECKING:
    from pathlib import Path

_KINDS = {
    stat.S_IFDIR: "a directory", stat.S_IFIFO: "a pipe", stat.S_IFSOCK: "a socket", stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
}  # fmt: skip
TOML_BYTES = 1 << 20
"""Largest size of a TOML text."""
_MOST_DOTS = 2000
"""Largest number of dots in a line of TOML: the parser's time grows with the square of the parts of a dotted key."""


def open_input(path: Path, error: type[Exception] = OdomCorruptError) -> BinaryIO:
    """Open a regular file for reading.

    path : the file, or a link to it
    error : class of the error

    Raises
    ------
    OdomCorruptError
        (`error`) If it cannot be opened, or is a pipe, device, socket or directory.
    """
    try:
        # checked before opening: opening alone triggers some devices, and blocks until a pipe has a writer
        if stat.S_ISREG(mode := path.stat().st_mode):
            # it may have been replaced by a pipe since: that would wait for a writer
            at_once = getattr(os, "O_NONBLOCK", 0)
            stream = open(path, "rb", opener=lambda name, flags: os.open(name, flags | at_once))  # noqa: SIM115
            if stat.S_ISREG(mode := os.fstat(stream.fileno()).st_mode):
                return stream
            stream.close()
    except (OSError, ValueError) as failure:  # ValueError: a name with a zero byte
        raise error(f"{path}: cannot be read: {getattr(failure, 'strerror', None) or failure}") from failure
    raise error(f"{path}: is {_KINDS.get(stat.S_IFMT(mode), 'no file')}; name a regular file")


def read_input(path: Path, most: int, what: str, error: type[Exception] = OdomCorruptError) -> bytes:
    """Return the content of a regular file of at most `most` bytes.

    most, what : largest size, bytes, and the expected content for the error, as in "model file"
    error : class of the error

    Raises
    ------
    OdomCorruptError
        (`error`) If it cannot be read, is larger, or not a regular file.
    """
    with open_input(path, error) as stream:
        try:
            # in parts, because one read of the whole limit allocates it
            data = b"".join(islice(iter(lambda: stream.read(1 << 16), b""), (most >> 16) + 1))
        except OSError as failure:
            raise error(f"{path}: cannot be read: {failure.strerror}") from failure
    if len(data) > most:
        raise error(f"{path}: more than {most} bytes; that is not a {what}")
    return data


def parse_toml(text: str) -> dict[str, Any]:
    """Return the table of a TOML text.

    Raises
    ------
    ValueError
        If it is invalid, too long, or nested too deeply.
    """
    import tomllib  # noqa: PLC0415 - not needed for most commands

    if len(text) > TOML_BYTES:
        raise ValueError(f"it has more than {TOML_BYTES} characters")
    if any(line.count(".") > _MOST_DOTS for line in text.splitlines()):
        raise ValueError(f"a line has more than {_MOST_DOTS} dots")
    try:
        return tomllib.loads(text)
    except RecursionError as error:
        raise ValueError("it is nested too deeply") from error
