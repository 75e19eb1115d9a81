"""Keyframe SLAM: keyframes, loop closures between them, and the pose graph that places them.

Gauss-Newton on SE(2) with sparse normal equations; inconsistent relative poses are down-weighted
(Geman-McClure, as in dynamic covariance scaling: Agarwal et al., ICRA 2013).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.sparse import coo_array, diags_array
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu

from odomcorrupt.geometry.se2 import between, compose, rotate, wrap
from odomcorrupt.laser.icp import (
    COARSE,
    OVERLAP,
    SURE_OVERLAP,
    WEAK,
    Surface,
    best_guess,
    lines_of,
    match,
    surface_of,
    thinned,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.laser.calibrate import Calibration
    from odomcorrupt.laser.icp import Lines, Match
    from odomcorrupt.laser.scans import Sweeps


_KERNEL = 12.0
"""Squared normalised residual at which a match, which may be wrong, has a quarter of its weight."""


class Edge(NamedTuple):
    """Pose of the second keyframe in the frame of the first, its information, and whether it is a match and a loop."""

    first: int
    second: int
    pose: Array
    information: Array
    matched: bool
    loop: bool


def optimise(poses: Array, edges: Sequence[Edge], rounds: int = 12) -> tuple[Array, Array]:
    """Return the most likely poses (n, 3), with the first one fixed, and the final weights (e,) of the edges."""
    poses = poses.copy()
    weight = np.ones(len(edges))
    count = len(poses)
    if count < 2 or not edges:
        return poses, weight
    i, j, pose, information, matched = map(np.array, list(zip(*edges, strict=True))[:5])
    rows = (3 * np.stack((i, j), axis=1)[:, :, None] + np.arange(3)).reshape(len(edges), 6)
    at = np.repeat(rows[:, :, None], 6, axis=2), np.repeat(rows[:, None, :], 6, axis=1)
    for _ in range(rounds):
        a, b = poses[i], poses[j]
        seen = between(a, b)
        miss = seen - pose
        miss[:, 2] = wrap(miss[:, 2])
        chi2 = np.einsum("ei,eij,ej->e", miss, information, miss)
        weight = np.where(matched, (_KERNEL / (_KERNEL + chi2)) ** 2, 1.0)
        c, s = np.cos(a[:, 2]), np.sin(a[:, 2])
        left = np.zeros((len(edges), 3, 3))
        left[:, 0, 0], left[:, 0, 1], left[:, 1, 0], left[:, 1, 1] = -c, -s, s, -c
        left[:, 0, 2], left[:, 1, 2], left[:, 2, 2] = seen[:, 1], -seen[:, 0], -1.0
        right = -left.copy()
        right[:, :2, 2], right[:, 2, 2] = 0.0, 1.0
        jacobian = np.concatenate((left, right), axis=2)
        pulled = np.swapaxes(jacobian, 1, 2) @ (information * weight[:, None, None])
        blocks = pulled @ jacobian
        gradient = np.zeros(3 * count)
        np.add.at(gradient, rows.ravel(), (pulled @ miss[:, :, None])[:, :, 0].ravel())
        normal = coo_array((blocks.ravel(), (at[0].ravel(), at[1].ravel())), shape=(3 * count, 3 * count)).tocsc()
        inner = normal[3:, 3:] + diags_array(np.full(3 * count - 3, 1e-9))
        step = np.zeros(3 * count)
        step[3:] = -splu(inner.tocsc()).solve(gradient[3:])
        poses += step.reshape(-1, 3)
        if float(np.abs(step).max()) < 1e-4:  # converged
            break
    return poses, weight


NEIGHBOURS = 8
"""Maximum number of nearest keyframes to which a new one is connected."""
_REACH_M, _REACH_RAD = 0.5, 0.1
_STEPS = np.stack(np.meshgrid(*(np.array([-1.0, 0.0, 1.0]),) * 3, indexing="ij"), axis=-1).reshape(-1, 3)
_EDGE_M, _EDGE_RAD = 0.004, 0.001
_WEAK_AGAIN = 0.01
_ODOMETRY_M, _ODOMETRY_RAD = 0.1, 0.05


class KeyframeMap:
    """Keyframes with their poses in one map frame, edges, and local surfaces."""

    def __init__(self, field_of_view_rad: float) -> None:
        self.narrow = field_of_view_rad < np.radians(300.0)
        self.poses = np.zeros((0, 3))
        self.scans: list[Array] = []
        self.edges: list[Edge] = []
        self._own: list[Lines] = []
        self._single: dict[int, Surface] = {}
        self._local: dict[int, Surface] = {}
        self._beside: list[set[int]] = []

    def __len__(self) -> int:
        return len(self.scans)

    def add(self, scan: Array, pose: Array) -> int:
        """Add a keyframe with returns (m, 2) in its frame at a pose (3,), and return its index."""
        self._own.append(lines_of(scan))
        self.scans.append(scan)
        self.poses = np.concatenate((self.poses, pose[None]))
        self._beside.append(set())
        return len(self.scans) - 1

    def connect(self, edge: Edge) -> None:
        """Add an edge."""
        self.edges.append(edge)
        if edge.matched:
            self._beside[edge.first].add(edge.second)
            self._beside[edge.second].add(edge.first)
            self._local.pop(edge.first, None)
            self._local.pop(edge.second, None)

    def single(self, k: int) -> Surface:
        """Return the surface of one keyframe in its frame."""
        if k not in self._single:
            self._single[k] = surface_of(*self._own[k])
        return self._single[k]

    def local(self, k: int) -> Surface:
        """Return the surface of a keyframe and its nearest connected ones, in its frame."""
        if k not in self._local:
            chosen = [k, *self.nearest(self.poses[k], list(self._beside[k]))[:6]]
            parts = []
            for other in chosen:
                points, facing = self._own[other]
                relative = between(self.poses[k], self.poses[other])
                turn = np.full(len(points), relative[2])
                parts.append((relative[:2] + rotate(points, turn), rotate(facing, turn)))
            self._local[k] = surface_of(*(np.concatenate(p) for p in zip(*parts, strict=True)))
        return self._local[k]

    def nearest(self, pose: Array, others: list[int]) -> list[int]:
        """Return keyframes sorted by distance from a pose, see `distances`."""
        if not others:
            return []
        index = np.array(others)
        return index[np.argsort(self.distances(pose, index), kind="stable")].tolist()

    def distances(self, pose: Array, index: Array) -> Array:
        """Return distances (n,) of keyframes from a pose, m; for a narrow field of view, a radian counts as a metre."""
        away = self.poses[index] - pose
        far: Array = np.hypot(away[:, 0], away[:, 1])
        if self.narrow:
            far = far + np.abs(np.angle(np.exp(1j * away[:, 2])))
        return far

    def reachable(self, k: int, hops: int = 2) -> list[int]:
        """Return the keyframes at most `hops` edges from keyframe `k`, including it."""
        found = {k}
        ring = {k}
        for _ in range(hops):
            ring = {o for i in ring for o in self._beside[i]} - found
            found |= ring
        return list(found)

    def tie(self, k: int, skip: set[int]) -> int:
        """Match a new keyframe with the nearest others, and return the number of loops closed."""
        others = [i for i in range(len(self)) if i != k and i not in skip and i not in self._beside[k]]
        return sum(self._matched(k, self.nearest(self.poses[k], others)[:NEIGHBOURS]))

    def _matched(self, k: int, near: list[int]) -> list[bool]:
        """Connect keyframe k with those of `near` within 3 m that it matches; return whether each match is a loop."""
        around, loops = set(self.reachable(k, 4)), []
        for i in near:
            # more than 3 m apart they share little of the view
            if float(self.distances(self.poses[k], np.array([i]))[0]) > 3.0:
                continue
            loop = i not in around
            found = self.pair(i, k, wide=loop)
            if found is not None:
                self.connect(Edge(i, k, found.pose, edge_information(found), matched=True, loop=loop))
                loops.append(loop)
        return loops

    def pair(self, i: int, k: int, *, wide: bool) -> Match | None:
        """Return the match of keyframe k in keyframe i's frame; None if they do not match.

        wide : whether to search within 0.5 m and 0.1 rad first, and require more overlap
        """
        surface = self.single(i)
        scan = self.scans[k]
        guess = between(self.poses[i], self.poses[k])
        if wide:
            if len(surface.points) < COARSE:
                return None
            guess = nearest_pose(scan, surface, guess)
        found = match(thinned(scan, 240), surface, guess)
        # a wide search may find a similar place: it has to overlap by more
        if found is None or found.overlap < (0.55 if wide else OVERLAP):
            return None
        if not wide:
            away = found.pose - guess
            if np.hypot(away[0], away[1]) > _REACH_M or abs(away[2]) > 2.0 * _REACH_RAD:
                return None
        return found

    def settle(self) -> None:
        """Optimise all poses, discard local surfaces that moved, and disconnect loops with a low weight."""
        if not self.edges:
            return
        before = self.poses
        self.poses, weights = optimise(self.poses, self.edges)
        i, j = np.array([(e.first, e.second) for e in self.edges]).T
        moved = np.abs(between(before[i], before[j]) - between(self.poses[i], self.poses[j])).max(axis=1) > 1e-3
        for k in {*i[moved].tolist(), *j[moved].tolist()}:
            self._local.pop(k, None)
        for edge, weight in zip(self.edges, weights, strict=True):
            # a loop that the others contradict
            if edge.loop and weight < 0.3:
                for one, other in ((edge.first, edge.second), (edge.second, edge.first)):
                    if other in self._beside[one]:
                        self._beside[one].discard(other)
                        self._local.pop(one, None)

    def close(self) -> int:
        """Match all pairs of near keyframes that are not connected yet, and return the number of matches."""
        tried = {(min(e.first, e.second), max(e.first, e.second)) for e in self.edges if e.matched}
        count = 0
        for k in range(len(self)):
            if len(self._beside[k]) >= NEIGHBOURS:
                continue
            others = [i for i in range(len(self)) if i != k and (min(i, k), max(i, k)) not in tried]
            near = self.nearest(self.poses[k], others)[: NEIGHBOURS // 2]
            tried |= {(min(i, k), max(i, k)) for i in near}
            count += len(self._matched(k, near))
        return count

    def parts(self) -> Array:
        """Return the index (k,) of the part of the map, connected by matches, to which each keyframe belongs."""
        pairs = np.array([(k, i) for k, beside in enumerate(self._beside) for i in beside], dtype=np.int64).reshape(
            -1, 2
        )
        graph = coo_array((np.ones(len(pairs)), tuple(pairs.T)), shape=(len(self), len(self)))
        return connected_components(graph, directed=False)[1]

    def dead_reckoned(self, i: int, k: int, pose: Array) -> Edge:
        """Return an odometry edge between two keyframes, with so little weight that it matters only without matches."""
        far = 0.1 + float(np.hypot(pose[0], pose[1])) + 0.2 * abs(float(pose[2]))
        deviation = np.array([_ODOMETRY_M, _ODOMETRY_M, _ODOMETRY_RAD]) * far
        return Edge(i, k, pose, np.diag(1.0 / deviation**2), matched=False, loop=False)


def nearest_pose(scan: Array, surface: Surface, guess: Array) -> Array:
    """Return the pose (3,) within 0.5 m and 0.1 rad of a guess at which a scan is nearest to a surface."""
    return best_guess(thinned(scan, COARSE), surface, guess + _STEPS * (_REACH_M, _REACH_M, _REACH_RAD))


def edge_information(found: Match) -> Array:
    """Return the information (3, 3) of a relative pose: the match's, limited by the accuracy of maps.

    Along a weak axis it is scaled down, see `_WEAK_AGAIN`.
    """
    xy = max(_EDGE_M, 0.5 * found.deviation_m)
    limit = np.diag([xy, xy, max(_EDGE_RAD, xy / 4.0)]) ** 2
    covariance = np.linalg.inv(found.information + 1e-6 * np.eye(3)) + limit
    information: Array = np.linalg.inv(covariance)
    if found.ratio < WEAK:
        axis = np.array([*found.weak_axis, 0.0])
        project = np.eye(3) - (1.0 - _WEAK_AGAIN) * np.outer(axis, axis)
        information = project @ information @ project
    return information


_AWAY_M, _AWAY_RAD = 0.25, 0.2
_AWAY_SHARE = 0.2
_NEW_M, _LEAST_M = 0.5, 0.1
_KEYFRAME_RETURNS = 40
_FAST_MPS, _FAST_RADPS = 5.0, 6.0
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
    for _ in range(3):
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
            if len(scan) >= _KEYFRAME_RETURNS:
                self._enter(n, self.world.add(scan, self._dead[n]))
            return
        step = self._step(n)
        guess = compose(self._inside, step)
        matched = self._matched(scan, guess, step)
        if matched is None:
            self._lost += 1
            if self._lost > 3 and len(scan) >= _KEYFRAME_RETURNS:
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
        world, query = self.world, thinned(scan, 180)
        found = match(query, world.local(self._current), guess, _GATES_M)
        if _fits(found, guess, step, OVERLAP, 1.0):
            return found
        if not self._lost:
            return None
        found = match(query, world.local(self._current), nearest_pose(scan, world.local(self._current), guess))
        return found if _fits(found, guess, step, SURE_OVERLAP, 3.0) else None

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
        best = world.nearest(pose, world.reachable(current))[0]
        away_m = float(world.distances(pose, np.array([best]))[0])
        if away_m > _NEW_M or (found.overlap < SURE_OVERLAP and away_m > _LEAST_M):
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
