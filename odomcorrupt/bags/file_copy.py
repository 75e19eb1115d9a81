"""Copy of a file by the kernel, in a thread beside the reader; a reflink if the file system supports it."""

from __future__ import annotations

import errno
import os
import threading
from contextlib import suppress
from typing import TYPE_CHECKING, NamedTuple

from odomcorrupt.errors import BagError

if TYPE_CHECKING:
    from pathlib import Path

_AT_ONCE_BYTES = 16 << 20
"""Bytes copied by one system call; an interrupt waits for the end of a call."""


class FileState(NamedTuple):
    """Device, inode, size and modification time of a file, which differ after it was replaced or written to."""

    device: int
    inode: int
    size: int
    modified_ns: int

    @classmethod
    def of(cls, descriptor: int) -> FileState:
        """Return the state of an open file."""
        now = os.fstat(descriptor)
        return cls(now.st_dev, now.st_ino, now.st_size, now.st_mtime_ns)


class FileCopy:
    """Running copy of a file, from one position to its end, to the same position of another file.

    The copy ends early if the system has no such call, or if the call fails.

    source : file to be copied
    target : descriptor of the file that is written. Its file offset does not change
    begin : position of the first byte to copy
    state : state of the source when it was read; by default its present state

    Raises
    ------
    OSError
        If the source cannot be opened, or is not the file that was read.
    """

    def __init__(self, source: Path, target: int, begin: int = 0, state: FileState | None = None) -> None:
        self._name = str(source)
        self._source, self._target = os.open(source, os.O_RDONLY | getattr(os, "O_BINARY", 0)), target
        self._state = FileState.of(self._source)
        if state not in (None, self._state):
            os.close(self._source)
            raise OSError(errno.ESTALE, os.strerror(errno.ESTALE), self._name)
        self._position = begin
        self._ended = self._stopped = False
        self._progress = threading.Condition()
        self._thread = threading.Thread(target=self._run, name="copy", daemon=True)
        self._thread.start()

    @property
    def done(self) -> bool:
        """Whether the copy has ended, completely or early."""
        return self._ended

    def complete(self) -> bool:
        """Wait until the copy has ended; return whether all bytes were copied."""
        return self.reaches(self._state.size)

    def reaches(self, end: int) -> bool:
        """Wait until the bytes before `end` are copied or the copy has ended; return whether they are copied."""
        with self._progress:
            self._progress.wait_for(lambda: self._position >= end or self._ended)
        return self._position >= end

    def stop(self) -> None:
        """End the copy early."""
        self._stopped = True
        self._thread.join()

    def close(self) -> None:
        """End the copy, and close the source."""
        self.stop()
        os.close(self._source)

    def require_unchanged(self) -> None:
        """Raise BagError if the source was replaced or written to since it was read."""
        if FileState.of(self._source) != self._state:
            raise BagError(
                f"{self._name}: changed while it was read; the output is discarded, run again once the recording is "
                "complete"
            )

    def _run(self) -> None:
        with suppress(OSError, AttributeError):
            while not self._stopped and (left := self._state.size - self._position) > 0:
                at = self._position
                done = os.copy_file_range(self._source, self._target, min(left, _AT_ONCE_BYTES), at, at)
                if not done:
                    break
                with self._progress:
                    self._position += done
                    self._progress.notify_all()
        with self._progress:
            self._ended = True
            self._progress.notify_all()
