"""Predictive check: corrupted runs along the truth's path, compared with the measured odometry.

The truth's path is smoothed (its noise would count as motion) and corrupted by the same code as bags. The resulting
error is added to the measured truth. Runs and measured odometry both start at the truth.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.stats import f as fisher_f

from odomcorrupt.corruption.path import NoisyPath
from odomcorrupt.geometry.increments import Increments, accumulate
from odomcorrupt.geometry.se2 import between, compose, inverse, wrap
from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.rng import stream
from odomcorrupt.study.estimate.problem import undo
from odomcorrupt.study.estimate.regressors import driving_motion

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.io.recording import Recording
    from odomcorrupt.study.validate.evaluation import Evaluation

__all__ = ["Replay", "overlapping", "replay", "smooth_truth"]

_MAX_POSES = 1500
"""Poses kept of each path, for plots and statistics."""
_MIN_RUNS = 20


@dataclass(frozen=True, slots=True)
class Replay:
    """Corrupted runs and measured odometry at m poses of one stretch of a recording, in the truth's frame.

    distance_m : (m,) travelled by the truth
    truth_xyt, measured_xyt : (m, 3) truth, and the odometry aligned with the truth's first pose
    runs_xyt : (r, m, 3) corrupted runs
    """

    distance_m: Array
    truth_xyt: Array
    measured_xyt: Array
    runs_xyt: Array

    def inside(self, at: NDArray[np.int64], part: float = 0.9) -> NDArray[np.bool_]:
        """Return for selected poses whether the measured pose is inside the prediction region of probability `part`.

        The region is the ellipsoid of the runs about their mean, in x, y and heading jointly, with the size of a
        prediction region for this number of runs (Hotelling's T squared).
        """
        count = len(self.runs_xyt)
        off = between(self.truth_xyt[at], self.runs_xyt[:, at])
        own = between(self.truth_xyt[at], self.measured_xyt[at])
        off[..., 2] = np.unwrap(off[..., 2], axis=1)
        mean = off.mean(axis=0)
        spread = np.einsum("rmi,rmj->mij", off - mean, off - mean) / (count - 1.0)
        spread[:, [0, 1, 2], [0, 1, 2]] += 1e-12
        gap = own - mean
        gap[:, 2] = wrap(gap[:, 2])
        square = np.sum(np.linalg.solve(spread, gap[:, :, None])[:, :, 0] * gap, axis=1)
        limit = 3.0 * (count - 1.0) * (count + 1.0) / (count * (count - 3.0)) * fisher_f.ppf(part, 3, count - 3)
        within: NDArray[np.bool_] = square <= limit
        return within


def replay(piece: Evaluation, *, runs: int = 100, seed: int = 0) -> Replay:
    """Return corrupted runs along a stretch's truth, beside its odometry with the measurement's effects removed."""
    if runs < _MIN_RUNS:
        raise ValueError(f"runs: {runs}; give {_MIN_RUNS} or more: fewer do not determine the covariance of the runs")
    model = piece.model
    measured = overlapping(undo(piece.recording, model.setup.effects))
    smooth, truth = smooth_truth(measured)
    stamps = measured.odometry.stamps_ns
    kept = np.unique(np.linspace(0, len(stamps) - 1, min(_MAX_POSES, len(stamps))).astype(np.int64))
    travelled = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(smooth[:, :2], axis=0), axis=1))))
    starts = stream(seed, 0, "replay").standard_normal((runs, 3)) * np.array(
        [piece.truth.xy_m, piece.truth.xy_m, piece.truth.yaw_rad]
    )
    poses = np.empty((runs, len(kept), 3))
    for run in range(runs):
        error = NoisyPath(model, seed, run, covariance=False).feed(stamps, smooth).error_xyt
        poses[run] = truth[kept] + error[kept]
        # The true start is uncertain: the truth's noise turns and shifts the whole run.
        first = truth[0]
        poses[run] = compose(compose(compose(first, starts[run]), inverse(first)), poses[run])
    own = compose(truth[0], between(measured.odometry.xyt[0], measured.odometry.xyt[kept]))
    return Replay(travelled[kept], truth[kept], own, poses)


def overlapping(recording: Recording) -> Recording:
    """Return the recording with the odometry restricted to the time of the truth."""
    odometry, truth = recording.odometry, recording.truth
    inside = (odometry.stamps_ns >= truth.stamps_ns[0]) & (odometry.stamps_ns <= truth.stamps_ns[-1])
    return replace(recording, odometry=Trajectory(odometry.stamps_ns[inside], odometry.xyt[inside]))


def smooth_truth(recording: Recording) -> tuple[Array, Array]:
    """Return the truth at the odometry's stamps, smoothed (n, 3) and as measured (n, 3)."""
    truth = recording.truth.at(recording.odometry_s, recording.origin_ns)
    m = driving_motion(recording, "truth")
    sideways = m.vy * m.dt_s
    if np.abs(sideways).sum() < 0.1 * np.abs(m.v * m.dt_s).sum():
        sideways = np.zeros_like(sideways)
    steps = Increments(np.ascontiguousarray(m.v * m.dt_s), sideways, np.ascontiguousarray(m.omega * m.dt_s))
    return accumulate(truth[0], steps), truth
