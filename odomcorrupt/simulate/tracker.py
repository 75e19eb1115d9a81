"""The judge outside: cameras (or RTK with two antennas) that see a frame on the robot, in a world of their own."""

from dataclasses import dataclass

import numpy as np

from odomcorrupt.simulate.contact import Drive
from odomcorrupt.simulate.encoders import jittered_times
from odomcorrupt.simulate.planar import attach, sample
from odomcorrupt.simulate.robot import Robot


@dataclass(frozen=True, slots=True)
class Tracker:
    """How often and how well the robot is seen; the noise is white."""

    rate_hz: float = 100.0
    sampling_jitter_s: float = 0.0001
    noise_m: float = 0.002
    noise_rad: float = float(np.radians(0.2))
    dropouts_per_min: float = 1.0
    dropout_mean_s: float = 0.2


TRACKERS: dict[str, Tracker] = {
    "mocap": Tracker(),
    "rtk": Tracker(rate_hz=10.0, noise_m=0.012, noise_rad=float(np.radians(0.4)), dropout_mean_s=0.8),
}


@dataclass(frozen=True, slots=True)
class Track:
    """What was seen: stamps (s, true time) and poses (m, 3) of the tracked frame in the world."""

    stamps_s: np.ndarray
    xyt: np.ndarray


def watch(
    drive: Drive,
    robot: Robot,
    tracker: Tracker,
    rngs: dict[str, np.random.Generator],
) -> Track:
    """Track the robot's marker.

    Parameters
    ----------
    drive : Drive
        What truly happened.
    rngs : dict of Generator
        Streams ``"world"``, ``"tracker_clock"``, ``"tracker"`` and ``"dropouts"``.
    """
    grid_s = drive.grid_s
    world = rngs["world"]
    start_xyt = np.array([[*world.uniform(-8.0, 8.0, size=2), world.uniform(-np.pi, np.pi)]])
    origin, heading_rad = complex(*start_xyt[0, :2]), start_xyt[0, 2]

    times_s = jittered_times(grid_s[-1], tracker.rate_hz, tracker.sampling_jitter_s, rngs["tracker_clock"])
    marker_xyt = attach(sample(grid_s, drive.true_xyt, times_s), robot.marker_xyt)
    place = origin + (marker_xyt[:, 0] + 1j * marker_xyt[:, 1]) * np.exp(1j * heading_rad)
    seen_xyt = np.column_stack((place.real, place.imag, marker_xyt[:, 2] + heading_rad))
    seen_xyt += rngs["tracker"].normal(size=seen_xyt.shape) * (tracker.noise_m, tracker.noise_m, tracker.noise_rad)

    hidden = np.zeros(times_s.size, dtype=bool)
    for _ in range(rngs["dropouts"].poisson(tracker.dropouts_per_min * grid_s[-1] / 60.0)):
        begin_s = rngs["dropouts"].uniform(0.0, grid_s[-1])
        end_s = begin_s + min(rngs["dropouts"].exponential(tracker.dropout_mean_s), 5.0 * tracker.dropout_mean_s)
        hidden |= (times_s >= begin_s) & (times_s < end_s)
    return Track(times_s[~hidden], seen_xyt[~hidden])
