"""Odometry messages sorted by stamp, and divided into stretches where time jumps back.

Decisions depend on stamps and log times alone, never on the division of a bag into blocks. Log times are running
maxima. A stamp far ahead of the log clock is accepted only once the next message confirms it: if that one continues
from the stamps before, the stamp was an error of one message, not a restart of time.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array

WINDOW_NS = 1_000_000_000
"""Messages swapped within this are sorted; a jump further back begins a new stretch."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Arrivals:
    """n poses with their stamps.

    stamps_ns : (n,) header stamps
    time_ns : (n,) log time at which the odometry had reached this stamp
    xyt : (n, 3) poses, metres and radians
    """

    stamps_ns: NDArray[np.int64]
    time_ns: NDArray[np.int64]
    xyt: Array

    def __len__(self) -> int:
        return len(self.stamps_ns)

    def take(self, which: NDArray[np.bool_] | NDArray[np.int64] | slice) -> Arrivals:
        """Return some of them."""
        return Arrivals(self.stamps_ns[which], self.time_ns[which], self.xyt[which])

    def followed_by(self, other: Arrivals) -> Arrivals:
        """Return both, one behind the other."""
        return Arrivals(
            np.concatenate((self.stamps_ns, other.stamps_ns)),
            np.concatenate((self.time_ns, other.time_ns)),
            np.concatenate((self.xyt, other.xyt)),
        )


_NONE = Arrivals(np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64), np.zeros((3, 0)).T)
_LONG_AGO = -(2**62)


class TimeOrder:
    """Buffer that releases messages in stamp order, once no earlier one can follow.

    late : messages more than `WINDOW_NS` of log time behind their neighbours, left out
    leaps : messages whose stamp lies far ahead of both neighbours', left out
    restarts : number of jumps back in time
    swapped : messages behind a later one by no more than the window, sorted
    """

    def __init__(self) -> None:
        self.swapped = 0
        self.late = 0
        self.leaps = 0
        self.restarts = 0
        self._waiting = _NONE  # in the order of arrival
        self._begin()

    def _begin(self) -> None:
        self._newest_ns = _LONG_AGO
        self._seen_ns = _LONG_AGO
        self._released_ns = _LONG_AGO
        self._ahead: Arrivals | None = None  # one message that leapt ahead

    def add(self, new: Arrivals) -> list[Arrivals]:
        """Add messages in the order of arrival; return the rest of each stretch that a jump back in time ends.

        Each is sorted; a stretch with nothing left to release is returned empty: the length is the number of restarts.
        """
        ended = []
        while len(new):
            self._judge_ahead(new)
            reach = np.maximum.accumulate(np.concatenate(([self._newest_ns], new.stamps_ns)))
            back = new.stamps_ns < reach[:-1] - WINDOW_NS
            leap = new.stamps_ns - reach[:-1] - np.diff(new.time_ns, prepend=self._seen_ns) > WINDOW_NS
            leap[0] &= self._newest_ns != _LONG_AGO
            odd = back | leap
            cut = int(np.argmax(odd)) if odd.any() else len(new)
            self._append(new.take(slice(0, cut)), behind=int(np.count_nonzero((new.stamps_ns < reach[:-1])[:cut])))
            if cut < len(new) and leap[cut]:
                self._ahead = new.take(slice(cut, cut + 1))
                cut += 1
            elif cut < len(new):
                ended.append(self.flush())
                self.restarts += 1
                self._begin()
            new = new.take(slice(cut, None))
        return ended

    def _judge_ahead(self, after: Arrivals) -> None:
        """Accept the message with the stamp far ahead, or drop it where the next one continues the stamps before."""
        ahead = self._ahead
        if ahead is None:
            return
        soon = after.time_ns[0] - ahead.time_ns[0] < WINDOW_NS
        if soon and self._newest_ns - WINDOW_NS <= after.stamps_ns[0] < ahead.stamps_ns[0] - WINDOW_NS:
            self.leaps += 1
            self._ahead = None
        else:
            self._accept_ahead()

    def _accept_ahead(self) -> None:
        if self._ahead is not None:
            ahead, self._ahead = self._ahead, None
            self._append(ahead, behind=0)

    def _append(self, new: Arrivals, *, behind: int) -> None:
        if len(new):
            self._newest_ns = max(self._newest_ns, int(new.stamps_ns.max()))
            self._seen_ns = int(new.time_ns[-1])
        if behind:
            both = self._waiting.followed_by(new)
            reach = np.maximum.accumulate(both.stamps_ns)
            long_seen = np.searchsorted(both.time_ns, new.time_ns - WINDOW_NS, side="right") - 1
            limit = np.where(long_seen >= 0, reach[long_seen], self._released_ns)
            on_time = new.stamps_ns >= np.maximum(limit, self._released_ns)
            late = int(np.count_nonzero(~on_time))
            self.late += late
            self.swapped += behind - late
            new = new.take(on_time)
        self._waiting = self._waiting.followed_by(new)

    def release(self, now_ns: int) -> Arrivals:
        """Return, sorted, the messages that no message after log time `now_ns` can precede."""
        if self._ahead is not None and now_ns - self._ahead.time_ns[0] >= WINDOW_NS:
            self._accept_ahead()
        ordered = self._sorted()
        if not len(ordered):
            return ordered
        seen = int(np.searchsorted(ordered.time_ns, now_ns - WINDOW_NS, side="right"))
        limit = self._newest_ns - WINDOW_NS
        if seen:
            limit = max(limit, int(ordered.stamps_ns[seen - 1]))
        return self._let_go(ordered, int(np.searchsorted(ordered.stamps_ns, limit, side="right")))

    def flush(self) -> Arrivals:
        """Return, sorted, all buffered messages, at the end of a stretch."""
        self._accept_ahead()
        ordered = self._sorted()
        return self._let_go(ordered, len(ordered))

    def _sorted(self) -> Arrivals:
        waiting = self._waiting
        if (np.diff(waiting.stamps_ns) < 0).any():
            waiting = waiting.take(np.argsort(waiting.stamps_ns, kind="stable"))
        # a stamp counts as reached at the first message at or beyond it
        reached = np.minimum.accumulate(waiting.time_ns[::-1])[::-1]
        return Arrivals(waiting.stamps_ns, reached, waiting.xyt)

    def _let_go(self, ordered: Arrivals, count: int) -> Arrivals:
        if not count:
            return _NONE
        self._released_ns = int(ordered.stamps_ns[count - 1])
        self._waiting = self._waiting.take(self._waiting.stamps_ns > self._released_ns)
        return ordered.take(slice(0, count))
