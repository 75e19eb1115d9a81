"""Result files other than bags, written completely or not at all."""

from __future__ import annotations

from os import PathLike, fspath
from pathlib import Path

from odomcorrupt.errors import OdomCorruptError


def refuse_existing(path: Path | None, *, overwrite: bool) -> None:
    """Raise, before any work is done, if an output would replace a file, or its directory does not exist."""
    if path is not None and path.exists() and not overwrite:
        raise OdomCorruptError(f"{path}: exists already; choose another name or pass --overwrite")
    if path is not None and not path.parent.is_dir():
        raise OdomCorruptError(f"{path}: the directory {path.parent} does not exist; create it first")


def write_new(path: str | PathLike[str], data: bytes, *, overwrite: bool) -> Path:
    """Write a file that does not exist, unless it may be replaced; return its path."""
    target = Path(fspath(path))
    refuse_existing(target, overwrite=overwrite)
    write_file(target, data)
    return target


def write_file(path: Path, data: bytes | str, *, overwrite: bool = True) -> None:
    """Write beside the target and rename when complete; text as UTF-8."""
    from odomcorrupt.bags.output import Output  # noqa: PLC0415 - numpy is slow to import, and help writes nothing

    output = Output(path, overwrite=overwrite)
    try:
        output.open()
        output.write(data if isinstance(data, bytes) else data.encode())
        output.commit()
    finally:
        output.discard()
