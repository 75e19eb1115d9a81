"""Result files, written whole or not at all."""

from __future__ import annotations

import os
import tempfile
from contextlib import suppress
from typing import TYPE_CHECKING

from odomcorrupt.errors import OdomCorruptError

if TYPE_CHECKING:
    from pathlib import Path

__all__ = ["refuse_existing", "write_bytes", "write_text"]


def refuse_existing(path: Path | None, *, overwrite: bool) -> None:
    """Raise before any work is done, where an output would replace something, or has no place to be."""
    if path is not None and path.exists() and not overwrite:
        raise OdomCorruptError(f"{path}: exists already; choose another name or pass --overwrite")
    if path is not None and not path.parent.is_dir():
        raise OdomCorruptError(f"{path}: the directory {path.parent} does not exist; create it first")


def write_text(path: Path, text: str) -> None:
    """Write text as UTF-8, whole or not at all."""
    write_bytes(path, text.encode())


def write_bytes(path: Path, data: bytes) -> None:
    """Write beside the target and rename when complete."""
    try:
        handle, beside = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    except OSError as error:
        raise OdomCorruptError(f"{path}: cannot be written ({error.strerror})") from error
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(data)
        umask = os.umask(0)
        os.umask(umask)
        os.chmod(beside, 0o666 & ~umask)  # noqa: PTH101 - a mkstemp file is private until here
        os.replace(beside, path)  # noqa: PTH105 - as above
    except OSError as error:
        raise OdomCorruptError(f"{path}: cannot be written ({error.strerror})") from error
    finally:
        with suppress(FileNotFoundError):
            os.unlink(beside)  # noqa: PTH108 - as above
