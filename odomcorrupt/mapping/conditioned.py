"""Runs within a map: paths that never leave free space, drawn under the condition of the map.

The book (Probabilistic Robotics, section 5.5) multiplies the motion's density by an indicator of a free pose.
Repeated draws until the pose is free are exact samples of this density. The number of tries is limited, because no
motion from a dead end is free. A run without a free try is replaced by a copy of another run, past included, as in the
resampling of a particle filter (section 4.3).

Most increments are free at their first draw. A piece of the path is drawn without the map up to its first pose that is
not free. That one increment is drawn again, and the next piece begins after it. A run that meets no wall equals the
run without a map, bit by bit.

Drawn increment by increment, a path can end in a pocket of the map without exit. In that case many variants of a run
are drawn in parallel as by a particle filter: stuck ones are replaced by copies of others, and one that reached the
end is taken with its whole past. Only the first states of blocks are kept in memory. Each block is drawn twice, the
second time from the end, to trace the ancestors of the chosen path.
"""

from __future__ import annotations

import copy
import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from odomcorrupt.bags.messages import TRANSFORMS, locate
from odomcorrupt.bags.open import open_reader
from odomcorrupt.corruption.odometry_source import ENCODINGS, ODOMETRY, OdometrySource
from odomcorrupt.corruption.path import (
    JUMP_MIN_S,
    JUMP_SPEED,
    DriftMeter,
    NoisyPath,
    PathSamples,
    StepGrowth,
    noise_variances,
)
from odomcorrupt.errors import MapError, ModelError, TopicError
from odomcorrupt.geometry.se2 import Increments, compose, increments, inverse
from odomcorrupt.mapping.frames import FrameTree
from odomcorrupt.mapping.messages import GRID, read_grid
from odomcorrupt.mapping.occupancy_grid import FREE, OCCUPIED, UNKNOWN, Check, Constraint, Grid, free_space, read_map
from odomcorrupt.rng import stream

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from odomcorrupt.corruption.transform import Options
    from odomcorrupt.forecasting.forecast import CleanDrive
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.mapping.occupancy_grid import FreeSpace
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


PARTICLES = 64
_BLOCK = 1024
_MOST_SIGMAS = 6.0
"""Drift at the end, in standard deviations, above which it is attributed to the map instead of the noise."""
_MOST_OUTSIDE = 0.25
"""Fraction of odometry poses outside free space above which map and recording do not belong together."""


@dataclass(frozen=True, slots=True)
class Plan:
    """Normals of a path that is free as a whole.

    stamps_ns : (n,) stamps of the poses at which the increments end
    normals : (n, 4) of rot1, trans, across and rot2
    particles, resampled : number of parallel paths, and number of replacements among them
    """

    stamps_ns: NDArray[np.int64]
    normals: Array
    particles: int
    resampled: int

    def at(self, stamps_ns: NDArray[np.int64], otherwise: Array) -> Array:
        """Return the normals (m, 4) of increments that end at stamps (m,); for unknown stamps those of `otherwise`."""
        place = np.minimum(np.searchsorted(self.stamps_ns, stamps_ns), len(self.stamps_ns) - 1)
        known = self.stamps_ns[place] == stamps_ns
        return np.where(known[:, None], self.normals[place], otherwise)


def plan_path(
    stamps_ns: NDArray[np.int64], clean_xyt: Array, model: MotionModel, within: Constraint, seed: int, run: int
) -> Plan:
    """Return the normals of a path that is free as a whole.

    stamps_ns, clean_xyt : (n,) and (n, 3) odometry, nanoseconds, metres and radians

    Raises
    ------
    MapError
        If the drive's first pose is not free, or all paths are stuck at one place.
    """
    runs = FreeRuns(model, within, seed=seed, runs=range(run, run + 1), particles=PARTICLES)
    beginnings = []
    for begin in range(0, len(stamps_ns), _BLOCK):
        beginnings.append(copy.deepcopy(runs))
        runs.feed(stamps_ns[begin : begin + _BLOCK], clean_xyt[begin : begin + _BLOCK])
    taken = int(stream(seed, run, "map path").integers(PARTICLES))
    normals = np.empty((len(stamps_ns), 4))
    for number in range(len(beginnings) - 1, -1, -1):
        part = slice(number * _BLOCK, (number + 1) * _BLOCK)
        normals[part], taken = beginnings[number].feed(stamps_ns[part], clean_xyt[part]).lineage(taken)
    return Plan(stamps_ns, normals, PARTICLES, runs.resampled)


def whole_path(
    stamps_ns: NDArray[np.int64], clean_xyt: Array, model: MotionModel, within: Constraint, seed: int, run: int = 0
) -> FreePath:
    """Return one run of a known drive within free space, drawn increment by increment if that reaches the end.

    See `plan_path` for parameters.

    Raises
    ------
    MapError
        If map and drive do not match: much of the odometry is not free, no path is free, or the only free ones
        are far outside the noise.
    """
    require_free(within.space, clean_xyt[0])
    astray = 1.0 - float(np.mean(within.space.free(clean_xyt[:, :2])))
    if astray > _MOST_OUTSIDE:
        raise NoFreePoseError(f"{astray:.0%} of the odometry's own poses are not free")
    try:
        _refuse_held_back(FreePath(model, within, seed, run).feed(stamps_ns, clean_xyt))
    except NoFreePoseError:
        plan = plan_path(stamps_ns, clean_xyt, model, within, seed, run)
        _refuse_held_back(FreePath(model, within, seed, run, plan).feed(stamps_ns, clean_xyt))
        return FreePath(model, within, seed, run, plan)
    return FreePath(model, within, seed, run)


def _refuse_held_back(samples: PathSamples) -> None:
    """Raise NoFreePoseError if a path ends farther from the odometry than its noise explains."""
    meter = DriftMeter()
    meter.add(samples)
    drift = meter.result()
    if drift is not None and drift.end_drawn_m > _MOST_SIGMAS * drift.end_expected_m > 0.0:
        raise NoFreePoseError(
            f"within the map the odometry ends {drift.end_drawn_m:.3g} m from where it was recorded, and noise of this "
            f"model accounts for about {drift.end_expected_m:.2g} m"
        )


_SHORT, _LONG = 4, 1024
"""Increments drawn ahead: few after meeting a wall, more otherwise."""


class FreePath:
    """Source of one run's path within free space; see `FreeRuns` for the draws and their number.

    plan : normals of a path that is free as a whole, which are drawn first; None: the run's usual normals
    increments : number of increments so far
    redrawn : number of them that were not free at the first draw
    astray : number of odometry poses that are not free even without noise
    """

    def __init__(
        self, model: MotionModel, within: Constraint, seed: int, run: int = 0, plan: Plan | None = None
    ) -> None:
        self._plan, self._within, self._space = plan, within, within.space
        self._swing = swing_of(without_effects(model))
        self._reader = MotionReader(model)
        self._own, self._again = stream(seed, run, "noise"), stream(seed, run, "map")
        self._replay = _Replay()
        self._path = NoisyPath(model, seed, run, normals=self._replay)
        self.increments = self.redrawn = self.astray = 0
        self.restart()

    def restart(self) -> None:
        """Begin a new path: the next pose is a first pose, and unchanged."""
        self._reader.restart()
        self._path.restart()
        self._pose = np.zeros(3)
        self._ahead = _LONG

    def account(self) -> str:
        """Return the numbers of redrawn increments and poses outside, in one or two sentences."""
        said = f"Map: {self.redrawn} of {self.increments} increments were drawn again"
        if self._plan is not None:
            said += f"; one of {self._plan.particles} paths, resampled {self._plan.resampled} times"
        return (
            f"{said}. {self.astray} poses of the odometry are not free: check --map-pose" if self.astray else f"{said}."
        )

    def feed(self, stamps_ns: NDArray[np.int64], clean_xyt: Array) -> PathSamples:
        """Return the path at the next n poses; see `NoisyPath.feed`.

        Raises
        ------
        MapError
            If the first pose is not free, or no try of an increment ends in free space.
        """
        if not len(stamps_ns):
            return self._path.feed(stamps_ns, clean_xyt)
        first = not self._reader.begun
        if first:
            require_free(self._space, clean_xyt[0])
            self._pose = clean_xyt[0].copy()
        motions = self._reader.read(stamps_ns, clean_xyt)
        self.increments += len(stamps_ns) - first
        self.astray += int(np.count_nonzero(~self._space.free(clean_xyt[:, :2])))
        normals = self._own.standard_normal((len(stamps_ns), 4))
        if self._plan is not None:
            normals = self._plan.at(stamps_ns, normals)
        parts, done = [], 0
        while done < len(stamps_ns):
            rows = slice(done, done + self._ahead)
            part = self._free_prefix(stamps_ns[rows], motions, done, normals[rows])
            if not len(part):
                part = self._redraw_one(stamps_ns[rows][:1], motions, done)
            self._pose = part.clean_xyt[-1] + part.error_xyt[-1]
            parts.append(part)
            done += len(part)
        return _joined(parts)

    def _free_prefix(self, stamps_ns: NDArray[np.int64], motions: Motions, at: int, normals: Array) -> PathSamples:
        """Draw increments ahead, and keep those before the first one that is not free."""
        count = len(stamps_ns)
        clean_xyt = motions.clean_xyt[at + 1 : at + 1 + count]
        trial = copy.copy(self._path)
        self._replay.rows = normals
        samples = trial.feed(stamps_ns, clean_xyt)
        noisy_xy = clean_xyt[:, :2] + samples.error_xyt[:, :2]
        from_xy = np.concatenate((self._pose[None, :2], noisy_xy[:-1]))
        good = self._within.allows(from_xy, noisy_xy)
        good |= (motions.jump | motions.rest)[at : at + count]
        # a robot whose pose was set into a wall may leave it
        good |= ~self._space.free(from_xy)
        if good.all():
            self._path = trial
            self._ahead = min(2 * self._ahead, _LONG)
            return samples
        free = int(np.argmin(good))
        self._ahead = _SHORT
        self._replay.rows = normals[:free]
        return self._path.feed(stamps_ns[:free], clean_xyt[:free])

    def _redraw_one(self, stamp_ns: NDArray[np.int64], motions: Motions, at: int) -> PathSamples:
        """Draw one increment again whose first draw is not free."""
        self.redrawn += 1
        clean_xyt, step, sd = motions.clean_xyt[at + 1 : at + 2], motions.step[at], motions.sd[at]
        for count in rounds(self._within.tries):
            again = self._again.standard_normal((count, 4))
            candidates = moved(self._pose, step, again * sd, self._swing)
            from_xy = np.broadcast_to(self._pose[:2], (count, 2))
            for number in np.flatnonzero(self._within.allows(from_xy, candidates[:, :2])):
                trial = copy.copy(self._path)
                self._replay.rows = again[number : number + 1]
                samples = trial.feed(stamp_ns, clean_xyt)
                # at the edge of a cell rounding decides, and the path's own pose counts
                there_xy = clean_xyt[:, :2] + samples.error_xyt[:, :2]
                if self._within.allows(from_xy[:1], there_xy)[0]:
                    self._path = trial
                    return samples
        x, y = self._pose[:2]
        raise NoFreePoseError(
            f"at ({x:.2f} m, {y:.2f} m) none of {self._within.tries} tries ends where the map is free"
        )


class _Replay:
    """Source of previously chosen normals for the next increments."""

    def __init__(self) -> None:
        self.rows = np.zeros((0, 4))

    def standard_normal(self, size: tuple[int, int]) -> Array:
        """Return the chosen rows, as many as requested."""
        return self.rows.reshape(size)


def _joined(parts: list[PathSamples]) -> PathSamples:
    if len(parts) == 1:
        return parts[0]
    return PathSamples(
        np.concatenate([part.stamps_ns for part in parts]),
        np.concatenate([part.clean_xyt for part in parts]),
        np.concatenate([part.error_xyt for part in parts]),
        np.concatenate([part.sums for part in parts], axis=1),
        parts[0].origin_xy,
        np.concatenate([part.travelled_m for part in parts]),
        sum(part.jumps for part in parts),
        sum(part.sideways_m for part in parts),
    )


OCCUPIED_PERCENT, FREE_PERCENT = 65, 25
"""Values of an OccupancyGrid from which a cell is occupied, and up to which it is free: map_server's thresholds."""


class RecordedMap(NamedTuple):
    """A map and the frame it is in."""

    grid: Grid
    frame_id: str


def read_recorded_map(path: Path, topic: str, *, recover: bool = False) -> RecordedMap:
    """Read the last nav_msgs/OccupancyGrid of a topic."""
    latest: tuple[bytes, str, str] | None = None
    with open_reader(path, recover=recover) as reader:
        channels = [c for c in reader.channels.values() if c.topic.lstrip("/") == topic.lstrip("/")]
        if not channels or channels[0].msgtype != GRID:
            found = ", ".join(sorted({c.topic for c in reader.channels.values() if c.msgtype == GRID})) or "none"
            raise TopicError(
                f"{reader.name}: no nav_msgs/OccupancyGrid on {topic} (found {found}); name another, or a map's .yaml"
            )
        for block in reader.blocks():
            for channel in channels:
                rows = block.table[block.table["channel"] == channel.id]
                if len(rows):
                    start, size = rows[-1]["offset"], rows[-1]["length"]
                    latest = block.data[start : start + size].tobytes(), channel.topic, channel.encoding
        name = reader.name
    if latest is None:
        raise MapError(f"{name}: {topic} holds no map; name a map's .yaml instead")
    message = read_grid(*latest)
    cells = np.full(message.cells.shape, UNKNOWN, dtype=np.uint8)
    cells[(message.cells >= 0) & (message.cells <= FREE_PERCENT)] = FREE
    cells[message.cells >= OCCUPIED_PERCENT] = OCCUPIED
    return RecordedMap(Grid(cells, message.resolution_m, message.origin_xyt), message.frame_id)


def read_map_from_odom(path: Path, map_frame: str, odom_frame: str, *, recover: bool = False) -> Array | None:
    """Return the pose (3,) of the odom frame in the map from the first transforms of a bag; None if TF has none."""
    tree = FrameTree()
    with open_reader(path, recover=recover) as reader:
        for block in reader.blocks():
            tree.take(block, reader.channels.values())
            pose = tree.pose(map_frame, odom_frame)
            if pose is not None:
                return pose
    return None


def read_odom_frame(path: Path, options: Options, learned_from: str | None = None, *, recover: bool = False) -> str:
    """Return the frame of a bag's odometry, from its first message.

    learned_from : topic of the odometry if the bag has several: the one that the model was learned from

    Raises
    ------
    TopicError
        If the bag has no odometry.
    """
    source = OdometrySource(options.odom_topic, options.odom_frame, options.base_frame, learned_from)
    with open_reader(path, recover=recover) as reader:
        source.prepare(reader, reader.name)
        for block in reader.blocks():
            channels = [reader.channels[int(number)] for number in np.unique(block.table["channel"])]
            wanted = [c for c in channels if c.encoding in ENCODINGS and c.msgtype in (ODOMETRY, *TRANSFORMS)]
            source.read(block, [(c, layout) for c in wanted for layout in locate(block, c)], block.table["log_ns"])
            if source.frames is not None:
                return source.frames.odom
        raise TopicError(f"{reader.name}: {source.name} has no message with a pose{source.elsewhere}")


@dataclass(frozen=True, slots=True)
class MapCondition(Constraint):
    """Constraint on the motions of a corruption by a map, recorded in its output."""

    def path(self, model: MotionModel, seed: int, run: int, drive: CleanDrive | None = None) -> FreePath | None:
        """Return the path of one run within the free space; None if no noise is drawn, and nothing moves.

        drive : odometry, required to draw whole paths; None if unknown
        """
        if without_effects(model).noise.coefficients.noise_free:
            return None
        if drive is None:
            return FreePath(model, self, seed, run)
        return whole_path(drive.stamps_ns, drive.xyt, model, self, seed, run)

    def provenance(self) -> dict[str, str]:
        """Return the map's record for an output: a hash of the blocked cells, without a file name."""
        grid = self.space.grid
        digest = hashlib.sha256(self.space.blocked.tobytes())
        digest.update(repr((self.space.blocked.shape, grid.resolution_m, grid.origin_xyt.tolist())).encode())
        pose = ",".join(repr(float(value)) for value in self.space.map_from_odom)
        words = f"{self.check}, {self.tries} tries, odom at {pose}, blocked cells {digest.hexdigest()[:16]}"
        return {"map": words}


def is_map_file(name: str) -> bool:
    """Tell whether a name is that of a map's .yaml file, instead of a topic."""
    return name.endswith((".yaml", ".yml"))


def read_condition(
    name: str,
    *,
    bag: Path | None = None,
    odom_frame: str = "odom",
    map_pose: Sequence[float] | None = None,
    radius_m: float = 0.2,
    unknown: Literal["blocked", "free"] = "blocked",
    check: Check = "endpoint",
    tries: int = 100,
    recover: bool = False,
) -> MapCondition:
    """Return the condition of a map: its free space for a robot, placed in the odom frame.

    name : a map's .yaml file, or a topic of the bag
    bag : source of the topic, and of the pose of odom in the map
    odom_frame : frame of the odometry
    map_pose : (3,) pose of the odom frame in the map, metres and radians; by default from TF in the bag, or zero
        without a bag
    radius_m : radius of the robot, metres
    unknown : "free" if the robot may be in unknown cells, else "blocked"
    check : whether only the end of a motion must be free, "endpoint", or all of it, "path"
    tries : largest number of draws per motion
    recover : whether to read the undamaged part of a damaged bag

    Raises
    ------
    MapError
        If the map cannot be read, or the pose of odom in it is unknown.
    """
    frame = "map"
    if is_map_file(name):
        grid = read_map(Path(name))
    elif bag is None:
        raise MapError(f"{name}: without a bag a map is a .yaml file; name one")
    else:
        grid, frame = read_recorded_map(bag, name, recover=recover)
    pose = np.zeros(3) if map_pose is None else np.array(map_pose, dtype=np.float64)
    if map_pose is None and bag is not None and frame.lstrip("/") != odom_frame.lstrip("/"):
        found = read_map_from_odom(bag, frame, odom_frame, recover=recover)
        if found is None:
            raise MapError(
                f"{bag}: TF has nothing between {frame!r} and {odom_frame!r}; give the pose of odom in the map with "
                "--map-pose x,y,yaw (0,0,0 where they are the same)"
            )
        pose = found
    return MapCondition(free_space(grid, radius_m, unknown=unknown, map_from_odom=pose), check, tries)
