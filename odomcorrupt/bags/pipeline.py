"""Worker threads for compression; results are used in order.

Codecs and checksums release the GIL, so they run in parallel. The output does not depend on the number of threads:
they only compute results that the main thread uses in its own order. The main thread alone reads and writes, so an
error or Ctrl-C takes effect at once, and no thread blocks on a pipe. A thread that reads ahead would wait for the GIL
longer than it saves.
"""

from __future__ import annotations

import os
import threading
from collections import deque
from functools import partial
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Generic, Self, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

MOST_THREADS = 4
"""Largest default number of threads: more help slow codecs only, and each uses memory."""

WAITING_BYTES = 12 << 20
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


class _Task(Generic[T]):
    """A call and its future result."""

    __slots__ = ("_done", "_error", "_value", "call")

    def __init__(self, call: Callable[[], T]) -> None:
        self.call: Callable[[], T] | None = call
        self._error: BaseException | None = None
        self._done = threading.Lock()
        self._done.acquire()

    def run(self) -> None:
        """Compute it."""
        call, self.call = self.call, None
        try:
            if call is not None:
                self._value = call()
        except BaseException as error:  # noqa: BLE001 - raised when the result is requested
            self._error = error
        self._done.release()

    @property
    def done(self) -> bool:
        """Whether the result is there."""
        return not self._done.locked()

    def result(self) -> T:
        """Wait for the result, and return it or raise what the call raised."""
        with self._done:
            pass
        if self._error is not None:
            raise self._error
        return self._value


class Workers:
    """Thread pool; closed by the context manager, which drops calls not yet started.

    threads : total number of threads of the process: with one, `submit` makes the call itself
    """

    def __init__(self, threads: int) -> None:
        self.threads = threads
        self._tasks: SimpleQueue[_Task[object] | None] = SimpleQueue()
        self._started: list[threading.Thread] = []
        self._closed = False

    def submit(self, call: Callable[[], T]) -> _Task[T]:
        """Submit a call to the pool; return its task."""
        task = _Task(call)
        if self.threads == 1:
            task.run()
            return task
        if len(self._started) < self.threads - 1:
            # not before there is work: a short bag needs none
            self._started.append(threading.Thread(target=self._work, name="compress", daemon=True))
            self._started[-1].start()
        self._tasks.put(task)  # type: ignore[arg-type] # whatever it returns
        return task

    def help(self) -> bool:
        """Make one waiting call in the current thread; return whether there was one."""
        try:
            task = self._tasks.get_nowait()
        except Empty:
            return False
        if task is not None:
            task.run()
        return task is not None

    def _work(self) -> None:
        while (task := self._tasks.get()) is not None and not self._closed:
            task.run()

    def close(self) -> None:
        """End the threads after their present calls."""
        self._closed = True
        for _ in self._started:
            self._tasks.put(None)
        for thread in self._started:
            thread.join()
        self._started.clear()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()


class OrderedResults:
    """Calls in worker threads, whose results are processed in order by the submitting thread.

    workers : thread pool; None: the submitting thread makes the calls
    """

    def __init__(self, workers: Workers | None) -> None:
        self._workers = workers if workers is not None and workers.threads > 1 else None
        self._waiting: deque[tuple[Callable[[], None], Callable[[], bool], int]] = deque()
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
        task = self._workers.submit(call)
        self._waiting.append((partial(_pass_on, task, then), lambda: task.done, size))
        self._bytes += size
        self._take_ready()

    def put_behind(self, then: Callable[[], None], size: int = 0) -> None:
        """Submit a function to run after all earlier ones; it holds `size` bytes until then."""
        if not self._waiting:
            then()
            return
        self._waiting.append((then, lambda: True, size))
        self._bytes += size
        self._take_ready()

    def finish(self) -> None:
        """Wait for all submitted calls."""
        while self._waiting:
            self._take()

    def _take_ready(self) -> None:
        while self._waiting and (self._bytes > WAITING_BYTES or self._waiting[0][1]()):
            self._take()

    def _take(self) -> None:
        act, done, size = self._waiting.popleft()
        self._bytes -= size
        while not done() and self._workers is not None and self._workers.help():
            pass
        act()


def _pass_on(task: _Task[T], then: Callable[[T], None]) -> None:
    then(task.result())
