"""Walls and furniture around a path, as line segments: rooms, offices and plain corridors."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial import cKDTree

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

__all__ = ["WORLDS", "world_around"]

WORLDS = ("room", "office", "corridor")
_CLEAR_M = 0.45
_PIECE_M = 0.25
_MARGIN_M = 1.5
_WALL_EVERY_M = 6.0
_BOX_PER_M2 = 0.12


def world_around(kind: str, path_xy: Array, rng: np.random.Generator) -> Array:
    """Return segments (s, 2, 2), metres, that leave a path (n, 2) free.

    room : one rectangle around everything, with boxes in it
    office : walls on a grid with doors where the path goes through, and boxes
    corridor : two plain walls along the longest axis of the path, with their ends out of sight
    """
    turn = float(rng.uniform(-0.5, 0.5)) if kind != "corridor" else _axis(path_xy)
    c, s = np.cos(turn), np.sin(turn)
    frame = np.array([[c, -s], [s, c]])
    own = path_xy @ frame  # in axes along the walls
    low, high = own.min(axis=0) - _MARGIN_M, own.max(axis=0) + _MARGIN_M
    if kind == "corridor":
        sides = own[:, 1].min() - rng.uniform(0.7, 1.0), own[:, 1].max() + rng.uniform(0.7, 1.0)
        walls = [((low[0] - 40.0, y), (high[0] + 40.0, y)) for y in sides]
        return _turned(np.array(walls), frame)
    parts = [_rectangle(low, high)]
    if kind == "office":
        for axis in (0, 1):
            across = np.arange(low[axis] + rng.uniform(3.0, _WALL_EVERY_M), high[axis] - 2.0, _WALL_EVERY_M)
            for at in across + rng.uniform(-0.5, 0.5, len(across)):
                ends = np.arange(low[1 - axis], high[1 - axis], _PIECE_M)
                start = np.column_stack((np.full(len(ends), at), ends))
                stop = start + np.array([0.0, _PIECE_M])
                parts.append(np.stack((start, stop), axis=1)[:, :, :: 1 if axis == 0 else -1])
    count = int(_BOX_PER_M2 * float(np.prod(high - low)))
    parts += [_box(rng, low, high) for _ in range(count)]
    tree = cKDTree(own[::5])
    kept = [parts[0]]
    for part in parts[1:]:
        middle = part.mean(axis=1)
        distance, _ = tree.query(middle)
        length = np.linalg.norm(part[:, 1] - part[:, 0], axis=1)
        far = distance > _CLEAR_M + 0.5 * length
        if part.shape[0] == 4:
            # keep a box completely or not at all
            far = np.full(4, bool(far.all() and tree.query(middle.mean(axis=0))[0] > _CLEAR_M + length.max()))
        kept.append(part[far])
    return _turned(np.concatenate(kept), frame)


def _axis(path_xy: Array) -> float:
    """Return the direction in which a path is longest, radians."""
    _, _, axes = np.linalg.svd(path_xy - path_xy.mean(axis=0), full_matrices=False)
    return float(np.arctan2(axes[0, 1], axes[0, 0]))


def _turned(segments: Array, frame: Array) -> Array:
    out: Array = segments @ frame.T
    return out


def _rectangle(low: Array, high: Array) -> Array:
    corners = np.array([low, (high[0], low[1]), high, (low[0], high[1])])
    return np.stack((corners, np.roll(corners, -1, axis=0)), axis=1)


def _box(rng: np.random.Generator, low: Array, high: Array) -> Array:
    """Return the four sides of a box at a random place and angle."""
    half = rng.uniform(0.1, 0.6, 2)
    angle = rng.choice((0.0, rng.uniform(-np.pi, np.pi)))
    c, s = np.cos(angle), np.sin(angle)
    corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * half @ np.array([[c, s], [-s, c]])
    corners = corners + rng.uniform(low, high)
    return np.stack((corners, np.roll(corners, -1, axis=0)), axis=1)
