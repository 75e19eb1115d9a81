"""First-order covariance of a noisy path, as running sums.

A heading error e at position q rotates the rest of the path about q: a later point p moves by J (p - q) e, with
J = [[0, -1], [1, 0]]. The covariance at p is therefore a function of the sums of the errors' variances times 1, q
and q q'. Sums are taken along the noisy path, about which a filter linearises.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from odomcorrupt.effects.effect import Motion

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from odomcorrupt.effects.effect import Effect, RandomCoefficient
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.model.noise_laws import Variances

_FIRST, _SECOND = np.triu_indices(5)

RANDOM_SUMS = len(_FIRST)
"""Rows of the running sums: covariances of the five, row by row of the upper triangle."""

_STEP_FIRST, _STEP_SECOND = np.array([0, 0, 1, 0, 1, 2]), np.array([0, 1, 1, 2, 2, 2])


class _Memory(NamedTuple):
    """Present variance of a random coefficient, and its covariance (5,) with the five sums."""

    variance: float
    with_sums: Array


class Grown(NamedTuple):
    """Covariance terms of n intervals.

    path : (RANDOM_SUMS, n) increments of the running sums
    step : (6, n) covariance of each interval's own error, odom axes: xx, xy, yy, x-yaw, y-yaw, yaw-yaw
    """

    path: Array
    step: Array


def has_random_part(effect: Effect, track_m: float | None) -> bool:
    """Return whether an effect has a random part whose variance it states."""
    none = np.zeros(0)
    still = Motion(
        none, none, none, none, none, np.zeros((0, 3)), none, none, none, none, track_m=track_m
    )  # fmt: skip
    return effect.acts and bool(effect.gains(still))


class RandomEffectCovariance:
    """Covariance of the random effects, carried from batch to batch; any division into batches gives the same bits."""

    def __init__(self) -> None:
        self._memories: list[_Memory] = []

    def restart(self) -> None:
        """Begin a new path; the random coefficients keep their values."""
        self._memories = [_Memory(memory.variance, np.zeros(5)) for memory in self._memories]

    def grow(self, gains: tuple[RandomCoefficient, ...], dt_s: Array, middle_xy: Array, travel_rad: Array) -> Grown:
        """Return the covariance terms of n intervals.

        gains : random coefficients; the same, in the same order, at every call
        dt_s : (n,) lengths of the intervals, seconds
        middle_xy : (2, n) noisy positions at the middle of each interval, metres from the path's start
        travel_rad : (n,) direction of the body's x axis during the translation, radians
        """
        from odomcorrupt.effects.random_processes import autoregression  # noqa: PLC0415 - slow to import

        self._memories = self._memories or [_Memory(gain.start, np.zeros(5)) for gain in gains]
        c, s = np.cos(travel_rad), np.sin(travel_rad)
        path, step = np.zeros((RANDOM_SUMS, len(dt_s))), np.zeros((6, len(dt_s)))
        memories = []
        for gain, memory in zip(gains, self._memories, strict=True):
            along, left, yaw = (gain.f * dt_s[:, None]).T
            own = np.stack((c * along - s * left, s * along + c * left, yaw, yaw * middle_xy[0], yaw * middle_xy[1]))
            variance = autoregression(memory.variance, gain.keep**2, gain.kick)
            with_sums = np.stack([
                np.concatenate(([before], autoregression(float(before), gain.keep, kick)))
                for before, kick in zip(memory.with_sums, own * variance, strict=True)
            ])  # fmt: skip
            old = gain.keep * with_sums[:, :-1]
            path += own[_FIRST] * old[_SECOND] + own[_SECOND] * old[_FIRST] + own[_FIRST] * own[_SECOND] * variance
            step += own[_STEP_FIRST] * own[_STEP_SECOND] * variance
            last = float(variance[-1]) if len(variance) else memory.variance
            memories.append(_Memory(last, with_sums[:, -1].copy()))
        self._memories = memories
        return Grown(path, step)


def random_effect_covariance(sums: NDArray[np.float64], xy_m: Array) -> Array:
    """Return pose covariances (n, 3, 3) in odom axes of random effects, from sums (RANDOM_SUMS, n), at xy_m (2, n)."""
    n = sums.shape[1]
    five = np.empty((n, 5, 5))
    five[:, _FIRST, _SECOND] = five[:, _SECOND, _FIRST] = sums.T
    reach = np.zeros((n, 3, 5))
    reach[:, 0, 0] = reach[:, 1, 1] = reach[:, 2, 2] = reach[:, 0, 4] = 1.0
    reach[:, 1, 3] = -1.0
    reach[:, 0, 2], reach[:, 1, 2] = -xy_m[1], xy_m[0]
    grown: Array = reach @ five @ reach.transpose(0, 2, 1)
    return (grown + grown.transpose(0, 2, 1)) / 2.0


SUMS = 16
"""Rows of the running sums: nine for the pose (1, x, y, xx, xy, yy; translation xx, xy, yy), six of the other
errors of the increments, each at its own mid heading, and the number of noisy increments. All are in odom axes.

Where effects draw, RANDOM_SUMS rows follow; the six hold both.
"""

STEP_SUMS = slice(6, SUMS)
"""Those that the error of an interval's own motion follows from."""

FLOOR = 1e-9
"""Added to every variance, m^2 or rad^2: filters invert covariances, and a robot that has not moved has none.

Nor would one that turned once and then drove straight: there the floor alone keeps the matrix positive, so covariances
are written with all their digits. Rounded to those of a float32 they would pack into 16 % less, though in no less time,
and of such drives every second matrix would be none of a covariance.
"""


class NoiseSteps(NamedTuple):
    """Variances and geometry of n noisy increments.

    variances : of the four draws (rot1, trans, across, rot2)
    start_xy, end_xy : (2, n) noisy positions, metres from the path's start
    travel_rad : (n,) direction of the body's x axis during the translation
    bearing_rad : (n,) direction of the trans noise relative to the body's x axis; None: along it
    arc : whether rot1 is spread evenly over the translation
    """

    variances: Variances
    start_xy: Array
    end_xy: Array
    travel_rad: Array
    bearing_rad: Array | None
    arc: bool


def sum_terms(steps: NoiseSteps) -> Array:
    """Return the terms that each increment adds to the running sums, (SUMS, n)."""
    v = steps.variances
    (x1, y1), (x2, y2) = (steps.start_xy + steps.end_xy) / 2.0 if steps.arc else steps.start_xy, steps.end_xy
    world = steps.travel_rad if steps.bearing_rad is None else steps.travel_rad + steps.bearing_rad
    c, s = np.cos(world), np.sin(world)
    moved_x, moved_y = steps.end_xy - steps.start_xy
    heading = v.rot1 + v.rot2
    # relative to the mid heading, the step rotates by half of rot1 less half of rot2; an arc's rot1 by nothing
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
    terms[9] = shear * moved_y * moved_y
    terms[10] = -shear * moved_x * moved_y
    terms[11] = shear * moved_x * moved_x
    terms[12] = -both * moved_y
    terms[13] = both * moved_x
    terms[14] = heading
    terms[15] = heading > 0.0
    return terms


def pose_covariance(sums: Array, xy_m: Array) -> Array:
    """Return pose covariances (n, 3, 3) of x, y, yaw in odom axes, from sums (SUMS or more, n) and positions (2, n).

    Positions are the noisy ones relative to the origin of the sums, metres.
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
    return noise if len(sums) == SUMS else noise + random_effect_covariance(sums[SUMS:], xy_m)


def twist_covariance(grown: Array, dt_s: Array, heading_rad: Array, body_xy_m: Array) -> Array:
    """Return covariances (n, 3, 3) of vx, vy, yaw rate over intervals.

    Over several increments a heading that errs like a random walk turns the displacement from its end's mean heading
    with the variance of the integral of a Brownian bridge, a twelfth of that of the heading.

    grown : (10, n) increments of the running sums of `STEP_SUMS`
    dt_s : (n,) lengths of the intervals, seconds
    heading_rad : (n,) mid heading of the body, in whose axes the twists are
    body_xy_m : (2, n) displacement in these axes, metres
    """
    xx, xy, yy = grown[:3] + grown[3:6]
    x_yaw, y_yaw, yaw, count = grown[6:]
    c, s, (along, across) = np.cos(heading_rad), np.sin(heading_rad), body_xy_m
    bridge = yaw / 12.0 * (1.0 - 1.0 / np.maximum(count, 1.0) ** 2)
    body = (
        c * c * xx + 2.0 * c * s * xy + s * s * yy + bridge * across * across,
        c * s * (yy - xx) + (c * c - s * s) * xy - bridge * along * across,
        s * s * xx - 2.0 * c * s * xy + c * c * yy + bridge * along * along,
        c * x_yaw + s * y_yaw,
        c * y_yaw - s * x_yaw,
        yaw,
    )
    return _symmetric(*np.stack(body) / (dt_s * dt_s))


def _symmetric(*upper: Array) -> Array:
    """Return matrices (n, 3, 3) from xx, xy, yy, x-yaw, y-yaw, yaw-yaw, (n,) each; `FLOOR` is added to the diagonal."""
    out = np.empty((3, 3, len(upper[0]))).transpose(2, 0, 1)  # each entry is contiguous, which is faster
    for values, (i, j) in zip(upper, ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2)), strict=True):
        out[:, i, j] = out[:, j, i] = values + FLOOR if i == j else values
    return out
