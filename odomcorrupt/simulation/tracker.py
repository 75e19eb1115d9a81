"""Ground truth: motion capture, or RTK with two antennas, of a frame on the robot in the world frame."""

from dataclasses import dataclass

import numpy as np

from odomcorrupt.simulation.encoders import jittered_times
from odomcorrupt.simulation.kinematics import Drive
from odomcorrupt.simulation.planar import attach, sample
from odomcorrupt.simulation.robot import Robot
from odomcorrupt.simulation.streams import Streams, gauss_markov_noise


@dataclass(frozen=True, slots=True)
class Tracker:
    """Rate, noise, dropouts and clock of the ground truth."""

    rate_hz: float = 100.0
    sampling_jitter_s: float = 0.0001
    noise_m: float = 0.002
    noise_rad: float = float(np.radians(0.2))
    dropouts_per_min: float = 1.0
    dropout_mean_s: float = 0.2
    wander_m: float = 0.0
    """Standard deviation of slowly varying errors beside the white noise (satellites, atmosphere, reflections)."""
    wander_tau_s: float = 60.0
    clock_offset_s: float = 0.0
    """Tracker's clock minus true time at the start, s."""
    clock_rate: float = 0.0
    """Tracker's seconds per true second, minus 1."""


TRACKERS: dict[str, Tracker] = {
    "mocap": Tracker(),
    "rtk": Tracker(rate_hz=10.0, noise_m=0.012, noise_rad=float(np.radians(0.4)), dropout_mean_s=0.8, wander_m=0.01),
}


@dataclass(frozen=True, slots=True)
class Track:
    """Tracker output: stamps (s, tracker's clock) and poses (m, 3) of the tracked frame in the world."""

    stamps_s: np.ndarray
    xyt: np.ndarray


def dock(rng: np.random.Generator) -> np.ndarray:
    """Return a random start pose (3,) in the truth frame; m, m, rad."""
    return np.array([*rng.uniform(-8.0, 8.0, size=2), rng.uniform(-np.pi, np.pi)])


def watch(drive: Drive, robot: Robot, tracker: Tracker, streams: Streams) -> Track:
    """Return stamps, s, and poses of the robot's marker in the truth frame, m and rad, as the tracker measures them."""
    grid_s = drive.grid_s
    origin, heading_rad = complex(drive.start_xyt[0], drive.start_xyt[1]), drive.start_xyt[2]

    clock = streams.open("tracker_clock")
    times_s = jittered_times(grid_s[-1], tracker.rate_hz, tracker.sampling_jitter_s, clock)
    marker_xyt = attach(sample(grid_s, drive.true_xyt, times_s), robot.marker_xyt)
    place = origin + (marker_xyt[:, 0] + 1j * marker_xyt[:, 1]) * np.exp(1j * heading_rad)
    seen_xyt = np.column_stack((place.real, place.imag, marker_xyt[:, 2] + heading_rad))
    noise = streams.open("tracker").normal(size=seen_xyt.shape)
    seen_xyt += noise * (tracker.noise_m, tracker.noise_m, tracker.noise_rad)
    for axis, name in enumerate(("east", "north") if tracker.wander_m > 0.0 else ()):
        slow = streams.open(f"tracker wander {name}")
        seen_xyt[:, axis] += gauss_markov_noise(
            tracker.wander_m, tracker.wander_tau_s, 1.0 / tracker.rate_hz, len(seen_xyt), slow
        )

    seen = ~_hidden(times_s, grid_s[-1], tracker, streams.open("dropouts"))
    stamps_s = times_s * (1.0 + tracker.clock_rate) + tracker.clock_offset_s
    return Track(stamps_s[seen], seen_xyt[seen])


def _hidden(times_s: np.ndarray, duration_s: float, tracker: Tracker, rng: np.random.Generator) -> np.ndarray:
    hidden = np.zeros(times_s.size, dtype=bool)
    for _ in range(rng.poisson(tracker.dropouts_per_min * duration_s / 60.0)):
        begin_s = rng.uniform(0.0, duration_s)
        end_s = begin_s + min(rng.exponential(tracker.dropout_mean_s), 5.0 * tracker.dropout_mean_s)
        hidden |= (times_s >= begin_s) & (times_s < end_s)
    return hidden
