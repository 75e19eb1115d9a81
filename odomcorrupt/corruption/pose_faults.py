"""Checks for poses and frame trees that are unusable for a planar robot."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array

FAR_M = 1e9
"""Where no robot is: a pose so far away is no number of use."""

_STEEP = float(np.sin(np.deg2rad(85.0)))
"""Sine of a pitch at which the body's x axis points up or down, and the heading is an accident."""


@dataclass(slots=True)
class PoseFaults:
    """Counts of unusable poses of an odometry topic.

    no_orientation : quaternions that are zero
    upright : pitches beyond 85 deg
    far : positions beyond `FAR_M`
    """

    no_orientation: int = 0
    upright: int = 0
    far: int = 0

    def take(self, position: Array, quat_xyzw: Array) -> None:
        """Count the unusable poses of position (n, 3), metres, and quat_xyzw (n, 4)."""
        with np.errstate(all="ignore"):
            x, y, z, w = quat_xyzw.T
            length2 = x * x + y * y + z * z + w * w
            sine = np.abs(2.0 * (w * y - z * x))
            self.no_orientation += _count(length2 == 0.0)
            self.upright += _count((length2 > 0.0) & (sine > _STEEP * length2))
            far = (np.abs(position[:, 0]) >= FAR_M) | (np.abs(position[:, 1]) >= FAR_M)
            if far.any():
                self.far += _count(far & np.isfinite(position).all(axis=1))

    def sentences(self) -> list[str]:
        """Return one warning for each kind of fault found, without a full stop."""
        said = []
        if self.no_orientation:
            said.append(f"{self.no_orientation} orientations are zero: their heading is taken as 0")
        if self.upright:
            said.append(f"{self.upright} poses pitch beyond 85 deg: their heading is undefined")
        if self.far:
            said.append(f"{self.far} poses are beyond {FAR_M:.0e} m: not used, and left unchanged")
        return said


def _count(which: NDArray[np.bool_] | np.bool_) -> int:
    return int(np.count_nonzero(which))


def frame_faults(edges: Iterable[tuple[str, str]], odom: str | None, base: str | None) -> list[str]:
    """Return warnings on a bag's TF tree (loops, several parents), without a full stop.

    edges : parent and child of every transform
    odom, base : frames of the odometry
    """
    said = []
    if odom is not None and odom == base:
        said.append(f"the odometry is from {odom} to {base}, one and the same frame; it needs two")
    parents: dict[str, set[str]] = {}
    for parent, child in edges:
        parents.setdefault(child, set()).add(parent)
    for child, above in sorted(parents.items()):
        if len(above) > 1 and not any(child in parents.get(one, ()) for one in above):
            said.append(
                f"TF gives {child} {len(above)} parents ({', '.join(sorted(above)[:6])}): a frame can have only one"
            )
    loop = _loop(parents)
    if loop:
        said.append(f"TF has a loop: {' -> '.join(loop)}")
    return said


def _loop(parents: dict[str, set[str]]) -> list[str]:
    """Return the frames of one loop, the first repeated at the end; empty for a tree."""
    done: set[str] = set()
    for first in sorted(parents):
        path: list[str] = []
        ways = [iter(sorted(parents.get(first, ())))]
        path.append(first)
        while path and first not in done:
            above = next(ways[-1], None)
            if above is None:
                done.add(path.pop())
                ways.pop()
            elif above in path:
                return [above, *reversed(path[path.index(above) :])]
            elif above not in done:
                path.append(above)
                ways.append(iter(sorted(parents.get(above, ()))))
    return []
