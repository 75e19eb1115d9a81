"""Noisy path of one run that never enters a wall, for `--map`.

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
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.corruption.drift import DriftMeter
from odomcorrupt.corruption.path import NoisyPath, PathSamples
from odomcorrupt.mapping.conditioned_runs import (
    FreeRuns,
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
    from odomcorrupt.mapping.conditioned_runs import Motions
    from odomcorrupt.mapping.free_space import Constraint
    from odomcorrupt.model.motion_model import MotionModel

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
