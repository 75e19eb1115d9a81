"""Whether odometry and truth turn the same way, in the same plane, at the same time."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.errors import RecordingError
from odomcorrupt.study.io.cross_correlation import likeness

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.io.raw_trajectory import Samples

__all__ = ["check_plane", "check_shape", "check_turning"]

_STILL_M = 0.05
_LAG_S = 60.0
_NEAR_S = 3.0
_CLEAR = 0.7
_MIRRORED = 0.5
_FITS = 0.15


def check_plane(here: Samples, there: Samples) -> None:
    """Refuse a truth that moves in a plane that is not x-y: its width in x-y then is nothing like the odometry's."""
    wide = _width(here.xyz[:, :2])
    if _width(there.xyz[:, :2]) > 0.25 * wide or wide < _STILL_M:
        return
    for up, plane in (("y", [0, 2]), ("x", [1, 2])):
        if _width(there.xyz[:, plane]) > 0.5 * wide:
            axes = "xyz"[plane[0]] + "-" + "xyz"[plane[1]]
            raise RecordingError(
                f"{there.place}: moves in its {axes} plane, not in x-y: {up} points up there; turn it so that z does"
            )


def check_turning(here: Samples, there: Samples) -> None:
    """Refuse a truth that turns right where the odometry turns left, or does so at another time."""
    alike = likeness(here.trajectory(), there.trajectory(), min(_LAG_S, here.span_s / 2.0))
    near = np.abs(alike.lag_s) <= _NEAR_S
    best, flipped = int(np.argmax(alike.both)), int(np.argmin(np.where(near, alike.turn, 1.0)))
    least, most = float(alike.turn[flipped]), float(alike.turn[near].max())
    # drives that repeat themselves look mirrored half a period later: another clock must not explain it better
    if least < -_MIRRORED and most < 0.5 * abs(least) and alike.both[best] < alike.mirrored[flipped] + 0.02:
        raise RecordingError(
            f"{there.place}: turns right where the odometry turns left (yaw rates correlate by {least:.2f}): one of "
            "its axes is mirrored, or it has compass headings; flip it"
        )
    if alike.both[best] > _CLEAR and alike.both[near].max() < 0.5 * alike.both[best]:
        side = "behind" if alike.lag_s[best] > 0.0 else "ahead of"
        raise RecordingError(
            f"{there.place}: its clock is {abs(alike.lag_s[best]):.1f} s {side} the odometry's (motions correlate by "
            f"{alike.both[best]:.2f} there, by {alike.both[near].max():.2f} as they are); say --truth-shift "
            f"{alike.lag_s[best]:.1f}"
        )


def check_shape(here: Samples, there: Samples) -> None:
    """Refuse a truth onto which the odometry's path fits in a mirror alone: of a robot that never turns, say."""
    p, q = _shape(here, here), _shape(there, here)
    whole = float(np.sum(np.abs(p) ** 2) + np.sum(np.abs(q) ** 2))
    both = np.array([np.abs(np.vdot(p, q)), np.abs(np.sum(p * q))])
    turned, flipped = np.sqrt(np.maximum(1.0 - 2.0 * both / whole, 0.0)).tolist()
    if flipped < _FITS and turned > 3.0 * flipped and turned > _FITS:
        raise RecordingError(
            f"{there.place}: its path is the odometry's in a mirror ({flipped:.0%} off, {turned:.0%} without one): one "
            "of its axes is mirrored; flip it"
        )


def _shape(path: Samples, clock: Samples) -> NDArray[np.complex128]:
    """Return the path as complex numbers about their mean, at the stamps of another one."""
    own, at = (x.seconds_since(int(clock.stamps_ns[0])) for x in (path, clock))
    xy = [np.interp(at, own, path.xyz[:, i]) for i in (0, 1)]
    centred: NDArray[np.complex128] = (xy[0] - np.mean(xy[0])) + 1j * (xy[1] - np.mean(xy[1]))
    return centred


def _width(plane: Array) -> float:
    """Return the smaller of the two standard deviations of points (n, 2) about their axes."""
    return float(np.linalg.svd(plane - plane.mean(axis=0), compute_uv=False)[-1] / np.sqrt(len(plane)))
