"""Motion within a map, p(x_t | u_t, x_t-1, m), by rejection, for many runs of a drive at once; its increments.

The book (Probabilistic Robotics, section 5.5) multiplies the motion's density by an indicator of a free pose.
Repeated draws until the pose is free are exact samples of this density. The number of tries is limited, because no
motion from a dead end is free. A run without a free try is replaced by a copy of another run, past included, as in the
resampling of a particle filter (section 4.3).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.corruption.path import JUMP_MIN_S, JUMP_SPEED, StepGrowth, noise_variances
from odomcorrupt.errors import MapError, ModelError
from odomcorrupt.geometry.increments import Increments, increments
from odomcorrupt.geometry.se2 import compose, inverse
from odomcorrupt.rng import stream

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.mapping.free_space import Constraint, FreeSpace
    from odomcorrupt.model.motion_model import MotionModel

FIRST_TRIES = 12
"""Number of tries of the first round, usually sufficient; a stuck robot needs all rounds."""


class NoFreePoseError(MapError):
    """No path in free space explains a drive."""

    def __init__(self, why: str) -> None:
        way_out = "check --map-pose, --robot-radius and --unknown, or leave out --map"
        super().__init__(f"the map and the drive do not match: {why}; {way_out}")


def rounds(tries: int) -> tuple[int, ...]:
    """Return the numbers of simultaneous tries, round by round, after a first draw that was not free."""
    left = tries - 1
    return tuple(count for count in (min(FIRST_TRIES, left), left - FIRST_TRIES) if count > 0)


def without_effects(model: MotionModel) -> MotionModel:
    """Return a model that a map can constrain; ModelError if it has acting effects."""
    acting = [effect.name for effect in model.effects if effect.acts]
    if acting:
        raise ModelError(f"--map: {acting[0]} is not noise and cannot be redrawn; leave out effects, or --map")
    return model


def require_free(space: FreeSpace, first_xyt: Array) -> None:
    """Raise MapError if a drive's first pose (3,) is not free."""
    if not space.free(first_xyt[None, :2])[0]:
        x, y = first_xyt[:2]
        raise MapError(
            f"the drive begins at ({x:.3f} m, {y:.3f} m), which is not free in the map for this robot; check "
            "--map-pose, --robot-radius and --unknown"
        )


@dataclass(frozen=True, slots=True)
class Motions:
    """n increments and their noise.

    clean_xyt : (n + 1, 3) odometry before and after the increments, metres and radians
    jump : (n,) pose reset, not driven: nothing is drawn across it, but the odom frame's correction is held
    step : (n, 4) forward (m), to the left (m), turn (rad), and bearing of the noise's axes (rad)
    sd : (n, 4) of rot1 (rad), trans (m), across (m), rot2 (rad)
    """

    clean_xyt: Array
    jump: NDArray[np.bool_]
    step: Array
    sd: Array

    @property
    def rest(self) -> NDArray[np.bool_]:
        """Increments (n,) that neither move nor are noisy."""
        moves = np.logical_or(self.sd.any(axis=1), self.step[:, :3].any(axis=1))
        return np.logical_not(moves)


class MotionReader:
    """Converts odometry into motions, batch by batch; the division into batches has no influence."""

    def __init__(self, model: MotionModel) -> None:
        self._noise = model.noise
        self.restart()

    def restart(self) -> None:
        """Begin a new path."""
        self._growth = StepGrowth()
        self._last: tuple[int, Array] | None = None

    @property
    def begun(self) -> bool:
        """Whether a first pose was read."""
        return self._last is not None

    def read(self, stamps_ns: NDArray[np.int64], clean_xyt: Array) -> Motions:
        """Return the motions that end at the next n poses (n, 3), n > 0; a first pose ends an empty motion."""
        before_ns, before_xyt = (int(stamps_ns[0]), clean_xyt[0]) if self._last is None else self._last
        poses: Array = np.concatenate((before_xyt[None], clean_xyt))
        dt_s = np.diff(stamps_ns, prepend=before_ns) * np.float64(1e-9)
        travel = np.hypot(*np.diff(poses[:, :2], axis=0).T)
        jump = travel > JUMP_SPEED * np.maximum(dt_s, JUMP_MIN_S)
        whole = increments(poses)
        steps = Increments.of_rows(np.where(jump[:, None], 0.0, whole.rows))
        grown = noise_variances(self._noise, steps, np.where(jump, 0.0, dt_s), self._growth)
        v = grown.variances
        sd = np.sqrt(np.stack((v.rot1, v.trans, v.across, v.rot2), axis=1))
        bearing = np.arctan2(steps.dl_m, steps.ds_m) * self._noise.law.along_travel
        self._growth, self._last = grown.growth, (int(stamps_ns[-1]), clean_xyt[-1].copy())
        return Motions(poses, jump, np.column_stack((steps.rows, bearing)), sd)


def swing_of(model: MotionModel) -> float:
    """Return the fraction of rot1 that precedes an increment's translation: half of it on an arc."""
    return 0.5 if model.noise.law.arc else 1.0


def moved(pose: Array, step: Array, noise: Array, swing: float) -> Array:
    """Return poses (n, 3) after one increment (4,) from poses (n, 3) or (3,), with noise (n, 4) added."""
    ds, dl, turn, bearing = step
    x, y, theta = pose.T
    along = noise[:, 1] * np.cos(bearing) - noise[:, 2] * np.sin(bearing) + ds
    across = noise[:, 1] * np.sin(bearing) + noise[:, 2] * np.cos(bearing) + dl
    heading = theta + swing * noise[:, 0] + turn / 2.0
    c, s = np.cos(heading), np.sin(heading)
    return np.column_stack(
        (x + c * along - s * across, y + s * along + c * across, theta + turn + noise[:, 0] + noise[:, 3])
    )


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
                    f"about ({x:.2f} m, {y:.2f} m) none of {self._within.tries} tries of any of {len(pose)} paths ends "
                    "where the map is free"
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
