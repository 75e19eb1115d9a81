"""Sweeps to a map: tracking against local surfaces, new keyframes where none is near, loops closed, poses optimised."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.geometry.se2 import between, compose, wrap
from odomcorrupt.laser.calibrate import deskewed
from odomcorrupt.laser.icp import match
from odomcorrupt.laser.keyframes import Edge, KeyframeMap, edge_information, thinned

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.laser.calibrate import Calibration
    from odomcorrupt.laser.icp import Match
    from odomcorrupt.laser.sweep import Sweeps

__all__ = ["Tracked", "make_map"]

_TRACK_QUERY = 180
_OVERLAP = 0.35
_SURE_OVERLAP = 0.6
_AWAY_M, _AWAY_RAD = 0.25, 0.2
_AWAY_SHARE = 0.2
_NEW_M, _LEAST_M, _NEW_OVERLAP = 0.5, 0.1, 0.6
_LOST = 3
_FAST_MPS, _FAST_RADPS = 5.0, 6.0
_CLOSE_ROUNDS = 3
_GATES_M = (0.4, 0.25, 0.15)


@dataclass(frozen=True, slots=True)
class Tracked:
    """Where every sweep was in the map.

    keyframe : (n,) the keyframe each sweep was matched with last, -1 where it fitted nowhere
    relative : (n, 3) its pose in that keyframe's frame
    t_s : (n,) middles of the sweeps, seconds on the laser's clock since the origin
    """

    map: KeyframeMap
    keyframe: NDArray[np.int64]
    relative: Array
    t_s: Array


def make_map(
    sweeps: Sweeps, calibration: Calibration, told: Callable[[float], None] | None = None
) -> Tracked:
    """Return the finished map and where each sweep was in it.

    told : called now and then with which part of the sweeps is done
    """
    motion = calibration.motion
    t_s = sweeps.middle_s(motion.origin_ns)
    dead = motion.laser(t_s)
    count = len(sweeps)
    world = KeyframeMap(sweeps.field_of_view_rad)
    keyframe, relative = np.full(count, -1), np.zeros((count, 3))
    current, inside, lost, last = -1, np.zeros(3), 0, -1
    before = np.zeros(3)
    for n in range(count):
        if told is not None and n % 50 == 0:
            told(n / count)
        scan = deskewed(sweeps.sweeps[n], motion, mirrored=calibration.mirrored, turn_s=calibration.turn_s)
        if current < 0:
            if len(scan) >= 2 * 20:
                current, last = world.add(scan, dead[n]), n
                keyframe[n], inside = current, np.zeros(3)
            continue
        step = between(dead[last], dead[n])
        gap_s = max(float(t_s[n] - t_s[last]), 1e-3)
        if np.hypot(step[0], step[1]) > _FAST_MPS * gap_s + 0.1 or abs(step[2]) > _FAST_RADPS * gap_s + 0.2:
            # the odometry was reset: go on as before
            step = before
        guess = compose(inside, step)
        found = match(thinned(scan, _TRACK_QUERY), world.local(current), guess, _GATES_M) if len(scan) else None
        if not _fits(found, guess, step, _OVERLAP, 1.0) and len(scan) and lost >= 1:
            found = match(thinned(scan, _TRACK_QUERY), world.local(current), world.around(current, scan, guess))
            found = found if _fits(found, guess, step, _SURE_OVERLAP, 3.0) else None
        elif not _fits(found, guess, step, _OVERLAP, 1.0):
            found = None
        if found is None:
            lost += 1
            if lost <= _LOST or len(scan) < 2 * 20:
                continue
            # too far from all that is known: begin a part of its own, and see whether it fits somewhere
            pose = compose(world.poses[current], guess)
            new = world.add(scan, pose)
            world.connect(world.dead_reckoned(current, new, guess))
            if world.tie(new, set()):
                world.settle()
            current, inside, last, lost = new, np.zeros(3), n, 0
            keyframe[n] = new
            continue
        lost = 0
        before = step if n == last + 1 else step / max(n - last, 1)
        inside, last = found.pose, n
        keyframe[n], relative[n] = current, inside
        pose = compose(world.poses[current], inside)
        near = world.nearest_to(pose, world.reachable(current))
        best = near[0]
        if best != current:
            inside = between(world.poses[best], pose)
        away_m = float(world.distances(pose, np.array([best]))[0])
        if away_m > _NEW_M or (found.overlap < _NEW_OVERLAP and away_m > _LEAST_M):
            new = world.add(scan, pose)
            world.connect(Edge(current, new, found.pose, edge_information(found), matched=True, loop=False))
            world.connect(world.dead_reckoned(current, new, guess))
            loops = len([e for e in world.edges if e.loop])
            world.tie(new, {current})
            if len([e for e in world.edges if e.loop]) > loops:
                world.settle()
            best, inside = new, np.zeros(3)
            keyframe[n], relative[n] = new, np.zeros(3)
        current = best
    for _ in range(_CLOSE_ROUNDS):
        world.settle()
        if not world.close():
            break
    world.settle()
    return Tracked(world, keyframe, relative, t_s)


def _fits(found: Match | None, guess: Array, step: Array, overlap: float, times: float) -> bool:
    """Whether a match overlaps enough, and is not much farther from the odometry's guess than the step allows."""
    if found is None or found.overlap < overlap:
        return False
    away = found.pose - guess
    reach = _AWAY_M + _AWAY_SHARE * float(np.hypot(step[0], step[1]))
    turned = _AWAY_RAD + _AWAY_SHARE * abs(float(step[2]))
    return bool(np.hypot(away[0], away[1]) <= times * reach and abs(float(wrap(away[2]))) <= times * turned)
