"""Noisy twists of an odometry topic: the clean twist plus the error of the interval that ends at each stamp."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.corruption.covariance import BODY_SUMS, twist_covariance
from odomcorrupt.geometry.se2 import rotate, wrap

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from odomcorrupt.corruption.correction import Correction
    from odomcorrupt.geometry.se2 import Array

__all__ = ["TopicTwist", "TwistChange"]

STILL = 1e-9
"""What a step of a pose that stands still may be by rounding, metres or radians."""


@dataclass(frozen=True, slots=True)
class TwistChange:
    """Changes of n twists.

    known : (n,) whether the message has a predecessor at another stamp; others are not changed
    added : (n, 3) noisy minus clean, forward and leftward m/s, yaw rad/s, in the body at mid heading
    covariance : (n, 3, 3) of these
    stationary : (n,) whether the clean pose equals that of the message before
    """

    known: NDArray[np.bool_]
    added: Array
    covariance: Array
    stationary: NDArray[np.bool_]


class TopicTwist:
    """Twist changes of one topic, from messages in the order of arrival.

    A message that arrives after a later stamp gets the rates of the interval that contains its own.
    """

    def __init__(self) -> None:
        self._stretch = -1

    def _begin(self, stretch: int) -> None:
        self._stretch = stretch
        self._stamps_ns: NDArray[np.int64] = np.zeros(0, dtype=np.int64)
        self._clean, self._correction, self._sums = np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 0))
        self._known, self._added, self._covariance, self._stationary = False, np.zeros(3), np.zeros((3, 3)), False

    def change(self, stamps_ns: NDArray[np.int64], clean_xyt: Array, at: Correction) -> TwistChange:
        """Return the changes of the twists of the next n messages.

        Parameters
        ----------
        stamps_ns : (n,)
            Header stamps.
        clean_xyt : (n, 3)
            Their clean poses, metres and radians.
        at : Correction
            The correction at these stamps.

        """
        n = len(stamps_ns)
        edges = np.flatnonzero(np.diff(at.stretch)) + 1
        if n and not len(edges):
            if at.stretch[0] != self._stretch:
                self._begin(int(at.stretch[0]))
            return self._within_stretch(stamps_ns, clean_xyt, at.xyt, at.sums)
        out = TwistChange(np.zeros(n, dtype=bool), np.zeros((n, 3)), np.zeros((n, 3, 3)), np.zeros(n, dtype=bool))
        for start, stop in zip([0, *edges], [*edges, n], strict=True):
            if start == stop:
                continue
            if at.stretch[start] != self._stretch:
                self._begin(int(at.stretch[start]))
            rows = slice(int(start), int(stop))
            part = self._within_stretch(stamps_ns[rows], clean_xyt[rows], at.xyt[rows], at.sums[:, rows])
            out.known[rows], out.added[rows], out.covariance[rows] = part.known, part.added, part.covariance
            out.stationary[rows] = part.stationary
        return out

    def _within_stretch(
        self, stamps_ns: NDArray[np.int64], clean_xyt: Array, correction_xyt: Array, sums: Array
    ) -> TwistChange:
        sums = sums[BODY_SUMS]
        if not len(self._stamps_ns):
            self._sums = sums[:, :0]
        floor = self._stamps_ns[-1] if len(self._stamps_ns) else np.iinfo(np.int64).min
        reach = np.maximum.accumulate(np.concatenate(([floor], stamps_ns)))
        beyond = stamps_ns > reach[:-1]
        # nearly always all of them are, and need not be picked out
        ahead = slice(None) if beyond.all() else np.flatnonzero(beyond)
        at_ns = np.concatenate((self._stamps_ns, stamps_ns[ahead]))
        clean = np.concatenate((self._clean, clean_xyt[ahead]))
        correction = np.concatenate((self._correction, correction_xyt[ahead]))
        every_sum = np.concatenate((self._sums, sums[:, ahead]), axis=1)
        dt_s = np.diff(at_ns) * np.float64(1e-9)

        # row 0 is the state before this batch, row k that of the k-th message that is ahead
        count = len(at_ns) - len(self._stamps_ns)
        fresh = count - len(dt_s)
        known = np.concatenate(([self._known], np.arange(count) >= fresh))
        added = np.zeros((len(known), 3))
        covariance = np.zeros((len(known), 3, 3))
        stationary = np.concatenate(([self._stationary], np.zeros(count, dtype=bool)))
        added[0], covariance[0] = self._added, self._covariance
        added[1 + fresh :] = _body_difference(clean, correction) / dt_s[:, None]
        covariance[1 + fresh :] = twist_covariance(np.diff(every_sum, axis=1), dt_s)
        stationary[1 + fresh :] = np.abs(np.diff(clean, axis=0)).max(axis=1) < STILL

        self._stamps_ns, self._clean, self._correction = at_ns[-1:], clean[-1:], correction[-1:]
        self._sums = every_sum[:, -1:]
        self._known, self._added, self._covariance = bool(known[-1]), added[-1], covariance[-1]
        self._stationary = bool(stationary[-1])
        if isinstance(ahead, slice):
            return TwistChange(known[1:], added[1:], covariance[1:], stationary[1:])
        latest = np.zeros(len(stamps_ns), dtype=np.int64)
        latest[ahead] = np.arange(1, count + 1)
        latest = np.maximum.accumulate(latest)
        known = known[latest] & (stamps_ns != reach[:-1])
        return TwistChange(known, added[latest], covariance[latest], stationary[latest])


def _body_difference(clean_xyt: Array, correction_xyt: Array) -> Array:
    """Return noisy minus clean body increments (n - 1, 3), each at its own mid heading.

    Only changes of the correction enter: where it is held, the difference is zero to the last bit.
    """
    turn = wrap(np.diff(clean_xyt[:, 2]))
    middle = clean_xyt[:-1, 2] + turn / 2.0
    world = np.diff(clean_xyt[:, :2], axis=0)
    swing = np.diff(correction_xyt[:, 2])
    shift = rotate(np.diff(correction_xyt[:, :2], axis=0), -correction_xyt[:-1, 2])
    end = clean_xyt[1:, :2]
    noisy_less_clean = shift + (rotate(end, swing) - end)
    clean_body = rotate(world, -middle)
    body = rotate(clean_body, -swing / 2.0) - clean_body + rotate(noisy_less_clean, -middle - swing / 2.0)
    return np.column_stack((body, swing))
