"""Checks that truth and odometry share turning direction, plane of motion and clock."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.errors import RecordingError
from odomcorrupt.study.io.cross_correlation import cross_correlation

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.io.raw_trajectory import Samples

_MIN_WIDTH_M = 0.05  # smaller widths of a path in x-y are not compared
_MAX_LAG_S = 60.0  # largest lag tested for a clock offset
_SAME_CLOCK_S = 3.0  # lags up to here count as the same clock
_CLEAR = 0.7  # correlation above which a lag is taken as a clock offset
_MIRRORED = 0.5  # magnitude of a negative yaw rate correlation that suggests a mirrored axis
_SAME_SHAPE = 0.15  # relative residual of a path's alignment below which two paths have the same shape


def check_plane(here: Samples, there: Samples) -> None:
    """Refuse a truth that moves in the x-z or y-z plane: its width in x-y is then far below the odometry's."""
    wide = _width(here.xyz[:, :2])
    if _width(there.xyz[:, :2]) > 0.25 * wide or wide < _MIN_WIDTH_M:
        return
    for up, plane in (("y", [0, 2]), ("x", [1, 2])):
        if _width(there.xyz[:, plane]) > 0.5 * wide:
            axes = "xyz"[plane[0]] + "-" + "xyz"[plane[1]]
            raise RecordingError(
                f"{there.place}: moves in its {axes} plane, not in x-y: {up} points up there; turn it so that z does"
            )


def check_turning(here: Samples, there: Samples) -> None:
    """Refuse a truth whose yaw rate has the opposite sign of the odometry's, or whose clock is shifted."""
    corr = cross_correlation(here.trajectory(), there.trajectory(), min(_MAX_LAG_S, here.span_s / 2.0))
    near = np.abs(corr.lag_s) <= _SAME_CLOCK_S
    best, flipped = int(np.argmax(corr.both)), int(np.argmin(np.where(near, corr.turn, 1.0)))
    least, most = float(corr.turn[flipped]), float(corr.turn[near].max())
    # A periodic drive looks mirrored half a period later: refuse only if no clock offset explains it better.
    if least < -_MIRRORED and most < 0.5 * abs(least) and corr.both[best] < corr.mirrored[flipped] + 0.02:
        raise RecordingError(
            f"{there.place}: turns right where the odometry turns left (yaw rates correlate by {least:.2f}): one of "
            "its axes is mirrored, or it has compass headings; flip it"
        )
    if corr.both[best] > _CLEAR and corr.both[near].max() < 0.5 * corr.both[best]:
        side = "behind" if corr.lag_s[best] > 0.0 else "ahead of"
        raise RecordingError(
            f"{there.place}: its clock is {abs(corr.lag_s[best]):.1f} s {side} the odometry's (motions correlate by "
            f"{corr.both[best]:.2f} there, by {corr.both[near].max():.2f} as they are); give --truth-shift "
            f"{corr.lag_s[best]:.1f}"
        )


def check_shape(here: Samples, there: Samples) -> None:
    """Refuse a truth that matches the odometry's path only when mirrored (also finds it in drives without turns)."""
    p, q = _shape(here, here), _shape(there, here)
    whole = float(np.sum(np.abs(p) ** 2) + np.sum(np.abs(q) ** 2))
    both = np.array([np.abs(np.vdot(p, q)), np.abs(np.sum(p * q))])
    turned, flipped = np.sqrt(np.maximum(1.0 - 2.0 * both / whole, 0.0)).tolist()
    if flipped < _SAME_SHAPE and turned > 3.0 * flipped and turned > _SAME_SHAPE:
        raise RecordingError(
            f"{there.place}: its path is the odometry's in a mirror ({flipped:.0%} off, {turned:.0%} without one): one "
            "of its axes is mirrored; flip it"
        )


def _shape(path: Samples, clock: Samples) -> NDArray[np.complex128]:
    """Return a path's positions as complex numbers about their mean, interpolated at the stamps of `clock`."""
    own, at = (x.seconds_since(int(clock.stamps_ns[0])) for x in (path, clock))
    xy = [np.interp(at, own, path.xyz[:, i]) for i in (0, 1)]
    return (xy[0] - np.mean(xy[0])) + 1j * (xy[1] - np.mean(xy[1]))


def _width(plane: Array) -> float:
    """Return the smaller of the two standard deviations of points (n, 2) about their axes."""
    return float(np.linalg.svd(plane - plane.mean(axis=0), compute_uv=False)[-1] / np.sqrt(len(plane)))
