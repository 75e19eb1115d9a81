"""Threads beside the one that computes: one reads a file ahead, others compress; results are taken in order.

Reading, codecs, checksums and numpy's loops leave the interpreter free, so that they do run side by side. What is
written does not depend on the number of threads: they only compute what the one that computes will ask for, in the
order in which it would have done it, and that one alone writes, and reads from pipes. So an error or Ctrl-C reaches it
at once, and no thread can be left waiting for a pipe.
"""

from __future__ import annotations

import os
import threading
from collections import deque
from contextlib import closing
from functools import partial
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Generic, Self, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterator
    from types import TracebackType

__all__ = ["MOST_THREADS", "OrderedResults", "Workers", "default_threads", "read_ahead"]

MOST_THREADS = 4
"""More are of use to slow codecs only, and each holds memory."""

AHEAD_BYTES = 8 << 20
"""What is read before it is asked for: more would find no place in a processor's cache."""

_BATCH_BYTES = 1 << 20
"""What is handed over at once: less would have threads wait for each other."""

WAITING_BYTES = 12 << 20
"""What may wait for being compressed and written."""

T = TypeVar("T")


def default_threads() -> int:
    """Return how many threads a process uses where nobody says: as many as it has cores, and at most four."""
    try:
        cores = len(os.sched_getaffinity(0))
    except AttributeError:  # not on this system
        cores = os.cpu_count() or 1
    return min(cores, MOST_THREADS)


class _Task(Generic[T]):
    """A call whose result comes later."""

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
        except BaseException as error:  # noqa: BLE001 - raised where the result is asked for
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
    """Threads that make calls; closed by context manager, which drops those that nobody has begun.

    Parameters
    ----------
    threads : int
        Threads of the process in all: with one, calls are made at once by who submits them.

    """

    def __init__(self, threads: int) -> None:
        self.threads = threads
        self._tasks: SimpleQueue[_Task[object] | None] = SimpleQueue()
        self._started: list[threading.Thread] = []
        self._closed = False

    def submit(self, call: Callable[[], T]) -> _Task[T]:
        """Have a call made by some thread."""
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
        """Make a call that no thread has begun; tell whether there was one."""
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
        """End the threads, when what they are at is done."""
        self._closed = True
        for _ in self._started:
            self._tasks.put(None)
        for thread in self._started:
            thread.join()
        self._started.clear()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


class OrderedResults:
    """Calls made by threads, and what is done with their results: that in order, by the thread that put them.

    Parameters
    ----------
    workers : Workers | None
        Who makes the calls, None for the thread that puts them.

    """

    def __init__(self, workers: Workers | None) -> None:
        self._workers = workers if workers is not None and workers.threads > 1 else None
        self._waiting: deque[tuple[Callable[[], None], Callable[[], bool], int]] = deque()
        self._bytes = 0

    def put(self, call: Callable[[], T], then: Callable[[T], None], size: int, *, worth: bool = True) -> None:
        """Make a call, and later something of its result.

        Parameters
        ----------
        call, then : Callable
            What any thread may do, and what is to be done with its result.
        size : int
            Bytes that it holds in memory until then.
        worth : bool
            Whether the call takes longer than to hand over what it is about; else it is made when its turn comes.

        """
        if self._workers is None or not worth:
            self.put_behind(lambda: then(call()), size)
            return
        task = self._workers.submit(call)
        self._waiting.append((partial(_pass_on, task, then), lambda: task.done, size))
        self._bytes += size
        self._take_ready()

    def put_behind(self, then: Callable[[], None], size: int = 0) -> None:
        """Do something, which holds so many bytes until then, when all that was put before is done."""
        if not self._waiting:
            then()
            return
        self._waiting.append((then, lambda: True, size))
        self._bytes += size
        self._take_ready()

    def finish(self) -> None:
        """Wait for all that was put."""
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


def read_ahead(
    items: Generator[T, None, None], size_of: Callable[[T], int], worth: Callable[[T], bool] = lambda _: True
) -> Iterator[T]:
    """Yield the items of a generator which, behind the first that is worth it, a thread of its own runs ahead.

    It runs at most `AHEAD_BYTES` and one item ahead, is stopped when nobody asks any more, and must not wait for
    anything but files: who closes this generator waits for it.

    Parameters
    ----------
    items : Generator
        It is run, and closed, by the thread.
    size_of : Callable
        Bytes that an item holds in memory.
    worth : Callable
        Whether items like this one take longer to make than to hand over: what is only read, and not unpacked, is best
        used while it is in the cache of the processor that has read it.

    """
    with closing(items):
        for item in items:
            yield item
            if worth(item):
                yield from _read_ahead(items, size_of)


def _read_ahead(items: Generator[T, None, None], size_of: Callable[[T], int]) -> Iterator[T]:
    hall = _Hall[T]()
    thread = threading.Thread(target=_fill, args=(hall, items, size_of), name="read", daemon=True)
    thread.start()
    try:
        while (batch := hall.take()) is not None:
            yield from batch
        if hall.error is not None:
            raise hall.error
    finally:
        hall.stop()
        thread.join()


class _Hall(Generic[T]):
    """Items in batches between two threads.

    error : what ended the reading, if not the end
    """

    def __init__(self) -> None:
        self.error: BaseException | None = None
        self._changed = threading.Condition()
        self._batches: deque[tuple[list[T], int]] = deque()
        self._bytes = 0
        self._ended = self._stopped = False

    def put(self, batch: list[T], size: int) -> bool:
        """Add a batch when there is room; tell whether more is wanted."""
        with self._changed:
            self._changed.wait_for(lambda: self._bytes <= AHEAD_BYTES or self._stopped)
            self._batches.append((batch, size))
            self._bytes += size
            self._changed.notify_all()
            return not self._stopped

    def end(self) -> None:
        """Say that no more comes."""
        with self._changed:
            self._ended = True
            self._changed.notify_all()

    def stop(self) -> None:
        """Say that no more is wanted."""
        with self._changed:
            self._stopped = True
            self._changed.notify_all()

    def take(self) -> list[T] | None:
        """Return the next batch, None behind the last one."""
        with self._changed:
            self._changed.wait_for(lambda: self._batches or self._ended)
            if not self._batches:
                return None
            batch, size = self._batches.popleft()
            self._bytes -= size
            self._changed.notify_all()
            return batch


def _fill(hall: _Hall[T], items: Generator[T, None, None], size_of: Callable[[T], int]) -> None:
    batch: list[T] = []
    size = 0
    try:
        for item in items:
            batch.append(item)
            size += size_of(item)
            if size >= _BATCH_BYTES:
                wanted = hall.put(batch, size)
                batch, size = [], 0
                if not wanted:
                    return
    except BaseException as error:  # noqa: BLE001 - raised where the items are asked for
        hall.error = error
    finally:
        items.close()
        if batch:
            hall.put(batch, size)
        hall.end()
