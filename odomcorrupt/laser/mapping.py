"""Occupancy maps of a drive: scans along the laser's trajectory, the odometry, and noisy odometry if asked."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.geometry.se2 import between, compose
from odomcorrupt.geometry.trajectory import Trajectory, distance_along
from odomcorrupt.mapping.messages import mount_at
from odomcorrupt.mapping.scan_map import Rays, scan_maps
from odomcorrupt.summary import Line, Summary

if TYPE_CHECKING:
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.laser.trajectory import LaserRun
    from odomcorrupt.mapping.scan_map import ScanMap

_LEAST_SAID_S = 1.0


@dataclass(frozen=True, slots=True)
class LaserMaps:
    """Maps of one drive.

    trajectory : the robot's by the laser, on the odometry's clock, in the map's frame
    maps : maps along that trajectory, along the odometry, and along the odometry with noise, if there is any
    placed : number of sweeps in the map, in a sentence
    parts : parts of the drive that the map does not cover, in a sentence; "" if none
    remarks : findings about the scans and the mounting of the laser, in sentences
    """

    trajectory: Trajectory
    maps: tuple[ScanMap, ...]
    placed: str
    parts: str
    remarks: tuple[str, ...]

    @property
    def notes(self) -> tuple[str, ...]:
        """All sentences."""
        return (*self.remarks, *([self.parts] if self.parts else []), self.placed)


def largest_part(run: LaserRun) -> tuple[LaserRun, str]:
    """Return the run limited to the largest connected part of its map, and a sentence on the rest ("" if none)."""
    path = run.path
    parts, sizes = np.unique(path.part, return_counts=True)
    largest = parts[np.argmax(sizes)]
    spans = {part: path.t_s[path.part == part][[0, -1]] for part in parts}
    said = {part: f"{a:.0f}-{b:.0f} s" for part, (a, b) in spans.items() if b - a > _LEAST_SAID_S or part == largest}
    others = ", ".join(words for part, words in said.items() if part != largest)
    kept = replace(run, path=path.only(path.part == largest))
    return kept, others and (
        f"{len(said)} parts that no scan connects: the map covers {said[largest]} only; left out: {others}"
    )


def laser_maps(whole: LaserRun, error_xyt: Array | None, resolution_m: float) -> LaserMaps:
    """Return the maps along the laser's trajectory, the odometry and the noisy odometry.

    whole : run, of which the largest connected part is mapped
    error_xyt : (n, 3) error that noise adds to each pose of the odometry; None for no noisy odometry
    """
    run, parts = largest_part(whole)
    motion, path = run.calibration.motion, run.path
    stamps = motion.origin_ns + np.round((path.t_s + motion.lag_s) * 1e9).astype(np.int64)
    stamps, first = np.unique(stamps, return_index=True)
    trajectory = Trajectory(stamps, path.xyt[first])
    odometry = run.odometry
    start = np.clip(trajectory.seconds_since(int(odometry.stamps_ns[0]))[:1], 0.0, None)
    begin = odometry.at(start, int(odometry.stamps_ns[0]))[0]
    rays = _rays(run)
    inside = (rays.stamps_ns >= max(stamps[0], odometry.stamps_ns[0])) & (
        rays.stamps_ns <= min(stamps[-1], odometry.stamps_ns[-1])
    )
    rays = replace(rays, stamps_ns=rays.stamps_ns[inside], to_xy=rays.to_xy[inside])
    paths = {
        "corrected by the laser": replace(trajectory, xyt=compose(begin, between(trajectory.xyt[0], trajectory.xyt))),
        "odometry": odometry,
    }
    if error_xyt is not None:
        paths["noisy odometry"] = Trajectory(odometry.stamps_ns, odometry.xyt + error_xyt)
    way = distance_along(odometry.xyt)
    travelled = np.interp(rays.stamps_ns.astype(np.float64), odometry.stamps_ns.astype(np.float64), way)
    maps = scan_maps(rays, travelled, paths, resolution_m)
    placed = f"{len(run.path)} of {len(run.sweeps)} sweeps placed in the map"
    remarks = (*run.sweeps.notes, *run.calibration.said)
    return LaserMaps(paths["corrected by the laser"], maps, placed, parts, remarks)


def laser_brief(drawn: LaserMaps) -> Summary:
    """Return the number of sweeps in the map, parts left out, the wall thickness of each map, and remarks."""
    lines = [Line("MATCHED", drawn.placed, "good")]
    lines += [Line("parts", drawn.parts, "warning")] if drawn.parts else []
    walls = (f"{100.0 * s.thickness_m[-1]:.2f} cm thick, {s.name}" for s in drawn.maps)
    how = " (root of the mean plane variance, Razlaw et al., ECMR 2015)"
    lines += [Line("" if i else "walls", said, full=said + how * (not i)) for i, said in enumerate(walls)]
    lines += [Line("note", note, "warning") for note in drawn.remarks]
    return Summary(tuple(lines))


def tum_text(trajectory: Trajectory) -> str:
    """Return a trajectory in TUM format: seconds, x y z, quaternion."""
    lines = []
    for stamp, (x, y, yaw) in zip(trajectory.stamps_ns.tolist(), trajectory.xyt.tolist(), strict=True):
        seconds, nanoseconds = divmod(stamp, 1_000_000_000)
        lines.append(
            f"{seconds}.{nanoseconds:09d} {x:.6f} {y:.6f} 0 0 0 {np.sin(0.5 * yaw):.9f} {np.cos(0.5 * yaw):.9f}"
        )
    return "\n".join(lines) + "\n"


def _rays(run: LaserRun) -> Rays:
    """Return the returns of all sweeps with a pose, in the robot's frame and on the odometry's clock."""
    motion, sweeps = run.calibration.motion, run.sweeps
    placed = [sweeps.sweeps[row] for row in run.path.row]
    total = sum(len(s) for s in placed)
    thin = max(1, total // 400_000)
    lag_ns = round(motion.lag_s * 1e9)
    mount = mount_at(motion.mount)
    plane = mount.plane @ np.diag([1.0, -1.0 if run.calibration.mirrored else 1.0])
    stamps, ends = [], []
    for sweep in placed:
        after = np.round(sweep.after_s[::thin].astype(np.float64) * 1e9).astype(np.int64)
        stamps.append(sweep.stamp_ns + lag_ns + after)
        ends.append(mount.position_xy + sweep.xy[::thin].astype(np.float64) @ plane.T)
    return Rays(np.concatenate(stamps), mount.position_xy, np.concatenate(ends), len(placed), sweeps.frame_id)
