"""Consistency of a path's headings with its direction of travel, and plausibility of their units."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.errors import RecordingError
from odomcorrupt.geometry.trajectory import distance_along
from odomcorrupt.study.io.units import GIVE_METRES

if TYPE_CHECKING:
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.io.raw_trajectory import Samples

_DEGREE = np.pi / 180.0
_CLEAR, _UNCLEAR = 0.9, 0.6  # agreement of a better reading of the headings, and of the given one, for a refusal
_MIN_CHORDS = 12
_CHORDS = 40  # chords per extent of the path
_SPEED_S = 2.0
_MAX_MPS = 60.0  # m/s

_READINGS = (
    (-1.0, "its headings turn the other way than its path does: an axis is mirrored, or they are compass headings; {}"),
    (_DEGREE, "its headings are degrees, not radians; {}"),
    (-_DEGREE, "its headings are degrees of a compass (clockwise), not radians counter-clockwise; {}"),
    (1.0 / _DEGREE, "its headings were read as degrees, but are radians; {}"),
)


def check_itself(path: Samples) -> None:
    """Refuse a path with implausible headings or units.

    Chords of the path point along the heading or straight backwards, up to a constant mounting angle. Twice the chord's
    angle minus twice the heading is therefore constant. If this holds for degrees or mirrored headings and not for the
    given headings, those are wrong.

    Raises
    ------
    RecordingError
        If headings are in degrees or mirrored, or the usual speed exceeds 60 m/s.
    """
    t_s = path.t_s
    later = np.searchsorted(t_s, t_s + _SPEED_S)
    here = np.flatnonzero(later < len(t_s))
    later = later[here]
    speed = np.linalg.norm(path.xyz[later, :2] - path.xyz[here, :2], axis=1) / (t_s[later] - t_s[here])
    usual = float(np.median(speed[speed > 0.0])) if np.any(speed > 0.0) else 0.0
    if usual > _MAX_MPS:
        raise RecordingError(
            f"{path.place}: it usually moves at {usual:.0f} m/s: millimetres for metres? {GIVE_METRES}"
        )
    if not path.headed:
        return
    course, yaw = _chords(path)
    if len(course) < _MIN_CHORDS:
        return
    if _agreement(course, yaw) > _UNCLEAR:
        return
    for factor, sentence in _READINGS:
        if _agreement(course, factor * yaw) > _CLEAR:
            way_out = "in a CSV file, name the column yaw_deg or yaw_rad, as it is; turn a compass by 90 deg - yaw"
            raise RecordingError(f"{path.place}: {sentence.format(way_out)}")


def _chords(path: Samples) -> tuple[Array, Array]:
    """Return the angles of chords (k,), and the headings (k,) at their middle, radians."""
    xy = path.xyz[:, :2]
    extent = float(np.linalg.norm(np.std(xy, axis=0)))
    noise = float(np.median(np.abs(np.diff(xy, n=2, axis=0)))) if len(xy) > 2 else 0.0
    length = max(extent / _CHORDS, 15.0 * noise, 1e-6)
    picked = [0]
    # The travelled distance only bounds the chord from above: continue until the chord itself is long enough.
    gone = distance_along(xy)
    at = 0
    while (at := int(np.searchsorted(gone, gone[at] + length))) < len(xy):
        if np.linalg.norm(xy[at] - xy[picked[-1]]) > length / 2.0:
            picked.append(at)
    ends = np.array(picked)
    chord = np.diff(xy[ends], axis=0)
    return np.arctan2(chord[:, 1], chord[:, 0]), path.yaw_rad[(ends[:-1] + ends[1:]) // 2]


def _agreement(course: Array, yaw: Array) -> float:
    """Return the concentration of twice the difference of two angles: 1 for a constant, about 0 for no relation."""
    return float(np.abs(np.mean(np.exp(2j * (course - yaw)))))
