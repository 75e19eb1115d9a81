"""The drift that a fitted model leaves, and whether another one leaves more."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from odomcorrupt.study.estimate.truth_bias import scale_errors
from odomcorrupt.study.estimate.windows import phased_misses
from odomcorrupt.study.io.headings import with_recomputed_headings

if TYPE_CHECKING:
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.estimate.gauss_newton import Fit
    from odomcorrupt.study.io.recording import Recording

__all__ = ["Drift", "drift", "ten_second_error"]


class Drift(NamedTuple):
    """Squared position errors (n,) after 10 s, m^2: of windows at five phases."""

    squared: tuple[Array, ...]

    @property
    def rmse(self) -> float:
        """Their root mean square, m; NaN if no window is whole."""
        together = np.concatenate(self.squared)
        return float(np.sqrt(np.mean(together))) if len(together) else float("nan")

    def nats_over(self, other: Drift) -> float:
        """Return what its windows gain in log likelihood over another's, both normal in the plane and of any size.

        Phases share what they see: they count as one.
        """
        windows = np.mean([len(each) for each in self.squared])
        return float(2.0 * windows * np.log(other.rmse / self.rmse)) if other.rmse > 0.0 < self.rmse else 0.0

    def worse_than(self, other: Drift, *, factor: float, plain: float, errors: float) -> bool:
        """Return whether it is larger than another of the same recordings by more than chance.

        Of a minute that has hardly any windows a true cause may well spoil some.

        Parameters
        ----------
        factor : what it may be larger by in any case
        plain : what it may be larger by if windows, paired one by one, show less than `errors` standard errors of it

        """
        if not self.rmse > factor * other.rmse:
            return False
        pairs = [(a, b) for a, b in zip(self.squared, other.squared, strict=True) if len(a) == len(b) > 1]
        if self.rmse > plain * other.rmse or len(pairs) < len(self.squared):
            return True
        more = [a - b for a, b in pairs]
        # phases share what they see: the mean of their errors, as if they were one
        deviation = np.mean([np.std(d, ddof=1) / np.sqrt(len(d)) for d in more])
        return bool(np.mean([np.mean(d) for d in more]) > errors * deviation)


def drift(fitted: Fit, *, truths_scaled: bool = False) -> Drift:
    """Return how far odometry drifts in 10 s, a fit's effects taken out, on the fitted recordings themselves.

    truths_scaled : whether the scale errors that the fit sees in the truths (a laser's) are taken out of these, too
    """
    left = [with_recomputed_headings(recording) for recording in fitted.problem.left]
    if truths_scaled:
        errors = scale_errors(fitted.problem, fitted.noise).tolist()
        left = [_scaled(recording, 1.0 / (1.0 + error)) for recording, error in zip(left, errors, strict=True)]
    return Drift(tuple(phased_misses(left)))


def _scaled(recording: Recording, factor: float) -> Recording:
    """Return a recording with all lengths of its truth multiplied."""
    return replace(recording, truth=replace(recording.truth, xyt=recording.truth.xyt * (factor, factor, 1.0)))


def ten_second_error(fitted: Fit) -> float:
    """Return the root mean square position error (m) after 10 s on the fitted recordings themselves."""
    return drift(fitted).rmse
