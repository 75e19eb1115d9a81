"""Laser maps through different odometries, and their growing wall thickness: the mean plane variance of the walls.

The scans of a bag become rays in the robot's frame, each with its own time; a path places them in a map.

Razlaw, Droeschel, Holz & Behnke, "Evaluation of registration methods for sparse 3D laser scans" (ECMR 2015), evaluate
a map without truth by the variance of its points about the plane through their neighbours: the smallest eigenvalue of
the covariance of all points near a point, averaged over points. Here planes are lines, neighbours are those in a
square of `WINDOW_M`, and the root is reported: a deviation in metres. Corners are not lines, but count equally in
every map, so the difference between two maps of one drive measures the effect of the odometry.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.bags.messages import SCAN
from odomcorrupt.errors import RecordingError
from odomcorrupt.geometry.se2 import increments, rotate
from odomcorrupt.mapping.messages import ScanMessage, read_lasers
from odomcorrupt.mapping.occupancy_grid import Canvas, canvas_for, draw_map
from odomcorrupt.summary import Line, Summary

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.geometry.trajectory import Trajectory
    from odomcorrupt.mapping.messages import Mount
    from odomcorrupt.mapping.occupancy_grid import Grid
    from odomcorrupt.trajectories import Drive


@dataclass(frozen=True, slots=True)
class Rays:
    """n rays with a return.

    stamps_ns : (n,) time of each ray
    from_xy : (2,) position of the laser in the robot's frame, metres
    to_xy : (n, 2) end of each ray, in the robot's frame at the ray's time
    scans : number of scans
    frame_id : frame of the laser
    notes : omissions, in words
    """

    stamps_ns: NDArray[np.int64]
    from_xy: Array
    to_xy: Array
    scans: int
    frame_id: str
    notes: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.stamps_ns)


def read_rays(path: Path, topic: str | None, base_frame: str, mount: Mount | None) -> Rays:
    """Read all scans of a topic.

    path : a bag
    topic : topic of laser scans; None takes the only one
    base_frame : the robot's frame, which TF must connect with the laser's
    mount : pose of the laser, to be used instead of TF

    Raises
    ------
    TopicError
        If there are no scans, several topics of them, or TF does not contain the laser's pose.
    """
    found = read_lasers(path, topic, (SCAN,))
    scans: list[ScanMessage] = found.messages  # type: ignore[assignment]  # of one type
    if not scans:
        raise RecordingError(f"{found.place}: {found.topic} holds no scan; name another topic with --scan")
    frame = scans[0].frame_id
    if mount is None:
        mount = found.tree.mount(base_frame, frame, found.place)
    return _rays(scans, mount, frame)


def _rays(scans: list[ScanMessage], mount: Mount, frame: str) -> Rays:
    stamps, ends = [], []
    lost = total = 0
    for scan in scans:
        number = np.arange(len(scan.ranges_m))
        # comparisons with NaN are false: such rays are dropped, as are those without a return
        good = (scan.ranges_m >= scan.range_min_m) & (scan.ranges_m < scan.range_max_m)
        total += len(number)
        lost += int(np.count_nonzero(~good))
        hit, ranges = number[good], scan.ranges_m[good]
        angle = scan.angle_min + scan.angle_step * hit
        direction = np.column_stack((np.cos(angle), np.sin(angle))) @ mount.plane.T
        ends.append(mount.position_xy + ranges[:, None] * direction)
        stamps.append(scan.stamp_ns + np.rint(hit * scan.time_step_s * 1e9).astype(np.int64))
    every, xy = np.concatenate(stamps), np.concatenate(ends)
    usable = np.isfinite(xy).all(axis=1)
    notes = (f"{lost} of {total} rays have no return within the laser's range",) if lost else ()
    return Rays(every[usable], mount.position_xy, xy[usable], len(scans), frame, notes)


WINDOW_M = 1.0
"""Side of the square of neighbours, metres; walls more than half of it apart are separate walls."""
MIN_NEIGHBOURS = 8
_MARKS = 8
"""Number of distances at which the walls are measured."""
_CELL_M = 0.02
"""Side of the cells into which points are binned, metres."""


def added_thickness(clean_m: Array, noisy_m: Array) -> Array:
    """Return the increase of wall thickness by noise (k,), metres, as the root of the difference of the variances."""
    return np.sqrt(np.maximum(noisy_m**2 - clean_m**2, 0.0))


def wall_thickness(points_xy: Array, *, cell_m: float = _CELL_M) -> float:
    """Return the root of the mean plane variance of points (n, 2), metres; nan if no point has neighbours.

    Points are binned into cells of `cell_m` and keep their own coordinates in the sums; the window is that of the
    cell, so its edge is rounded to a cell.
    """
    xx, xy, yy = _covariances(points_xy, cell_m)
    smaller = _smaller(xx, xy, yy)
    known = np.isfinite(smaller)
    return float(np.sqrt(np.maximum(smaller[known], 0.0).mean())) if known.any() else float("nan")


def distance_to_surface(clean_xy: Array, noisy_xy: Array) -> Array:
    """Return the distance of noisy hits from the walls of the clean map (n,), metres; nan for clean hits on no wall.

    The displacement of a hit is measured across the wall of its clean counterpart: shifts along a wall are not visible
    in a map, and a wall displaced by more than the window is still compared with itself.

    clean_xy, noisy_xy : (n, 2) ends of the same rays, transformed by clean and by noisy odometry, metres
    """
    xx, xy, yy = _covariances(clean_xy, _CELL_M)
    smaller = np.maximum(_smaller(xx, xy, yy), 0.0)
    along = 0.5 * np.arctan2(2.0 * xy, xx - yy)
    shift = noisy_xy - clean_xy
    across = np.abs(-np.sin(along) * shift[:, 0] + np.cos(along) * shift[:, 1])
    # ratio of the smaller to the larger variance above which points are not a wall and have no normal
    return np.where(smaller < 0.1 * (xx + yy - smaller), across, np.nan)


def _smaller(xx: Array, xy: Array, yy: Array) -> Array:
    """Return the smaller eigenvalue (n,) of covariances."""
    return (xx + yy) / 2.0 - np.sqrt(((xx - yy) / 2.0) ** 2 + xy**2)


def _covariances(points_xy: Array, cell_m: float) -> tuple[Array, Array, Array]:
    """Return xx, xy and yy (n,) of the points in the window around each point; nan if there are too few."""
    low = points_xy.min(axis=0) - 2.0 * cell_m
    # centred coordinates, because the covariance is a small difference of large sums
    centred = points_xy - points_xy.mean(axis=0)
    column, row = np.floor((points_xy - low) / cell_m).astype(np.int64).T
    shape = int(row.max()) + 2, int(column.max()) + 2
    flat = row * shape[1] + column
    half = round(0.5 * WINDOW_M / cell_m)
    top, bottom = np.minimum(row + half + 1, shape[0]), np.maximum(row - half, 0)
    right, left = np.minimum(column + half + 1, shape[1]), np.maximum(column - half, 0)

    def sums(weights: Array | None) -> Array:
        """Return the sums of weights (n,), or of ones, over each window, from cumulative sums over the cells."""
        cells = np.bincount(flat, weights, minlength=shape[0] * shape[1]).reshape(shape)
        table = np.zeros((shape[0] + 1, shape[1] + 1))
        np.cumsum(np.cumsum(cells, axis=0), axis=1, out=table[1:, 1:])
        return table[top, right] - table[bottom, right] - table[top, left] + table[bottom, left]

    x, y = centred.T
    count, sx, sy, sxx, sxy, syy = (sums(w) for w in (None, x, y, x * x, x * y, y * y))
    n = np.where(count >= MIN_NEIGHBOURS, count, np.nan)
    xx, xy, yy = (s / n - (a / n) * (b / n) for s, a, b in ((sxx, sx, sx), (sxy, sx, sy), (syy, sy, sy)))
    return xx, xy, yy


@dataclass(frozen=True, slots=True)
class View:
    """Rays transformed by one path.

    from_xy, to_xy : (n, 2) start and end of each ray, metres in the path's frame
    """

    from_xy: Array
    to_xy: Array


@dataclass(frozen=True, slots=True)
class ScanMap:
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
    chosen = replace(rays, stamps_ns=rays.stamps_ns[kept], to_xy=rays.to_xy[kept], notes=())
    return Slow(chosen, drive.distance_m[interval[kept]], tuple(notes))


def place(rays: Rays, path: Trajectory) -> View:
    """Return rays transformed by a path: each by the pose at its own time, on arcs between the path's stamps."""
    origin = int(path.stamps_ns[0])
    poses = path.at((rays.stamps_ns - origin) * np.float64(1e-9), origin)
    start = poses[:, :2] + rotate(np.broadcast_to(rays.from_xy, (len(rays), 2)), poses[:, 2])
    return View(start, poses[:, :2] + rotate(rays.to_xy, poses[:, 2]))


def make_scan_map(name: str, path_xyt: Array, view: View, clean: View, travelled_m: Array, canvas: Canvas) -> ScanMap:
    """Return the map of a view, its wall thickness against distance, and the distance of its hits from the clean walls.

    clean : the same rays through the clean odometry
    """
    ends = np.linspace(0.0, float(travelled_m.max()), _MARKS + 1)[1:]
    thickness = np.array([wall_thickness(view.to_xy[travelled_m <= end]) for end in ends])
    off = distance_to_surface(clean.to_xy, view.to_xy)
    leg = np.minimum(np.searchsorted(ends, travelled_m), _MARKS - 1)
    known = np.isfinite(off)
    count = np.bincount(leg[known], minlength=_MARKS)
    square = np.bincount(leg[known], off[known] ** 2, minlength=_MARKS)
    off_surface = np.sqrt(np.divide(square, count, out=np.full(_MARKS, np.nan), where=count > 0))
    return ScanMap(name, path_xyt, draw_map(canvas, view.from_xy, view.to_xy), ends, thickness, off_surface)


def scan_maps(
    rays: Rays, travelled_m: Array, paths: Mapping[str, Trajectory], resolution_m: float
) -> tuple[ScanMap, ...]:
    """Return the map of the same rays along each path; hits are compared with the walls of the first one.

    travelled_m : (n,) distance travelled at each ray
    """
    views = {name: place(rays, path) for name, path in paths.items()}
    every = [part for view in views.values() for part in (view.from_xy, view.to_xy)]
    canvas, first = canvas_for(np.concatenate(every), resolution_m), next(iter(views.values()))
    return tuple(make_scan_map(name, paths[name].xyt, view, first, travelled_m, canvas) for name, view in views.items())


def maps_brief(maps: Sequence[ScanMap], notes: Sequence[str], noise: Sequence[Line]) -> Summary:
    """Return the increase in wall thickness, the distance of hits from the walls, and the lines on the noise."""
    clean, noisy = (100.0 * s.thickness_m[-1] for s in maps[:2])
    added = 100.0 * added_thickness(maps[0].thickness_m, maps[1].thickness_m)[-1]
    first, last = 100.0 * maps[1].off_surface_m[0], 100.0 * maps[1].off_surface_m[-1]
    said = f"walls {clean:.2f} -> {noisy:.2f} cm ({noisy / clean:.2f} times); noise alone {added:.2f} cm"
    lines = [Line("THICKER", said, "warning") if noisy > clean else Line("NO THICKER", said, "good")]
    lines.append(Line("hits", f"{first:.1f} cm off the clean walls at first, {last:.1f} cm at last"))
    lines += [Line("walls", f"{100.0 * s.thickness_m[-1]:.2f} cm through the {s.name}") for s in maps[2:]]
    lines += [*noise, *(Line("scans" if "rays" in note else "note", note) for note in notes)]
    return Summary(tuple(lines))


def maps_table(maps: Sequence[ScanMap]) -> str:
    """Return a table of the wall thickness along the drive."""
    heads = [*(s.name.split(" (")[0].removesuffix(" odometry") for s in maps), "alone", "hits off"]
    lines = [
        f"wall thickness, cm (root of the mean plane variance, Razlaw et al., ECMR 2015; window {WINDOW_M:g} m),",
        "that of the noise alone (root of the difference of squares), and noisy hits off the clean walls, cm",
        "  after      " + "".join(f"{head:>12}" for head in heads),
    ]
    clean, noisy = (s.thickness_m for s in maps[:2])
    added = added_thickness(clean, noisy)
    for i, mark in enumerate(maps[0].marks_m):
        values = (*(s.thickness_m[i] for s in maps), added[i], maps[1].off_surface_m[i])
        lines.append(f"  {mark:7.2f} m  " + "".join(f"{100.0 * value:12.2f}" for value in values))
    return "\n".join(lines)
