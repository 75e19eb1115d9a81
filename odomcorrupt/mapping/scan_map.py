"""Laser maps through different odometries: the maps, and their growing wall thickness."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.errors import RecordingError
from odomcorrupt.geometry.increments import increments
from odomcorrupt.geometry.se2 import rotate
from odomcorrupt.mapping.raycast import draw_map
from odomcorrupt.mapping.wall_thickness import distance_to_surface, wall_thickness

if TYPE_CHECKING:
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.geometry.trajectory import Trajectory
    from odomcorrupt.mapping.mapfile import Grid
    from odomcorrupt.mapping.raycast import Canvas
    from odomcorrupt.mapping.scans import Rays
    from odomcorrupt.trajectories.reader import Drive

__all__ = ["Slow", "Survey", "View", "place", "slow_rays", "survey"]


@dataclass(frozen=True, slots=True)
class View:
    """Rays transformed by one path.

    from_xy, to_xy : (n, 2) start and end of each ray, metres in the path's frame
    """

    from_xy: Array
    to_xy: Array


@dataclass(frozen=True, slots=True)
class Survey:
    """Laser map from one path.

    marks_m : (k,) distances travelled
    thickness_m : (k,) wall thickness of the map of everything seen up to each distance
    off_surface_m : (k,) root mean square distance of the hits since the previous distance from the clean map's walls
    """

    name: str
    path_xyt: Array
    grid: Grid
    marks_m: Array
    thickness_m: Array
    off_surface_m: Array


@dataclass(frozen=True, slots=True)
class Slow:
    """Rays received while the robot hardly turned, with the distance travelled at each: travelled_m (n,)."""

    rays: Rays
    travelled_m: Array
    notes: tuple[str, ...]


def slow_rays(rays: Rays, drive: Drive, max_yaw_rate: float | None) -> Slow:
    """Return the rays received while the yaw rate was at most `max_yaw_rate` rad/s; None keeps all.

    For a robot that does not turn, a stamp error of a few milliseconds does not move a ray.
    """
    during = (rays.stamps_ns >= drive.stamps_ns[0]) & (rays.stamps_ns <= drive.stamps_ns[-1])
    notes = [*rays.notes]
    if not during.all():
        notes.append(f"{np.count_nonzero(~during)} rays were shot before or after the odometry")
    kept = during
    interval = np.clip(np.searchsorted(drive.stamps_ns, rays.stamps_ns, side="right") - 1, 0, len(drive) - 2)
    if max_yaw_rate is not None:
        # mean over a tenth of a second around each ray: single increments are noisy
        half_ns = 50_000_000
        turned = np.concatenate(([0.0], np.cumsum(increments(drive.xyt).dtheta_rad)))
        heading = [np.interp(rays.stamps_ns + side * half_ns, drive.stamps_ns, turned) for side in (-1, 1)]
        fast = np.abs(heading[1] - heading[0]) > max_yaw_rate * 2e-9 * half_ns
        notes.append(
            f"{np.count_nonzero(fast & during)} rays were shot while turning faster than {max_yaw_rate:g} rad/s"
        )
        kept = during & ~fast
    if not kept.any():
        raise RecordingError(f"scans: none of {len(rays)} rays can be used ({'; '.join(notes)})")
    chosen = type(rays)(rays.stamps_ns[kept], rays.from_xy, rays.to_xy[kept], rays.scans, rays.frame_id)
    return Slow(chosen, drive.distance_m[interval[kept]], tuple(notes))


def place(rays: Rays, path: Trajectory) -> View:
    """Return rays transformed by a path: each by the pose at its own time, on arcs between the path's stamps."""
    origin = int(path.stamps_ns[0])
    poses = path.at((rays.stamps_ns - origin) * np.float64(1e-9), origin)
    start = poses[:, :2] + rotate(np.broadcast_to(rays.from_xy, (len(rays), 2)), poses[:, 2])
    return View(start, poses[:, :2] + rotate(rays.to_xy, poses[:, 2]))


def survey(
    name: str, path_xyt: Array, view: View, clean: View, travelled_m: Array, canvas: Canvas, marks: int = 8
) -> Survey:
    """Return the map of a view, its wall thickness against distance, and the distance of its hits from the clean walls.

    clean : the same rays through the clean odometry
    """
    ends = np.linspace(0.0, float(travelled_m.max()), marks + 1)[1:]
    thickness = np.array([wall_thickness(view.to_xy[travelled_m <= end]) for end in ends])
    off = distance_to_surface(clean.to_xy, view.to_xy)
    leg = np.minimum(np.searchsorted(ends, travelled_m), marks - 1)
    known = np.isfinite(off)
    count = np.bincount(leg[known], minlength=marks)
    square = np.bincount(leg[known], off[known] ** 2, minlength=marks)
    off_surface = np.sqrt(np.divide(square, count, out=np.full(marks, np.nan), where=count > 0))
    return Survey(name, path_xyt, draw_map(canvas, view.from_xy, view.to_xy), ends, thickness, off_surface)
