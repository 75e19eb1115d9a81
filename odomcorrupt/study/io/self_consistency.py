"""Does a path agree with itself? Where it goes must be where it looks, up to a constant, in radians and metres."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.errors import RecordingError

if TYPE_CHECKING:
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.io.raw_trajectory import Samples

__all__ = ["check_itself"]

_DEGREE = np.pi / 180.0
_CLEAR, _UNCLEAR = 0.9, 0.6
_FEW = 12
_CHORDS = 40
_SPEED_S = 2.0
_FASTEST = 60.0

_READINGS = (
    (-1.0, "its headings turn the other way than its path does: an axis is mirrored, or they are compass headings; {}"),
    (_DEGREE, "its headings are degrees, not radians; {}"),
    (-_DEGREE, "its headings are degrees of a compass (clockwise), not radians counter-clockwise; {}"),
    (1.0 / _DEGREE, "its headings were taken for degrees, but are radians; {}"),
)


def check_itself(path: Samples) -> None:
    """Refuse a path whose headings or units cannot be meant.

    Chords of the path point where the robot looks, or straight backwards, whatever the angle at which it is mounted;
    twice their angle minus twice the heading is then a constant. Where another reading of the headings makes it
    constant and the given one does not, the given one is wrong.

    Raises
    ------
    RecordingError
        Where headings are degrees or mirrored, or the robot flies.

    """
    t_s = path.seconds_since(int(path.stamps_ns[0]))
    later = np.searchsorted(t_s, t_s + _SPEED_S)
    here = np.flatnonzero(later < len(t_s))
    later = later[here]
    speed = np.linalg.norm(path.xyz[later, :2] - path.xyz[here, :2], axis=1) / (t_s[later] - t_s[here])
    usual = float(np.median(speed[speed > 0.0])) if np.any(speed > 0.0) else 0.0
    if usual > _FASTEST:
        raise RecordingError(
            f"{path.place}: it usually moves at {usual:.0f} m/s: millimetres for metres? Give metres, or name a CSV "
            "file's columns x_mm, y_mm"
        )
    if not path.headed:
        return
    course, yaw = _chords(path)
    if len(course) < _FEW:
        return
    if _agreement(course, yaw) > _UNCLEAR:
        return
    for factor, sentence in _READINGS:
        if _agreement(course, factor * yaw) > _CLEAR:
            way_out = "in a CSV file, name the column yaw_deg or yaw_rad, as it is; turn a compass by 90 deg - yaw"
            raise RecordingError(f"{path.place}: {sentence.format(way_out)}")


def _chords(path: Samples) -> tuple[Array, Array]:
    """Return the angles of chords (k,), and the headings (k,) half way along them."""
    xy = path.xyz[:, :2]
    extent = float(np.linalg.norm(np.std(xy, axis=0)))
    noise = float(np.median(np.abs(np.diff(xy, n=2, axis=0)))) if len(xy) > 2 else 0.0
    length = max(extent / _CHORDS, 15.0 * noise, 1e-6)
    picked = [0]
    # distances add up only to a guess of where a chord ends; a walk over the guesses makes them long enough
    gone = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(xy, axis=0), axis=1))))
    at = 0
    while (at := int(np.searchsorted(gone, gone[at] + length))) < len(xy):
        if np.linalg.norm(xy[at] - xy[picked[-1]]) > length / 2.0:
            picked.append(at)
    ends = np.array(picked)
    chord = np.diff(xy[ends], axis=0)
    return np.arctan2(chord[:, 1], chord[:, 0]), path.yaw_rad[(ends[:-1] + ends[1:]) // 2]


def _agreement(course: Array, yaw: Array) -> float:
    """Return how constant twice the difference of two angles is: 1 constant, 0 any."""
    return float(np.abs(np.mean(np.exp(2j * (course - yaw)))))
