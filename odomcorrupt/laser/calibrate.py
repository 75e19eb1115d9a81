"""How a laser's clock and mounting relate to the odometry: from the motion between sweeps, with nothing known before.

Pairs of sweeps that lie a little way apart are matched; their turns against the odometry's give the lag between the two
clocks, and whether the laser hangs upside down; then their displacements give the mounting (hand-eye calibration in the
plane, linear in the position and in cosine and sine of the yaw).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from odomcorrupt.errors import RecordingError
from odomcorrupt.geometry.se2 import between, wrap
from odomcorrupt.laser.deskewing import Deskewing, Motion
from odomcorrupt.laser.icp import best_guess, match, surface_of
from odomcorrupt.laser.surface import lines_of

if TYPE_CHECKING:
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.laser.sweep import Sweeps
    from odomcorrupt.study.io.recording import Trajectory

__all__ = ["Calibration", "calibrate", "hand_eye"]

_PAIRS = 240
_APART_M, _APART_RAD = 0.25, 0.15
_LAG_S, _LAG_STEP_S = 0.6, 0.01
_OVERLAP = 0.6
_LEAST_PAIRS = 8
_TURNS_RAD = 0.5
_PLAIN_RATIO = 0.05
_DIFFERS_RAD = np.radians(15.0)
_FEWER = 0.8
_BETTER = 0.93
"""Times that sweeps do not say are taken where they make the deviation of matched pairs this share of it or less, and
even stamps where they make that of the odometry so."""


@dataclass(frozen=True, slots=True)
class Calibration:
    """What is known of a laser before its sweeps are put together.

    sweeps : with the times within them at which they fit each other best
    motion : the odometry seen by the laser
    mirrored : whether bearings run the other way round
    turn_s : time that a whole turn of the laser takes, where the sweeps do not say or have it the wrong way round;
        negative where it turns clockwise, 0 where the sweeps' own times are right
    said : what was found, in words
    """

    sweeps: Sweeps
    motion: Motion
    mirrored: bool
    said: tuple[str, ...]
    turn_s: float = 0.0

    def deskewing(self) -> Deskewing:
        """Return the sweeps put right for the motion within them."""
        return Deskewing(self.sweeps, self.motion, mirrored=self.mirrored, turn_s=self.turn_s)


@dataclass(frozen=True, slots=True)
class _Pairs:
    """Matched pairs of sweeps: times (n,), the second seen from the first (n, 3), and how well they match.

    deviation_m : (n,) of the returns from the surfaces
    ratio : (n,) smaller over larger eigenvalue of the information of the position
    """

    first_s: Array
    second_s: Array
    pose: Array
    deviation_m: Array
    ratio: Array


def calibrate(sweeps: Sweeps, odometry: Trajectory, origin_ns: int) -> Calibration:
    """Find lag, sense of rotation and mounting of a laser.

    Raises
    ------
    RecordingError
        Where sweeps cannot be matched with each other.

    """
    mount = np.zeros(3)
    stated, stated_s = sweeps, _stated_turn_s(sweeps)
    sweeps = sweeps.at_once() if sweeps.by_scan_time else sweeps
    by_tf = sweeps.mount
    flipped = by_tf is not None and float(np.linalg.det(by_tf.plane)) < 0.0
    if by_tf is not None:
        mount = np.array([*by_tf.position_xy, np.arctan2(by_tf.plane[1, 0], by_tf.plane[0, 0])])
    known = mount if by_tf is not None else None
    motion = Motion(odometry, origin_ns, 0.0, mount)
    pairs, mirrored = _sense(sweeps, motion, flipped=flipped, sure=by_tf is not None)
    said = []
    if mirrored and not flipped:
        said.append(f"{sweeps.topic}: turns against the odometry: it hangs upside down; mirrored")
    found = None
    for _ in range(2):
        motion, found = _refined(pairs, motion, by_tf=known)
        pairs = _matched(sweeps, motion, mirrored=mirrored)
    best_s = turn_s = _turning_time(sweeps, motion, pairs, stated_s, mirrored=mirrored)
    if best_s:
        why = "times within a sweep run the wrong way" if stated_s else "no times within a sweep"
        if sweeps.by_scan_time:
            why = "time_increment is 0, scan_time is not"
            later_s = float(np.median(stated.middle_s(origin_ns) - sweeps.middle_s(origin_ns)))
            sweeps, motion = stated, replace(motion, lag_s=motion.lag_s - later_s)
            turn_s = 0.0 if best_s == stated_s else best_s
        pairs = _matched(sweeps, motion, mirrored=mirrored, turn_s=turn_s)
        motion, found = _refined(pairs, motion, by_tf=known)
        said.append(
            f"{sweeps.topic}: {why}; sweeps fit each other best if a turn takes {abs(best_s):.2f} s "
            f"({'counter-clockwise' if best_s > 0.0 else 'clockwise'})"
        )
    elif sweeps.by_scan_time:
        said.append(
            f"{sweeps.topic}: time_increment is 0, and sweeps fit each other no better spread over scan_time "
            f"({abs(stated_s):.2f} s): all beams of a sweep count as taken at once"
        )
    evenly = _taken_evenly(pairs, Calibration(sweeps, motion, mirrored, (), turn_s), by_tf=known)
    if evenly is not None:
        sweeps, motion, found, why = evenly
        said.append(why)
    said += _said_of_mounting(sweeps.topic, found, motion, by_tf=known)
    return Calibration(sweeps, motion, mirrored, tuple(said), turn_s)


def _sense(sweeps: Sweeps, motion: Motion, *, flipped: bool, sure: bool) -> tuple[_Pairs, bool]:
    """Return matched pairs, and whether the laser has to be mirrored for them to turn as the odometry does."""
    best: tuple[float, _Pairs, bool] | None = None
    for mirrored in (flipped, not flipped):
        pairs = _matched(sweeps, motion, mirrored=mirrored, free=not sure)
        if len(pairs.pose) < _LEAST_PAIRS:
            continue
        lagged = Motion(motion.odometry, motion.origin_ns, _lag(pairs, motion), motion.mount)
        turned = _turned(pairs, lagged)
        rms = float(np.median(np.abs(wrap(pairs.pose[:, 2] - turned)))) + 1e-3
        if best is None or rms < 0.5 * best[0]:
            best = (rms, pairs, mirrored)
        if sure and rms < 0.3 * (float(np.median(np.abs(turned))) + 0.05):
            break
    if best is None:
        raise RecordingError(
            f"{sweeps.place}: its sweeps do not fit each other (too few returns, too little in view, or too far apart "
            f"at one in {sweeps.period_s:.2f} s); name another topic with --scan"
        )
    return best[1], best[2]


def _refined(pairs: _Pairs, motion: Motion, *, by_tf: Array | None) -> tuple[Motion, Array | None]:
    """Return the motion with lag and mounting by matched pairs, and the mounting (3,) that these show, if any.

    by_tf : (3,) the mounting by TF, which is kept where the pairs do not plainly contradict it
    """
    motion = Motion(motion.odometry, motion.origin_ns, _lag(pairs, motion), motion.mount)
    found = _mounting(pairs, motion)
    if found is not None and (by_tf is None or abs(wrap(np.asarray(found[2] - by_tf[2]))) > _DIFFERS_RAD):
        motion = Motion(motion.odometry, motion.origin_ns, motion.lag_s, found)
    return motion, found


class _Evenly(NamedTuple):
    """Sweeps on even stamps, the motion and the mounting (3,) that go with them, and what is said of it."""

    sweeps: Sweeps
    motion: Motion
    mount: Array | None
    said: str


def _taken_evenly(pairs: _Pairs, plain: Calibration, *, by_tf: Array | None) -> _Evenly | None:
    """Return what is known of a laser that is stamped on arrival and turns evenly; None where its stamps are as good.

    The odometry between matched pairs says which: it follows the stamps, or it does not.
    """
    even = plain.sweeps.evened()
    if even is None:
        return None
    matched = _matched(even, plain.motion, mirrored=plain.mirrored, turn_s=plain.turn_s)
    motion, mount = _refined(matched, plain.motion, by_tf=by_tf)
    if not _astray(matched, motion) < _BETTER * _astray(pairs, plain.motion):
        return None
    off_ms = float(np.std(plain.sweeps.stamps_ns - even.stamps_ns)) * 1e-6
    said = f"{even.topic}: stamped on arrival, off by about {off_ms:.0f} ms each; the odometry fits even stamps better"
    return _Evenly(even, motion, mount, said)


def _said_of_mounting(topic: str, found: Array | None, motion: Motion, *, by_tf: Array | None) -> list[str]:
    """Return what should be known of where the laser sits; by_tf and found (3,) by TF, None where it does not say."""
    if by_tf is None:
        where = ", ".join(f"{v:.2f} m" for v in motion.mount[:2])
        return [f"{topic}: found to sit at {where}, {np.degrees(motion.mount[2]):.1f} deg on the robot"]
    yaw = 0.0 if found is None else float(wrap(np.asarray(found[2] - by_tf[2])))
    if abs(yaw) <= _DIFFERS_RAD:
        return []
    return [f"{topic}: turned by {np.degrees(yaw):.0f} deg against what TF says; mounting taken from the motion"]


def _stated_turn_s(sweeps: Sweeps) -> float:
    """Return the time of a whole turn by the sweeps' own times, negative where clockwise; 0 where they have none."""
    turns = []
    for sweep in sweeps.sweeps[:: max(1, len(sweeps) // 50)]:
        if len(sweep) > 1:
            bearing = np.unwrap(np.arctan2(sweep.xy[:, 1], sweep.xy[:, 0]))
            swept = float(bearing[-1] - bearing[0])
            turns.append(2.0 * np.pi * float(sweep.after_s[-1] - sweep.after_s[0]) / swept if abs(swept) > 0.1 else 0.0)
    return float(np.median(turns)) if turns else 0.0


def _turning_time(sweeps: Sweeps, motion: Motion, plain: _Pairs, stated_s: float, *, mirrored: bool) -> float:
    """Return the time of a whole turn at which sweeps fit each other best; 0 where their own times do as well.

    Sweeps without times may have been taken either way round; those with times the other way round: drivers of lasers
    that turn clockwise reverse the order of the ranges, and keep the sign of the time between them. Sweeps that have
    a scan_time alone may have been taken at once, which stands where neither way round fits better.
    """
    if not len(plain.pose):
        return 0.0
    period = stated_s if sweeps.by_scan_time else min(sweeps.period_s, 0.2)
    best = known = _misfit(plain)
    turn_s = 0.0
    for candidate in (-stated_s,) if stated_s and not sweeps.by_scan_time else (period, -period):
        # what a scan_time says needs no more evidence than that all beams are taken at once
        share = 1.0 if candidate == stated_s else _BETTER
        pairs = _matched(sweeps, motion, mirrored=mirrored, turn_s=candidate)
        if len(pairs.pose) >= _FEWER * len(plain.pose) and _misfit(pairs) < min(best, share * known):
            best, turn_s = _misfit(pairs), candidate
    return turn_s


def _astray(pairs: _Pairs, motion: Motion) -> float:
    """Return how far the odometry's motion between the sweeps of a pair usually is from that of the match, m."""
    if not len(pairs.pose):
        return np.inf
    miss = between(between(motion.laser(pairs.first_s), motion.laser(pairs.second_s)), pairs.pose)
    return float(np.median(np.hypot(miss[:, 0], miss[:, 1]) + _APART_M / _APART_RAD * np.abs(wrap(miss[:, 2]))))


def _misfit(pairs: _Pairs) -> float:
    """Return the mean deviation of returns from surfaces, over pairs."""
    return float(np.mean(pairs.deviation_m))


def _matched(sweeps: Sweeps, motion: Motion, *, mirrored: bool, free: bool = False, turn_s: float = 0.0) -> _Pairs:
    """Match pairs of sweeps a little way apart, spread over the drive.

    free : where the mounting is unknown, displacements in all directions are tried
    """
    t_s = sweeps.middle_s(motion.origin_ns)
    poses = motion.laser(t_s)
    chosen = _spread(t_s, poses)
    rows = np.array(chosen, dtype=np.int64).ravel()
    scans = Deskewing(sweeps, motion, mirrored=mirrored, turn_s=turn_s, rows=rows)
    first, second, found, deviation, ratio = [], [], [], [], []
    for a, b in chosen:
        one, other = scans[a], scans[b]
        lines = lines_of(one)
        if len(lines.feet) < 20 or len(other) < 20:
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
            guess = best_guess(other[:: max(1, len(other) // 90)], surface, np.stack(ways))
        fit = match(other[:: max(1, len(other) // 240)], surface, guess)
        if fit is not None and fit.overlap > _OVERLAP:
            first.append(t_s[a])
            second.append(t_s[b])
            found.append(fit.pose)
            deviation.append(fit.deviation_m)
            ratio.append(fit.ratio)
    return _Pairs(
        np.array(first), np.array(second), np.array(found).reshape(-1, 3), np.array(deviation), np.array(ratio)
    )


def _spread(t_s: Array, poses: Array) -> list[tuple[int, int]]:
    """Return pairs of sweeps between which the odometry moves a little, those that turn most before others."""
    turned = np.concatenate(([0.0], np.cumsum(np.abs(np.diff(poses[:, 2])))))
    gone = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(poses[:, :2], axis=0), axis=1))))
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
    """Return by how much the odometry turned between the sweeps of each pair (n,), rad."""
    turned: Array = motion.robot(pairs.second_s)[:, 2] - motion.robot(pairs.first_s)[:, 2]
    return turned


def _lag(pairs: _Pairs, motion: Motion) -> float:
    """Return the lag at which the odometry turns as the sweeps do, seconds; 0 where nothing turns."""
    measured = pairs.pose[:, 2]
    if len(measured) < _LEAST_PAIRS or np.abs(measured).sum() < _TURNS_RAD:
        return 0.0
    lags = np.arange(-_LAG_S, _LAG_S + _LAG_STEP_S / 2.0, _LAG_STEP_S)
    cost = []
    for lag in lags:
        turned = _turned(pairs, Motion(motion.odometry, motion.origin_ns, float(lag), motion.mount))
        scale = float(np.clip(measured @ turned / max(float(turned @ turned), 1e-9), 0.5, 2.0))
        miss = np.abs(wrap(measured - scale * turned))
        cost.append(float(np.minimum(miss, 0.1).sum()))
    best = int(np.argmin(cost))
    if not 0 < best < len(lags) - 1:
        return 0.0
    near = np.polyfit(lags[max(best - 4, 0) : best + 5], cost[max(best - 4, 0) : best + 5], 2)
    if near[0] <= 0.0:
        return float(lags[best])
    return float(np.clip(-near[1] / (2.0 * near[0]), lags[best] - 0.04, lags[best] + 0.04))


def _mounting(pairs: _Pairs, motion: Motion) -> Array | None:
    """Return the laser's pose (3,) on the robot; None where the drive does not show it."""
    plain = pairs.ratio > _PLAIN_RATIO
    if plain.sum() < _LEAST_PAIRS:
        return None
    own = between(motion.robot(pairs.first_s[plain]), motion.robot(pairs.second_s[plain]))
    return hand_eye(own, pairs.pose[plain])


def hand_eye(own: Array, seen: Array) -> Array | None:
    """Return the pose (3,) on the robot of a sensor whose motions are known beside the robot's; None where none fits.

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
