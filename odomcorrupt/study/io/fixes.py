"""Positions east and north, in metres, from satellite fixes with resolved ambiguities.

A receiver with carrier-phase corrections (RTK) is accurate to centimetres while its integer ambiguities are resolved.
Otherwise it reports float ambiguities, decimetres off and drifting as they settle, or a plain code solution. The status
separates them (NavSatStatus: -1 no fix, 0 fix, 1 satellite-based, 2 ground-based augmentation). Some drivers (ublox,
nmea_navsat_driver) give float and fixed solutions the same status; then the position covariance does.
Sources: sensor_msgs/NavSatFix and NavSatStatus; u-blox ZED-F9P integration manual, section on RTK modes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from odomcorrupt.study.io.geodesy import east_north_up, origin_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.model.motion_model import Origin
    from odomcorrupt.study.io.raw_trajectory import Samples

__all__ = ["Fixes", "Resolved", "resolved", "without_float_episodes"]

FLOAT_TIMES, _SETTLED_TIMES = 5.0, 2.5
"""Ratios to the best fixes' standard deviation: above the first a float episode begins; it ends below the second,
which is smaller because the reported deviation of a float solution decreases while it settles."""
_BEST_QUANTILE, _MIN_GOOD = 0.1, 0.3
"""Quantile that defines the best fixes; fraction of fixes that must remain."""
_ISLAND_S = 3.0
"""Resolved fixes between two float episodes count as float if they last shorter: too short to be reliable."""
_OUTAGE_S, _OUTAGE_STEPS = 2.0, 5.0  # an outage is longer than both: seconds, and multiples of the median step
NO_FIX, UNKNOWN = -1, -2


class Fixes(NamedTuple):
    """Fixes of a receiver, n messages sorted by stamp.

    stamps_ns : (n,) nanoseconds
    lla : (n, 3) latitude and longitude in degrees, height in metres
    status : (n,) values of NavSatStatus
    variance_m2 : (n,) east plus north; 0 or NaN if the receiver reports none
    """

    stamps_ns: NDArray[np.int64]
    lla: Array
    status: NDArray[np.int8]
    variance_m2: Array


class Resolved(NamedTuple):
    """Positions of the fixes with resolved ambiguities.

    rows : (k,) indices of these fixes
    xyz : (k, 3) metres east, north and up of the first one
    origin : geodetic origin of xyz, None if there is no fix
    notes : descriptions of the fixes left out, for reports
    """

    rows: NDArray[np.int64]
    xyz: Array
    origin: Origin | None
    notes: tuple[str, ...]


def resolved(fixes: Fixes) -> Resolved:
    """Return the positions of the resolved fixes, or of all fixes if 30 % or fewer are resolved."""
    notes: list[str] = []
    there = np.isfinite(fixes.lla[:, :2]).all(axis=1) & (fixes.lla[:, :2] != 0.0).any(axis=1)
    there &= fixes.status != NO_FIX
    if not there.all():
        notes.append(f"{np.sum(~there)} messages without a fix left out")
    rows = np.flatnonzero(there)
    if not len(rows):
        return Resolved(rows, np.zeros((0, 3)), None, tuple(notes))
    stamps_s = (fixes.stamps_ns[rows] - fixes.stamps_ns[rows[0]]).astype(np.float64) * 1e-9
    poor = _poor(fixes.status[rows], fixes.variance_m2[rows])
    if np.mean(~poor) > _MIN_GOOD:
        poor = _joined(stamps_s, poor)
    good_share = float(np.mean(~poor))
    if good_share > _MIN_GOOD:
        notes += _episodes(stamps_s, poor)
        rows = rows[~poor]
    elif poor.any():
        notes.append(
            f"only {good_share:.0%} of its fixes are as good as the best (the others: float or single, by their status "
            "or covariance), so that all are used: a truth of decimetres; effects smaller than that cannot be seen"
        )
    notes += _outages(stamps_s)
    notes.append("metres east and north of its first fix")
    return Resolved(rows, east_north_up(fixes.lla[rows]), origin_of(fixes.lla[rows[0]]), tuple(notes))


def without_float_episodes(truth: Samples) -> Samples:
    """Return a truth of positions without float episodes by its reported variances: a receiver's poses, not fixes.

    A truth with headings is returned as it is: variances of a localisation vary for other reasons.
    """
    if truth.headed or truth.geodetic_origin is not None or not len(truth.variance_m2):
        return truth
    stamps_s = truth.seconds_since(int(truth.stamps_ns[0]))
    poor = _joined(stamps_s, _poor(np.full(len(truth), UNKNOWN, dtype=np.int8), truth.variance_m2))
    if not poor.any() or np.mean(~poor) <= _MIN_GOOD:
        return truth
    return truth.only(~poor, *_episodes(stamps_s, poor))


def _poor(status: NDArray[np.int8], variance_m2: Array) -> NDArray[np.bool_]:
    """Return a mask (n,) of fixes of a lower grade than the best usual one, by status or reported covariance."""
    poor = np.zeros(len(status), dtype=bool)
    grades = [grade for grade in (0, 1, 2) if np.mean(status >= grade) > _MIN_GOOD]
    if grades:
        poor |= (status < grades[-1]) & (status != UNKNOWN)
    claimed = np.isfinite(variance_m2) & (variance_m2 > 0.0)
    if np.any(claimed & ~poor):
        best = float(np.quantile(variance_m2[claimed & ~poor], _BEST_QUANTILE))
        poor |= claimed & (variance_m2 > FLOAT_TIMES**2 * best)
        for first, last in _runs(poor | (claimed & (variance_m2 > _SETTLED_TIMES**2 * best))):
            poor[first:last] |= poor[first:last].any()
    return poor


def _joined(stamps_s: Array, poor: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the mask with short stretches of good fixes between two poor ones counted as poor."""
    joined = poor.copy()
    for first, last in _runs(~poor):
        inside = first > 0 and last < len(poor)
        if inside and stamps_s[last] - stamps_s[first - 1] < _ISLAND_S:
            joined[first:last] = True
    return joined


def _episodes(stamps_s: Array, poor: NDArray[np.bool_]) -> list[str]:
    episodes = _runs(poor)
    if not episodes:
        return []
    seconds = sum(float(stamps_s[min(last, len(poor) - 1)] - stamps_s[first]) for first, last in episodes)
    what = "float episode" if len(episodes) == 1 else "float episodes"
    why = f"by their status or by {FLOAT_TIMES:g} and more times the deviation of the best ones"
    share = f"{np.sum(poor)} of {len(poor)} fixes: float or single, {why}"
    return [f"{len(episodes)} {what}, {seconds:.0f} s, left out ({share})"]


def _outages(stamps_s: Array) -> list[str]:
    steps = np.diff(stamps_s)
    if not len(steps):
        return []
    out = steps[steps > max(_OUTAGE_S, _OUTAGE_STEPS * float(np.median(steps)))]
    if not len(out):
        return []
    return [f"{len(out)} {'outage' if len(out) == 1 else 'outages'}, {out.sum():.0f} s without any fix"]


def _runs(mask: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return the stretches of a mask (n,) that are true, as half-open index ranges."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], mask, [False])).astype(np.int8)))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]
