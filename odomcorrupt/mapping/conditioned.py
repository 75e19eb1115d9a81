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

from odomcorrupt.bags.open import open_reader
from odomcorrupt.corruption.odometry_source import OdometrySource, plain
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
from odomcorrupt.geometry.se2 import Increments, compose, increments, inverse, rotated
from odomcorrupt.mapping.messages import GRID, FrameTree, read_grid
from odomcorrupt.mapping.occupancy_grid import FREE, OCCUPIED, UNKNOWN, Check, Constraint, Grid, free_space, read_map
from odomcorrupt.rng import stream

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from odomcorrupt.corruption.transform import Options
    from odomcorrupt.forecasting import CleanDrive
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.mapping.occupancy_grid import FreeSpace
    from odomcorrupt.model.motion_model import MotionModel


_FIRST_TRIES = 12
"""Number of tries that are drawn first and usually suffice; a stuck robot needs all."""


class NoFreePoseError(MapError):
    """No path in free space explains a drive."""

    def __init__(self, why: str) -> None:
        way_out = "check --map-pose, --robot-radius and --unknown, or leave out --map"
        super().__init__(f"the map and the drive do not match: {why}; {way_out}")


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


def walked(pose: Array, steps: Array, noise: Array, swing: float) -> Array:
    """Return the poses (k, n, 3) of n robots after each of k increments.

    pose : (n, 3) or (3,) poses before them; steps : (k, 4), see `Motions`; noise : (k, n, 4) errors added to them
    swing : fraction of rot1 that precedes an increment's translation: half of it on an arc
    """
    ds, dl, turn, bearing = np.ascontiguousarray(steps.T)[:, :, None]
    rot1, trans, aside, rot2 = np.moveaxis(noise, -1, 0)
    along = trans * np.cos(bearing) - aside * np.sin(bearing) + ds
    across = trans * np.sin(bearing) + aside * np.cos(bearing) + dl
    first: Array = np.broadcast_to(pose, (1, noise.shape[1], 3))
    theta = np.cumsum(np.concatenate((first[..., 2], turn + rot1 + rot2)), axis=0)
    x, y = rotated(along, across, theta[:-1] + swing * rot1 + turn / 2.0)
    place = [np.cumsum(np.concatenate((first[..., i], way)), axis=0)[1:] for i, way in enumerate((x, y))]
    return np.stack((*place, theta[1:]), axis=-1)


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


_SHORT, _LONG = 4, 1024
"""Increments drawn ahead: few after meeting a wall, more otherwise."""


class FreeRuns:
    """Runs of a drive that stay in free space, fed with the odometry batch by batch.

    Every increment is first drawn with the random numbers that corruption uses for that run. If its end is not free,
    it is drawn again from a separate stream. A run that meets no wall therefore equals the unconditioned run. Unless
    resampled, a run does not depend on the number of runs or on the division of the odometry into batches.

    particles : 0, or the number of variants of a single run, drawn instead of runs. They are redrawn only if all are
        stuck, else copied: the distribution is that of whole free paths, not of increments (section 4.3 of the book)
    plan : normals of a path that is free as a whole, which are drawn first; None: each run's usual normals
    redrawn : number of increments so far that were not free at the first draw
    resampled : number of times a run without a free try was replaced by a copy of another one
    """

    def __init__(
        self,
        model: MotionModel,
        within: Constraint,
        *,
        seed: int,
        runs: range,
        particles: int = 0,
        plan: Plan | None = None,
    ) -> None:
        self._noise, self._within, self._plan, self._whole = without_effects(model).noise, within, plan, bool(particles)
        self._swing = 0.5 if self._noise.law.arc else 1.0
        keys = [(run, 0) for run in runs] if not particles else [(runs.start, number) for number in range(particles)]
        self._own = [stream(seed, run, "noise", number) for run, number in keys]
        self._again = [stream(seed, run, "map", number) for run, number in keys]
        self._choose = stream(seed, runs.start, "map resampling")
        self.redrawn = self.resampled = 0
        self.restart()

    def restart(self) -> None:
        """Begin a new path: the next pose is a first pose, and unchanged."""
        self._growth = StepGrowth()
        self._last: tuple[int, Array] | None = None
        self._pose = np.zeros((0, 3))
        self._ahead = _LONG

    @property
    def begun(self) -> bool:
        """Whether a first pose was fed."""
        return self._last is not None

    def feed(self, stamps_ns: NDArray[np.int64], clean_xyt: Array) -> Walked:
        """Return the runs at the next n poses, n > 0; stamps ascend. See `NoisyPath.feed`.

        Raises
        ------
        MapError
            If the first pose is not free, or an increment has no free try in any run.
        """
        if self._last is None:
            require_free(self._within.space, clean_xyt[0])
            self._pose = np.repeat(clean_xyt[:1], len(self._own), axis=0)
        motions, pose, count = self._motions(stamps_ns, clean_xyt), self._pose, len(clean_xyt)
        normals = np.stack([rng.standard_normal((count, 4)) for rng in self._own], axis=1)
        if self._plan is not None:
            normals[:, 0] = self._plan.at(stamps_ns, normals[:, 0])
        out = np.empty((len(pose), count, 3))
        every = np.arange(len(pose))
        parents = np.tile(every, (count, 1))
        ancestors = every
        jumps = np.append(np.flatnonzero(motions.jump), count)
        i = 0
        while i < count:
            if motions.jump[i]:
                pose = compose(compose(pose, inverse(motions.clean_xyt[i])), motions.clean_xyt[i + 1])
            else:
                rows = slice(i, min(i + self._ahead, int(jumps[np.searchsorted(jumps, i)])))
                ahead, stuck = self._first_draw(pose, motions, rows, normals[rows])
                out[:, i : i + len(ahead)] = np.swapaxes(ahead, 0, 1)
                i, pose = i + len(ahead), ahead[-1] if len(ahead) else pose
                self._ahead = min(2 * self._ahead, _LONG)
                if not len(stuck):
                    continue
                self._ahead = _SHORT
                pose, parents[i] = self._redrawn(pose, motions, i, stuck, normals[i])
                if (parents[i] != every).any():
                    out[:, :i], ancestors = out[parents[i], :i], ancestors[parents[i]]
            out[:, i] = pose
            i += 1
        self._pose = pose
        return Walked(out, ancestors, parents, normals)

    def _motions(self, stamps_ns: NDArray[np.int64], clean_xyt: Array) -> Motions:
        """Return the motions that end at the next n poses (n, 3); a first pose ends an empty motion."""
        before_ns, before_xyt = (int(stamps_ns[0]), clean_xyt[0]) if self._last is None else self._last
        poses: Array = np.concatenate((before_xyt[None], clean_xyt))
        dt_s = np.diff(stamps_ns, prepend=before_ns) * np.float64(1e-9)
        travel = np.hypot(*np.diff(poses[:, :2], axis=0).T)
        jump = travel > JUMP_SPEED * np.maximum(dt_s, JUMP_MIN_S)
        steps = Increments.of_rows(np.where(jump[:, None], 0.0, increments(poses).rows))
        v, self._growth = noise_variances(self._noise, steps, np.where(jump, 0.0, dt_s), self._growth)
        sd = np.sqrt(np.stack((v.rot1, v.trans, v.across, v.rot2), axis=1))
        bearing = np.arctan2(steps.dl_m, steps.ds_m) * self._noise.law.along_travel
        self._last = int(stamps_ns[-1]), clean_xyt[-1].copy()
        return Motions(poses, jump, np.column_stack((steps.rows, bearing)), sd)

    def _first_draw(self, pose: Array, motions: Motions, rows: slice, normals: Array) -> tuple[Array, NDArray[np.intp]]:
        """Return poses (k, runs, 3) before the first increment that is not free in every run, and the runs stuck."""
        drawn = walked(pose, motions.step[rows], normals * motions.sd[rows, None], self._swing)
        from_xy = np.concatenate((pose[None], drawn[:-1]))[..., :2].reshape(-1, 2)
        bad = ~self._within.allows(from_xy, drawn[..., :2].reshape(-1, 2))
        # a robot whose pose was set into a wall may leave it
        bad &= self._within.space.free(from_xy)
        bad = bad.reshape(drawn.shape[:2]) & ~motions.rest[rows, None]
        if not bad.any():
            return drawn, np.zeros(0, dtype=np.intp)
        first = int(np.argmax(bad.any(axis=1)))
        return drawn[:first], np.flatnonzero(bad[first])

    def _redrawn(
        self, pose: Array, motions: Motions, i: int, stuck: NDArray[np.intp], normals: Array
    ) -> tuple[Array, NDArray[np.intp]]:
        """Return poses (runs, 3) after increment i, drawn again for stuck runs, and the run each is a copy of.

        normals : (runs, 4); replaced by those of the tries that were accepted
        """
        step, sd, tries = motions.step[i : i + 1], motions.sd[i], self._within.tries
        parents: NDArray[np.intp] = np.arange(len(pose))
        self.redrawn += len(stuck)
        rounds = min(_FIRST_TRIES, tries - 1), tries - 1 - _FIRST_TRIES
        for count in rounds if not self._whole or len(stuck) == len(pose) else ():
            if count <= 0 or not len(stuck):
                break
            again = np.stack([self._again[run].standard_normal((count, 4)) for run in stuck])
            origin = np.repeat(pose[stuck], count, axis=0)
            drawn = walked(origin, step, (again * sd).reshape(1, -1, 4), self._swing)[0]
            good = self._within.allows(origin[:, :2], drawn[:, :2]).reshape(-1, count)
            found, first = good.any(axis=1), np.argmax(good, axis=1)
            normals[stuck[found]] = again[found, first[found]]
            stuck = stuck[~found]
        if len(stuck):
            alive = np.setdiff1d(parents, stuck)
            if not len(alive):
                x, y = pose[:, :2].mean(axis=0)
                paths = f" of any of {len(pose)} paths" if len(pose) > 1 else ""
                raise NoFreePoseError(
                    f"at ({x:.2f} m, {y:.2f} m) none of {tries} tries{paths} ends where the map is free"
                )
            self.resampled += len(stuck)
            parents[stuck] = alive[self._choose.integers(len(alive), size=len(stuck))]
        return walked(pose, step, (normals * sd)[None], self._swing)[0][parents], parents


PARTICLES = 64


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
    for begin in range(0, len(stamps_ns), _AT_ONCE):
        beginnings.append(copy.deepcopy(runs, {id(within): within}))
        runs.feed(stamps_ns[begin : begin + _AT_ONCE], clean_xyt[begin : begin + _AT_ONCE])
    taken = int(stream(seed, run, "map path").integers(PARTICLES))
    normals = np.empty((len(stamps_ns), 4))
    for number in range(len(beginnings) - 1, -1, -1):
        part = slice(number * _AT_ONCE, (number + 1) * _AT_ONCE)
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
    # fraction of odometry poses outside free space above which map and recording do not belong together
    if astray > 0.25:
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
    # drift at the end, in standard deviations, above which it is attributed to the map instead of the noise
    if drift is not None and drift.end_drawn_m > 6.0 * drift.end_expected_m > 0.0:
        raise NoFreePoseError(
            f"within the map the odometry ends {drift.end_drawn_m:.3g} m from where it was recorded, and noise of this "
            f"model accounts for about {drift.end_expected_m:.2g} m"
        )


class FreePath:
    """Source of one run's path within free space; see `FreeRuns` for the draws and their number.

    increments : number of increments so far
    astray : number of odometry poses that are not free even without noise
    """

    def __init__(
        self, model: MotionModel, within: Constraint, seed: int, run: int = 0, plan: Plan | None = None
    ) -> None:
        self._plan, self._space = plan, within.space
        self._runs = FreeRuns(model, within, seed=seed, runs=range(run, run + 1), plan=plan)
        self._accepted = np.zeros((0, 4))
        self._path = NoisyPath(model, seed, run, normals=lambda _: self._accepted)
        self.increments = self.astray = 0

    @property
    def redrawn(self) -> int:
        """Number of increments that were not free at the first draw."""
        return self._runs.redrawn

    def restart(self) -> None:
        """Begin a new path: the next pose is a first pose, and unchanged."""
        self._runs.restart()
        self._path.restart()

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
        if len(stamps_ns):
            self.increments += len(stamps_ns) - (not self._runs.begun)
            self._accepted = self._runs.feed(stamps_ns, clean_xyt).normals[:, 0]
            self.astray += int(np.count_nonzero(~self._space.free(clean_xyt[:, :2])))
        return self._path.feed(stamps_ns, clean_xyt)


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
        channels = [c for c in reader.channels.values() if plain(c.topic) == plain(topic)]
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
            source.read_block(block, reader)
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
    if map_pose is None and bag is not None and plain(frame) != plain(odom_frame):
        found = read_map_from_odom(bag, frame, odom_frame, recover=recover)
        if found is None:
            raise MapError(
                f"{bag}: TF has nothing between {frame!r} and {odom_frame!r}; give the pose of odom in the map with "
                "--map-pose x,y,yaw (0,0,0 where they are the same)"
            )
        pose = found
    return MapCondition(free_space(grid, radius_m, unknown=unknown, map_from_odom=pose), check, tries)
