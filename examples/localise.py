"""Monte-Carlo localisation of every run of a batch: odometry, laser and an occupancy grid, as nav2's amcl does it.

    odomcorrupt batch drive.mcap runs --runs 40 --model robot.toml --output trajectories --seed 7
    python examples/localise.py drive.mcap map.yaml runs estimates --alphas 0.2 0.2 0.2 0.2 --truth /ground_truth
    odomcorrupt score runs --outputs estimates --truth /ground_truth --align none

The motion update draws from the library's `quadratic` law, which is amcl's: the variance of one update is alpha times
its squared motion (Thrun, Burgard & Fox, Probabilistic Robotics, ch. 5.4 and table 8.2; likelihood field: table 6.3;
low-variance resampling: table 4.4).
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import distance_transform_edt

from odomcorrupt.batching.sinks import format_tum
from odomcorrupt.geometry.se2 import between, compose, rotate
from odomcorrupt.mapping.occupancy_grid import OCCUPIED, Grid, canvas_for, draw_map, read_map
from odomcorrupt.mapping.scan_map import read_rays
from odomcorrupt.model.motion_model import Noise
from odomcorrupt.model.noise_laws import Coefficients
from odomcorrupt.sampling.samples import move_between, move_sampled, move_variances
from odomcorrupt.scoring.run import read_estimate
from odomcorrupt.trajectories import read_poses

if TYPE_CHECKING:
    from odomcorrupt.geometry.trajectory import Trajectory

UPDATE_M, UPDATE_RAD = 0.25, 0.2
"""The filter is updated after so much motion: the defaults of amcl, at which its alphas hold."""
BEAMS = 60
SIGMA_M, RANDOM = 0.1, 0.1
"""Deviation of a range about a wall of the map, and the share of ranges that are anything."""
TEMPER = 0.2
"""Beams of one scan err together: each counts as this part of an independent one."""
START_M, START_RAD = 0.05, 0.05
"""Deviations of the initial pose that the filter is given, which is the true one."""


@dataclass(frozen=True)
class Scan:
    """What one scan hit: points (n, 2) in the robot's frame, metres."""

    stamp_ns: int
    points_xy: np.ndarray


def read_scans(bag: Path, base_frame: str) -> list[Scan]:
    """Return the scans of a bag, `BEAMS` rays of each."""
    rays = read_rays(bag, None, base_frame, None)
    cuts = np.flatnonzero(np.diff(rays.stamps_ns) > 5_000_000) + 1
    scans = []
    for stamps, points in zip(np.split(rays.stamps_ns, cuts), np.split(rays.to_xy, cuts), strict=True):
        shown = np.unique(np.linspace(0, len(points) - 1, BEAMS).astype(int))
        scans.append(Scan(int(stamps[0]), points[shown]))
    return scans


def map_of(bag: Path, poses: str, base_frame: str = "base_link") -> Grid:
    """Return the map that a laser draws through the poses of a topic, where there is no map yet."""
    rays, path = read_rays(bag, None, base_frame, None), read_estimate(bag, poses).trajectory
    inside = (rays.stamps_ns >= path.stamps_ns[0]) & (rays.stamps_ns <= path.stamps_ns[-1])
    xyt = path.at((rays.stamps_ns[inside] - path.stamps_ns[0]) * 1e-9, int(path.stamps_ns[0]))
    ends = xyt[:, :2] + rotate(rays.to_xy[inside], xyt[:, 2])
    return draw_map(canvas_for(ends, 0.05), xyt[:, :2], ends)


class Field:
    """The likelihood field of a map: log likelihood of a ray's end by its distance to the nearest wall."""

    def __init__(self, grid: Grid) -> None:
        distance = distance_transform_edt(grid.cells != OCCUPIED) * grid.resolution_m
        self._log = np.log((1.0 - RANDOM) * np.exp(-0.5 * (distance / SIGMA_M) ** 2) + RANDOM)
        self._grid = grid

    def log_likelihood(self, particles: np.ndarray, points_xy: np.ndarray) -> np.ndarray:
        """Return log likelihoods (n,) of a scan's points (k, 2) for particles (n, 3)."""
        world = rotate(points_xy[None], particles[:, 2:3]) + particles[:, None, :2]
        column, row = np.floor(self._grid.places(world)).astype(int).transpose(2, 0, 1)
        rows, columns = self._log.shape
        inside = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
        found = self._log[np.clip(row, 0, rows - 1), np.clip(column, 0, columns - 1)]
        return TEMPER * np.where(inside, found, np.log(RANDOM)).sum(axis=1)


def moved(
    particles: np.ndarray, before: np.ndarray, after: np.ndarray, noise: Noise, rng: np.random.Generator
) -> np.ndarray:
    """Return particles (n, 3) moved as the odometry was from `before` to `after`, with draws from the noise law."""
    move = move_between(before, after)
    ends = move_sampled(move, move_variances(noise, move), len(particles), rng)
    return compose(particles, between(before, ends))


def resampled(particles: np.ndarray, weights: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return as many particles, drawn by weight with one random number."""
    places = (rng.random() + np.arange(len(particles))) / len(particles)
    return particles[np.minimum(np.searchsorted(np.cumsum(weights), places), len(particles) - 1)]


def mean_pose(particles: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return the weighted mean (3,)."""
    heading = np.arctan2(*(weights @ np.column_stack((np.sin(particles[:, 2]), np.cos(particles[:, 2])))))
    return np.array([*(weights @ particles[:, :2]), heading])


def localise(
    path: Trajectory, scans: list[Scan], field: Field, start: np.ndarray, noise: Noise, *, count: int, seed: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return stamps (n,) and poses (n, 3) in the map, one per scan: the filter's mean, carried on by odometry."""
    rng = np.random.default_rng(seed)
    scans = [scan for scan in scans if path.stamps_ns[0] <= scan.stamp_ns <= path.stamps_ns[-1]]
    stamps = np.array([scan.stamp_ns for scan in scans])
    poses = path.at((stamps - path.stamps_ns[0]) * 1e-9, int(path.stamps_ns[0]))
    last = path.xyt[0]
    particles = start + rng.standard_normal((count, 3)) * [START_M, START_M, START_RAD]
    weights = np.full(count, 1.0 / count)
    best, out = start, np.empty((len(scans), 3))
    for i, (scan, pose) in enumerate(zip(scans, poses, strict=True)):
        step = between(last, pose)
        if np.hypot(step[0], step[1]) >= UPDATE_M or abs(step[2]) >= UPDATE_RAD:
            particles = moved(particles, last, pose, noise, rng)
            log = np.log(weights) + field.log_likelihood(particles, scan.points_xy)
            weights = np.exp(log - log.max())
            weights = np.maximum(weights / weights.sum(), 1e-300)
            last, best = pose, mean_pose(particles, weights)
            if 1.0 / np.sum(weights**2) < count / 2:
                particles, weights = resampled(particles, weights, rng), np.full(count, 1.0 / count)
        out[i] = compose(best, between(last, pose))
    return stamps, out


def main() -> None:
    """Localise every run of a batch, or of a sweep, and write a TUM file of each."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("bag", type=Path, help="the clean bag, for its scans")
    parser.add_argument("map", type=Path, help="its map, a .yaml")
    parser.add_argument("runs", type=Path, help="a batch made with --output trajectories")
    parser.add_argument("estimates", type=Path, help="directory to write")
    parser.add_argument("--alphas", type=float, nargs=4, required=True, help="amcl's alpha1 to alpha4")
    parser.add_argument("--truth", help="topic whose first pose is where the robot starts in the map [the odometry's]")
    parser.add_argument("--base-frame", default="base_link")
    parser.add_argument("--particles", type=int, default=500)
    parser.add_argument("--seed", type=int, default=0, help="of the filter's draws")
    given = parser.parse_args()
    noise = Noise("quadratic", Coefficients(*given.alphas))
    scans, field = read_scans(given.bag, given.base_frame), Field(read_map(given.map))
    runs = sorted(given.runs.rglob("run_*.tum"))
    for path in runs:
        odometry = read_estimate(path, None).trajectory
        start = odometry.xyt[0] if given.truth is None else read_poses(given.bag, given.truth).xyt[0]
        number = int(path.stem.removeprefix("run_"))
        stamps, xyt = localise(odometry, scans, field, start, noise, count=given.particles, seed=given.seed + number)
        target = given.estimates / path.relative_to(given.runs)
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(format_tum(stamps, xyt))
    print(f"{len(runs)} runs localised in {given.estimates}")


if __name__ == "__main__":
    main()
