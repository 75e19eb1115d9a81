"""Sequential reading of a bag's bytes from a file or a pipe; every stated length is checked before use."""

from __future__ import annotations

import mmap
import os
import re
import weakref
from contextlib import ExitStack, contextmanager
from functools import cached_property
from io import BufferedReader
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, Final, NamedTuple, Self

import numpy as np

from odomcorrupt.bags.checksum import combined, crc32
from odomcorrupt.errors import BagError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray


VARIABLE = "ODOMCORRUPT_MAX_UNPACKED"
"""Environment variable that sets the allowance of a chunk and of a bag; processes of a batch inherit it."""

_TIMES = 1000
"""What a bag may unpack to, in its own size, beyond the allowance; recorders reach 2 to 50, black images a thousand."""

_UNITS = {"B": 1, "K": 1 << 10, "M": 1 << 20, "G": 1 << 30, "T": 1 << 40}
_SIZE = re.compile(r"([0-9]{1,15}(?:\.[0-9]{1,15})?) *(B|[KMGT](?:I?B)?)", re.IGNORECASE)


class _Allowance(NamedTuple):
    """Decompressed bytes of any chunk, and of any bag beyond a multiple of its own size."""

    chunk: int
    bag: int


_DEFAULT = (1 << 30, 128 << 20)
"""So much stays below 300 MB of memory for a bag of 100 kB, together with what Python takes."""


def size_of(text: str) -> int:
    """Return a size in bytes: "4GiB", "500 MB", "4G" or "1000B"; units are of 1024.

    Raises
    ------
    ValueError
        If it is none, or zero.
    """
    found = _SIZE.fullmatch(text.strip())
    size = int(float(found[1]) * _UNITS[found[2][0].upper()]) if found else 0
    if not size:
        raise ValueError(f"{text!r} is not a size; write one such as 4GiB or 500MB")
    return size


@contextmanager
def limited(size: int | None) -> Iterator[None]:
    """Let chunks and bags unpack to `size` bytes in this process and those it starts; None: as before."""
    before = os.environ.get(VARIABLE)
    if size is not None:
        os.environ[VARIABLE] = f"{size}B"
    try:
        yield
    finally:
        if size is not None:
            os.environ.pop(VARIABLE)
            if before is not None:
                os.environ[VARIABLE] = before


class Budget:
    """Remaining decompressed bytes of a bag in one pass."""

    def __init__(self) -> None:
        self._packed = self._unpacked = 0

    @cached_property
    def _allowance(self) -> _Allowance:
        text = os.environ.get(VARIABLE)
        if text is None:
            return _Allowance(*_DEFAULT)
        try:
            size = size_of(text)
        except ValueError as error:
            raise BagError(f"{VARIABLE}: {error}") from error
        return _Allowance(size, size)

    def require(self, size: int, packed: int, what: str) -> None:
        """Count the compressed bytes of a chunk; raise BagError if its stated size is too large.

        The limit of a bag grows with the compressed bytes that were read.
        """
        self._packed += packed
        if size > self._allowance.chunk:
            raise BagError(
                f"{what}: states that it unpacks to {size} bytes, more than the {self._allowance.chunk} that a chunk "
                f"may; it is damaged, or to be recorded again in smaller chunks; {_advice(size)}"
            )
        if size > self.left:
            raise BagError(
                f"{what}: states that it unpacks to {size} bytes; the bag would unpack to {self._unpacked + size} "
                f"bytes from {self._packed}, a ratio that no recording has; {_advice(self._unpacked + size)}"
            )

    def take(self, size: int, what: str) -> None:
        """Count decompressed bytes; raise BagError beyond the limit."""
        self._unpacked += size
        if self.left <= 0:
            raise BagError(
                f"{what}: up to here {self._packed} bytes have unpacked to {self._unpacked}, a ratio that no recording "
                f"has; {_advice(self._unpacked + 1)}"
            )

    @property
    def left(self) -> int:
        """Remaining bytes."""
        return self._allowance.bag + _TIMES * self._packed - self._unpacked


def _advice(size: int) -> str:
    gib = 1 << max((size - 1).bit_length() - 30, 0)
    return f"--max-unpacked {gib}GiB allows it"


ARENA_BYTES = 11 << 20
"""What is put side by side: with less, NumPy has fewer messages at once; some four such pieces of memory are in use."""


class BufferPool:
    """Allocator of chunk buffers.

    sparse : whether few bytes of each are written to, so that more lie side by side: only these pages take memory
    left : bytes for which there is room directly after the previous buffer; if it is set to 0, the next lies elsewhere
    """

    def __init__(self, *, sparse: bool = False) -> None:
        self._sparse = sparse
        self._lent: dict[int, tuple[object, NDArray[np.uint8]]] = {}
        self._unused: list[object] = []  # references to what is no longer lent
        self._buffer: NDArray[np.uint8] = np.empty(0, dtype=np.uint8)
        self.left = 0

    def place(self, size: int) -> NDArray[np.uint8]:
        """Return a writable buffer (size,), placed directly after the previous one if there is room."""
        if size > ARENA_BYTES and not self._sparse:
            return np.empty(size, dtype=np.uint8)
        if size > self.left:
            self._buffer = np.empty(0, dtype=np.uint8)
            if self._sparse:
                pages = mmap.mmap(-1, 16 * ARENA_BYTES, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)
                pages.madvise(mmap.MADV_NOHUGEPAGE)
                self._buffer = np.frombuffer(pages, dtype=np.uint8)
            else:
                # not zeroed: a short bag never touches most of it
                memory = self._lent.pop(id(self._unused.pop()))[1] if self._unused else np.empty(ARENA_BYTES, np.uint8)
                self._buffer = np.frombuffer(memory.data, dtype=np.uint8)
                # All buffers are views of this array: without the last of them, the memory is unused. No function in
                # Python is called then, from which the exception of a signal's handler would be lost.
                view = weakref.ref(self._buffer, self._unused.append)
                self._lent[id(view)] = view, memory
            self.left = self._buffer.size
        begin = self._buffer.size - self.left
        self.left -= size
        return self._buffer[begin : begin + size]


def lies_behind(data: NDArray[np.uint8], before: NDArray[np.uint8]) -> bool:
    """Return whether bytes lie directly behind others in the same buffer."""
    same = isinstance(data.base, np.ndarray) and data.base is before.base
    return same and _address(data) == _address(before) + before.size


def extended(data: NDArray[np.uint8], size: int) -> NDArray[np.uint8]:
    """Return as many bytes (size,) of a buffer from where those of a view of it begin."""
    whole = data.base
    assert isinstance(whole, np.ndarray)  # noqa: S101 - only what lies side by side is extended
    begin = _address(data) - _address(whole)
    return whole[begin : begin + size]


def _address(data: NDArray[np.uint8]) -> int:
    return int(data.__array_interface__["data"][0])


MCAP: Final = b"\x89MCAP0\r\n"
ROS1: Final = b"#ROSBAG V2.0\n"
SQLITE: Final = b"SQLite format 3\0"
ZSTD: Final = b"\x28\xb5\x2f\xfd"

SNIFFED: Final = 64
"""Number of first bytes that tell."""

_OTHERS = {
    SQLITE: "a sqlite3 bag cannot come through a pipe; name the file or directory",
    b"#ROSBAG V1": "is a ROS 1 bag of version 1; `rosbag migrate` makes it a 2.0 one",
    ZSTD: "is a zstd-compressed file; decompress it first (`zstd -d`)",
    b"\x1f\x8b": "is a gzip-compressed file; decompress it first (`gunzip`)",
    b"BZh": "is a bzip2-compressed file; decompress it first (`bunzip2`)",
    b"\xfd7zXZ\0": "is a xz-compressed file; decompress it first (`unxz`)",
    b"\x04\x22\x4d\x18": "is a lz4-compressed file; decompress it first (`lz4 -d`)",
    b"PK\x03\x04": "is a zip archive; unpack it first (`unzip`)",
    b"version https://git-lfs": "is a Git LFS pointer, not the file it points to; `git lfs pull` fetches that",
    b"rosbag2_bagfile_information": "is the metadata.yaml of a ROS 2 bag; name its directory",
    b"<!doctype": "is an HTML page, not a bag; download the file that the page offers",
    b"<html": "is an HTML page, not a bag; download the file that the page offers",
}
"""Other files that are taken for bags, and the way out; text may begin with white space and be in capitals."""


def unknown(name: str, begin: bytes) -> BagError:
    """Return the error that says what a file is that is no bag, from its first bytes."""
    if not begin:
        return BagError(f"{name}: is empty; nothing was recorded, or nothing came through the pipe")
    text = begin.lstrip().lower()
    for first, said in _OTHERS.items():
        if begin.startswith(first) or text.startswith(first.lower()):
            return BagError(f"{name}: {said}")
    if not any(begin):
        return BagError(f"{name}: begins with zeros: space that was reserved and never written; nothing is in it")
    if name.endswith((".csv", ".tum", ".txt")):
        return BagError(f"{name}: is text, not a bag; learn, fit, compare, diagnose and score read trajectories")
    return BagError(f"{name}: begins with {begin[:8]!r}, which is not an MCAP, a ROS 1 bag or a ROS 2 bag")


_BUFFER_BYTES = 1 << 16
"""What is read ahead: small records want some, and of a large one as much is copied twice."""
_TRUSTED_BYTES = 1 << 24
"""How much a pipe's claim of a length is allocated at once; beyond, memory grows with the bytes that really come."""

LARGEST_BYTES = 1 << 32
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


class Source:
    """A bag's bytes, read forwards.

    name : name in error messages
    size : file size in bytes, or None for a pipe
    position : bytes read so far
    summing : whether the CRC is computed
    crc : CRC-32 of the bytes read since it was last set to 0; crc_of_last : of those last read into a buffer
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
        self.crc = self.crc_of_last = 0
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

    @property
    def descriptor(self) -> int:
        """Descriptor of the open file."""
        return self._stream.fileno()

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

    def ahead(self) -> bytes:
        """Return the next bytes without consuming them, as far as they are in memory; none at the end."""
        return self._ahead or (self._stream.peek() if isinstance(self._stream, BufferedReader) else b"")

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
            if begin >= LARGEST_BYTES:
                raise BagError(
                    f"{self.name}: {what} has a stated length of {size} bytes; the bag is damaged, or must be read "
                    "from a file"
                )
            pieces.append(np.empty(min(_TRUSTED_BYTES, size - begin), dtype=np.uint8))
            self._fill(pieces[-1].data, what)
        data = np.concatenate(pieces)
        self.crc_of_last = crc32(data.data) if self.summing else 0
        return data

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
            self.crc_of_last = crc32(view)
            self.crc = combined(self.crc, self.crc_of_last, len(view))

    def close(self) -> None:
        """Close a file; a pipe is left to the caller."""
        if self._owned:
            self._stream.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()
