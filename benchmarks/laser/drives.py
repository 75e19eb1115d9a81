"""A simulated drive with two truths: motion capture, and a laser on the robot."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from laser.caster import LASERS, Laser, ranges_of, walkers
from laser.world import world_around
from odomcorrupt.geometry.se2 import compose
from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.laser.scans import Sweep, Sweeps
from odomcorrupt.simulation import simulate
from odomcorrupt.simulation.sensors import Tracker
from odomcorrupt.study.io.laser_truth import LaserRun, match_run, truth_of
from odomcorrupt.study.io.raw_trajectory import Samples
from odomcorrupt.study.io.reader import recordings_of
from odomcorrupt.study.io.recording import Recording

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from odomcorrupt.simulation.run import SimulatedRun

    Array = NDArray[np.float64]

__all__ = ["Seen", "drive", "laser_recordings", "mocap_recording"]

EXACT = Tracker(rate_hz=100.0, sampling_jitter_s=0.0, noise_m=0.0, noise_rad=0.0, dropouts_per_min=0.0)
PEOPLE = 3
SCALE_ERROR = 0.003
"""Standard deviation of the laser's drawn scale error, which `--laser-scale-accuracy` states by default."""


@dataclass(frozen=True, slots=True)
class Seen:
    """One drive with all its measurements.

    run : odometry and motion capture
    exact : truth without noise of the tracker
    sweeps : sweeps of the laser
    scale, lag_s, mount : scale error, clock lag and mounting of the laser
    """

    run: SimulatedRun
    exact: Trajectory
    sweeps: Sweeps
    scale: float
    lag_s: float
    mount: Array


def drive(
    seed: int, cause: str | Sequence[str] | None, kind: str, *, laser: str = "cheap", scale_error: float = SCALE_ERROR,
    most_lag_s: float = 0.15, **options: Any,
) -> Seen:  # fmt: skip
    """Return a simulated drive with laser sweeps in a world of the given kind."""
    run = simulate(seed, cause, **options)
    exact = _trajectory(simulate(seed, cause, truth=EXACT, **options))
    rng = np.random.default_rng([seed, 7])
    device: Laser = LASERS[laser]
    mount = np.array([0.1, 0.0, np.radians(1.0)]) + rng.normal(size=3) * (0.02, 0.02, np.radians(0.5))
    scale, lag_s = float(scale_error * rng.normal()), float(rng.uniform(-most_lag_s, most_lag_s))
    path = exact.xyt[:, :2]
    segments = world_around(kind, path, rng)
    origin_ns = int(exact.stamps_ns[0])
    last_s = float(exact.stamps_ns[-1] - origin_ns) * 1e-9
    people = None
    if kind != "corridor":
        people = walkers(PEOPLE, path.min(axis=0) - 1.0, path.max(axis=0) + 1.0, last_s, rng)

    def pose_at(t_s: Array) -> Array:
        return compose(exact.at(np.clip(t_s, 0.0, last_s), origin_ns), mount)

    starts = np.arange(0.05, last_s - 1.0 / device.rate_hz - 0.05, 1.0 / device.rate_hz)
    bearing = -np.pi + 2.0 * np.pi * np.arange(device.beams) / device.beams
    way = np.stack((np.cos(bearing), np.sin(bearing)), axis=1)
    step = 1.0 / (device.beams * device.rate_hz)
    sweeps = []
    for start in starts:
        seen = ranges_of(device, segments, people, pose_at, float(start), rng) * (1.0 + scale)
        hit = np.flatnonzero(np.isfinite(seen) & (seen > 0.0))
        stamp = origin_ns + round((start + lag_s) * 1e9)
        xy = (seen[hit, None] * way[hit]).astype(np.float32)
        sweeps.append(Sweep(stamp, xy, (hit * step).astype(np.float32)))
    stamps = np.array([s.stamp_ns for s in sweeps])
    whole = Sweeps("simulated: /scan", "/scan", "laser", tuple(sweeps), 2.0 * np.pi, stamps, None)
    return Seen(run, exact, whole, scale, lag_s, mount)


def _trajectory(run: SimulatedRun) -> Trajectory:
    xyt = run.truth_xyt.copy()
    xyt[:, 2] = np.unwrap(xyt[:, 2])
    return Trajectory(run.truth_stamps_ns, xyt)


def odometry_samples(run: SimulatedRun) -> Samples:
    """Return a run's odometry in the form in which it is read from a bag."""
    xyz = np.column_stack((run.odom_xyt[:, :2], np.zeros(len(run.odom_xyt))))
    nothing = np.zeros(0)
    return Samples(
        "simulated: /odom", "/odom", "odom", run.odom_stamps_ns, xyz, run.odom_xyt[:, 2], run.odom_stamps_ns, nothing,
        child="base_link",
    )  # fmt: skip


def mocap_recording(seen: Seen) -> Recording:
    """Return the drive with motion capture as its truth."""
    run = seen.run
    odometry = run.odom_xyt.copy()
    odometry[:, 2] = np.unwrap(odometry[:, 2])
    own = Trajectory(run.odom_stamps_ns, odometry)
    return Recording("mocap", own, _trajectory(run), int(run.odom_stamps_ns[0]), run.track_m)


def laser_recordings(seen: Seen, *, scale_error: float = SCALE_ERROR) -> tuple[list[Recording], LaserRun]:
    """Return the drive with the laser as its truth, as `learn --scan` reads it, and the laser's run."""
    odometry = odometry_samples(seen.run)
    found = match_run(odometry, seen.sweeps)
    recordings = [r for part in truth_of(found) for r in recordings_of("laser", odometry, part, seen.run.track_m)]
    return [replace(r, truth_scale_error=scale_error) for r in recordings], found
