"""The noisy path of one run that never enters a wall: what `--map` puts in the place of the noisy path.

Most increments are free at their first draw. So a piece of the path is drawn as ever and asked for its first pose that
is not free; up to there it stands, that one increment is drawn again, and the next piece begins behind it. A run that
meets no wall has the bits that it has without a map.
"""

from __future__ import annotations

import copy
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.corruption.path import NoisyPath, PathSamples
from odomcorrupt.mapping.conditioned import MAX_TRIES
from odomcorrupt.mapping.constrained_increments import (
    MotionReader,
    NoFreePoseError,
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
    from odomcorrupt.mapping.constrained_increments import Motions
    from odomcorrupt.mapping.free_space import Check, FreeSpace
    from odomcorrupt.mapping.whole_path import Plan
    from odomcorrupt.model.motion_model import MotionModel

__all__ = ["FreePath"]

_SHORT, _LONG = 4, 1024
"""Increments drawn ahead: few after a wall was met, more while none is."""


class FreePath:
    """Says where odometry goes within free space; see `FreeRuns` for what is drawn, and how often.

    plan : normals of a path that is free as a whole, which are drawn first; None: the run's own
    increments : how many were driven so far
    redrawn : of these, not free at the first draw
    astray : odometry poses, without any noise, that are not free themselves
    """

    def __init__(
        self,
        model: MotionModel,
        space: FreeSpace,
        *,
        seed: int,
        run: int = 0,
        check: Check = "endpoint",
        tries: int = MAX_TRIES,
        plan: Plan | None = None,
    ) -> None:
        self._plan = plan
        self._space, self._check, self._tries = space, check, tries
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
        """Return what it took, in one or two sentences."""
        said = f"Map: {self.redrawn} of {self.increments} increments were drawn again"
        if self._plan is not None:
            said += f"; the whole path is one of {self._plan.particles}, resampled {self._plan.resampled} times"
        if self.astray:
            said += f". The odometry itself is where the map is not free at {self.astray} poses; is --map-pose right?"
        return said if self.astray else f"{said}."

    def feed(self, stamps_ns: NDArray[np.int64], clean_xyt: Array) -> PathSamples:
        """Return the path at the next n poses; see `NoisyPath.feed`.

        Raises
        ------
        MapError
            Where the first pose is not free, or no try of an increment ends where the map is free.

        """
        if not len(stamps_ns):
            return self._path.feed(stamps_ns, clean_xyt)
        first = not self._reader.begun
        if first:
            must_be_free(self._space, clean_xyt[0])
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
            part = self._as_far_as_free(stamps_ns[rows], motions, done, normals[rows])
            if not len(part):
                part = self._one_again(stamps_ns[rows][:1], motions, done)
            self._pose = part.clean_xyt[-1] + part.error_xyt[-1]
            parts.append(part)
            done += len(part)
        return _joined(parts)

    def _as_far_as_free(self, stamps_ns: NDArray[np.int64], motions: Motions, at: int, normals: Array) -> PathSamples:
        """Draw increments ahead, and go on those that come before the first one that is not free."""
        count = len(stamps_ns)
        clean_xyt = motions.clean_xyt[at + 1 : at + 1 + count]
        trial = copy.copy(self._path)
        self._replay.rows = normals
        samples = trial.feed(stamps_ns, clean_xyt)
        noisy_xy = clean_xyt[:, :2] + samples.error_xyt[:, :2]
        from_xy = np.concatenate((self._pose[None, :2], noisy_xy[:-1]))
        good = self._space.allows(from_xy, noisy_xy, self._check)
        good |= (motions.jump | motions.rest)[at : at + count]
        # a robot whose pose was set into a wall is let out of it
        good |= ~self._space.free(from_xy)
        if good.all():
            self._path = trial
            self._ahead = min(2 * self._ahead, _LONG)
            return samples
        free = int(np.argmin(good))
        self._ahead = _SHORT
        self._replay.rows = normals[:free]
        return self._path.feed(stamps_ns[:free], clean_xyt[:free])

    def _one_again(self, stamp_ns: NDArray[np.int64], motions: Motions, at: int) -> PathSamples:
        """Go on one increment whose first draw is not free."""
        self.redrawn += 1
        clean_xyt, step, sd = motions.clean_xyt[at + 1 : at + 2], motions.step[at], motions.sd[at]
        for count in rounds(self._tries):
            again = self._again.standard_normal((count, 4))
            candidates = moved(self._pose, step, again * sd, self._swing)
            from_xy = np.broadcast_to(self._pose[:2], (count, 2))
            for number in np.flatnonzero(self._space.allows(from_xy, candidates[:, :2], self._check)):
                trial = copy.copy(self._path)
                self._replay.rows = again[number : number + 1]
                samples = trial.feed(stamp_ns, clean_xyt)
                # on the edge of a cell the last bit decides, and the path's own counts
                there_xy = clean_xyt[:, :2] + samples.error_xyt[:, :2]
                if self._space.allows(from_xy[:1], there_xy, self._check)[0]:
                    self._path = trial
                    return samples
        x, y = self._pose[:2]
        raise NoFreePoseError(
            f"the map and the drive do not fit: at ({x:.2f} m, {y:.2f} m) none of {self._tries} tries ends where the "
            "map is free; check --map-pose, --robot-radius and --unknown, or leave out --map. A drive in a file is "
            "drawn as whole paths, one on a pipe is not"
        )


class _Replay:
    """Hands out the normals that were chosen for the next increments."""

    def __init__(self) -> None:
        self.rows = np.zeros((0, 4))

    def standard_normal(self, size: tuple[int, int]) -> Array:
        """Return the rows, which are as many as are asked for."""
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
