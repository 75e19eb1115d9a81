"""Share of a study's work that is done: the number of steps of a search is not known before."""

from __future__ import annotations

from collections.abc import Callable

__all__ = ["Watch", "Work", "silent"]

Watch = Callable[[str, float], None]
"""Called before each stage with its name and the share of the work that is done."""
_MORE_STEPS = 2.0
"""Steps that a search is expected to take after the one that is under way, however many it took."""


def silent(_stage: str, _share: float) -> None:
    """Report no progress."""


class Work:
    """What is done and what is expected to be left, in units of one step of a search.

    Parameters
    ----------
    watch : called before each stage with its name and the share that is done, which never falls and never reaches one
    following : what comes after the search
    """

    def __init__(self, watch: Watch = silent, following: float = 0.0) -> None:
        self._watch, self._following = watch, following
        self._done = self._under_way = self._share = 0.0
        self._steps = 0

    def begin(self, stage: str, cost: float, left: float) -> None:
        """Take note of a stage that begins, what it costs, and what is expected to be left after it."""
        self._done += self._under_way
        self._under_way = cost
        self._share = max(self._share, self._done / (self._done + cost + left))
        self._watch(stage, self._share)

    def begin_clocks(self) -> None:
        """Take note of what comes before the first step."""
        self.begin("clocks", 1.0, 1.0 + _MORE_STEPS + self._following)

    def begin_step(self) -> None:
        """Take note of a step of the search."""
        self._steps += 1
        self.begin(f"search, step {self._steps}: screening effects", 0.7, 0.3 + _MORE_STEPS + self._following)

    def within_step(self, what: str) -> None:
        """Take note of what follows in a step once its effects are screened."""
        self.begin(f"search, step {self._steps}: {what}", 0.3, _MORE_STEPS + self._following)
