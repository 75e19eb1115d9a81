"""The map under construction: keyframes, relative poses between them, and local surfaces for scan matching."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from odomcorrupt.geometry.se2 import between, compose, rotate
from odomcorrupt.laser.icp import WEAK, Surface, best_guess, match, surface_of, thinned
from odomcorrupt.laser.pose_graph import Edges, optimise
from odomcorrupt.laser.surface import lines_of

if TYPE_CHECKING:
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.laser.icp import Match
    from odomcorrupt.laser.surface import Lines

NEIGHBOURS = 8
"""Maximum number of nearest keyframes to which a new one is connected."""
_NEAR_M = 3.0
_LOCAL = 6
_PAIR_OVERLAP, _LOOP_OVERLAP = 0.35, 0.55
_QUERY, _COARSE = 240, 60
_REACH_M, _REACH_RAD = 0.5, 0.1
_STEPS = np.stack(np.meshgrid(*(np.array([-1.0, 0.0, 1.0]),) * 3, indexing="ij"), axis=-1).reshape(-1, 3)
_HELD = 0.3
_EDGE_M, _EDGE_RAD = 0.004, 0.001
_WEAK_AGAIN = 0.01
_ODOMETRY_M, _ODOMETRY_RAD = 0.1, 0.05


class Edge(NamedTuple):
    """Pose of the second keyframe in the frame of the first, its information, and whether it is a match and a loop."""

    first: int
    second: int
    pose: Array
    information: Array
    matched: bool
    loop: bool


class KeyframeMap:
    """Keyframes with their poses in one map frame, edges, and local surfaces."""

    def __init__(self, field_of_view_rad: float) -> None:
        self.narrow = field_of_view_rad < np.radians(300.0)
        self.poses = np.zeros((0, 3))
        self.scans: list[Array] = []
        self.edges: list[Edge] = []
        self.weights: Array = np.zeros(0)
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
            chosen = [k, *self.nearest(k, list(self._beside[k]))[:_LOCAL]]
            parts = []
            for other in chosen:
                points, facing = self._own[other]
                relative = between(self.poses[k], self.poses[other])
                turn = np.full(len(points), relative[2])
                parts.append((relative[:2] + rotate(points, turn), rotate(facing, turn)))
            self._local[k] = surface_of(*(np.concatenate(p) for p in zip(*parts, strict=True)))
        return self._local[k]

    def nearest(self, k: int, others: list[int]) -> list[int]:
        """Return keyframes sorted by distance from keyframe `k`, see `distances`."""
        return self.nearest_to(self.poses[k], others)

    def nearest_to(self, pose: Array, others: list[int]) -> list[int]:
        """Return keyframes sorted by distance from a pose, see `distances`."""
        if not others:
            return []
        index = np.array(others)
        return [int(i) for i in index[np.argsort(self.distances(pose, index), kind="stable")]]

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
        near = self.nearest(k, others)[:NEIGHBOURS]
        near = [i for i in near if float(self.distances(self.poses[k], np.array([i]))[0]) < _NEAR_M]
        around = set(self.reachable(k, 4))
        count = 0
        for i in near:
            found = self.pair(i, k, wide=i not in around)
            if found is not None:
                self.connect(Edge(i, k, found.pose, edge_information(found), matched=True, loop=i not in around))
                count += i not in around
        return count

    def around(self, k: int, scan: Array, guess: Array) -> Array:
        """Return the pose (3,) near a guess, in a keyframe's frame, at which a scan is nearest to the surfaces."""
        return best_guess(thinned(scan, _COARSE), self.local(k), guess + _STEPS * (_REACH_M, _REACH_M, _REACH_RAD))

    def pair(self, i: int, k: int, *, wide: bool) -> Match | None:
        """Return the match of keyframe k in keyframe i's frame; None if they do not match.

        wide : whether to search within 0.5 m and 0.1 rad first, and require more overlap
        """
        surface = self.single(i)
        scan = self.scans[k]
        guess = between(self.poses[i], self.poses[k])
        if wide:
            if len(surface.points) < _COARSE:
                return None
            guess = best_guess(thinned(scan, _COARSE), surface, guess + _STEPS * (_REACH_M, _REACH_M, _REACH_RAD))
        found = match(thinned(scan, _QUERY), surface, guess)
        if found is None or found.overlap < (_LOOP_OVERLAP if wide else _PAIR_OVERLAP):
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
        self.poses, self.weights = optimise(self.poses, self._graph())
        i, j = np.array([(e.first, e.second) for e in self.edges]).T
        moved = np.abs(between(before[i], before[j]) - between(self.poses[i], self.poses[j])).max(axis=1) > 1e-3
        for k in {*i[moved].tolist(), *j[moved].tolist()}:
            self._local.pop(k, None)
        for edge, weight in zip(self.edges, self.weights, strict=True):
            if edge.loop and weight < _HELD:
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
            skip = {i for i in range(len(self)) if (min(i, k), max(i, k)) in tried}
            others = [i for i in range(len(self)) if i != k and i not in skip]
            near = self.nearest(k, others)[: NEIGHBOURS // 2]
            around = set(self.reachable(k, 4))
            for i in near:
                tried.add((min(i, k), max(i, k)))
                if float(self.distances(self.poses[k], np.array([i]))[0]) > _NEAR_M:
                    continue
                found = self.pair(i, k, wide=i not in around)
                if found is not None:
                    self.connect(Edge(i, k, found.pose, edge_information(found), matched=True, loop=i not in around))
                    count += 1
        return count

    def parts(self) -> Array:
        """Return the index (k,) of the part of the map, connected by matches, to which each keyframe belongs."""
        label = np.full(len(self), -1)
        part = 0
        for k in range(len(self)):
            if label[k] >= 0:
                continue
            ring = {k}
            while ring:
                for i in ring:
                    label[i] = part
                ring = {o for i in ring for o in self._beside[i] if label[o] < 0}
            part += 1
        return label

    def _graph(self) -> Edges:
        return Edges(
            first=np.array([e.first for e in self.edges]),
            second=np.array([e.second for e in self.edges]),
            pose=np.stack([e.pose for e in self.edges]),
            information=np.stack([e.information for e in self.edges]),
            robust=np.array([e.matched for e in self.edges]),
        )

    def dead_reckoned(self, i: int, k: int, pose: Array) -> Edge:
        """Return an odometry edge between two keyframes, with so little weight that it matters only without matches."""
        far = 0.1 + float(np.hypot(pose[0], pose[1])) + 0.2 * abs(float(pose[2]))
        deviation = np.array([_ODOMETRY_M, _ODOMETRY_M, _ODOMETRY_RAD]) * far
        return Edge(i, k, pose, np.diag(1.0 / deviation**2), matched=False, loop=False)


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


def placed(poses: Array, k: Array, relative: Array) -> Array:
    """Return map poses (n, 3) of poses relative (n, 3) to keyframes with indices `k` (n,)."""
    return compose(poses[k], relative)
