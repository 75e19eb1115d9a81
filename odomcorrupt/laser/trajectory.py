"""Trajectory of the laser in its finished map, with the noise of its poses.

With e the laser's heading minus the odometry's at the same time, white errors of the laser make neighbouring
differences of e anticorrelated, for any odometry: cov(e1 - e0, e2 - e1) = -var. The part of that variance that grows
with the square of the yaw rate is jitter of the stamps.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from odomcorrupt.geometry.se2 import between, compose, inverse, rotate, wrap
from odomcorrupt.laser.icp import OVERLAP, WEAK, match, thinned

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.geometry.trajectory import Trajectory
    from odomcorrupt.laser.calibrate import Calibration
    from odomcorrupt.laser.scans import Motion, Sweeps
    from odomcorrupt.laser.slam import Tracked


UNKNOWN_M = 2.0
"""Standard deviation along an axis that the scan does not determine, m."""


@dataclass(frozen=True, slots=True)
class LaserPath:
    """Poses of the robot from its laser.

    row : (k,) index of the sweep of each pose
    t_s : (k,) middle of that sweep on the laser's clock, seconds since the origin
    xyt : (k, 3) poses of the robot in the map, m and rad
    covariance : (k, 3, 3) of each pose in the robot's axes, from the match; `UNKNOWN_M` along an undetermined axis
    part : (k,) index of the connected part of the map
    weak : (k,) whether the match does not determine the position along one axis
    """

    row: NDArray[np.int64]
    t_s: Array
    xyt: Array
    covariance: Array
    part: NDArray[np.int64]
    weak: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.row)

    def only(self, kept: NDArray[np.bool_]) -> LaserPath:
        """Return the poses selected by a mask (k,)."""
        arrays = ("row", "t_s", "xyt", "covariance", "part", "weak")
        return replace(self, **{name: getattr(self, name)[kept] for name in arrays})


class WhiteNoise(NamedTuple):
    """Ratios of position and heading variances to those of the matches, and standard deviation of the stamps, s."""

    position: float
    heading: float
    stamps_s: float


@dataclass(frozen=True, slots=True)
class LaserRun:
    """One run with its trajectory by the laser.

    odometry : as recorded
    sweeps, calibration, tracked, path : laser sweeps, mounting and clock, the map, and the trajectory in it
    noise : noise of the trajectory relative to its matches' covariances
    """

    odometry: Trajectory
    sweeps: Sweeps
    calibration: Calibration
    tracked: Tracked
    path: LaserPath
    noise: WhiteNoise


def relocalised(
    calibration: Calibration, tracked: Tracked, progress: Callable[[float], None] | None = None
) -> LaserPath:
    """Return each sweep's pose in the finished map; sweeps that do not match are left out."""
    motion, world = calibration.motion, tracked.map
    part_of = world.parts()
    scans = calibration.deskewing()
    found = []
    tracked_rows = np.flatnonzero(tracked.keyframe >= 0)
    for done, n in enumerate(tracked_rows):
        if progress is not None and done % 50 == 0:
            progress(done / len(tracked_rows))
        k = int(tracked.keyframe[n])
        fit = match(thinned(scans[int(n)], 450), world.local(k), tracked.relative[n], (0.2, 0.15))
        if fit is None or fit.overlap < OVERLAP:
            continue
        covariance = np.linalg.inv(fit.information + np.diag([1e-4, 1e-4, 1e-4]))
        if fit.ratio < WEAK:
            covariance[:2, :2] += UNKNOWN_M**2 * np.outer(fit.weak_axis, fit.weak_axis)
        # rotate into the laser's axes, then the robot's
        turn = np.eye(3)
        turn[:2, :2] = rotate(np.eye(2), np.full(2, fit.pose[2] - motion.mount[2]))
        found.append((n, compose(world.poses[k], fit.pose), turn @ covariance @ turn.T, part_of[k], fit.ratio < WEAK))
    rows, poses, covariances, parts, weak = zip(*found, strict=True) if found else ((),) * 5
    row = np.array(rows, dtype=np.int64)
    xyt = compose(np.array(poses).reshape(-1, 3), inverse(motion.mount))
    xyt[:, 2] = np.unwrap(xyt[:, 2])
    covariance = np.array(covariances, dtype=np.float64).reshape(-1, 3, 3)
    return LaserPath(
        row, tracked.t_s[row], xyt, covariance, np.array(parts, dtype=np.int64), np.array(weak, dtype=bool)
    )


_FEW = 60
_EXTREME = 99.0
_TURNS_RADPS, _MOVES_MPS = 0.1, 0.05
_YAW = 2
_SMALLEST, _LARGEST = 0.04, 400.0
_SPIKE, _NEIGHBOURS, _NEAR_S = 6.0, 3, 0.7
"""Threshold for a spike, in usual deviations from its neighbours' median prediction; number of neighbours per side;
time within which they count, s: over it the odometry is accurate to a few millimetres."""
_AROUND_S, _NEW_VIEW_M, _TURN_M = 0.5, 0.1, 0.3
"""Half the time over which motion is measured, s; motion after which the view is new, m; metres per radian in it."""
_VIEW_M, _VIEW_RAD = 1e-3, 2e-4
"""Standard deviations of errors that change with the view; their scale is estimated with that of the matches."""
_LEAST_M, _LEAST_RAD = 1e-4, 2e-5
_USUAL = np.array([2.5e-3, 2.5e-3, 2e-3])


def white_noise(path: LaserPath, motion: Motion) -> WhiteNoise:
    """Return the noise of a path's poses relative to their matches' covariances; zero jitter if not significant.

    It is one regression of the three channels' variances. Its regressors are the matches' variances, with one level for
    positions and one for headings, and the squares of the robot's twist, whose coefficient is the stamps' variance.
    """
    t_s = path.t_s
    if len(t_s) < _FEW:
        return WhiteNoise(1.0, 1.0, 0.0)
    robot = motion.robot(t_s)
    step = between(robot[:-1], robot[1:]) - between(path.xyt[:-1], path.xyt[1:])
    step[:, 2] = wrap(step[:, 2])
    apart = np.diff(t_s)
    whole = (apart < 1.6 * float(np.median(apart))) & (path.part[:-1] == path.part[1:])
    both = whole[:-1] & whole[1:]
    seen = both & ~(path.weak[:-2] | path.weak[1:-1] | path.weak[2:])
    rate = _rate(path, motion)[1:-1]
    columns, targets = [], []
    for channel in range(3):
        rows = both if channel == _YAW else seen
        if np.count_nonzero(rows) < _FEW:
            continue
        white = -(step[:-1, channel] * step[1:, channel])[rows]
        white = np.clip(white, *np.percentile(white, (100.0 - _EXTREME, _EXTREME)))
        claimed = path.covariance[1:-1, channel, channel][rows]
        column = np.zeros((len(white), 3))
        column[:, int(channel == _YAW)], column[:, 2] = claimed, rate[rows, channel] ** 2
        spread = max(float(np.std(white)), 1e-12)
        columns.append(column / spread)
        targets.append(white / spread)
    if not columns:
        return WhiteNoise(1.0, 1.0, 0.0)
    design, target = np.concatenate(columns), np.concatenate(targets)
    moving = bool(np.sqrt(np.mean(rate[:, 2] ** 2)) > _TURNS_RADPS or np.sqrt(np.mean(rate[:, 0] ** 2)) > _MOVES_MPS)
    design[:, 2] *= moving
    scale = np.sqrt(np.mean(design**2, axis=0))
    scale[scale == 0.0] = 1.0
    scaled = design / scale
    inverse = np.linalg.pinv(scaled.T @ scaled)
    solution = inverse @ (scaled.T @ target)
    error = np.sqrt(np.diag(inverse)) * float(np.std(target - scaled @ solution))
    jitter = float(np.sqrt(solution[2] / scale[2])) if solution[2] > 2.0 * error[2] else 0.0
    position, heading = np.clip(solution[:2] / scale[:2], (_SMALLEST, 1.0), _LARGEST).tolist()
    return WhiteNoise(position, heading, jitter if jitter > 1e-3 else 0.0)


def with_noise(path: LaserPath, motion: Motion, noise: WhiteNoise) -> LaserPath:
    """Return the path with covariances scaled to the estimated noise, plus the pose errors due to stamp jitter."""
    covariance = _scaled(path.covariance, np.sqrt([noise.position, noise.position, noise.heading]))
    if noise.stamps_s > 0.0:
        rate = _rate(path, motion)
        covariance = covariance + noise.stamps_s**2 * rate[:, :, None] * rate[:, None, :]
    return replace(path, covariance=covariance)


def with_view_errors(path: LaserPath, motion: Motion) -> LaserPath:
    """Return the path with covariances that include match errors due to the view: corners, furniture, the map.

    These errors change along the path and stay constant while the robot stands. They are left out there: counted fully,
    sweeps at rest would make the noise seem smaller than it is in motion.
    """
    robot = [motion.robot(path.t_s + side) for side in (-_AROUND_S, _AROUND_S)]
    moved = between(robot[0], robot[1])
    gone_m = np.hypot(moved[:, 0], moved[:, 1]) + _TURN_M * np.abs(wrap(moved[:, 2]))
    share = np.clip(gone_m / _NEW_VIEW_M, 0.0, 1.0)
    more = np.diag([_VIEW_M, _VIEW_M, _VIEW_RAD]) ** 2 * share[:, None, None] ** 2
    return replace(path, covariance=path.covariance + more + np.diag([_LEAST_M, _LEAST_M, _LEAST_RAD]) ** 2)


def _scaled(covariance: Array, deviation: Array) -> Array:
    """Return covariances (k, 3, 3) with deviations multiplied by (3,) or (k, 3); undetermined axes are unchanged."""
    values, vectors = np.linalg.eigh(covariance[:, :2, :2])
    unseen = np.zeros_like(covariance)
    blind = np.where(values > 0.25 * UNKNOWN_M**2, values, 0.0)
    unseen[:, :2, :2] = (vectors * blind[:, None, :]) @ np.swapaxes(vectors, 1, 2)
    both = deviation[..., :, None] * deviation[..., None, :]
    return (covariance - unseen) * both + unseen


def without_spikes(path: LaserPath, motion: Motion) -> LaserPath:
    """Return the path without poses far from the median of the poses predicted from their neighbours by odometry.

    The median keeps steps, which are errors of the odometry, and detects runs of wrong matches (Hampel 1974, Journal of
    the American Statistical Association 69).
    """
    if len(path) < _FEW:
        return path
    robot, rows = motion.robot(path.t_s), np.arange(len(path))
    miss = np.full((2 * _NEIGHBOURS + 1, len(path), 3), np.nan)
    for said, shift in zip(miss, range(-_NEIGHBOURS, _NEIGHBOURS + 1), strict=True):
        other = np.clip(rows + shift, 0, len(path) - 1)
        near = (np.abs(path.t_s[other] - path.t_s) < _NEAR_S) | (abs(shift) <= 1)
        k = np.flatnonzero((other == rows + shift) & (path.part[other] == path.part) & near)
        said[k] = between(compose(path.xyt[other[k]], between(robot[other[k]], robot[k])), path.xyt[k])
    miss[:, :, 2] = wrap(miss[:, :, 2])
    aside = np.abs(np.nanmedian(miss, axis=0))
    step = np.abs(miss[_NEIGHBOURS + 1])
    usual = 1.4826 * np.nanmedian(step[~path.weak] if (~path.weak[:-1]).any() else step, axis=0)
    out = aside > _SPIKE * np.maximum(usual, _USUAL)
    out[path.weak, :2] = False
    return path.only(~out.any(axis=1))


def _rate(path: LaserPath, motion: Motion) -> Array:
    """Return the robot's twist (k, 3) in its body axes at the sweeps, m/s and rad/s."""
    half = 0.05
    return between(motion.robot(path.t_s - half), motion.robot(path.t_s + half)) / (2.0 * half)
