"""Motion within a map, p(x_t | u_t, x_t-1, m), by rejection, for many runs of a drive at once.

The book (Probabilistic Robotics, section 5.5) multiplies the motion's density by an indicator of a free pose.
Repeated draws until the pose is free are exact samples of this density. The number of tries is limited, because no
motion from a dead end is free. A run without a free try is replaced by a copy of another run, past included, as in the
resampling of a particle filter (section 4.3).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.geometry.se2 import compose, inverse
from odomcorrupt.mapping.constrained_increments import (
    MotionReader,
    NoFreePoseError,
    moved,
    require_free,
    rounds,
    swing_of,
    without_effects,
)
from odomcorrupt.rng import stream

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.mapping.free_space import Constraint
    from odomcorrupt.model.motion_model import MotionModel

__all__ = ["FreePaths", "FreeRuns", "free_paths"]


_AT_ONCE = 1024
"""Largest number of increments held in memory together."""


@dataclass(frozen=True, slots=True)
class FreePaths:
    """Paths in the free space of a map.

    xyt : (runs, k, 3) poses at the requested places, metres and radians
    redrawn : increments that were not free at the first draw, over all runs
    resampled : number of times a run without a free try was replaced by a copy of another one
    increments : total number of increments
    """

    xyt: Array
    redrawn: int
    resampled: int
    increments: int
    tries: int

    def account(self) -> str:
        """Return the numbers of redrawn and resampled increments, in one sentence."""
        said = f"map: {self.redrawn} of {self.increments} increments were drawn again"
        if self.resampled:
            said += f"; {self.resampled} times none of {self.tries} tries was free, and another run was copied"
        return said


def free_paths(
    stamps_ns: NDArray[np.int64],
    clean_xyt: Array,
    model: MotionModel,
    within: Constraint,
    *,
    seed: int,
    runs: range,
    places: NDArray[np.intp],
) -> FreePaths:
    """Draw runs of a whole drive within free space, and return their poses at k of its n poses.

    See `FreeRuns`; stamps_ns is (n,), clean_xyt (n, 3) the odometry.
    """
    walkers = FreeRuns(model, within, seed=seed, runs=runs)
    out = np.empty((len(runs), len(places), 3))
    for begin in range(0, len(stamps_ns), _AT_ONCE):
        part = slice(begin, begin + _AT_ONCE)
        here = (places >= begin) & (places < begin + _AT_ONCE)
        walked = walkers.feed(stamps_ns[part], clean_xyt[part])
        out = out[walked.ancestors]
        out[:, here] = walked.xyt[:, places[here] - begin]
    return FreePaths(out, walkers.redrawn, walkers.resampled, (len(stamps_ns) - 1) * len(runs), within.tries)


@dataclass(frozen=True, slots=True)
class Walked:
    """Runs over n increments.

    xyt : (runs, n, 3) poses after each increment
    ancestors : (runs,) index that each run's ancestor had at the beginning of the batch
    parents : (n, runs) index of the run that each one was a copy of, after each increment
    normals : (n, runs, 4) standard normals of rot1, trans, across and rot2 of each run
    """

    xyt: Array
    ancestors: NDArray[np.intp]
    parents: NDArray[np.intp]
    normals: Array

    def lineage(self, run: int) -> tuple[Array, int]:
        """Return the normals (n, 4) that led to a run, and its ancestor's index at the beginning of the batch."""
        rows = np.empty((len(self.parents), 4))
        for i in range(len(self.parents) - 1, -1, -1):
            run = int(self.parents[i, run])
            rows[i] = self.normals[i, run]
        return rows, run


class FreeRuns:
    """Runs of a drive that stay in free space, fed with the odometry batch by batch.

    Every increment is first drawn with the random numbers that corruption uses for that run. If its end is not free,
    it is drawn again from a separate stream. A run that meets no wall therefore equals the unconditioned run. Unless
    resampled, a run does not depend on the number of runs or on the division of the odometry into batches.

    particles : 0, or the number of variants of a single run, drawn instead of runs. They are redrawn only if all are
        stuck, else copied: the distribution is that of whole free paths, not of increments (section 4.3 of the book)
    redrawn : number of increments so far that were not free at the first draw
    resampled : number of times a run without a free try was replaced by a copy of another one
    """

    def __init__(self, model: MotionModel, within: Constraint, *, seed: int, runs: range, particles: int = 0) -> None:
        self._reader, self._space = MotionReader(without_effects(model)), within.space
        keys = [(run, 0) for run in runs] if not particles else [(runs.start, number) for number in range(particles)]
        self._own = [stream(seed, run, "noise", number) for run, number in keys]
        again = [stream(seed, run, "map", number) for run, number in keys]
        choose = stream(seed, runs.start, "map resampling")
        self._walk = _Walk(within, again, choose, swing_of(model), whole=bool(particles))
        self.restart()

    @property
    def redrawn(self) -> int:
        """Number of increments drawn again."""
        return self._walk.redrawn

    @property
    def resampled(self) -> int:
        """Number of times a run was replaced by a copy of another one."""
        return self._walk.resampled

    def restart(self) -> None:
        """Begin a new path: the next pose is a first pose, and unchanged."""
        self._reader.restart()
        self._pose = np.zeros((0, 3))

    def feed(self, stamps_ns: NDArray[np.int64], clean_xyt: Array) -> Walked:
        """Return the runs at the next n poses; stamps ascend. See `NoisyPath.feed`.

        Raises
        ------
        MapError
            If the first pose is not free, or an increment has no free try in any run.
        """
        if not self._reader.begun:
            require_free(self._space, clean_xyt[0])
            self._pose = np.repeat(clean_xyt[:1], len(self._own), axis=0)
        motions, pose = self._reader.read(stamps_ns, clean_xyt), self._pose
        poses = motions.clean_xyt
        normals = np.stack([rng.standard_normal((len(clean_xyt), 4)) for rng in self._own], axis=1)
        out = np.empty((len(pose), len(clean_xyt), 3))
        every = np.arange(len(pose))
        parents = np.tile(every, (len(clean_xyt), 1))
        ancestors = every
        for i in range(len(clean_xyt)):
            if motions.jump[i]:
                pose = compose(compose(pose, inverse(poses[i])), poses[i + 1])
            else:
                pose, parents[i] = self._walk.on(pose, motions.step[i], motions.sd[i], normals[i])
                if (parents[i] != every).any():
                    out[:, :i], ancestors = out[parents[i], :i], ancestors[parents[i]]
            out[:, i] = pose
        self._pose = pose
        return Walked(out, ancestors, parents, normals)


class _Walk:
    """Propagates many robots by one increment at a time."""

    def __init__(
        self, within: Constraint, again: list[np.random.Generator], choose: np.random.Generator, swing: float, *,
        whole: bool,
    ) -> None:  # fmt: skip
        self._within, self._again, self._choose, self._swing, self._whole = within, again, choose, swing, whole
        self._rounds = rounds(within.tries)
        self.redrawn = self.resampled = 0

    def on(self, pose: Array, step: Array, sd: Array, normals: Array) -> tuple[Array, NDArray[np.intp]]:
        """Return poses (runs, 3) after an increment, and the index (runs,) of the run that each is a copy of.

        normals : (runs, 4) of rot1, trans, across, rot2; replaced by those of the tries that were accepted
        """
        ahead = moved(pose, step, normals * sd, self._swing)
        parents: NDArray[np.intp] = np.arange(len(pose))
        if not (sd.any() or step[:3].any()):
            return ahead, parents
        bad = ~self._within.allows(pose[:, :2], ahead[:, :2])
        # a robot whose pose was set into a wall may leave it
        stuck = np.flatnonzero(bad & self._within.space.free(pose[:, :2]))
        self.redrawn += len(stuck)
        for count in () if self._whole and len(stuck) < len(pose) else self._rounds:
            if len(stuck):
                stuck = self._redraw_stuck(pose, step, sd, stuck, count, ahead, normals)
        if len(stuck):
            alive = np.setdiff1d(parents, stuck)
            if not len(alive):
                x, y = pose[:, :2].mean(axis=0)
                raise NoFreePoseError(
                    f"the map and the drive do not fit: about ({x:.2f} m, {y:.2f} m) none of {self._within.tries} "
                    f"tries of any of {len(pose)} paths ends where the map is free; check --map-pose, --robot-radius "
                    "and --unknown, or leave out --map"
                )
            self.resampled += len(stuck)
            parents[stuck] = alive[self._choose.integers(len(alive), size=len(stuck))]
        return ahead[parents], parents

    def _redraw_stuck(
        self, pose: Array, step: Array, sd: Array, stuck: NDArray[np.intp], count: int, ahead: Array, normals: Array
    ) -> NDArray[np.intp]:
        """Draw `count` candidates per stuck run, put the first free one into `ahead`, and return the runs not freed."""
        again = np.concatenate([self._again[run].standard_normal((count, 4)) for run in stuck])
        origin = np.repeat(pose[stuck], count, axis=0)
        candidates = moved(origin, step, again * sd, self._swing)
        good = self._within.allows(origin[:, :2], candidates[:, :2]).reshape(-1, count)
        found = good.any(axis=1)
        first = np.argmax(good, axis=1)
        ahead[stuck[found]] = candidates.reshape(-1, count, 3)[found, first[found]]
        normals[stuck[found]] = again.reshape(-1, count, 4)[found, first[found]]
        return stuck[~found]
