"""ATE and RPE, the usual measures for SLAM, between poses at the same stamps; reduction of the drift by clocks.

Definitions: Sturm et al., A benchmark for the evaluation of RGB-D SLAM systems, IROS 2012; alignment: Umeyama, PAMI
13(4), 1991, without scale. The values equal those of the tool evo (its defaults, in the plane). Alignment hides errors
that a rotation can absorb: read these values together with errors that start at the truth pose.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.geometry.se2 import between, compose, wrap
from odomcorrupt.study.estimate.windows import distance_windows, drift_of, joint_rmse
from odomcorrupt.study.io.clock import Clock, aligned

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.io.recording import Recording

RPE_M = 1.0
"""Distance between the poses that RPE compares, metres."""


def aligned_rigidly(reference_xyt: Array, estimate_xyt: Array) -> Array:
    """Return the estimate (n, 3) aligned rigidly with the reference (n, 3) by least squares of the positions."""
    p, q = reference_xyt[:, :2], estimate_xyt[:, :2]
    centre_p, centre_q = p.mean(axis=0), q.mean(axis=0)
    dp, dq = p - centre_p, q - centre_q
    # in the plane the best rotation has a closed form, without a singular value decomposition
    turn = np.arctan2(np.sum(dq[:, 0] * dp[:, 1] - dq[:, 1] * dp[:, 0]), np.sum(dq * dp))
    c, s = np.cos(turn), np.sin(turn)
    shift = centre_p - np.array([c * centre_q[0] - s * centre_q[1], s * centre_q[0] + c * centre_q[1]])
    return compose(np.array([*shift, turn]), estimate_xyt)


def aligned_at_origin(reference_xyt: Array, estimate_xyt: Array) -> Array:
    """Return the estimate (n, 3) moved rigidly so that its first pose equals the reference's."""
    return compose(reference_xyt[0], between(estimate_xyt[0], estimate_xyt))


def absolute_errors(reference_xyt: Array, estimate_xyt: Array) -> Array:
    """Return the distances (n,) between positions, metres."""
    return np.linalg.norm(estimate_xyt[:, :2] - reference_xyt[:, :2], axis=1)


@dataclass(frozen=True, slots=True)
class RelativeErrors:
    """Unsigned errors of m motions: translation_m (m,) metres, rotation_rad (m,) radians."""

    translation_m: Array
    rotation_rad: Array


def relative_errors(reference_xyt: Array, estimate_xyt: Array, delta_m: float) -> RelativeErrors:
    """Return the errors of successive motions, each `delta_m` long on the estimate's path."""
    ends = _cuts(estimate_xyt, delta_m)
    true = between(reference_xyt[ends[:-1]], reference_xyt[ends[1:]])
    error = between(true, between(estimate_xyt[ends[:-1]], estimate_xyt[ends[1:]]))
    return RelativeErrors(np.hypot(error[:, 0], error[:, 1]), np.abs(wrap(error[:, 2])))


def _cuts(xyt: Array, delta_m: float) -> NDArray[np.int64]:
    """Return the indices of the first pose and of each pose at least `delta_m` of path after the previous one."""
    cuts, gone = [0], 0.0
    for i, step in enumerate(np.linalg.norm(np.diff(xyt[:, :2], axis=0), axis=1).tolist(), start=1):
        gone += step
        if gone >= delta_m:
            cuts.append(i)
            gone = 0.0
    return np.array(cuts)


@dataclass(frozen=True, slots=True)
class TrajectoryError:
    """Root mean square errors over recordings; NaN if a value needs headings and the truth has none.

    ate_m : after rigid alignment; ate_origin_m : with the first poses aligned
    rpe_m, rpe_rad : of motions of length `RPE_M`
    """

    ate_m: float
    ate_origin_m: float
    rpe_m: float
    rpe_rad: float


def trajectory_error(recordings: Sequence[Recording]) -> TrajectoryError:
    """Return the errors of the odometry at the truth's stamps, with each recording aligned separately."""
    aligned, origin, shift, turn = [], [], [], []
    for recording in recordings:
        inside = recording.within_odometry
        truth = recording.truth.xyt[inside]
        estimate = recording.odometry.at(recording.truth_s[inside], recording.origin_ns)
        aligned.append(absolute_errors(truth, aligned_rigidly(truth, estimate)))
        if recording.headed:
            origin.append(absolute_errors(truth, aligned_at_origin(truth, estimate)))
            motions = relative_errors(truth, estimate, RPE_M)
            shift.append(motions.translation_m)
            turn.append(motions.rotation_rad)
    return TrajectoryError(*(_rms(parts) for parts in (aligned, origin, shift, turn)))


def _rms(parts: Sequence[Array]) -> float:
    values = np.concatenate(parts) if parts else np.zeros(0)
    return float(np.sqrt(np.mean(values**2))) if len(values) else float("nan")


@dataclass(frozen=True, slots=True)
class ClockGain:
    """Position errors, metres, without and with clock correction; NaN if a drive is too short."""

    after_10m: tuple[float, float]
    after_50m: tuple[float, float]
    after_10s: tuple[float, float]


def clock_gain(recordings: Sequence[Recording], clocks: Sequence[Clock]) -> ClockGain:
    """Return the drift without and with clock correction, over windows that start at the truth."""

    def errors(runs: list[Recording]) -> list[float]:
        after_path = [joint_rmse(distance_windows(run, length_m) for run in runs) for length_m in (10.0, 50.0)]
        return [*after_path, drift_of(runs).rmse]

    before = errors([aligned(r, Clock()) for r in recordings])
    after = errors([aligned(r, c) for r, c in zip(recordings, clocks, strict=True)])
    return ClockGain(*zip(before, after, strict=True))
