"""The bytes of a bag in order, from a file or a pipe, with every claimed length checked before it is believed."""

from __future__ import annotations

import shutil
import tempfile
from typing import TYPE_CHECKING, BinaryIO, Self

import numpy as np

from odomcorrupt.bags.budget import Budget
from odomcorrupt.bags.buffer_pool import BufferPool
from odomcorrupt.errors import BagError

if TYPE_CHECKING:
    from pathlib import Path
    from types import TracebackType

    from numpy.typing import NDArray

__all__ = ["Source"]

_BUFFER_BYTES = 1 << 16
"""What is read ahead: small records want some, and of a large one as much is copied twice."""
_TRUSTED_BYTES = 1 << 24
"""How much a pipe's claim of a length is allocated at once; beyond, memory grows with the bytes that really come."""

_LARGEST_BYTES = 1 << 32
"""More than that no chunk can have; an endless pipe must not fill the memory."""


class Source:
    """A bag's bytes, read forwards.

    name : what errors call it
    size : of the file in bytes, or None for a pipe
    position : bytes read so far
    shelf : where chunks are put
    budget : how much may come out of them
    """

    def __init__(self, stream: BinaryIO, name: str) -> None:
        self._stream = stream
        self._owned = False
        self.name = name
        self.size: int | None = None
        self.position = 0
        self._ahead = b""
        self._scratch = np.empty(0, dtype=np.uint8)
        self.shelf = BufferPool()
        self.budget = Budget()

    @classmethod
    def of_file(cls, path: Path) -> Self:
        """Open a file."""
        try:
            stream = path.open("rb", buffering=_BUFFER_BYTES)
        except OSError as error:
            raise BagError(f"{path}: cannot be opened: {error.strerror}") from error
        source = cls(stream, str(path))
        source._owned = True
        source.size = path.stat().st_size if stream.seekable() else None
        return source

    def spooled(self) -> Self:
        """Return the rest of a pipe as a file without a name, in which one can go back."""
        stream = tempfile.TemporaryFile(prefix="odomcorrupt")  # noqa: SIM115 - closed by the source that is returned
        try:
            shutil.copyfileobj(self._stream, stream, _BUFFER_BYTES)
            size = stream.tell()
            stream.seek(0)
        except OSError as error:
            stream.close()
            raise BagError(f"{self.name}: cannot be kept while it is read: {error.strerror}; name a file") from error
        source = type(self)(stream, self.name)
        source._owned = True  # noqa: SLF001 - its own class
        source.size = size
        return source

    def sniff(self, size: int) -> bytes:
        """Return the first bytes without stepping over them; fewer where the input is shorter."""
        try:
            while len(self._ahead) < size and (more := self._stream.read(size - len(self._ahead))):
                self._ahead += more
        except OSError as error:
            raise BagError(f"{self.name}: cannot be read: {error.strerror}") from error
        return self._ahead[:size]

    def seek(self, position: int) -> None:
        """Go to a byte of a file."""
        self._stream.seek(position)
        self._ahead = b""
        self.position = position

    def skip_to(self, position: int) -> bool:
        """Go forwards to a byte; return whether the input reaches so far."""
        if self.size is not None:
            self.seek(min(position, self.size))
            return position <= self.size
        try:
            while self.position < position:
                self.read_scratch(min(position - self.position, _BUFFER_BYTES), "skipped bytes")
        except BagError:
            return False
        return True

    def require(self, size: int, what: str) -> None:
        """Refuse a length that reaches beyond the file."""
        if self.size is not None and size > self.size - self.position:
            raise self.cut(what, size, self.size - self.position)

    def cut(self, what: str, wanted: int, left: int) -> BagError:
        """Return the error that says the input ends early."""
        return BagError(
            f"{self.name}: {what} at byte {self.position} needs {wanted} bytes, {left} are left: the bag is "
            "truncated or damaged; --recover saves what is whole"
        )

    def read(self, size: int, what: str) -> bytes:
        """Read exactly so many bytes, meant for small things."""
        if not self._ahead and size <= _TRUSTED_BYTES:
            self.require(size, what)
            try:
                data = self._stream.read(size)
            except OSError as error:
                raise BagError(f"{self.name}: cannot be read: {error.strerror}") from error
            if len(data) == size:
                self.position += size
                return data
            self._ahead = data
        if size > _TRUSTED_BYTES:
            return self.read_array(size, what).tobytes()
        self.require(size, what)
        small = bytearray(size)
        self._fill(memoryview(small), what)
        return bytes(small)

    def at_end(self) -> bool:
        """Tell whether nothing is left."""
        return not self.sniff(1)

    def read_array(self, size: int, what: str) -> NDArray[np.uint8]:
        """Read exactly so many bytes into a writable array of their own."""
        self.require(size, what)
        if self.size is not None or size <= _TRUSTED_BYTES:
            data = self.shelf.place(size)
            self._fill(data.data, what)
            return data
        pieces: list[NDArray[np.uint8]] = []
        for begin in range(0, size, _TRUSTED_BYTES):
            if begin >= _LARGEST_BYTES:
                raise BagError(f"{self.name}: {what} claims {size} bytes at once; damaged, or to be read from a file")
            pieces.append(np.empty(min(_TRUSTED_BYTES, size - begin), dtype=np.uint8))
            self._fill(pieces[-1].data, what)
        return np.concatenate(pieces)

    def read_scratch(self, size: int, what: str) -> memoryview:
        """Read exactly so many bytes into a buffer that the next call uses again."""
        self.require(size, what)
        if self.size is None and size > max(_TRUSTED_BYTES, self._scratch.size):
            return self.read_array(size, what).data
        if self._scratch.size < size:
            self._scratch = np.empty(size + size // 4, dtype=np.uint8)
        view = self._scratch.data[:size]
        self._fill(view, what)
        return view

    def _fill(self, view: memoryview, what: str) -> None:
        begin = min(len(self._ahead), len(view))
        view[:begin] = self._ahead[:begin]
        self._ahead = self._ahead[begin:]
        try:
            # A BufferedReader's readinto is complete; an unbuffered stream's may be short.
            while begin < len(view) and (got := self._stream.readinto(view[begin:])):  # type: ignore[attr-defined]
                begin += got
        except OSError as error:
            raise BagError(f"{self.name}: cannot be read: {error.strerror}") from error
        if begin < len(view):
            raise self.cut(what, len(view), begin)
        self.position += begin

    def close(self) -> None:
        """Close a file; a pipe belongs to who gave it."""
        if self._owned:
            self._stream.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
