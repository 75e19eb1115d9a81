"""Progress of a study, whose number of stages is unknown while it runs."""

from __future__ import annotations

from collections.abc import Callable

Watch = Callable[[str, float], None]
"""Called before each stage with its name and the fraction of the work done."""


def no_progress(_stage: str, _share: float) -> None:
    """Report no progress."""


class Work:
    """Work done so far: a fraction that never decreases, and never reaches one.

    watch : called before each stage with its name and that fraction
    """

    def __init__(self, watch: Watch = no_progress) -> None:
        self._watch, self._left = watch, 1.0

    def begin(self, stage: str) -> None:
        """Report the start of a stage."""
        self._watch(stage, 1.0 - self._left)
        self._left *= 0.85  # the number of stages to come is unknown
