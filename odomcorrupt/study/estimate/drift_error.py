"""The drift that a fitted model leaves, and whether another one leaves more."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from odomcorrupt.study.estimate.problem import undo
from odomcorrupt.study.estimate.windows import phased_misses
from odomcorrupt.study.io.clock import aligned
from odomcorrupt.study.io.headings import headed_anew

if TYPE_CHECKING:
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.estimate.gauss_newton import Fit

__all__ = ["Drift", "drift", "ten_second_error"]

_HARM = 1.02
"""An effect that the drift hardly depends on moves it up or down by about a hundredth, by chance."""
_PLAIN_HARM = 1.15
_BEYOND_CHANCE = 2.0


class Drift(NamedTuple):
    """Squared position errors (n,) after 10 s, m^2: of windows at five phases."""

    squared: tuple[Array, ...]

    @property
    def rmse(self) -> float:
        """Their root mean square, m; NaN if no window is whole."""
        together = np.concatenate(self.squared)
        return float(np.sqrt(np.mean(together))) if len(together) else float("nan")

    def worse_than(self, other: Drift) -> bool:
        """Tell whether it is plainly larger than another of the same recordings.

        A few per cent more count only where they are more than what windows show by chance, paired one by one: of a
        minute that has hardly any windows, a true cause may well spoil some.
        """
        if not self.rmse > _HARM * other.rmse:
            return False
        pairs = [(a, b) for a, b in zip(self.squared, other.squared, strict=True) if len(a) == len(b) > 1]
        if self.rmse > _PLAIN_HARM * other.rmse or len(pairs) < len(self.squared):
            return True
        more = [a - b for a, b in pairs]
        # phases share what they see: the mean of their errors, as if they were one
        error = np.mean([np.std(d, ddof=1) / np.sqrt(len(d)) for d in more])
        return bool(np.mean([np.mean(d) for d in more]) > _BEYOND_CHANCE * error)


def drift(fitted: Fit) -> Drift:
    """Return how far odometry drifts in 10 s, a fit's effects taken out, on the fitted recordings themselves."""
    problem = fitted.problem
    left = [
        headed_anew(undo(aligned(recording, clock), problem.effects))
        for recording, clock in zip(problem.recordings, problem.clocks, strict=True)
    ]
    return Drift(tuple(phased_misses(left)))


def ten_second_error(fitted: Fit) -> float:
    """Return the root mean square position error (m) after 10 s on the fitted recordings themselves."""
    return drift(fitted).rmse
