"""Maps of motions that lose a part of them: signs, limits and dead zones of travel, turns or wheels.

The odometry's motions in windows are a matrix times such a map of the truth's; the reverse holds for commands that a
robot does not follow. All maps are compared by one number, the part of the motions that remains unexplained, and the
best one is a finding if it is much smaller than with a matrix alone.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from operator import attrgetter
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from odomcorrupt.geometry.se2 import Array

_KINDS: dict[str, Callable[[Array, Array, float], Array]] = {
    "sign": lambda u, unit, k: np.where(unit < 0.0, k * u, u),
    "limit": lambda u, unit, most: np.clip(u, -most * np.abs(unit), most * np.abs(unit)),
    "dead zone": lambda u, unit, least: np.where(np.abs(u) < least * np.abs(unit), 0.0, u),
}
"""What is done to a motion: a factor where another one is negative, or a limit or least size relative to another."""
WHEELS = {"left wheel": (True, False), "right wheel": (False, True), "wheels": (True, True)}
"""Whether the left and the right wheel are changed."""
STEERED_WHEELS = ("steered wheel", "steered wheel, gyro")
"""Travel of a steered wheel that is taken for the axle's; turns are computed from it, or are those of a gyro."""
_ARMS_M = np.geomspace(0.03, 1.5, 8)
"""Half of the wheel separation: that of the odometry is not known."""
AGREE, PLAIN = 0.06, 0.12
"""Unexplained part of the motions up to which no map is sought, and from which the two differ plainly."""
_LOST, _SHARES = (-1.0, 0.0), np.arange(10.0, 100.0, 10.0)
"""Factors of a motion in reverse, and percentiles of a motion, that are tried."""


@dataclass(frozen=True, eq=False)
class MotionMap:
    """A map of travel and turns, and how well it explains motions.

    kind : sign, limit or dead zone
    channel : travel, motion (both, in reverse), left turns, right turns, turns in reverse, turns, curvature, turns on
        the spot, or one of `WHEELS` or `STEERED_WHEELS`
    at : factor, or limit in m/s, rad/s or rad/m
    arm_m : half of the wheel separation, of wheels; how far a steered wheel is ahead of the axle
    residual, without : unexplained motions relative to all, root mean square, with the map and with a matrix alone
    matrix : (2, 2), by which mapped travel and turns are multiplied
    """

    kind: str = "sign"
    channel: str = "travel"
    at: float = 1.0
    arm_m: float = 0.0
    residual: float = np.inf
    without: float = 0.0
    matrix: Array = field(default_factory=lambda: np.eye(2))

    def of(self, rates: Array) -> Array:
        """Return the rates (n, 2) of travel and turns to which others (n, 2) are mapped."""
        v, w = rates.T

        def change(u: Array, signed: Array) -> Array:
            return _KINDS[self.kind](u, signed if self.kind == "sign" else np.ones(len(u)), self.at)

        if self.channel in WHEELS:
            rims = zip((v - self.arm_m * w, v + self.arm_m * w), WHEELS[self.channel], strict=True)
            left, right = (change(rim, rim) if changed else rim for rim, changed in rims)
            v, w = (left + right) / 2.0, (right - left) / (2.0 * self.arm_m)
        elif self.channel == "travel":
            v = change(v, v)
        elif self.channel == "motion":
            v, w = change(v, v), change(w, v)
        elif self.channel in STEERED_WHEELS:
            far = np.sqrt(1.0 + (self.arm_m * w / np.where(np.abs(v) > 1e-9, v, np.inf)) ** 2)
            v, w = v * far, w * (far if self.channel == "steered wheel" else 1.0)
        elif self.channel == "turns on the spot":
            w = np.where(np.abs(v) < self.at, 0.0, w)
        elif self.channel == "curvature":
            w = _KINDS[self.kind](w, v, self.at)
        else:
            w = change(w, {"left turns": -w, "turns in reverse": v}.get(self.channel, w))
        return np.column_stack((v, w))


def linear(x: Array, y: Array) -> tuple[Array, float]:
    """Return the matrix (m, k) of y = M x, outliers left out, and the least part explained, of (n, k) and (n, m)."""
    used = np.ones(len(x), dtype=bool)
    least = 0.02 * np.percentile(np.abs(y), 95.0, axis=0)
    for _ in range(5):
        matrix = np.linalg.lstsq(x[used], y[used], rcond=None)[0].T
        off = np.abs(y - x @ matrix.T)
        used = (off <= 6.0 * np.maximum(np.median(off, axis=0), least)).all(axis=1)
    size = np.sum(y[used] ** 2, axis=0)
    explained = 1.0 - np.sum(off[used] ** 2, axis=0) / np.maximum(size, 1e-3 * size.max() + 1e-12)
    return np.asarray(matrix, dtype=np.float64), float(explained.min()) * float(used.mean() > 0.6)


def unexplained(x: Array, y: Array) -> tuple[Array, float]:
    """Return the matrix (2, 2) of y = M x of motions (n, 2), and the part of y that it leaves, root mean square."""
    size = np.sqrt(np.mean(y**2, axis=0)) + 1e-9
    # slight turns do not count as much as all travel, nor slight travel on the spot as all turns
    size = np.maximum(size, size[::-1] * (0.03, 0.2))
    matrix, _ = linear(x, y)
    off = np.minimum(np.square((y - x @ matrix.T) / size), 1.0)
    return matrix, float(np.sqrt(off.sum(axis=1).mean()))


def best_map(rates: Array, sums: Callable[[Array], Array], motions: Array, signs: bool) -> MotionMap:  # noqa: FBT001
    """Return the map of rates (k, 2) with the smallest residual of motions (n, 2) in windows.

    sums : function that returns the motions (n, 2) in windows of rates (k, 2)
    signs : whether maps of signs are among them
    """
    # no robot is suddenly five times as fast as ever
    usual = [np.abs(x) <= 5.0 * np.percentile(np.abs(x), 95.0, axis=0) + 1e-9 for x in (motions, sums(rates))]
    kept = np.hstack(usual).all(axis=1)

    def fitted(one: MotionMap, rates: Array) -> MotionMap:
        matrix, residual = unexplained(sums(one.of(rates))[kept], motions[kept])
        return replace(one, residual=residual, matrix=matrix, without=without)

    def searched(rates: Array, kinds: tuple[str, ...]) -> MotionMap:
        groups, key = [some for some in _trials(rates) if some and some[0].kind in kinds], attrgetter("residual")
        for step in (1.3, 1.1, 1.03, 1.0):
            found = sorted((min((fitted(one, rates) for one in some), key=key) for some in groups), key=key)[:6]
            groups = [list(_near(one, step)) for one in found]
        return found[0]

    without = np.inf
    if (without := fitted(MotionMap(), rates).residual) < AGREE:
        return MotionMap(residual=without, without=without)
    thresholds = ("limit", "dead zone")
    one = searched(rates, ("sign", *thresholds) if signs else thresholds)
    if one.residual < without / 2.0 or without < PLAIN:
        return one
    # what limits travel may limit turns, too
    return replace(one, residual=searched(one.of(rates), thresholds).residual)


def _trials(rates: Array) -> Iterator[list[MotionMap]]:
    """Yield the maps that are compared for rates (n, 2), those of one kind and channel together."""
    v, w = np.abs(rates.T)
    moves = v > 0.2 * np.percentile(v, 95.0)
    sizes = {"travel": v[moves], "turns": w[w > 0.1 * np.percentile(w, 95.0)], "curvature": w[moves] / v[moves]}
    for channel in ("travel", "motion", "left turns", "right turns", "turns in reverse"):
        yield from ([MotionMap("sign", channel, k)] for k in _LOST)
    yield [MotionMap("dead zone", "turns on the spot", k * float(np.percentile(v, 90.0))) for k in (0.05, 0.1, 0.2)]
    yield from ([MotionMap("sign", wheel, arm_m=arm_m) for arm_m in _ARMS_M.tolist()] for wheel in STEERED_WHEELS)
    for channel in (*sizes, *WHEELS):
        size = sizes.get(channel, v[moves])
        steps = np.percentile(size, _SHARES).tolist() if len(size) else []
        arms_m = _ARMS_M.tolist() if channel in WHEELS else [0.0]
        if channel in WHEELS:
            yield from ([MotionMap("sign", channel, k, arm_m) for arm_m in arms_m] for k in _LOST)
        yield [MotionMap("limit", channel, k, arm_m) for arm_m in arms_m for k in steps[2:]]
        yield [MotionMap("dead zone", channel, k, arm_m) for arm_m in arms_m for k in steps[:-2]]


def _near(one: MotionMap, step: float) -> Iterator[MotionMap]:
    """Yield a map and those beside it, by a factor of its limit and of its arm."""
    for at in (one.at,) if one.kind == "sign" else (one.at / step, one.at, one.at * step):
        for arm_m in sorted({one.arm_m / step, one.arm_m, one.arm_m * step}):
            yield replace(one, at=at, arm_m=arm_m)
