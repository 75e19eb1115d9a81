"""Noisy paths of a whole drive that never enter a wall: many runs at once, one increment after the other."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.corrupt.steps import StepGrowth, noise_variances
from odomcorrupt.errors import MapError, ModelError
from odomcorrupt.increments import increments
from odomcorrupt.mapping.conditioned import MAX_TRIES
from odomcorrupt.rng import stream

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from odomcorrupt.mapping.free_space import Check, FreeSpace
    from odomcorrupt.model import MotionModel
    from odomcorrupt.pose import Array

__all__ = ["FreePaths", "free_paths"]

_AT_ONCE = 1024
"""Increments whose normals are drawn together; drawn row by row, so it changes no number."""

_FIRST_TRIES = 12


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
    """Draw runs of a drive within free space.

    Every increment is first drawn with the numbers that corruption draws for that run; where the pose it leads to is
    not free, it is drawn again from a stream of its own. So a run that meets no wall is the unconditioned run, and
    a run is the same however many others are drawn.

    Parameters
    ----------
    stamps_ns, clean_xyt
        (n,) and (n, 3), the odometry.
    model
        Noise only: effects are no draws, and cannot be drawn again.
    places
        (k,) which of the n poses to return.

    """
    if model.effects:
        raise ModelError(f"--map: {model.effects[0].name} is no noise and cannot be drawn again; leave effects out")
    if not space.free(clean_xyt[:1, :2])[0]:
        x, y = clean_xyt[0, :2]
        raise MapError(
            f"the drive begins at ({x:.3f} m, {y:.3f} m), which the map does not leave free for this robot; check "
            "--map-pose and --robot-radius"
        )
    steps = increments(clean_xyt)
    dt_s = np.diff(stamps_ns) * np.float64(1e-9)
    v = noise_variances(model.noise, steps, dt_s, StepGrowth()).variances
    walk = _Walk(space, check, tries, [stream(seed, run, "map") for run in runs], 0.5 if model.noise.law.arc else 1.0)
    own = [stream(seed, run, "noise") for run in runs]
    for rng in own:
        rng.standard_normal(4)  # corruption draws for the first pose too, and leaves it
    bearing = np.arctan2(steps.dl_m, steps.ds_m) * model.noise.law.along_travel
    sd = np.sqrt(np.stack((v.rot1, v.trans, v.across, v.rot2), axis=1))
    pose = np.repeat(clean_xyt[:1], len(runs), axis=0)
    out = np.empty((len(runs), len(places), 3))
    wanted: dict[int, list[int]] = {}
    for column, place in enumerate(places.tolist()):
        wanted.setdefault(place, []).append(column)
    out[:, wanted.get(0, [])] = pose[:, None]
    for begin in range(0, len(steps), _AT_ONCE):
        part = range(begin, min(begin + _AT_ONCE, len(steps)))
        normals = np.stack([rng.standard_normal((len(part), 4)) for rng in own], axis=1)
        for i in part:
            step = np.array([steps.ds_m[i], steps.dl_m[i], steps.dtheta_rad[i], bearing[i]])
            pose = walk.on(pose, step, sd[i], normals[i - begin])
            if i + 1 in wanted:
                out[:, wanted[i + 1]] = pose[:, None]
    return FreePaths(out, walk.redrawn, walk.blocked, len(steps) * len(runs), tries)


class _Walk:
    """Takes many robots one increment further."""

    def __init__(
        self, space: FreeSpace, check: Check, tries: int, again: list[np.random.Generator], swing: float
    ) -> None:
        self._space, self._check, self._tries, self._again, self._swing = space, check, tries, again, swing
        self.redrawn = self.blocked = 0

    def on(self, pose: Array, step: Array, sd: Array, normals: Array) -> Array:
        """Return poses (runs, 3) after an increment with normals (runs, 4) of rot1, trans, across, rot2."""
        ahead = self._moved(pose, step, normals * sd)
        if not (sd.any() or step[:3].any()):
            return ahead
        stuck = np.flatnonzero(~self._space.allows(pose[:, :2], ahead[:, :2], self._check))
        self.redrawn += len(stuck)
        left = self._tries - 1
        # a few tries are mostly enough, and a robot that is stuck takes all
        for count in (min(_FIRST_TRIES, left), max(left - _FIRST_TRIES, 0)):
            if len(stuck) and count:
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
        candidates = self._moved(origin, step, noise)
        good = self._space.allows(origin[:, :2], candidates[:, :2], self._check).reshape(-1, count)
        found = good.any(axis=1)
        first = np.argmax(good, axis=1)
        ahead[stuck[found]] = candidates.reshape(-1, count, 3)[found, first[found]]
        return stuck[~found]

    def _moved(self, pose: Array, step: Array, noise: Array) -> Array:
        ds, dl, turn, bearing = step
        along = noise[:, 1] * np.cos(bearing) - noise[:, 2] * np.sin(bearing) + ds
        across = noise[:, 1] * np.sin(bearing) + noise[:, 2] * np.cos(bearing) + dl
        heading = pose[:, 2] + self._swing * noise[:, 0] + turn / 2.0
        c, s = np.cos(heading), np.sin(heading)
        return np.column_stack(
            (
                pose[:, 0] + c * along - s * across,
                pose[:, 1] + s * along + c * across,
                pose[:, 2] + turn + noise[:, 0] + noise[:, 3],
            )
        )
