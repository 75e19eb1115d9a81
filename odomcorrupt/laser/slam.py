"""Keyframe SLAM: track sweeps against local surfaces, add keyframes, close loops and optimise the poses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.geometry.se2 import between, compose, wrap
from odomcorrupt.laser.icp import match, thinned
from odomcorrupt.laser.keyframes import Edge, KeyframeMap, edge_information

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.laser.calibrate import Calibration
    from odomcorrupt.laser.icp import Match
    from odomcorrupt.laser.sweep import Sweeps

_TRACK_QUERY = 180
_OVERLAP = 0.35
_SURE_OVERLAP = 0.6
_AWAY_M, _AWAY_RAD = 0.25, 0.2
_AWAY_SHARE = 0.2
_NEW_M, _LEAST_M, _NEW_OVERLAP = 0.5, 0.1, 0.6
_LOST = 3
_LEAST_RETURNS = 40
_FAST_MPS, _FAST_RADPS = 5.0, 6.0
_CLOSE_ROUNDS = 3
_GATES_M = (0.4, 0.25, 0.15)


@dataclass(frozen=True, slots=True)
class Tracked:
    """A map with the pose of each sweep in it.

    keyframe : (n,) index of the keyframe each sweep was matched with last, -1 if it was not matched
    relative : (n, 3) the sweep's pose in that keyframe's frame
    t_s : (n,) middles of the sweeps, seconds on the laser's clock since the origin
    """

    map: KeyframeMap
    keyframe: NDArray[np.int64]
    relative: Array
    t_s: Array


def make_map(sweeps: Sweeps, calibration: Calibration, progress: Callable[[float], None] | None = None) -> Tracked:
    """Return the finished map and each sweep's pose in it.

    progress : called every 50 sweeps with the fraction done
    """
    tracker = _Tracker(sweeps, calibration)
    for n in range(len(sweeps)):
        if progress is not None and n % 50 == 0:
            progress(n / len(sweeps))
        tracker.take(n)
    world = tracker.world
    for _ in range(_CLOSE_ROUNDS):
        world.settle()
        if not world.close():
            break
    world.settle()
    return Tracked(world, tracker.keyframe, tracker.relative, tracker.t_s)


class _Tracker:
    """Tracker that places one sweep after the other in the map, and adds a keyframe if none is near."""

    def __init__(self, sweeps: Sweeps, calibration: Calibration) -> None:
        self.world = KeyframeMap(sweeps.field_of_view_rad)
        self.t_s = sweeps.middle_s(calibration.motion.origin_ns)
        self.keyframe, self.relative = np.full(len(sweeps), -1), np.zeros((len(sweeps), 3))
        self._scans = calibration.deskewing()
        self._dead = calibration.motion.laser(self.t_s)
        self._current, self._inside = -1, np.zeros(3)
        self._last, self._lost = -1, 0
        self._before = np.zeros(3)

    def take(self, n: int) -> None:
        """Place sweep `n` in the map."""
        scan = self._scans[n]
        if self._current < 0:
            if len(scan) >= _LEAST_RETURNS:
                self._enter(n, self.world.add(scan, self._dead[n]))
            return
        step = self._step(n)
        guess = compose(self._inside, step)
        matched = self._matched(scan, guess, step)
        if matched is None:
            self._lost += 1
            if self._lost > _LOST and len(scan) >= _LEAST_RETURNS:
                self._begin(n, scan, guess)
            return
        self._lost = 0
        self._before = step / max(n - self._last, 1)
        self._last = n
        self._follow(n, scan, guess, matched)

    def _step(self, n: int) -> Array:
        """Return the odometry's motion since the last placed sweep; if the odometry jumped, the motion before that."""
        step = between(self._dead[self._last], self._dead[n])
        gap_s = max(float(self.t_s[n] - self.t_s[self._last]), 1e-3)
        jumped = np.hypot(step[0], step[1]) > _FAST_MPS * gap_s + 0.1 or abs(step[2]) > _FAST_RADPS * gap_s + 0.2
        return self._before if jumped else step

    def _matched(self, scan: Array, guess: Array, step: Array) -> Match | None:
        """Return the match of a sweep with the local map, searched more widely if previous sweeps were lost."""
        if not len(scan):
            return None
        world, query = self.world, thinned(scan, _TRACK_QUERY)
        found = match(query, world.local(self._current), guess, _GATES_M)
        if _fits(found, guess, step, _OVERLAP, 1.0):
            return found
        if not self._lost:
            return None
        found = match(query, world.local(self._current), world.around(self._current, scan, guess))
        return found if _fits(found, guess, step, _SURE_OVERLAP, 3.0) else None

    def _begin(self, n: int, scan: Array, guess: Array) -> None:
        """Begin a new part of the map after tracking is lost, and try to match it with existing keyframes."""
        new = self.world.add(scan, compose(self.world.poses[self._current], guess))
        self.world.connect(self.world.dead_reckoned(self._current, new, guess))
        if self.world.tie(new, set()):
            self.world.settle()
        self._lost = 0
        self._enter(n, new)

    def _follow(self, n: int, scan: Array, guess: Array, found: Match) -> None:
        """Record a sweep's pose and change to the nearest keyframe; if none is near, make the sweep a keyframe."""
        world, current = self.world, self._current
        self.keyframe[n], self.relative[n] = current, found.pose
        pose = compose(world.poses[current], found.pose)
        best = world.nearest_to(pose, world.reachable(current))[0]
        away_m = float(world.distances(pose, np.array([best]))[0])
        if away_m > _NEW_M or (found.overlap < _NEW_OVERLAP and away_m > _LEAST_M):
            new = world.add(scan, pose)
            world.connect(Edge(current, new, found.pose, edge_information(found), matched=True, loop=False))
            world.connect(world.dead_reckoned(current, new, guess))
            if world.tie(new, {current}):
                world.settle()
            self._enter(n, new)
            return
        self._current, self._inside = best, found.pose if best == current else between(world.poses[best], pose)

    def _enter(self, n: int, keyframe: int) -> None:
        """Continue from a new keyframe, which is sweep `n` itself."""
        self._current, self._inside, self._last = keyframe, np.zeros(3), n
        self.keyframe[n], self.relative[n] = keyframe, np.zeros(3)


def _fits(found: Match | None, guess: Array, step: Array, overlap: float, times: float) -> bool:
    """Return whether a match overlaps enough and is near enough to the odometry's guess for the length of the step."""
    if found is None or found.overlap < overlap:
        return False
    away = found.pose - guess
    reach = _AWAY_M + _AWAY_SHARE * float(np.hypot(step[0], step[1]))
    turned = _AWAY_RAD + _AWAY_SHARE * abs(float(step[2]))
    return bool(np.hypot(away[0], away[1]) <= times * reach and abs(float(wrap(away[2]))) <= times * turned)
