"""Conversion of satellite fixes to metres east and north, and of recordings to a common geodetic origin.

The plane touches the ellipsoid at its origin. Geodetic coordinates become Earth-centred ones by the closed formula of
the World Geodetic System 1984 (NIMA TR8350.2, third edition, section 4.2); a rotation turns these to east and north.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.geometry.se2 import compose
from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.model.motion_model import Origin

if TYPE_CHECKING:
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.io.recording import Recording

__all__ = ["east_north_up", "frame_of", "in_frame", "origin_of"]

_A_M = 6378137.0
"""Semi-major axis of WGS 84."""
_F = 1.0 / 298.257223563
"""Flattening of WGS 84."""
_E2 = _F * (2.0 - _F)


def origin_of(lla: Array) -> Origin:
    """Return a fix (3,) as an origin; a height that is not finite counts as 0."""
    latitude, longitude, height = np.nan_to_num(lla).tolist()
    return Origin(latitude, longitude, height)


def east_north_up(lla: Array) -> Array:
    """Return positions (n, 3) in metres east, north and up of the first fix, from fixes (n, 3) in degrees and metres.

    Heights that are NaN count as 0 (on the ellipsoid): some receivers report only latitude and longitude.
    """
    centred = _earth_centred(lla)
    plane: Array = (centred - centred[0]) @ _to_plane(lla[0]).T
    return plane


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
    return np.stack(
        (
            (normal + height) * cos_lat * cos_lon,
            (normal + height) * cos_lat * sin_lon,
            (normal * (1.0 - _E2) + height) * sin_lat,
        ),
        axis=1,
    )
