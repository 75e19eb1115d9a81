"""Wheels and a gyro alone: a bag with odometry and Imu, without truth, and what `diagnose` reports of it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np

import odomcorrupt as oc
from laser.bag import write_gyro_bag
from laser.cases import TRAVEL
from laser.drives import EXACT
from odomcorrupt.errors import RecordingError
from odomcorrupt.simulation import simulate
from odomcorrupt.simulation.faults import SIZES

if TYPE_CHECKING:
    from laboratory.cases import Case
    from numpy.typing import NDArray

    from odomcorrupt.simulation.run import SimulatedRun

    Array = NDArray[np.float64]

__all__ = ["ask_gyro"]

GAIN = 0.01  # one standard deviation, as the program assumes
BIAS_RADPS, NOISE_RADPS = 0.01, 0.003
WALKS = (1e-5, 5e-4)
"""Bounds of the random walk of the bias, rad/s/sqrt(s), whose logarithm is uniform."""
MOST_LAG_S = 0.02
RATE_HZ = 100.0
REST_BIAS_RADPS = 3e-4  # error of a bias measured in the rests of a drive
GRID_S = 0.5


@dataclass(frozen=True, slots=True)
class Gyro:
    """Errors and mounting of a gyro.

    gain : scale error
    bias_radps, walk : biases of its axes (3,), rad/s, and their random walk, rad/s/sqrt(s)
    lag_s : lag of its stamps, s
    axis, sign : upward axis, and 1 if it points up or -1 if down
    """

    gain: float
    bias_radps: Array
    walk: float
    lag_s: float
    axis: int
    sign: float

    def measure(self, run: SimulatedRun, rng: np.random.Generator) -> tuple[NDArray[np.int64], Array]:
        """Return stamps, ns, and rates (n, 3), rad/s, of a drive whose truth is exact, at 100 Hz."""
        t_s = (run.truth_stamps_ns - run.truth_stamps_ns[0]) * 1e-9
        rates = np.zeros((len(t_s), 3))
        rates[:, self.axis] = self.sign * (1.0 + self.gain) * np.gradient(np.unwrap(run.truth_xyt[:, 2]), t_s)
        walk = np.cumsum(rng.normal(size=rates.shape), axis=0) * self.walk / np.sqrt(RATE_HZ)
        rates += self.bias_radps + walk + NOISE_RADPS * rng.normal(size=rates.shape)
        return run.truth_stamps_ns + round(self.lag_s * 1e9), rates


def ask_gyro(case: Case, walk: float | None = None) -> dict[str, Any]:
    """Return the results of a case with wheels and a gyro alone.

    walk : random walk of the bias, rad/s/sqrt(s); default: drawn
    """
    options: dict[str, Any] = {
        "size": SIZES.get(case.size, 1.0),
        "route": case.route,
        "yaw_from": case.yaw_from,
        "duration_s": case.duration_s,
        "truth": EXACT,
    }
    run = simulate(case.seed, list(case.causes) or None, **options)
    rng = np.random.default_rng([case.seed, 8])
    walk = float(np.exp(rng.uniform(*np.log(WALKS)))) if walk is None else walk
    gyro = Gyro(
        float(GAIN * rng.normal()), BIAS_RADPS * rng.normal(size=3), walk, float(rng.uniform(-MOST_LAG_S, MOST_LAG_S)),
        int(rng.integers(3)), float(rng.choice((-1.0, 1.0))),
    )  # fmt: skip
    row: dict[str, Any] = {
        "truth": run.answer["causes"],
        "gyro": {"gain": gyro.gain, "walk": walk, "lag_s": gyro.lag_s, "axis": "xyz"[gyro.axis], "sign": gyro.sign},
    }
    if case.causes:
        row["deviations"] = _deviations(run, simulate(case.seed, None, **options), walk)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "run.mcap"
        write_gyro_bag(path, run, *gyro.measure(run, rng))
        try:
            said = oc.diagnose(oc.read_recordings(path, track_m=run.track_m)).to_dict()
        except RecordingError as error:
            return row | {"refused": str(error)}
    row["found"] = [{key: one[key] for key in ("effect", "kind", "parameters", "confidence")} for one in said["found"]]
    row["unknown"] = [[one["channel"], one["depends_on"]] for one in said["unknown"]]
    row["notes"] = said["recordings"][0]["notes"]
    reported = " ".join(note for note in row["notes"] if "not testable" in note)
    untestable = [one["effect"] for one in said["not_testable"]]
    row["untestable"] = [*untestable, *(name for name in TRAVEL if name in reported and name not in untestable)]
    return row


def _deviations(run: SimulatedRun, without: SimulatedRun, walk: float) -> float:
    """Return the cause's effect on turns, in standard deviations of wheels and gyro.

    The effect is the heading error with the cause minus that without it, per half second. Its covariance has the
    white noise of gyro and wheels, the gyro's gain, and its bias, measured at rest, with its random walk.
    """
    error, turns = _turns(run)
    other, _ = _turns(without)
    t_s = GRID_S * np.arange(1, len(turns) + 1)
    white = NOISE_RADPS**2 * GRID_S / RATE_HZ + float(np.var(other))
    walked = walk**2 * np.minimum.outer(t_s, t_s)
    covariance = (
        white * np.eye(len(turns)) + GAIN**2 * np.outer(turns, turns) + GRID_S**2 * (REST_BIAS_RADPS**2 + walked)
    )
    effect = error - other
    return float(np.sqrt(effect @ np.linalg.solve(covariance, effect)))


def _turns(run: SimulatedRun) -> tuple[Array, Array]:
    """Return the odometry's errors of turns and the true turns, rad per half second."""
    stamps = run.truth_stamps_ns
    last = min(run.odom_stamps_ns[-1], stamps[-1])
    grid = np.arange(0.1, (last - stamps[0]) * 1e-9, GRID_S)
    real = np.diff(np.interp(grid, (stamps - stamps[0]) * 1e-9, np.unwrap(run.truth_xyt[:, 2])))
    own = np.interp(grid, (run.odom_stamps_ns - stamps[0]) * 1e-9, np.unwrap(run.odom_xyt[:, 2]))
    return np.diff(own) - real, real
