"""Result files, written whole or not at all."""

from __future__ import annotations

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
    from odomcorrupt.bags.output import Output  # noqa: PLC0415 - numpy is slow to import, and help writes nothing

    output = Output(path, overwrite=True)
    output.open()
    try:
        output.write(data)
        output.commit()
    finally:
        output.discard()
