"""Satellite fixes as metres east and north of the first one.

The plane touches the ellipsoid at the first fix. Geodetic to Earth-centred coordinates is the closed formula of the
World Geodetic System 1984 (NIMA TR8350.2, third edition, section 4.2), and a rotation takes these to east and north.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from odomcorrupt.geometry.se2 import Array

__all__ = ["east_north_up"]

_A_M = 6378137.0
"""Semi-major axis of WGS 84."""
_F = 1.0 / 298.257223563
"""Flattening of WGS 84."""
_E2 = _F * (2.0 - _F)


def east_north_up(lla: Array) -> Array:
    """Return metres (n, 3) east, north and up of the first of fixes (n, 3): degrees, degrees, metres.

    A height that is no number counts as that of the ellipsoid: receivers without height still know where they are.
    """
    latitude, longitude = np.radians(lla[:, 0]), np.radians(lla[:, 1])
    height = np.nan_to_num(lla[:, 2], nan=0.0)
    sin_lat, cos_lat, sin_lon, cos_lon = np.sin(latitude), np.cos(latitude), np.sin(longitude), np.cos(longitude)
    normal = _A_M / np.sqrt(1.0 - _E2 * sin_lat**2)
    centred = np.stack(
        (
            (normal + height) * cos_lat * cos_lon,
            (normal + height) * cos_lat * sin_lon,
            (normal * (1.0 - _E2) + height) * sin_lat,
        ),
        axis=1,
    )
    s, c, sl, cl = sin_lat[0], cos_lat[0], sin_lon[0], cos_lon[0]
    to_plane = np.array([[-sl, cl, 0.0], [-s * cl, -s * sl, c], [c * cl, c * sl, s]])
    plane: Array = (centred - centred[0]) @ to_plane.T
    return plane
