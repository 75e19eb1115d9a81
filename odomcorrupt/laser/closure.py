"""Where a drive ended, seen from where it began: its last sweeps matched with its first ones, without any map."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from odomcorrupt.errors import RecordingError
from odomcorrupt.geometry.se2 import between, compose, inverse, wrap
from odomcorrupt.laser.calibrate import calibrate
from odomcorrupt.laser.icp import WEAK, best_guess, match, surface_of
from odomcorrupt.laser.surface import lines_of

if TYPE_CHECKING:
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.laser.sweep import Sweeps
    from odomcorrupt.study.io.recording import Trajectory

__all__ = ["End", "end_by_scans"]

_SWEEPS = 5
_OVERLAP = 0.6
_REACH_M, _STEP_M = 0.6, 0.2
_STEP_RAD = np.radians(5.0)
_COARSE, _MOST = 60, 360
_NEAR_M, _NEAR_RAD = 0.02, 0.02
"""Matches of the same drive agree within this, or one of them is wrong."""


class End(NamedTuple):
    """The robot's last pose seen from its first (3,), m and rad, and how well the sweeps overlap there."""

    pose: Array
    overlap: float


def end_by_scans(sweeps: Sweeps, odometry: Trajectory) -> End:
    """Return where a drive ended by its first and last sweeps, carried to the odometry's own first and last pose.

    Each of the last five sweeps is matched with the first one, from all headings and within 0.6 m of where the drive
    began; the median counts.

    Raises
    ------
    RecordingError
        Where the last sweeps do not fit the first: the drive did not end where it began.

    """
    calibration = calibrate(sweeps, odometry, int(odometry.stamps_ns[0]))
    sweeps, motion, scans = calibration.sweeps, calibration.motion, calibration.deskewing()
    t_s = sweeps.middle_s(motion.origin_ns)
    full = np.array([k for k in range(len(sweeps)) if len(sweeps.sweeps[k]) >= _COARSE])
    if len(full) < 2 * _SWEEPS:
        raise RecordingError(f"{sweeps.place}: {len(full)} sweeps with {_COARSE} returns; too few to find the end by")
    first = int(full[0])
    surface = surface_of(*lines_of(scans[first]))
    if len(surface.points) < _COARSE:
        raise RecordingError(f"{sweeps.place}: its first sweep sees no walls; begin the drive beside some")
    found, overlaps = [], []
    for last in full[-_SWEEPS:].tolist():
        scan = scans[last]
        coarse = scan[:: max(1, len(scan) // _COARSE)]
        guess = best_guess(coarse, surface, _everywhere(), within_m=2.0 * _STEP_M)
        matched = match(scan[:: max(1, len(scan) // _MOST)], surface, guess)
        if matched is None or matched.overlap < _OVERLAP or matched.ratio < WEAK:
            continue
        laser = compose(compose(motion.mount, matched.pose), inverse(motion.mount))
        # from the sweeps to the drive's own ends, by what the odometry moved in between
        own = odometry.xyt[[0, -1]]
        robot = motion.robot(t_s[[first, last]])
        found.append(compose(compose(between(own[0], robot[0]), laser), between(robot[1], own[1])))
        overlaps.append(matched.overlap)
    poses = np.array(found).reshape(-1, 3)
    if len(poses):
        middle = np.median(poses, axis=0)
        away = poses - middle
        agree = (np.hypot(away[:, 0], away[:, 1]) < _NEAR_M) & (np.abs(wrap(away[:, 2])) < _NEAR_RAD)
        if np.count_nonzero(agree) > _SWEEPS // 2:
            return End(np.median(poses[agree], axis=0), float(np.median(overlaps)))
    raise RecordingError(
        f"{sweeps.place}: {len(poses)} of the last {_SWEEPS} sweeps fit the first: the drive does not end within "
        f"{_REACH_M:g} m of where it began; measure the end and give it with --end X,Y,YAW"
    )


def _everywhere() -> Array:
    """Return the guesses (g, 3): all headings, near the start."""
    steps = np.arange(-_REACH_M, _REACH_M + 0.5 * _STEP_M, _STEP_M)
    turns = np.arange(-np.pi, np.pi, _STEP_RAD)
    grid: Array = np.stack(np.meshgrid(steps, steps, turns, indexing="ij"), axis=-1).reshape(-1, 3)
    return grid
