"""Sequential reading of a bag's bytes from a file or a pipe; every stated length is checked before use."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, NamedTuple, Self

import numpy as np

from odomcorrupt.bags.budget import Budget, BufferPool
from odomcorrupt.bags.checksum import crc32, crc_of_both
from odomcorrupt.bags.output import FileState
from odomcorrupt.errors import BagError

if TYPE_CHECKING:
    from numpy.typing import NDArray

_BUFFER_BYTES = 1 << 16
"""What is read ahead: small records want some, and of a large one as much is copied twice."""
_TRUSTED_BYTES = 1 << 24
"""How much a pipe's claim of a length is allocated at once; beyond, memory grows with the bytes that really come."""

_LARGEST_BYTES = 1 << 32
"""More than that no chunk can have; an endless pipe must not fill the memory."""


def not_the_end(name: str, end: int) -> str:
    """Return the sentence for a file that goes on behind the end of its bag."""
    return f"{name}: goes on behind the end of the bag at byte {end}; give bags that `cat` joined one by one"


def temporary_folder(copies: ExitStack) -> Path:
    """Return a new folder, which is removed when `copies` is closed."""
    import tempfile  # noqa: PLC0415 - slow to import, and seldom needed

    return Path(copies.enter_context(tempfile.TemporaryDirectory(prefix="odomcorrupt")))


def temporary_copy(stream: BinaryIO, path: Path, name: str) -> Path:
    """Write the rest of a stream to a file in a temporary folder; return its path.

    Raises
    ------
    BagError
        If it cannot be read, or there is not enough space.
    """
    import shutil  # noqa: PLC0415 - as above

    try:
        with path.open("wb") as file:
            shutil.copyfileobj(stream, file, _BUFFER_BYTES)
    except OSError as error:
        raise BagError(
            f"{name}: cannot be copied to a temporary file: {error.strerror}; TMPDIR names another directory for it"
        ) from error
    return path


class Summed(NamedTuple):
    """Bytes read, and their CRC-32."""

    data: NDArray[np.uint8]
    crc: int


class Source:
    """A bag's bytes, read forwards.

    name : name in error messages
    size : file size in bytes, or None for a pipe
    position : bytes read so far
    summing : whether the CRC is computed
    crc : CRC-32 of the bytes read since it was last set to 0
    pool : allocator of chunk buffers
    budget : limit of decompressed bytes
    """

    def __init__(self, stream: BinaryIO, name: str) -> None:
        self._stream = stream
        self._owned = False
        self.name = name
        self.size: int | None = None
        self.position = 0
        self.summing = False
        self.crc = 0
        self._ahead = b""
        self._scratch = np.empty(0, dtype=np.uint8)
        self.pool = BufferPool()
        self.budget = Budget()

    @classmethod
    def of_file(cls, path: Path, name: str | None = None) -> Self:
        """Return a source that reads a file, which is opened; its name in messages is by default its path."""
        try:
            stream = path.open("rb", buffering=_BUFFER_BYTES)
        except OSError as error:
            raise BagError(f"{name or path}: cannot be opened: {error.strerror}") from error
        source = cls(stream, name or str(path))
        source._owned = True
        source.size = path.stat().st_size if stream.seekable() else None
        return source

    def state(self) -> FileState:
        """Return the state of the open file, to detect later changes."""
        return FileState.of(self._stream.fileno())

    def spooled(self) -> Self:
        """Return the rest of a pipe as a source on a temporary, seekable file, removed once it is closed."""
        with ExitStack() as copies:
            source = type(self).of_file(temporary_copy(self._stream, temporary_folder(copies) / "bag", self.name))
        source.name = self.name
        return source

    def sniff(self, size: int) -> bytes:
        """Return the first bytes without consuming them; fewer where the input is shorter."""
        try:
            while len(self._ahead) < size and (more := self._stream.read(size - len(self._ahead))):
                self._ahead += more
        except OSError as error:
            raise BagError(f"{self.name}: cannot be read: {error.strerror}") from error
        return self._ahead[:size]

    def seek(self, position: int) -> None:
        """Seek to a byte of a file."""
        self._stream.seek(position)
        self._ahead = b""
        self.position = position

    def skip_to(self, position: int) -> bool:
        """Skip forwards to a byte; return whether the input is that long."""
        if self.size is not None:
            self.seek(min(position, self.size))
            return position <= self.size
        try:
            self.skim(position - self.position, "skipped bytes")
        except BagError:
            return False
        return True

    def skim(self, size: int, what: str) -> None:
        """Read `size` bytes for their checksum only."""
        end = self.position + size
        while self.position < end:
            self.read_scratch(min(end - self.position, _BUFFER_BYTES), what)

    def require(self, size: int, what: str) -> None:
        """Raise BagError for a length beyond the end of the file."""
        if self.size is not None and size > self.size - self.position:
            raise self.cut(what, size, self.size - self.position)

    def cut(self, what: str, wanted: int, left: int) -> BagError:
        """Return the error that says the input ends early."""
        return BagError(
            f"{self.name}: {what} at byte {self.position} needs {wanted} bytes, {left} are left: the bag is "
            "truncated or damaged; --recover saves the intact part"
        )

    def read(self, size: int, what: str) -> bytes:
        """Return exactly `size` bytes; for small records."""
        if not self._ahead and size <= _TRUSTED_BYTES:
            self.require(size, what)
            try:
                data = self._stream.read(size)
            except OSError as error:
                raise BagError(f"{self.name}: cannot be read: {error.strerror}") from error
            if len(data) == size:
                self.position += size
                if self.summing:
                    self.crc = crc32(data, self.crc)
                return data
            self._ahead = data
        if size > _TRUSTED_BYTES:
            return self.read_array(size, what).tobytes()
        self.require(size, what)
        small = bytearray(size)
        self._fill(memoryview(small), what)
        return bytes(small)

    def at_end(self) -> bool:
        """Return whether the input is at its end."""
        return not self.sniff(1)

    def require_end(self) -> None:
        """Raise BagError if anything follows the end of the bag, such as a second one."""
        if not self.at_end():
            raise BagError(not_the_end(self.name, self.position))

    def read_array(self, size: int, what: str) -> NDArray[np.uint8]:
        """Return exactly `size` bytes in a new writable array."""
        self.require(size, what)
        if self.size is not None or size <= _TRUSTED_BYTES:
            data = self.pool.place(size)
            self._fill(data.data, what)
            return data
        pieces: list[NDArray[np.uint8]] = []
        for begin in range(0, size, _TRUSTED_BYTES):
            if begin >= _LARGEST_BYTES:
                raise BagError(
                    f"{self.name}: {what} has a stated length of {size} bytes; the bag is damaged, or must be read "
                    "from a file"
                )
            pieces.append(np.empty(min(_TRUSTED_BYTES, size - begin), dtype=np.uint8))
            self._fill(pieces[-1].data, what)
        return np.concatenate(pieces)

    def read_summed(self, size: int, what: str) -> Summed:
        """Return exactly `size` bytes in a new writable array, with their CRC-32."""
        summing, before = self.summing, self.crc
        self.summing, self.crc = True, 0
        data = self.read_array(size, what)
        crc, self.summing = self.crc, summing
        self.crc = crc_of_both(before, crc, data.data) if summing else before
        return Summed(data, crc)

    def read_scratch(self, size: int, what: str) -> memoryview:
        """Return exactly `size` bytes in a buffer that the next call overwrites."""
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
        if self.summing:
            self.crc = crc32(view, self.crc)

    def close(self) -> None:
        """Close a file; a pipe is left to the caller."""
        if self._owned:
            self._stream.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()
