"""Byte-identical output where nothing in a bag changes, for files and pipes."""

from __future__ import annotations

import sys
from contextlib import nullcontext
from typing import TYPE_CHECKING, BinaryIO

from odomcorrupt.bags.open import kind_of
from odomcorrupt.bags.output import Output

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable
    from pathlib import Path

    from odomcorrupt.bags.block import BagReader, Block

__all__ = ["TeeReader", "may_stay", "write_as_it_was"]

_PIECE_BYTES = 1 << 16


def may_stay(source: Path | None, target: Path | None, reader: BagReader) -> bool:
    """Whether an output may be a byte copy of its input: one file, or a pipe, and the same format."""
    if source is not None and source.is_dir():
        return False
    if source is not None and reader.kind == "sqlite3":
        from odomcorrupt.bags.rosbag2.database import has_log  # noqa: PLC0415 - sqlite3 is slow to import

        if has_log(source):
            return False
    one_file = target is None or reader.kind != "sqlite3" or bool(target.suffix)
    return one_file and kind_of(target, reader) == reader.kind


class TeeReader:
    """Stream that records the bytes read from a pipe, so that they can be copied to an output."""

    def __init__(self, stream: BinaryIO | None = None) -> None:
        self._stream: BinaryIO = sys.stdin.buffer if stream is None else stream
        self._kept = bytearray()
        self._output: Output | None = None
        self._recording = True

    def read(self, size: int = -1) -> bytes:
        """Read bytes."""
        data = self._stream.read(size)
        self._take(data)
        return data

    def readinto(self, view: memoryview) -> int:
        """Read bytes into a buffer."""
        got: int = self._stream.readinto(view)  # type: ignore[attr-defined] # a buffered stream has it
        self._take(view[:got])
        return got

    def _take(self, data: bytes | memoryview) -> None:
        if self._output is not None:
            self._output.write(data)
        elif self._recording:
            self._kept += data

    def play(self, output: Output) -> None:
        """Write the bytes read so far to an output, and from now on all that are read."""
        self._output = output
        output.write(bytes(self._kept))
        self._kept.clear()

    def stop(self) -> None:
        """Stop recording."""
        self._recording = False
        self._kept.clear()


def write_as_it_was(
    bag: TeeReader | Path,
    target: Path | None,
    blocks: Iterable[Block],
    watch: Callable[[Block], None],
    *,
    overwrite: bool = False,
) -> None:
    """Copy a bag byte by byte after reading its blocks (a pipe: while reading); `watch` is called with each block."""
    output = Output(target, sys.stdout.buffer if target is None else None, overwrite=overwrite)
    output.summing = False
    try:
        output.open()
        if isinstance(bag, TeeReader):
            bag.play(output)
        for block in blocks:
            watch(block)
        with nullcontext(bag) if isinstance(bag, TeeReader) else bag.open("rb") as rest:
            while piece := rest.read(_PIECE_BYTES):
                if rest is not bag:
                    output.write(piece)
        output.commit()
    except BaseException:
        output.discard()
        raise
