"""Noisy paths of a whole drive that never enter a wall: many runs at once, one increment after the other."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.geometry.se2 import compose, inverse
from odomcorrupt.mapping.conditioned import MAX_TRIES
from odomcorrupt.mapping.constrained_increments import (
    MotionReader,
    moved,
    must_be_free,
    rounds,
    swing_of,
    without_effects,
)
from odomcorrupt.rng import stream

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.mapping.free_space import Check, FreeSpace
    from odomcorrupt.model.motion_model import MotionModel

__all__ = ["FreePaths", "FreeRuns", "free_paths"]

_AT_ONCE = 1024
"""Increments that are held in memory together."""


@dataclass(frozen=True, slots=True)
class FreePaths:
    """Paths that a map allows.

    xyt : (runs, k, 3) at the places asked for, metres and radians
    redrawn : increments that were not free at the first draw, over all runs
    blocked : increments of which no try was free: the robot stayed where it was, and turned
    increments : how many there were in all
    """

    xyt: Array
    redrawn: int
    blocked: int
    increments: int
    tries: int

    def account(self) -> str:
        """Return what it took, in one sentence."""
        said = f"map: {self.redrawn} of {self.increments} increments were drawn again"
        if self.blocked:
            said += f"; for {self.blocked} none of {self.tries} tries was free: there the robot stayed where it was"
        return said


def free_paths(
    stamps_ns: NDArray[np.int64],
    clean_xyt: Array,
    model: MotionModel,
    space: FreeSpace,
    *,
    seed: int,
    runs: range,
    places: NDArray[np.intp],
    check: Check = "endpoint",
    tries: int = MAX_TRIES,
) -> FreePaths:
    """Draw runs of a whole drive within free space, and return them at places (k,) of its n poses.

    See `FreeRuns`; stamps_ns is (n,), clean_xyt (n, 3) the odometry.
    """
    walkers = FreeRuns(model, space, seed=seed, runs=runs, check=check, tries=tries)
    out = np.empty((len(runs), len(places), 3))
    for begin in range(0, len(stamps_ns), _AT_ONCE):
        part = slice(begin, begin + _AT_ONCE)
        here = (places >= begin) & (places < begin + _AT_ONCE)
        out[:, here] = walkers.feed(stamps_ns[part], clean_xyt[part])[:, places[here] - begin]
    return FreePaths(out, walkers.redrawn, walkers.blocked, (len(stamps_ns) - 1) * len(runs), tries)


class FreeRuns:
    """Runs of a drive that stay in free space, fed with the odometry batch by batch.

    Every increment is first drawn with the numbers that corruption draws for that run; where the pose it leads to is
    not free, it is drawn again from a stream of its own. So a run that meets no wall is the unconditioned run, and
    a run is the same however many others are drawn and however the odometry is cut into batches.

    redrawn : increments so far that were not free at the first draw
    blocked : increments of which no try was free: the robot stayed where it was, and turned
    """

    def __init__(
        self,
        model: MotionModel,
        space: FreeSpace,
        *,
        seed: int,
        runs: range,
        check: Check = "endpoint",
        tries: int = MAX_TRIES,
    ) -> None:
        self._reader, self._space = MotionReader(without_effects(model)), space
        self._own = [stream(seed, run, "noise") for run in runs]
        again = [stream(seed, run, "map") for run in runs]
        self._walk = _Walk(space, check, tries, again, swing_of(model))
        self.restart()

    @property
    def redrawn(self) -> int:
        """Increments that were drawn again."""
        return self._walk.redrawn

    @property
    def blocked(self) -> int:
        """Increments of which no try was free."""
        return self._walk.blocked

    def restart(self) -> None:
        """Begin a new path: the next pose is a first pose, and unchanged."""
        self._reader.restart()
        self._pose = np.zeros((0, 3))

    def feed(self, stamps_ns: NDArray[np.int64], clean_xyt: Array) -> Array:
        """Return the runs (runs, n, 3) at the next n poses; stamps ascend. See `NoisyPath.feed`.

        Raises
        ------
        MapError
            Where the first pose is not free.

        """
        if not self._reader.begun:
            must_be_free(self._space, clean_xyt[0])
            self._pose = np.repeat(clean_xyt[:1], len(self._own), axis=0)
        motions, pose = self._reader.read(stamps_ns, clean_xyt), self._pose
        poses = motions.clean_xyt
        normals = np.stack([rng.standard_normal((len(clean_xyt), 4)) for rng in self._own], axis=1)
        out = np.empty((len(pose), len(clean_xyt), 3))
        for i in range(len(clean_xyt)):
            if motions.jump[i]:
                pose = compose(compose(pose, inverse(poses[i])), poses[i + 1])
            else:
                pose = self._walk.on(pose, motions.step[i], motions.sd[i], normals[i])
            out[:, i] = pose
        self._pose = pose
        return out


class _Walk:
    """Takes many robots one increment further."""

    def __init__(
        self, space: FreeSpace, check: Check, tries: int, again: list[np.random.Generator], swing: float
    ) -> None:
        self._space, self._check, self._again, self._swing = space, check, again, swing
        self._rounds = rounds(tries)
        self.redrawn = self.blocked = 0

    def on(self, pose: Array, step: Array, sd: Array, normals: Array) -> Array:
        """Return poses (runs, 3) after an increment with normals (runs, 4) of rot1, trans, across, rot2."""
        ahead = moved(pose, step, normals * sd, self._swing)
        if not (sd.any() or step[:3].any()):
            return ahead
        bad = ~self._space.allows(pose[:, :2], ahead[:, :2], self._check)
        # a robot whose pose was set into a wall is let out of it
        stuck = np.flatnonzero(bad & self._space.free(pose[:, :2]))
        self.redrawn += len(stuck)
        for count in self._rounds:
            if len(stuck):
                stuck = self._again_from(pose, step, sd, stuck, count, ahead)
        self.blocked += len(stuck)
        ahead[stuck, :2] = pose[stuck, :2]
        return ahead

    def _again_from(
        self, pose: Array, step: Array, sd: Array, stuck: NDArray[np.intp], count: int, ahead: Array
    ) -> NDArray[np.intp]:
        """Draw so many candidates for each stuck run, put the first free one into `ahead`, return who is stuck yet."""
        noise = np.concatenate([self._again[run].standard_normal((count, 4)) for run in stuck]) * sd
        origin = np.repeat(pose[stuck], count, axis=0)
        candidates = moved(origin, step, noise, self._swing)
        good = self._space.allows(origin[:, :2], candidates[:, :2], self._check).reshape(-1, count)
        found = good.any(axis=1)
        first = np.argmax(good, axis=1)
        ahead[stuck[found]] = candidates.reshape(-1, count, 3)[found, first[found]]
        return stuck[~found]
