"""Calibration of a laser's clock lag and mounting against the odometry, from the motion between sweeps.

Pairs of sweeps a short way apart are matched. Comparing their turns with the odometry's gives the lag between the two
clocks, and whether the laser is mounted upside down. Their displacements then give the mounting (planar hand-eye
calibration, linear in the position and in cosine and sine of the yaw). No initial values are needed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.errors import RecordingError
from odomcorrupt.geometry.se2 import between, wrap
from odomcorrupt.geometry.trajectory import distance_along
from odomcorrupt.laser.icp import LEAST_RETURNS, SURE_OVERLAP, best_guess, lines_of, match, surface_of, thinned
from odomcorrupt.laser.scans import Deskewing, Motion

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.geometry.trajectory import Trajectory
    from odomcorrupt.laser.scans import Sweeps

_PAIRS = 240
_APART_M, _APART_RAD = 0.25, 0.15
_LAG_S, _LAG_STEP_S = 0.6, 0.01
_LEAST_PAIRS = 8
_TURNS_RAD, _TURN_RATIOS = 0.5, (0.5, 2.0)
_DIFFERS_RAD = np.radians(15.0)
_BETTER = 0.93
"""Ratio of misfits below which a correction is accepted: of matched pairs for estimated times within sweeps, and of the
odometry between pairs for evenly spaced stamps."""


@dataclass(frozen=True, slots=True)
class Calibration:
    """Calibration of a laser's times, mounting and orientation.

    sweeps : the sweeps, with the times within them that match best
    motion : the odometry on the laser's clock, with the laser's mounting
    mirrored : whether bearings are in the opposite sense
    turn_s : duration of a full turn of the laser, s, if the sweeps' own times are missing or reversed; negative if the
        laser turns clockwise, 0 if the sweeps' own times are right
    said : messages about the findings
    against_tf_rad : yaw of the mounting minus that of TF, if it is far from TF's and replaces it; otherwise 0
    """

    sweeps: Sweeps
    motion: Motion
    mirrored: bool
    said: tuple[str, ...]
    turn_s: float = 0.0
    against_tf_rad: float = 0.0

    def deskewing(self, rows: NDArray[np.int64] | None = None) -> Deskewing:
        """Return the sweeps of these rows (default all) corrected for the motion within them."""
        return Deskewing(self.sweeps, self.motion, mirrored=self.mirrored, turn_s=self.turn_s, rows=rows)

    def noted(self, message: str) -> Calibration:
        """Return the calibration with one more message, on the topic of the sweeps."""
        return replace(self, said=(*self.said, f"{self.sweeps.topic}: {message}"))


@dataclass(frozen=True, slots=True)
class _Pairs:
    """Matched pairs of sweeps.

    first_s, second_s : (n,) times of the sweeps, seconds
    pose : (n, 3) pose of the second in the frame of the first
    deviation_m : (n,) deviation of the returns from the surfaces
    ratio : (n,) smaller over larger eigenvalue of the information of the position
    """

    first_s: Array
    second_s: Array
    pose: Array
    deviation_m: Array
    ratio: Array


def calibrate(sweeps: Sweeps, odometry: Trajectory, origin_ns: int) -> Calibration:
    """Return the lag, sense of rotation, mounting and times within sweeps of a laser.

    Raises
    ------
    RecordingError
        If the sweeps cannot be matched with each other.
    """
    stated, stated_s = sweeps, _stated_turn_s(sweeps)
    sweeps = sweeps.at_once() if sweeps.by_scan_time else sweeps
    by_tf, known = sweeps.mount, None
    if by_tf is not None:
        known = np.array([*by_tf.position_xy, np.arctan2(by_tf.plane[1, 0], by_tf.plane[0, 0])])
    flipped = by_tf is not None and float(np.linalg.det(by_tf.plane)) < 0.0
    motion = Motion(odometry, origin_ns, 0.0, np.zeros(3) if known is None else known)
    now, pairs = _sense(Calibration(sweeps, motion, flipped, ()), certain=known is not None)
    if now.mirrored and not flipped:
        now = now.noted("turns opposite to the odometry: it is mounted upside down; mirrored")
    found = None
    for _ in range(2):
        now, found = _refined(pairs, now, by_tf=known)
        pairs = _matched(now)
    turn_s = _turning_time(now, pairs, stated_s)
    if turn_s:
        why = "times within a sweep run the wrong way" if stated_s else "no times within a sweep"
        now = replace(now, turn_s=turn_s)
        if sweeps.by_scan_time:
            why = "time_increment is 0, scan_time is not"
            later_s = float(np.median(stated.middle_s(origin_ns) - sweeps.middle_s(origin_ns)))
            motion = replace(now.motion, lag_s=now.motion.lag_s - later_s)
            now = replace(now, sweeps=stated, motion=motion, turn_s=0.0 if turn_s == stated_s else turn_s)
        pairs = _matched(now)
        now, found = _refined(pairs, now, by_tf=known)
        now = now.noted(
            f"{why}; sweeps fit each other best if a turn takes {abs(turn_s):.2f} s "
            f"({'counter-clockwise' if turn_s > 0.0 else 'clockwise'})"
        )
    elif sweeps.by_scan_time:
        now = now.noted(
            "time_increment is 0, and sweeps fit each other no better spread over scan_time "
            f"({abs(stated_s):.2f} s): all beams of a sweep are treated as simultaneous"
        )
    now, found = _taken_evenly(pairs, now, found, by_tf=known)
    if known is None:
        return now.noted(_estimated(now.motion.mount, shown=found is not None))
    yaw = 0.0 if found is None else float(wrap(np.asarray(found[2] - known[2])))
    return replace(now, against_tf_rad=yaw if abs(yaw) > _DIFFERS_RAD else 0.0)


def _estimated(mount: Array, *, shown: bool) -> str:
    """Return the message on the mounting (3,) of a laser without TF, and whether the drive shows it."""
    pose = f"{mount[0]:.2f} m, {mount[1]:.2f} m, {np.degrees(mount[2]):.1f} deg"
    return f"pose estimated as {pose} on the robot" if shown else f"this drive does not show its pose, taken as {pose}"


def _sense(plain: Calibration, *, certain: bool) -> tuple[Calibration, _Pairs]:
    """Return the calibration with bearings mirrored if sweeps then turn like the odometry, and matched pairs.

    certain : whether the mounting is known
    """
    best: tuple[float, Calibration, _Pairs] | None = None
    for mirrored in (plain.mirrored, not plain.mirrored):
        now = replace(plain, mirrored=mirrored)
        pairs = _matched(now, free=not certain)
        if len(pairs.pose) < _LEAST_PAIRS:
            continue
        turned = _turned(pairs, replace(now.motion, lag_s=_lag(pairs, now.motion)))
        rms = float(np.median(np.abs(wrap(pairs.pose[:, 2] - turned)))) + 1e-3
        if best is None or rms < 0.5 * best[0]:
            best = (rms, now, pairs)
        if certain and rms < 0.3 * (float(np.median(np.abs(turned))) + 0.05):
            break
    if best is None:
        sweeps = plain.sweeps
        raise RecordingError(
            f"{sweeps.place}: its sweeps do not fit each other (too few returns, too little in view, or too far apart "
            f"at one in {sweeps.period_s:.2f} s); name another topic with --scan"
        )
    return best[1:]


def _refined(pairs: _Pairs, now: Calibration, *, by_tf: Array | None) -> tuple[Calibration, Array | None]:
    """Return a calibration with lag, turn ratio and mounting from matched pairs, and the mounting (3,) or None.

    by_tf : (3,) the mounting from TF, kept unless its yaw differs from that of the pairs by more than 15 deg
    """
    motion = replace(now.motion, lag_s=_lag(pairs, now.motion))
    motion = replace(motion, turn_ratio=_turn_ratio(pairs, motion))
    found = _mounting(pairs, motion)
    if found is not None and (by_tf is None or abs(wrap(np.asarray(found[2] - by_tf[2]))) > _DIFFERS_RAD):
        motion = replace(motion, mount=found)
    return replace(now, motion=motion), found


def _taken_evenly(
    pairs: _Pairs, plain: Calibration, found: Array | None, *, by_tf: Array | None
) -> tuple[Calibration, Array | None]:
    """Return the calibration and the mounting found (3,), with evenly spaced stamps if the laser is stamped on arrival.

    The decision is by the misfit of the odometry's motion between matched pairs.
    """
    even = plain.sweeps.evened()
    if even is None:
        return plain, found
    now = replace(plain, sweeps=even)
    matched = _matched(now)
    now, mount = _refined(matched, now, by_tf=by_tf)
    if not _astray(matched, now.motion) < _BETTER * _astray(pairs, plain.motion):
        return plain, found
    off_ms = float(np.std(plain.sweeps.stamps_ns - even.stamps_ns)) * 1e-6
    return now.noted(
        f"stamped on arrival, off by about {off_ms:.0f} ms each; the odometry fits even stamps better"
    ), mount


def _stated_turn_s(sweeps: Sweeps) -> float:
    """Return the duration of a full turn from the sweeps' own times, s; negative if clockwise, 0 without times."""
    turns = []
    for sweep in sweeps.sweeps[:: max(1, len(sweeps) // 50)]:
        if len(sweep) > 1:
            bearing = np.unwrap(np.arctan2(sweep.xy[:, 1], sweep.xy[:, 0]))
            swept = float(bearing[-1] - bearing[0])
            turns.append(2.0 * np.pi * float(sweep.after_s[-1] - sweep.after_s[0]) / swept if abs(swept) > 0.1 else 0.0)
    return float(np.median(turns)) if turns else 0.0


def _turning_time(now: Calibration, plain: _Pairs, stated_s: float) -> float:
    """Return the duration of a full turn (s, negative if clockwise) with the best matches; 0 to keep the sweeps' times.

    Both senses of rotation are tested for sweeps without times. Only the opposite one is tested for sweeps with times,
    because drivers of lasers that turn clockwise may reverse the ranges but not the time increment. Sweeps with a
    scan_time alone count as simultaneous unless one sense matches better.
    """
    if not len(plain.pose):
        return 0.0
    sweeps = now.sweeps
    period = stated_s if sweeps.by_scan_time else min(sweeps.period_s, 0.2)
    best = known = float(np.mean(plain.deviation_m))
    turn_s = 0.0
    for candidate in (-stated_s,) if stated_s and not sweeps.by_scan_time else (period, -period):
        # a stated scan_time needs no more evidence than simultaneous beams do
        share = 1.0 if candidate == stated_s else _BETTER
        pairs = _matched(replace(now, turn_s=candidate))
        misfit = float(np.mean(pairs.deviation_m)) if len(pairs.pose) >= 0.8 * len(plain.pose) else np.inf
        if misfit < min(best, share * known):
            best, turn_s = misfit, candidate
    return turn_s


def _astray(pairs: _Pairs, motion: Motion) -> float:
    """Return the median difference of motion between odometry and matches, m; a radian counts as 1.7 m."""
    if not len(pairs.pose):
        return np.inf
    miss = between(between(motion.laser(pairs.first_s), motion.laser(pairs.second_s)), pairs.pose)
    return float(np.median(np.hypot(miss[:, 0], miss[:, 1]) + _APART_M / _APART_RAD * np.abs(wrap(miss[:, 2]))))


def _matched(now: Calibration, *, free: bool = False) -> _Pairs:
    """Return matched pairs of sweeps a short way apart, spread over the drive.

    free : whether the mounting is unknown; then displacements in all directions are tried
    """
    t_s = now.sweeps.middle_s(now.motion.origin_ns)
    poses = now.motion.laser(t_s)
    chosen = _spread(t_s, poses)
    scans = now.deskewing(np.array(chosen, dtype=np.int64).ravel())
    ends, fits = [], []
    for a, b in chosen:
        one, other = scans[a], scans[b]
        lines = lines_of(one)
        if len(lines.feet) < LEAST_RETURNS or len(other) < LEAST_RETURNS:
            continue
        surface = surface_of(*lines)
        guess = between(poses[a], poses[b])
        if free:
            reach = float(np.hypot(guess[0], guess[1]))
            ways = [
                np.array([reach * np.cos(w), reach * np.sin(w), sign * guess[2]])
                for w in np.arange(0.0, 2 * np.pi, np.pi / 4)
                for sign in (1.0, -1.0)
            ]
            guess = best_guess(thinned(other, 90), surface, np.stack(ways))
        fit = match(thinned(other, 240), surface, guess)
        if fit is not None and fit.overlap > SURE_OVERLAP:
            ends.append((a, b))
            fits.append(fit)
    first_s, second_s = t_s[np.array(ends, dtype=np.int64).reshape(-1, 2)].T
    poses = np.array([fit.pose for fit in fits]).reshape(-1, 3)
    deviations, ratios = np.array([(fit.deviation_m, fit.ratio) for fit in fits]).reshape(-1, 2).T
    return _Pairs(first_s, second_s, poses, deviations, ratios)


def _spread(t_s: Array, poses: Array) -> list[tuple[int, int]]:
    """Return index pairs of sweeps with a short motion in between: half with the most turning, half evenly spread."""
    turned = np.concatenate(([0.0], np.cumsum(np.abs(np.diff(poses[:, 2])))))
    gone = distance_along(poses)
    measure = turned / _APART_RAD + gone / _APART_M
    ahead = np.searchsorted(measure, measure + 1.0)
    start = np.flatnonzero(ahead < len(t_s))
    start = start[(t_s[ahead[start]] - t_s[start] < 3.0) & (ahead[start] > start)]
    if len(start) > _PAIRS:
        share = turned[ahead[start]] - turned[start]
        much = start[np.argsort(share)[::-1][: _PAIRS // 2]]
        even = start[np.linspace(0, len(start) - 1, _PAIRS // 2).round().astype(np.int64)]
        start = np.unique(np.concatenate((much, even)))
    return [(int(a), int(ahead[a])) for a in start]


def _turned(pairs: _Pairs, motion: Motion) -> Array:
    """Return the odometry's turn between the sweeps of each pair (n,), rad."""
    return motion.robot(pairs.second_s)[:, 2] - motion.robot(pairs.first_s)[:, 2]


def _lag(pairs: _Pairs, motion: Motion) -> float:
    """Return the lag at which turns of odometry and sweeps agree best, seconds; 0 if there is too little turning.

    Steady turning does not show the lag. So it is a maximum a posteriori estimate: misfits have a Laplace distribution,
    and lags are normal about zero.
    """
    measured = pairs.pose[:, 2]
    if len(measured) < _LEAST_PAIRS or np.abs(measured).sum() < _TURNS_RAD:
        return 0.0
    lags = np.arange(-_LAG_S, _LAG_S + _LAG_STEP_S / 2.0, _LAG_STEP_S)
    misfit = []
    for lag in lags:
        turned = _turned(pairs, replace(motion, lag_s=float(lag)))
        scale = float(np.clip(measured @ turned / max(float(turned @ turned), 1e-9), *_TURN_RATIOS))
        miss = np.abs(wrap(measured - scale * turned))
        misfit.append(float(np.minimum(miss, 0.1).sum()))
    # standard deviation of the lag before any turns are compared, s; scans of real robots are 0.08 to 0.19 s off
    cost = misfit + 0.5 * (lags / 0.2) ** 2 * min(misfit) / len(measured)
    best = int(np.argmin(cost))
    if not 0 < best < len(lags) - 1:
        return 0.0
    near = np.polyfit(lags[max(best - 4, 0) : best + 5], cost[max(best - 4, 0) : best + 5], 2)
    if near[0] <= 0.0:
        return float(lags[best])
    return float(np.clip(-near[1] / (2.0 * near[0]), lags[best] - 0.04, lags[best] + 0.04))


def _turn_ratio(pairs: _Pairs, motion: Motion) -> float:
    """Return the sweeps' turns divided by the odometry's, by robust regression; 1 if the robot hardly turns."""
    measured, turned = pairs.pose[:, 2], _turned(pairs, motion)
    ratio, weight = 1.0, np.ones(len(turned))
    if len(turned) < _LEAST_PAIRS or min(np.abs(measured).sum(), np.abs(turned).sum()) < _TURNS_RAD:
        return ratio
    for _ in range(8):
        ratio = float(np.clip((weight * turned) @ measured / ((weight * turned) @ turned), *_TURN_RATIOS))
        miss = np.abs(wrap(measured - ratio * turned))
        weight = 1.0 / (1.0 + (miss / (2.0 * max(float(np.median(miss)), 1e-4))) ** 2)
    return ratio


def _mounting(pairs: _Pairs, motion: Motion) -> Array | None:
    """Return the laser's pose (3,) on the robot; None if the drive does not determine it."""
    plain = pairs.ratio > 0.05
    if plain.sum() < _LEAST_PAIRS:
        return None
    own = between(motion.robot(pairs.first_s[plain]), motion.robot(pairs.second_s[plain]))
    return hand_eye(own, pairs.pose[plain])


def hand_eye(own: Array, seen: Array) -> Array | None:
    """Return the pose (3,) of a sensor on the robot from motions of both; None if the result is implausible.

    With O the robot's motion, L the sensor's and X the mounting, O X = X L: t_O + (R_O - I) t_X = k R_X t_L. The scale
    k between the two is free.

    own : (n, 3) motions of the robot by its odometry
    seen : (n, 3) motions of the sensor over the same times
    """
    n = len(own)
    rows = np.zeros((n, 2, 4))
    c, s = np.cos(seen[:, 2]) - 1.0, np.sin(seen[:, 2])
    rows[:, 0, 0], rows[:, 0, 1], rows[:, 1, 0], rows[:, 1, 1] = -c, s, -s, -c
    x, y = seen[:, 0], seen[:, 1]
    rows[:, 0, 2], rows[:, 0, 3], rows[:, 1, 2], rows[:, 1, 3] = x, -y, y, x
    weight = np.ones(n)
    solution = np.zeros(4)
    for _ in range(8):
        scaled = rows * weight[:, None, None]
        solution, *_ = np.linalg.lstsq(
            np.concatenate((scaled.reshape(-1, 4), 1e-2 * np.eye(4)[:2])),
            np.concatenate(((own[:, :2] * weight[:, None]).ravel(), np.zeros(2))),
            rcond=None,
        )
        miss = np.linalg.norm(rows @ solution - own[:, :2], axis=1)
        scale = max(float(np.median(miss)), 1e-3)
        weight = 1.0 / np.sqrt(1.0 + (miss / (2.0 * scale)) ** 2)
    length = float(np.hypot(solution[2], solution[3]))
    if not 0.5 < length < 2.0 or np.hypot(solution[0], solution[1]) > 3.0:
        return None
    return np.array([solution[0], solution[1], np.arctan2(solution[3], solution[2])])
