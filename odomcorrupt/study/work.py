"""Progress of a study: the fraction of work done while the number of selection steps is still unknown."""

from __future__ import annotations

from collections.abc import Callable

Watch = Callable[[str, float], None]
"""Called before each stage with its name and the fraction of the work done."""
_MORE_STEPS = 2.0
"""Number of selection steps expected after the current one, however many have been made."""


def no_progress(_stage: str, _share: float) -> None:
    """Report no progress."""


class Work:
    """Work done and expected to remain, in units of one selection step.

    watch : called before each stage with its name and the fraction done, which never decreases and never reaches one
    following : expected work after the selection
    """

    def __init__(self, watch: Watch = no_progress, following: float = 0.0) -> None:
        self._watch, self._following = watch, following
        self._done = self._under_way = self._share = 0.0
        self._steps = 0

    def begin(self, stage: str, cost: float, left: float) -> None:
        """Report the start of a stage, given its cost and the expected work after it."""
        self._done += self._under_way
        self._under_way = cost
        self._share = max(self._share, self._done / (self._done + cost + left))
        self._watch(stage, self._share)

    def begin_clocks(self) -> None:
        """Report the start of the clock estimation, before the first step."""
        self.begin("clocks", 1.0, 1.0 + _MORE_STEPS + self._following)

    def begin_step(self) -> None:
        """Report the start of a selection step, the screening of effects."""
        self._steps += 1
        self.begin(f"search, step {self._steps}: screening effects", 0.7, 0.3 + _MORE_STEPS + self._following)

    def within_step(self, what: str) -> None:
        """Report a later stage of the current selection step."""
        self.begin(f"search, step {self._steps}: {what}", 0.3, _MORE_STEPS + self._following)
