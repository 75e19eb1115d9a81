"""End pose of a drive relative to its start, from matching the last sweeps with the first, without a map."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from odomcorrupt.errors import RecordingError
from odomcorrupt.geometry.se2 import between, compose, inverse, wrap
from odomcorrupt.laser.calibrate import calibrate
from odomcorrupt.laser.icp import COARSE, SURE_OVERLAP, WEAK, best_guess, lines_of, match, surface_of, thinned

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.geometry.trajectory import Trajectory
    from odomcorrupt.laser.scans import Sweeps
    from odomcorrupt.laser.trajectory import LaserRun

_SWEEPS = 5
_REACH_M, _STEP_M = 0.6, 0.2
_MOST = 360
_NEAR_M, _NEAR_RAD = 0.02, 0.02
"""Largest distance (m) and angle (rad) of a match from the median of the drive's matches; others are wrong."""


class End(NamedTuple):
    """The robot's last pose relative to its first (3,), m and rad, and the median overlap of the matched sweeps."""

    pose: Array
    overlap: float


def end_by_scans(sweeps: Sweeps, odometry: Trajectory) -> End:
    """Return the odometry's last pose relative to its first, measured by the drive's first and last sweeps.

    Each of the last five sweeps is matched with the first one, from all headings and within 0.6 m of the start; the
    result is the median.

    Raises
    ------
    RecordingError
        If the last sweeps do not match the first: the drive did not end near its start.
    """
    calibration = calibrate(sweeps, odometry, int(odometry.stamps_ns[0]))
    sweeps, motion, scans = calibration.sweeps, calibration.motion, calibration.deskewing()
    t_s = sweeps.middle_s(motion.origin_ns)
    full = np.array([k for k in range(len(sweeps)) if len(sweeps.sweeps[k]) >= COARSE])
    if len(full) < 2 * _SWEEPS:
        raise RecordingError(
            f"{sweeps.place}: {len(full)} sweeps with {COARSE} returns; too few to estimate the end pose"
        )
    first = int(full[0])
    surface = surface_of(*lines_of(scans[first]))
    if len(surface.points) < COARSE:
        raise RecordingError(f"{sweeps.place}: its first sweep contains no walls; begin the drive near walls")
    found, overlaps = [], []
    for last in full[-_SWEEPS:].tolist():
        scan = scans[last]
        guess = best_guess(thinned(scan, COARSE), surface, _everywhere(), within_m=2.0 * _STEP_M)
        matched = match(thinned(scan, _MOST), surface, guess)
        if matched is None or matched.overlap < SURE_OVERLAP or matched.ratio < WEAK:
            continue
        laser = compose(compose(motion.mount, matched.pose), inverse(motion.mount))
        # from the sweeps to the odometry's first and last pose, by the odometry's motion between them
        own = odometry.xyt[[0, -1]]
        robot = motion.robot(t_s[[first, last]])
        found.append(compose(compose(between(own[0], robot[0]), laser), between(robot[1], own[1])))
        overlaps.append(matched.overlap)
    poses = np.array(found).reshape(-1, 3)
    if len(poses):
        agree = _near(poses - np.median(poses, axis=0))
        if np.count_nonzero(agree) > _SWEEPS // 2:
            return End(np.median(poses[agree], axis=0), float(np.median(overlaps)))
    raise RecordingError(
        f"{sweeps.place}: {len(poses)} of the last {_SWEEPS} sweeps fit the first: the drive does not end within "
        f"{_REACH_M:g} m of where it began; measure the end and give it with --end X,Y,YAW"
    )


class Lift(NamedTuple):
    """Motion of a robot (3,) that is not in its odometry, m and rad, and whether walls show all of it.

    Where walls on one axis alone are seen, the part along them is taken from the odometry.
    """

    moved: Array
    whole: bool


def lifted(run: LaserRun, before: int, after: int) -> Lift | None:
    """Return the robot's motion between two sweeps that is not in the odometry; None if they do not match.

    The later sweep is matched with the earlier one, within 0.6 m and 90 deg of where the odometry has it. The sweeps
    next to them have to give the same.

    before, after : indices of the sweeps
    """
    motion, scans, t_s = run.calibration.motion, run.calibration.deskewing(), run.tracked.t_s
    guesses = _everywhere()
    guesses = guesses[np.abs(guesses[:, 2]) < 0.5 * np.pi]
    found, whole = [], True
    for first, last in ((before, after), (before - 1, after), (before, after + 1)):
        if first < 0 or last >= len(t_s):
            return None
        scan, surface = scans[last], surface_of(*lines_of(scans[first]))
        if len(scan) < COARSE or len(surface.points) < COARSE:
            return None
        laser, robot = (at(t_s[[first, last]]) for at in (motion.laser, motion.robot))
        own = between(laser[0], laser[1])
        guess = best_guess(thinned(scan, COARSE), surface, own + guesses, within_m=2.0 * _STEP_M)
        matched = match(thinned(scan, _MOST), surface, guess)
        if matched is None or matched.overlap < SURE_OVERLAP:
            return None
        pose = matched.pose.copy()
        if matched.ratio < WEAK:
            whole = False
            pose[:2] -= matched.weak_axis * (matched.weak_axis @ (pose - own)[:2])
        seen = compose(compose(motion.mount, pose), inverse(motion.mount))
        apart = between(between(robot[0], robot[1]), seen)
        # in the axes of the robot at sweep `after`
        on = between(motion.robot(t_s[[after]])[0], robot[1])
        found.append(compose(compose(on, apart), inverse(on)))
    if not _near(np.array(found) - found[0]).all():
        return None
    return Lift(np.array([*found[0][:2], float(wrap(found[0][2:])[0])]), whole)


def _near(away: Array) -> NDArray[np.bool_]:
    """Return a mask (n,) of the matches that hardly differ, from the differences (n, 3) of poses."""
    return (np.hypot(away[:, 0], away[:, 1]) < _NEAR_M) & (np.abs(wrap(away[:, 2])) < _NEAR_RAD)


def _everywhere() -> Array:
    """Return guesses (g, 3) on a grid of positions near the start and of all headings."""
    steps = np.arange(-_REACH_M, _REACH_M + 0.5 * _STEP_M, _STEP_M)
    turns = np.arange(-np.pi, np.pi, np.radians(5.0))
    return np.stack(np.meshgrid(steps, steps, turns, indexing="ij"), axis=-1).reshape(-1, 3)
