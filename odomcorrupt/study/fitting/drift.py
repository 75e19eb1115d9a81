"""The drift that a fitted model leaves."""

from __future__ import annotations

from typing import TYPE_CHECKING

from odomcorrupt.study.fitting.problem import undo
from odomcorrupt.study.likelihood.windows import phased_rmse
from odomcorrupt.study.recordings.clock import aligned
from odomcorrupt.study.recordings.headings import headed_anew

if TYPE_CHECKING:
    from odomcorrupt.study.fitting.gauss_newton import Fit

__all__ = ["ten_second_error"]


def ten_second_error(fitted: Fit) -> float:
    """Return the root mean square position error (m) after 10 s on the fitted recordings themselves."""
    problem = fitted.problem
    left = [
        headed_anew(undo(aligned(recording, clock), problem.effects))
        for recording, clock in zip(problem.recordings, problem.clocks, strict=True)
    ]
    return phased_rmse(left)
