"""Drift of a run: drawn, and expected to first order."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np

from odomcorrupt.corruption.covariance import SUMS, pose_covariance
from odomcorrupt.corruption.inverse import Slowed
from odomcorrupt.geometry.se2 import between

if TYPE_CHECKING:
    from odomcorrupt.corruption.path import PathSamples
    from odomcorrupt.geometry.se2 import Array

LEG_M = 10.0
"""Length of a leg, metres: the drift of its end pose relative to its start pose is reported."""

MARKS_M = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1000.0, 2000.0, 5000.0)
"""Distances at which the drift of many runs is reported, besides the end, metres."""


class Drift(NamedTuple):
    """Position (m) and heading (rad) errors of a run, expected (standard deviation of the noise) and drawn.

    The leg values are root mean squares over legs of `LEG_M`; None for a shorter path. `slowed_s` and `slowed_to` are
    the sum and the least of `Slowed`; None if there is no such motion.
    """

    distance_m: float
    duration_s: float
    messages: int
    jumps: int
    sideways_m: float
    end_expected_m: float
    end_expected_rad: float
    end_drawn_m: float
    end_drawn_rad: float
    leg_expected_m: float | None
    leg_expected_rad: float | None
    leg_drawn_m: float | None
    leg_drawn_rad: float | None
    slowed_s: float | None = None
    slowed_to: float | None = None

    @property
    def rate_hz(self) -> float | None:
        """Mean message rate, Hz; None for fewer than two messages or no duration."""
        return (self.messages - 1) / self.duration_s if self.duration_s > 0.0 and self.messages > 1 else None


class _Place(NamedTuple):
    clean_xyt: Array
    error_xyt: Array
    sums: Array
    origin_xy: Array
    travelled_m: float
    stamp_ns: int


def _place(samples: PathSamples, i: int) -> _Place:
    return _Place(
        samples.clean_xyt[i].copy(), samples.error_xyt[i].copy(), samples.sums[:, i].copy(), samples.origin_xy,
        float(samples.travelled_m[i]), int(samples.stamps_ns[i]),
    )  # fmt: skip


class PathWatcher(Protocol):
    """Callback that receives the noisy path, part by part."""

    def restart(self) -> None:
        """Begin a new stretch: the stamps have jumped back."""

    def add(self, samples: PathSamples) -> None:
        """Process the next part of the path."""


class DriftMeter:
    """Drift of a path that arrives in parts; after a restart of time the end values are those of the last stretch."""

    def __init__(self) -> None:
        self._messages = self._jumps = 0
        self._sideways_m = 0.0
        self._slowed = Slowed()
        self._distance_m = self._duration_s = 0.0
        self._legs: list[list[float]] = []
        self._start: _Place | None = None
        self._mark: _Place | None = None
        self._end: _Place | None = None

    def restart(self) -> None:
        """End the current stretch."""
        if self._start is not None and self._end is not None:
            self._distance_m += self._end.travelled_m
            self._duration_s += (self._end.stamp_ns - self._start.stamp_ns) * 1e-9
        self._start = self._mark = None

    def add(self, samples: PathSamples) -> None:
        """Process the next part of the path."""
        if not len(samples):
            return
        self._messages += len(samples)
        self._jumps += samples.jumps
        self._sideways_m += samples.sideways_m
        self._slowed = Slowed(
            self._slowed.duration_s + samples.slowed.duration_s, min(self._slowed.to, samples.slowed.to)
        )
        if self._start is None or self._mark is None:
            self._start = self._mark = _place(samples, 0)
        ends: list[int] = []
        end_m = self._mark.travelled_m + LEG_M
        while samples.travelled_m[-1] >= end_m:
            ends.append(int(np.searchsorted(samples.travelled_m, end_m)))
            end_m = float(samples.travelled_m[ends[-1]]) + LEG_M
        if ends:
            self._legs += _legs(self._mark, samples, ends).tolist()
            self._mark = _place(samples, ends[-1])
        self._end = _place(samples, len(samples) - 1)

    def result(self) -> Drift | None:
        """Return the drift so far; None where there was no odometry."""
        if self._end is None:
            return None
        self.restart()
        end = self._end
        noisy_xy = end.clean_xyt[:2] + end.error_xyt[:2] - end.origin_xy
        expected_m, expected_rad = _expected(end.sums[:, None], noisy_xy[:, None])
        legs = [float(x) for x in np.sqrt(np.mean(np.square(self._legs), axis=0))] if self._legs else [None] * 4
        return Drift(
            self._distance_m, self._duration_s, self._messages, self._jumps, self._sideways_m,
            float(expected_m[0]), float(expected_rad[0]),
            float(np.hypot(*end.error_xyt[:2])), abs(float(end.error_xyt[2])), *legs,
            *(self._slowed if self._slowed.duration_s else (None, None)),
        )  # fmt: skip


def _expected(grown: Array, noisy_xy: Array) -> tuple[Array, Array]:
    """Return expected errors, metres and radians (n,), of increments of the sums (SUMS or more, n) at ends (2, n)."""
    covariance = pose_covariance(grown[:SUMS], noisy_xy)  # random effects are correlated between legs
    position, yaw = covariance[:, 0, 0] + covariance[:, 1, 1], covariance[:, 2, 2]
    return np.sqrt(np.maximum(position, 0.0)), np.sqrt(np.maximum(yaw, 0.0))


def _legs(start: _Place, samples: PathSamples, ends: list[int]) -> Array:
    """Return expected and drawn errors of legs, metres and radians (n, 4); each begins where the one before it ends."""
    clean = np.concatenate((start.clean_xyt[None], samples.clean_xyt[ends]))
    error = np.concatenate((start.error_xyt[None], samples.error_xyt[ends]))
    sums = np.concatenate((start.sums[:, None], samples.sums[:, ends]), axis=1)
    noisy = clean + error
    off = between(noisy[:-1], noisy[1:]) - between(clean[:-1], clean[1:])
    expected = _expected(np.diff(sums, axis=1), (noisy[1:, :2] - samples.origin_xy).T)
    return np.stack((*expected, np.hypot(off[:, 0], off[:, 1]), np.diff(error[:, 2])), axis=1)
