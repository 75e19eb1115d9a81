"""Worker threads for compression and for writing to files; results are used in order.

Codecs, checksums and file calls release the GIL, so they run in parallel. The output does not depend on the number of
threads: the main thread uses their results in its own order, and says where in a file each piece belongs. It alone
reads, and writes to pipes, so no thread blocks on one. A thread that reads ahead would wait for the GIL longer than it
saves.
"""

from __future__ import annotations

import os
from collections import deque
from typing import TYPE_CHECKING, Any, Self, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable
    from concurrent.futures import Future, ThreadPoolExecutor
    from pathlib import Path

MOST_THREADS = 4
"""Largest default number of threads: more help slow codecs only, and each uses memory."""

WAITING_BYTES = 8 << 20
"""Largest number of bytes waiting for compression and writing."""

_WORTH_BYTES = 1 << 20
"""Size of an input file below which one thread is used: a run ends before more threads could help."""

T = TypeVar("T")


def default_threads(source: Path | None = None) -> int:
    """Return the default number of threads: one for each core, at most four; one for a small file."""
    if source is not None and source.is_file() and source.stat().st_size < _WORTH_BYTES:
        return 1
    try:
        cores = len(os.sched_getaffinity(0))
    except AttributeError:  # not on this system
        cores = os.cpu_count() or 1
    return min(cores, MOST_THREADS)


class Workers:
    """Thread pool; closed by the context manager, which drops calls not yet started.

    threads : number of threads that compress and write: with one, it is the main thread
    """

    def __init__(self, threads: int) -> None:
        self.threads = threads
        self._pool: ThreadPoolExecutor | None = None

    def submit(self, call: Callable[[], T]) -> Future[T]:
        """Return the future result of a call."""
        if self._pool is None:
            from concurrent.futures import ThreadPoolExecutor  # noqa: PLC0415 - slow to import; a short bag needs none

            self._pool = ThreadPoolExecutor(self.threads, "compress")
        return self._pool.submit(call)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)


class OrderedResults:
    """Calls in worker threads, whose results are processed in order by the submitting thread.

    workers : thread pool; None: the submitting thread makes the calls
    most : largest number of bytes that wait; by default `WAITING_BYTES`
    """

    def __init__(self, workers: Workers | None, most: int | None = None) -> None:
        self._most = WAITING_BYTES if most is None else most
        self._workers = workers if workers is not None and workers.threads > 1 else None
        self._waiting: deque[tuple[Future[Any] | None, Callable[[], None], int]] = deque()
        self._bytes = 0

    def put(self, call: Callable[[], T], then: Callable[[T], None], size: int, *, worth: bool = True) -> None:
        """Submit a call, and a function to process its result.

        call, then : the call, for any thread, and the function of its result, for the submitting thread
        size : memory held until then, bytes
        worth : whether the call is worth a thread; else the submitting thread makes it in turn
        """
        if self._workers is None or not worth:
            self.put_behind(lambda: then(call()), size)
            return
        future = self._workers.submit(call)
        self._add(future, lambda: then(future.result()), size)

    def put_behind(self, then: Callable[[], None], size: int = 0) -> None:
        """Submit a function to run after all earlier ones; it holds `size` bytes until then."""
        if self._waiting:
            self._add(None, then, size)
        else:
            then()

    def finish(self) -> None:
        """Wait for all submitted calls."""
        while self._waiting:
            self._take()

    def drop(self) -> None:
        """Wait for the calls that have begun, and forget all."""
        for future, *_ in self._waiting:
            if future is not None and not future.cancel():
                future.exception()
        self._waiting.clear()

    def _add(self, future: Future[Any] | None, act: Callable[[], None], size: int) -> None:
        self._waiting.append((future, act, size))
        self._bytes += size
        while self._waiting and (self._bytes > self._most or (first := self._waiting[0][0]) is None or first.done()):
            self._take()

    def _take(self) -> None:
        _, act, size = self._waiting.popleft()
        self._bytes -= size
        act()
