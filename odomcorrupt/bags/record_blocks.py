"""Blocks of whole records from the stream of a large chunk, so that its size does not decide on the memory."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.errors import BagError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

__all__ = ["LARGE_BYTES", "record_blocks"]

LARGE_BYTES = 32 << 20
"""Decompressed size of a chunk beyond which it is read as several: recorders write 0.8 to 4 MB."""

_BLOCK_BYTES = 4 << 20
"""What is read of a large chunk at once, if no record is larger; the writers make a chunk of it."""

_LARGEST_RECORD_BYTES = 1 << 32
"""An endless pipe must not fill the memory."""


def record_blocks(
    pieces: Iterator[bytes | memoryview],
    size: int,
    record_bytes: Callable[[memoryview, int], int],
    place: Callable[[int], NDArray[np.uint8]],
    what: str,
) -> Iterator[NDArray[np.uint8]]:
    """Yield the records of a chunk in blocks of about 4 MB, or of one record that is larger.

    The blocks do not depend on how the stream is divided into pieces. The last one ends in the middle of a record if
    the chunk does; if a record cannot be one, or is larger than what is left of the chunk, that block is the last and
    is yielded when the stream has come to its end, where its checksum is compared.

    Parameters
    ----------
    pieces : Iterator
        The decompressed chunk, none of them empty.
    size : int
        Its stated size, bytes.
    record_bytes : Callable
        Size of the record that begins at an offset of the data, bytes; less if its header is not whole, but more than
        the data has; 0 if it is no record.
    place : Callable
        Allocator of buffers.
    what : str
        Name of the chunk in error messages.

    Raises
    ------
    BagError
        If there is no memory for one of its records.

    """
    piece, rest, wanted, behind = memoryview(b""), np.empty(0, dtype=np.uint8), _BLOCK_BYTES, 0
    while True:
        try:
            buffer = place(wanted)
        except MemoryError as error:
            raise BagError(f"{what}: there is no memory for a record of {wanted} bytes in it") from error
        filled = rest.size
        buffer[:filled] = rest
        while filled < wanted and (piece or (piece := memoryview(next(pieces, b"")))):
            taken = min(len(piece), wanted - filled)
            buffer.data[filled : filled + taken] = piece[:taken]
            piece, filled = piece[taken:], filled + taken
        end, needed = _last_end(buffer.data[:filled], record_bytes)
        if end:
            yield buffer[:end]
        rest, behind = buffer[end:filled], behind + end
        whole = filled < wanted
        if not whole and rest.size and not 0 < needed <= min(size - behind, _LARGEST_RECORD_BYTES):
            for _ in pieces:
                pass
            whole = True
        if whole:
            if rest.size:
                yield rest
            return
        wanted = max(_BLOCK_BYTES, needed)


def _last_end(data: memoryview, record_bytes: Callable[[memoryview, int], int]) -> tuple[int, int]:
    """Return where the last whole record ends, and the size of the one that begins there."""
    at, needed = 0, 0
    while at < len(data):
        needed = record_bytes(data, at)
        if not 0 < needed <= len(data) - at:
            break
        at, needed = at + needed, 0
    return at, needed
