"""Position error after 10 s that remains with a fitted model, and comparison of two models by it."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from odomcorrupt.geometry.se2 import rotate
from odomcorrupt.study.estimate.truth_bias import has_bias, scale_errors, turn_errors
from odomcorrupt.study.estimate.windows import phased_misses
from odomcorrupt.study.io.headings import with_recomputed_headings

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.estimate.gauss_newton import Fit
    from odomcorrupt.study.io.recording import Recording


class Drift(NamedTuple):
    """Squared position errors after 10 s: one array (n,) of windows in m^2 for each of five phases."""

    squared: tuple[Array, ...]

    @property
    def rmse(self) -> float:
        """Root mean square of the errors, m; NaN if there is no complete window."""
        together = np.concatenate(self.squared)
        return float(np.sqrt(np.mean(together))) if len(together) else float("nan")

    def nats_over(self, other: Drift) -> float:
        """Return the log-likelihood gain (nats) over another model's drift: planar normal errors of free variance.

        The phases share their data and count as one.
        """
        windows = np.mean([len(each) for each in self.squared])
        return float(2.0 * windows * np.log(other.rmse / self.rmse)) if other.rmse > 0.0 < self.rmse else 0.0

    def worse_than(self, other: Drift, *, factor: float, plain: float, errors: float) -> bool:
        """Return whether the drift is larger than another model's on the same recordings, by more than chance.

        In a recording of a minute, with few windows, even the true cause may increase the error of some.

        Parameters
        ----------
        factor : ratio of the RMS errors that is always allowed
        plain : ratio that is allowed if the paired windows differ by less than `errors` standard errors
        errors : number of standard errors of the mean paired difference that counts as significant
        """
        if not self.rmse > factor * other.rmse:
            return False
        pairs = [(a, b) for a, b in zip(self.squared, other.squared, strict=True) if len(a) == len(b) > 1]
        if self.rmse > plain * other.rmse or len(pairs) < len(self.squared):
            return True
        more = [a - b for a, b in pairs]
        # phases share their data: the mean of their standard errors, as of one phase
        deviation = np.mean([np.std(d, ddof=1) / np.sqrt(len(d)) for d in more])
        return bool(np.mean([np.mean(d) for d in more]) > errors * deviation)


def with_truths_corrected(recordings: Sequence[Recording], fitted: Fit) -> list[Recording]:
    """Return recordings without the errors of their truths that a fit estimates: scales of lasers, biases of gyros."""
    if not has_bias(fitted.problem):
        return list(recordings)
    errors = scale_errors(fitted.problem, fitted.noise).tolist()
    scaled = [_scaled(recording, 1.0 / (1.0 + error)) for recording, error in zip(recordings, errors, strict=True)]
    return with_gyros_corrected(scaled, fitted)


def with_gyros_corrected(recordings: Sequence[Recording], fitted: Fit) -> list[Recording]:
    """Return recordings with the biases that a fit to them estimates removed from those truths that are gyros."""
    if all(recording.positioned for recording in recordings):
        return list(recordings)
    turns = turn_errors(fitted.problem, fitted.noise)
    return [_turned(recording, fitted, i, turns) for i, recording in enumerate(recordings)]


def _turned(recording: Recording, fitted: Fit, number: int, turns: Array) -> Recording:
    """Return a recording whose truth, if it is a gyro, turns more by `turns` (K,), the fit's intervals being K."""
    own, truth = fitted.problem.run == number, recording.truth
    if recording.positioned or not own.any():
        return recording
    intervals = fitted.problem.intervals
    more = np.interp(
        recording.truth_s,
        np.append(intervals.start_s[own][:1], intervals.end_s[own]),
        np.append(0.0, np.cumsum(turns[own])),
    )
    steps = rotate(np.diff(truth.xyt[:, :2], axis=0), 0.5 * (more[1:] + more[:-1]))
    xy = truth.xyt[0, :2] + np.concatenate((np.zeros((1, 2)), np.cumsum(steps, axis=0)))
    return replace(recording, truth=replace(truth, xyt=np.column_stack((xy, truth.xyt[:, 2] + more))))


def _scaled(recording: Recording, factor: float) -> Recording:
    """Return a recording with all lengths of its truth multiplied by a factor."""
    return replace(recording, truth=replace(recording.truth, xyt=recording.truth.xyt * (factor, factor, 1.0)))


def ten_second_error(fitted: Fit) -> float:
    """Return the root mean square position error (m) after 10 s on the fitted recordings themselves."""
    left = [with_recomputed_headings(recording) for recording in fitted.problem.left]
    return Drift(tuple(phased_misses(left))).rmse
