"""Positions east and north, in metres, from satellite fixes with resolved ambiguities.

A receiver with carrier-phase corrections (RTK) is accurate to centimetres while its integer ambiguities are resolved.
Otherwise it reports float ambiguities, decimetres off and drifting as they settle, or a plain code solution. The status
separates them (NavSatStatus: -1 no fix, 0 fix, 1 satellite-based, 2 ground-based augmentation). Some drivers (ublox,
nmea_navsat_driver) give float and fixed solutions the same status; then the position covariance does.
Sources: sensor_msgs/NavSatFix and NavSatStatus; u-blox ZED-F9P integration manual, section on RTK modes.

The plane of positions touches the ellipsoid at its origin. Geodetic coordinates become Earth-centred ones by the closed
formula of the World Geodetic System 1984 (NIMA TR8350.2, third edition, section 4.2); a rotation turns these to east
and north.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.geometry.se2 import compose
from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.model.motion_model import Origin
from odomcorrupt.study.io.raw_trajectory import runs_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.io.raw_trajectory import Samples
    from odomcorrupt.study.io.recording import Recording

FLOAT_TIMES, _SETTLED_TIMES = 5.0, 2.5
"""Ratios to the best fixes' standard deviation: above the first a float episode begins; it ends below the second,
which is smaller because the reported deviation of a float solution decreases while it settles."""
_BEST_QUANTILE, _MIN_GOOD = 0.1, 0.3
"""Quantile that defines the best fixes; fraction of fixes that must remain."""
_ISLAND_S = 3.0
"""Resolved fixes between two float episodes count as float if they last shorter: too short to be reliable."""
_OUTAGE_S, _OUTAGE_STEPS = 2.0, 5.0  # an outage is longer than both: seconds, and multiples of the median step
NO_FIX, UNKNOWN = -1, -2


def resolved(fixes: Samples, status: NDArray[np.int8]) -> Samples:
    """Return the positions of the resolved fixes, or of all fixes if 30 % or fewer are resolved.

    fixes : n samples with latitude and longitude in degrees and height in metres as xyz, variances 0 or NaN if the
        receiver reports none
    status : (n,) values of NavSatStatus
    """
    there = np.isfinite(fixes.xyz[:, :2]).all(axis=1) & (fixes.xyz[:, :2] != 0.0).any(axis=1) & (status != NO_FIX)
    missing = np.sum(~there)
    fixes = fixes.only(there, *([f"{missing} messages without a fix left out"] if missing else []))
    if not len(fixes):
        return fixes
    stamps_s = fixes.t_s if fixes.stamps_ns.any() else (fixes.log_ns - fixes.log_ns[0]).astype(np.float64) * 1e-9
    poor = _poor(status[there], fixes.variance_m2)
    if np.mean(~poor) > _MIN_GOOD:
        poor = _joined(stamps_s, poor)
    good_share = float(np.mean(~poor))
    if good_share > _MIN_GOOD:
        fixes = fixes.only(~poor, *_episodes(stamps_s, poor))
    elif poor.any():
        fixes = fixes.noted(
            f"only {good_share:.0%} of its fixes are as good as the best (the others: float or single, by their status "
            "or covariance), so that all are used: a truth of decimetres; effects smaller than that cannot be seen"
        )
    first = Origin(*np.nan_to_num(fixes.xyz[0]).tolist())
    placed = replace(fixes, xyz=east_north_up(fixes.xyz), geodetic_origin=first)
    steps = np.diff(stamps_s)
    out = steps[steps > max(_OUTAGE_S, _OUTAGE_STEPS * float(np.median(steps)))] if len(steps) else steps
    lost = [f"{len(out)} outage{'s' * (len(out) > 1)}, {out.sum():.0f} s without any fix"] if len(out) else []
    return placed.noted(*lost, "metres east and north of its first fix")


def without_float_episodes(truth: Samples) -> Samples:
    """Return a truth of positions without float episodes by its reported variances: a receiver's poses, not fixes.

    A truth with headings is returned as it is: variances of a localisation vary for other reasons.
    """
    if truth.headed or truth.geodetic_origin is not None or not len(truth.variance_m2):
        return truth
    stamps_s = truth.t_s
    poor = _joined(stamps_s, _poor(np.full(len(truth), UNKNOWN, dtype=np.int8), truth.variance_m2))
    return truth if not poor.any() or np.mean(~poor) <= _MIN_GOOD else truth.only(~poor, *_episodes(stamps_s, poor))


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
        for first, last in runs_of(poor | (claimed & (variance_m2 > _SETTLED_TIMES**2 * best))):
            poor[first:last] |= poor[first:last].any()
    return poor


def _joined(stamps_s: Array, poor: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the mask with short stretches of good fixes between two poor ones counted as poor."""
    joined = poor.copy()
    for first, last in runs_of(~poor):
        inside = first > 0 and last < len(poor)
        if inside and stamps_s[last] - stamps_s[first - 1] < _ISLAND_S:
            joined[first:last] = True
    return joined


def _episodes(stamps_s: Array, poor: NDArray[np.bool_]) -> list[str]:
    episodes = runs_of(poor)
    if not episodes:
        return []
    seconds = sum(float(stamps_s[min(last, len(poor) - 1)] - stamps_s[first]) for first, last in episodes)
    what = "float episode" if len(episodes) == 1 else "float episodes"
    why = f"by their status or by {FLOAT_TIMES:g} and more times the deviation of the best ones"
    share = f"{np.sum(poor)} of {len(poor)} fixes: float or single, {why}"
    return [f"{len(episodes)} {what}, {seconds:.0f} s, left out ({share})"]


_A_M, _F = 6378137.0, 1.0 / 298.257223563
"""Semi-major axis and flattening of WGS 84."""
_E2 = _F * (2.0 - _F)


def east_north_up(lla: Array) -> Array:
    """Return positions (n, 3) in metres east, north and up of the first fix, from fixes (n, 3) in degrees and metres.

    Heights that are NaN count as 0 (on the ellipsoid): some receivers report only latitude and longitude.
    """
    centred = _earth_centred(lla)
    return (centred - centred[0]) @ _to_plane(lla[0]).T


def frame_of(origin: Origin, other: Origin) -> Array:
    """Return the pose (3,) of one origin's plane in another origin's plane: x east, y north; m and rad.

    The two planes are not parallel; at d metres from each other lengths differ by less than (d / 6 371 km)^2 / 2.
    """
    here, there = (np.array([o.latitude_deg, o.longitude_deg, o.altitude_m]) for o in (origin, other))
    axes = _to_plane(there)
    position = axes @ (_earth_centred(here[None]) - _earth_centred(there[None]))[0]
    east = axes @ _to_plane(here)[0]
    return np.array([position[0], position[1], np.arctan2(east[1], east[0])])


def in_frame(recording: Recording, origin: Origin | None) -> Recording:
    """Return the recording with its truth moved to another geodetic origin; unchanged if it has no origin.

    A place learned from one recording, such as a patch of wet floor, is then the same place in the others.
    """
    own = recording.geodetic_origin
    if origin is None or own is None or own == origin:
        return recording
    frame = frame_of(own, origin)
    truth = recording.truth
    moved = Trajectory(truth.stamps_ns, compose(frame, truth.xyt), truth.covariance, truth.relative)
    note = f"truth put into the frame of {origin}, {np.hypot(frame[0], frame[1]):.0f} m away"
    return replace(recording, truth=moved, geodetic_origin=origin, notes=(*recording.notes, note))


def _to_plane(lla: Array) -> Array:
    """Return the rotation (3, 3) from Earth-centred axes to east, north and up at a fix (3,)."""
    latitude, longitude = np.radians(lla[:2])
    s, c, sl, cl = np.sin(latitude), np.cos(latitude), np.sin(longitude), np.cos(longitude)
    return np.array([[-sl, cl, 0.0], [-s * cl, -s * sl, c], [c * cl, c * sl, s]])


def _earth_centred(lla: Array) -> Array:
    """Return Earth-centred coordinates (n, 3) of fixes (n, 3), metres."""
    latitude, longitude = np.radians(lla[:, 0]), np.radians(lla[:, 1])
    height = np.nan_to_num(lla[:, 2], nan=0.0)
    sin_lat, cos_lat, sin_lon, cos_lon = np.sin(latitude), np.cos(latitude), np.sin(longitude), np.cos(longitude)
    normal = _A_M / np.sqrt(1.0 - _E2 * sin_lat**2)
    from_axis = (normal + height) * cos_lat
    return np.column_stack((from_axis * cos_lon, from_axis * sin_lon, (normal * (1.0 - _E2) + height) * sin_lat))
