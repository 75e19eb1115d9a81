"""Laser maps of one drive: through clean and through noisy odometry, or corrected by matching the scans."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite
from os import PathLike, fspath
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from odomcorrupt.api.bag_options import drive_path
from odomcorrupt.api.model import Model, ModelLike, as_model
from odomcorrupt.api.result import Result
from odomcorrupt.corruption.path import NoisyPath
from odomcorrupt.corruption.summary import model_brief
from odomcorrupt.errors import MapError, OdomCorruptError
from odomcorrupt.extras import part_of_study
from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.mapping.messages import mount_at
from odomcorrupt.mapping.occupancy_grid import format_map
from odomcorrupt.mapping.scan_map import (
    WINDOW_M,
    added_thickness,
    maps_brief,
    maps_table,
    read_rays,
    scan_maps,
    slow_rays,
)
from odomcorrupt.result_files import refuse_existing, write_file
from odomcorrupt.rng import draw_seed
from odomcorrupt.summary import Line
from odomcorrupt.trajectories import read_drive, read_poses

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from matplotlib.figure import Figure

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.laser.mapping import LaserMaps
    from odomcorrupt.mapping.scan_map import ScanMap
    from odomcorrupt.study.select.selection import Watch
    from odomcorrupt.summary import Summary

Method = Literal["odometry", "laser"]


@dataclass(frozen=True, slots=True, repr=False, kw_only=True)
class Maps(Result):
    """Laser maps of one drive, and how thick their walls are along it.

    source : the bag
    model, seed, run : model of the noisy odometry, seed of its draws, number of its run
    maps : through clean and noisy odometry, and through the truth if there is one; by the laser: along its trajectory,
        the odometry, and noisy odometry if a model was given
    notes : what was read and left out, in sentences
    matched : trajectory of the laser, and the sweeps placed along it; None if odometry placed them
    """

    source: str
    model: Model
    seed: int
    run: int
    maps: tuple[ScanMap, ...]
    notes: tuple[str, ...]
    matched: LaserMaps | None = None

    @property
    def method(self) -> Method:
        """Whether odometry placed the scans, or matching them did."""
        return "odometry" if self.matched is None else "laser"

    @property
    def trajectory(self) -> Trajectory | None:
        """Trajectory of the robot by the laser, on the odometry's clock and in the map's frame; None by odometry."""
        return None if self.matched is None else self.matched.trajectory

    def summary(self) -> Summary:
        """Return the wall thickness of the maps, and the noise; by the laser, the number of sweeps placed."""
        if self.matched is not None:
            from odomcorrupt.laser.mapping import laser_brief

            return laser_brief(self.matched)
        model, origin = self.model.motion_model, self.model.origin
        full = f"{model.noise.words} ({origin})" if origin else model.noise.words
        drawn = Line("seed", f"{self.seed}, run {self.run}")
        return maps_brief(
            self.maps, self.notes, (drawn, Line("model", model_brief(model, origin.partition(":")[0]), full=full))
        )

    def _tables(self) -> str:
        return "" if self.matched is not None else maps_table(self.maps)

    def _values(self) -> dict[str, Any]:
        clean, noisy = self.maps[:2]
        return {
            "seed": self.seed,
            "measure": "root of the mean plane variance, m (Razlaw et al., ECMR 2015)",
            "travelled_m": clean.marks_m,
            "thickness_m": {one.name: one.thickness_m for one in self.maps},
            "added_m": added_thickness(clean.thickness_m, noisy.thickness_m),
            "off_surface_m": {one.name: one.off_surface_m for one in self.maps[1:]},
            "notes": self.notes,
        }

    def rows(self) -> list[dict[str, Any]]:
        """Return one row per map and distance travelled: wall thickness so far, distance of hits from the walls."""
        names = ("travelled_m", "thickness_m", "off_surface_m")
        return [
            {"map": one.name, **dict(zip(names, map(float, values), strict=True))}
            for one in self.maps
            for values in zip(*(getattr(one, name) for name in ("marks_m", *names[1:])), strict=True)
        ]

    def save(self, path: str | PathLike[str], *, overwrite: bool = False) -> tuple[Path, ...]:
        """Write the maps for nav2's map_server, and the trajectory of the laser; return the files.

        path : name ending in .yaml. By odometry, map.yaml stands for map_clean.yaml and map_noisy.yaml with their .pgm.
            By the laser, map.yaml and map.pgm are the map along its trajectory, which is in map.tum
        overwrite : whether existing files are replaced

        Returns
        -------
        tuple of pathlib.Path
            All files written.

        Raises
        ------
        OdomCorruptError
            If the name ends otherwise, or a file exists and `overwrite` is false.
        """
        target = Path(fspath(path))
        if target.suffix != ".yaml":
            raise OdomCorruptError(f"{target}: ends in {target.suffix or 'nothing'}; a map for nav2 ends in .yaml")
        files = map_files(target, self.method)
        for file in files:
            refuse_existing(file, overwrite=overwrite)
        descriptions = [file for file in files if file.suffix == ".yaml"]
        for one, file in zip(self.maps, descriptions, strict=False):
            image, text = format_map(one.grid, file.with_suffix(".pgm").name)
            write_file(file.with_suffix(".pgm"), image)
            write_file(file, text)
        if self.trajectory is not None:
            from odomcorrupt.laser.mapping import tum_text

            write_file(target.with_suffix(".tum"), tum_text(self.trajectory))
        return files

    def _figure(self) -> Figure:
        """Return a figure of the maps side by side, and of thickness and distance of hits along the drive."""
        from odomcorrupt.report.plots.samples import draw_scan_maps

        added = "noise alone" if self.matched is None else "odometry alone"
        return draw_scan_maps(self.maps, WINDOW_M, added)


def map_files(path: Path, method: str) -> tuple[Path, ...]:
    """Return the files that `Maps.save` writes.

    path : name of a file; its suffix is replaced
    """
    if method == "laser":
        return tuple(path.with_suffix(end) for end in (".yaml", ".pgm", ".tum"))
    names = (f"{path.stem}_{name}{end}" for name in ("clean", "noisy") for end in (".pgm", ".yaml"))
    return tuple(path.with_name(name) for name in names)


def require_method(
    method: str, truth: str | None, laser_pose: Sequence[float] | None, max_yaw_rate: float | None
) -> None:
    """Raise MapError, before any work, if a method is unknown or given what it does not take."""
    if method not in get_args(Method):
        raise MapError(f"--method {method}: is not one of {', '.join(get_args(Method))}")
    if method == "laser" and (truth is not None or laser_pose is not None):
        raise MapError("--method laser finds where the laser sits and takes no --truth; leave them out")
    if method == "laser" and max_yaw_rate is not None:
        raise MapError("--method laser undoes the motion during a scan and takes no --max-yaw-rate; leave it out")


def draw_maps(
    bag: str | PathLike[str],
    model: ModelLike | None = None,
    *,
    method: Method = "odometry",
    seed: int | None = None,
    run: int = 0,
    scan: str | None = None,
    odom_topic: str | None = None,
    truth: str | None = None,
    laser_pose: Sequence[float] | None = None,
    max_yaw_rate: float | None = None,
    resolution: float = 0.05,
    watch: Watch = lambda _stage, _share: None,
) -> Maps:
    """Draw the maps that a laser makes through a bag's odometry and through the same odometry with noise on it.

    bag : bag of any kind with odometry and laser scans; not a pipe
    model : noise and effects of the noisy odometry; by default `typical`, by the laser none: no map of such odometry
    method : "odometry" or "laser"; place scans by odometry, or by matching them, which corrects the odometry; needs the
        extra `study`
    seed : seed of all random draws; by default a random one, stated in the result
    run : number of the run under this seed: the noise is that of `corrupt` with the same seed and run
    scan : topic of laser scans; by default the only one
    odom_topic : odometry topic; by default the only one
    truth : topic of poses through which a third map is drawn. By odometry only
    laser_pose : (3,) pose of the laser on the robot, metres and radians, in place of the one in TF. By odometry only:
        matching scans estimates it
    max_yaw_rate : leave out rays received while turning faster, rad/s. By odometry only
    resolution : side of a cell, metres
    watch : called with the name of each stage and the completed share of the work

    Returns
    -------
    Maps
        `maps` are occupancy grids with their wall thickness along the drive; `save` writes them for nav2.

    Raises
    ------
    BagError, TopicError, RecordingError, MapError, ModelError
        If the bag cannot be read, a topic or the pose of the laser is missing, the scans do not match, or a value is
        invalid.

    Examples
    --------
    >>> import odomcorrupt as oc
    >>> drawn = oc.draw_maps("fixtures/office.mcap", "typical", seed=1, resolution=0.1)
    >>> [one.name for one in drawn.maps]
    ['clean odometry', 'noisy odometry']
    >>> [file.name for file in drawn.save("office.yaml")]
    ['office_clean.pgm', 'office_clean.yaml', 'office_noisy.pgm', 'office_noisy.yaml']
    """
    path = drive_path(bag)
    require_method(method, truth, laser_pose, max_yaw_rate)
    if not (isfinite(resolution) and resolution > 0.0):
        raise MapError(f"--resolution {resolution}: the side of a cell must be more than zero metres")
    if max_yaw_rate is not None and not max_yaw_rate >= 0.0:
        raise MapError(f"--max-yaw-rate {max_yaw_rate}: it must be zero rad/s or more")
    mount = None
    if laser_pose is not None:
        pose = np.asarray(laser_pose, dtype=np.float64)
        if pose.shape != (3,) or not np.isfinite(pose).all():
            raise MapError(f"--laser-pose {laser_pose}: give x, y and heading of the laser on the robot")
        mount = mount_at(pose)
    chosen = as_model("typical" if model is None else model)
    drawn_seed = draw_seed() if seed is None else seed

    def error_of(odometry: Trajectory) -> Array:
        noise = NoisyPath(chosen.motion_model, drawn_seed, run)
        return noise.feed(odometry.stamps_ns, odometry.xyt).error_xyt

    made: dict[str, Any] = {"source": str(path), "model": chosen, "seed": drawn_seed, "run": run}
    if method == "laser":
        drawn = _laser_maps(path, odom_topic, scan, watch, None if model is None else error_of, resolution)
        return Maps(**made, maps=drawn.maps, notes=drawn.notes, matched=drawn)
    watch("drawing maps", 0.0)
    drive = read_drive(path, odom_topic)
    rays = read_rays(path, scan, drive.child_frame_id, mount)
    slow = slow_rays(rays, drive, max_yaw_rate)
    noisy = Trajectory(drive.stamps_ns, drive.xyt + error_of(drive.trajectory))
    paths = {"clean odometry": drive.trajectory, "noisy odometry": noisy}
    if truth is not None:
        paths[f"truth ({truth})"] = read_poses(path, truth)
    maps = scan_maps(slow.rays, slow.travelled_m, paths, resolution)
    notes = (*drive.notes, f"{len(slow.rays)} rays of {rays.scans} scans from {rays.frame_id}", *slow.notes)
    return Maps(**made, maps=maps, notes=notes).then("odomcorrupt", "preview", path)


@part_of_study
def _laser_maps(
    path: Path,
    odom_topic: str | None,
    scan: str | None,
    watch: Watch,
    error_of: Callable[[Trajectory], Array] | None,
    resolution: float,
) -> LaserMaps:
    from odomcorrupt.laser.mapping import laser_maps
    from odomcorrupt.study.io.laser_truth import laser_run

    matched = laser_run(path, str(path), odom_topic, scan, watch)
    return laser_maps(matched, error_of and error_of(matched.odometry), resolution)
