"""What noise does to a path's uncertainty, to first order, as running sums.

A heading error e made where the robot was at q turns everything after it about q: it moves a later point p by
J (p - q) e, with J = [[0, -1], [1, 0]]. So all a covariance at p needs are the sums of the errors' variances times
1, q and q q'; sums are taken along the noisy path, for that is what a filter linearises about.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.corruption.random_covariance import wandered_covariance

if TYPE_CHECKING:
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.model.noise_laws import Variances

__all__ = ["BODY_SUMS", "FLOOR", "SUMS", "NoiseSteps", "pose_covariance", "sum_terms", "twist_covariance"]

SUMS = 15
"""Rows of the running sums: nine for the pose (1, x, y, xx, xy, yy; translation xx, xy, yy), six for the body.

Where effects draw, the rows of `wander` follow; the body's six hold both.
"""

BODY_SUMS = slice(9, SUMS)
"""Those of the body."""

FLOOR = 1e-9
"""Added to every variance, m^2 or rad^2: filters invert covariances, and a robot that has not moved has none.

Nor would one that turned once and then drove straight: there the floor alone keeps the matrix positive, so covariances
are written with all their digits. Rounded to those of a float32 they would pack into 16 % less, though in no less time,
and of such drives every second matrix would be none of a covariance.
"""


@dataclass(frozen=True, slots=True)
class NoiseSteps:
    """n noisy increments.

    variances : of the four draws
    start_xy, end_xy : (2, n) noisy positions, metres from the path's start
    travel_rad : (n,) where the body's x axis points while it translates
    bearing_rad : (n,) where trans acts, against the body's x axis; None along it
    along_m, across_m : (n,) the noisy travel
    arc : whether rot1 is spread evenly over the translation
    """

    variances: Variances
    start_xy: Array
    end_xy: Array
    travel_rad: Array
    bearing_rad: Array | None
    along_m: Array
    across_m: Array
    arc: bool


def sum_terms(steps: NoiseSteps) -> Array:
    """Return what each increment adds to the running sums, (SUMS, n)."""
    v = steps.variances
    (x1, y1), (x2, y2) = (steps.start_xy + steps.end_xy) / 2.0 if steps.arc else steps.start_xy, steps.end_xy
    body = 0.0 if steps.bearing_rad is None else steps.bearing_rad
    world = steps.travel_rad + body
    c, s, cb, sb = np.cos(world), np.sin(world), np.cos(body), np.sin(body)
    heading = v.rot1 + v.rot2
    # in the body at mid heading, the step swings by half of rot1 less half of rot2; an arc's rot1 swings nothing
    first, last = 0.0 if steps.arc else 0.5, -0.5
    shear, both = first**2 * v.rot1 + last**2 * v.rot2, first * v.rot1 + last * v.rot2
    terms = np.empty((SUMS, len(c)))
    terms[0] = heading
    terms[1] = v.rot1 * x1 + v.rot2 * x2
    terms[2] = v.rot1 * y1 + v.rot2 * y2
    terms[3] = v.rot1 * x1 * x1 + v.rot2 * x2 * x2
    terms[4] = v.rot1 * x1 * y1 + v.rot2 * x2 * y2
    terms[5] = v.rot1 * y1 * y1 + v.rot2 * y2 * y2
    terms[6] = v.trans * c * c + v.across * s * s
    terms[7] = (v.trans - v.across) * c * s
    terms[8] = v.trans * s * s + v.across * c * c
    terms[9] = shear * steps.across_m * steps.across_m + v.trans * cb * cb + v.across * sb * sb
    terms[10] = -shear * steps.along_m * steps.across_m + (v.trans - v.across) * cb * sb
    terms[11] = shear * steps.along_m * steps.along_m + v.trans * sb * sb + v.across * cb * cb
    terms[12] = -both * steps.across_m
    terms[13] = both * steps.along_m
    terms[14] = heading
    return terms


def pose_covariance(sums: Array, xy_m: Array) -> Array:
    """Return covariances (n, 3, 3) of x, y, yaw in odom axes, from sums (SUMS or more, n) and positions (2, n).

    Positions are noisy and counted from where the sums began, metres.
    """
    s0, sx, sy, sxx, sxy, syy, txx, txy, tyy = sums[:9]
    x, y = xy_m
    noise = _symmetric(
        y * y * s0 - 2.0 * y * sy + syy + txx,
        txy - (x * y * s0 - x * sy - y * sx + sxy),
        x * x * s0 - 2.0 * x * sx + sxx + tyy,
        sy - y * s0,
        x * s0 - sx,
        s0,
    )
    return noise if len(sums) == SUMS else noise + wandered_covariance(sums[SUMS:], xy_m)


def twist_covariance(grown: Array, dt_s: Array) -> Array:
    """Return covariances (n, 3, 3) of vx, vy, yaw rate over intervals in which the body's sums grew by (6, n)."""
    return _symmetric(*grown / (dt_s * dt_s))


def _symmetric(*upper: Array) -> Array:
    """Return matrices (n, 3, 3) from xx, xy, yy, x-yaw, y-yaw, yaw-yaw (n,) each, the floor added."""
    out = np.empty((len(upper[0]), 3, 3))
    for values, (i, j) in zip(upper, ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2)), strict=True):
        out[:, i, j] = out[:, j, i] = values + FLOOR if i == j else values
    return out
