"""Ray casting against line segments and walking people: ranges of a moving scanning laser."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Array = NDArray[np.float64]

__all__ = ["LASERS", "Laser", "People", "ranges_of", "walkers"]

_SHOULDERS_M = 0.25


@dataclass(frozen=True, slots=True)
class Laser:
    """A scanning laser: beams per full turn, turns per second, and errors of its ranges."""

    beams: int = 450
    rate_hz: float = 5.0
    reach_m: float = 8.0
    noise_m: float = 0.02
    dropouts: float = 0.015
    mixed: float = 0.3
    """Fraction of the rays at an edge that return a range between the near and the far surface (mixed pixels)."""


LASERS = {
    "cheap": Laser(),
    "quick": Laser(beams=360, rate_hz=10.0),
    "good": Laser(beams=720, rate_hz=10.0, reach_m=20.0, noise_m=0.008),
}


@dataclass(frozen=True, slots=True)
class People:
    """Walking people: corners (p, k, 2) of their paths, m, and the times (p, k) of reaching each, s."""

    places: Array
    at_s: Array

    def where(self, t_s: float) -> Array:
        """Return their positions (p, 2) at a time, m."""
        found = [
            [np.interp(t_s, at, places[:, i]) for i in (0, 1)]
            for at, places in zip(self.at_s, self.places, strict=True)
        ]
        return np.array(found).reshape(-1, 2)


def walkers(count: int, low: Array, high: Array, duration_s: float, rng: np.random.Generator) -> People:
    """Return people that walk about in the rectangle between two corners."""
    corners = int(duration_s / 4.0) + 2
    places = rng.uniform(low, high, (count, corners, 2))
    speed = rng.uniform(0.5, 1.3, (count, 1))
    step = np.linalg.norm(np.diff(places, axis=1), axis=2) / speed
    return People(places, np.concatenate((np.zeros((count, 1)), np.cumsum(step, axis=1)), axis=1))


def ranges_of(
    laser: Laser,
    segments: Array,
    people: People | None,
    pose_at: Callable[[Array], Array],
    start_s: float,
    rng: np.random.Generator,
) -> Array:
    """Return the ranges (beams,) of one sweep, each ray from the laser's pose at its time; infinite without a return.

    pose_at : function that returns the laser's poses (n, 3) at times (n,)
    start_s : start of the sweep, seconds
    """
    t_s = start_s + np.arange(laser.beams) / (laser.beams * laser.rate_hz)
    pose = pose_at(t_s)
    bearing = pose[:, 2] - np.pi + 2.0 * np.pi * np.arange(laser.beams) / laser.beams
    way = np.stack((np.cos(bearing), np.sin(bearing)), axis=1)
    near = _near(segments, pose[len(pose) // 2, :2], laser.reach_m + 0.5)
    exact = _walls(near, pose[:, :2], way)
    if people is not None:
        exact = np.minimum(exact, _round(people.where(float(t_s[len(t_s) // 2])), pose[:, :2], way))
    exact = np.minimum(exact, 1e3)
    after = np.roll(exact, -1)
    edge = (np.abs(after - exact) > 0.3) & (rng.random(laser.beams) < laser.mixed) & (np.maximum(exact, after) < 1e3)
    share = rng.random(laser.beams)
    exact = np.where(edge, exact + share * (after - exact), exact)
    seen = exact + laser.noise_m * rng.normal(size=laser.beams)
    lost = (exact > laser.reach_m) | (rng.random(laser.beams) < laser.dropouts)
    return np.where(lost, np.inf, seen)


def _near(segments: Array, xy: Array, reach_m: float) -> Array:
    a, b = segments[:, 0] - xy, segments[:, 1] - xy
    along = b - a
    share = np.clip(-np.einsum("ij,ij->i", a, along) / np.maximum(np.einsum("ij,ij->i", along, along), 1e-12), 0, 1)
    return segments[np.linalg.norm(a + share[:, None] * along, axis=1) < reach_m]


def _walls(segments: Array, origin: Array, way: Array) -> Array:
    """Return the distance (n,) to the first segment along each ray."""
    if not len(segments):
        return np.full(len(origin), np.inf)
    a, along = segments[:, 0], segments[:, 1] - segments[:, 0]
    dx, dy = a[:, 0] - origin[:, 0, None], a[:, 1] - origin[:, 1, None]
    cross = way[:, 0, None] * along[:, 1] - way[:, 1, None] * along[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = (dx * along[:, 1] - dy * along[:, 0]) / cross
        share = (dx * way[:, 1, None] - dy * way[:, 0, None]) / cross
    met = (distance > 0.0) & (share >= 0.0) & (share <= 1.0)
    out: Array = np.where(met, distance, np.inf).min(axis=1)
    return out


def _round(centres: Array, origin: Array, way: Array) -> Array:
    """Return the distance (n,) to the first person along each ray."""
    out = np.full(len(origin), np.inf)
    for centre in centres:
        to = centre - origin
        ahead = np.einsum("ij,ij->i", to, way)
        aside = np.einsum("ij,ij->i", to, to) - ahead**2
        deep = _SHOULDERS_M**2 - aside
        hit = (deep > 0.0) & (ahead > 0.0)
        distance = np.where(hit, ahead - np.sqrt(np.maximum(deep, 0.0)), np.inf)
        out = np.minimum(out, np.where(distance > 0.0, distance, np.inf))
    return out
