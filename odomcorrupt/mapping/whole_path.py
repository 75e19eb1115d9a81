"""Normals of a noisy path that is free from its beginning to its end, drawn as a particle filter draws paths.

Drawn increment by increment, a path can end in a pocket of the map from which no increment leads. So many variants of a
run are drawn side by side, those that are stuck are replaced by copies of others, and one that reached the end is taken
with its whole past. What is held in memory are the beginnings of blocks; a block is drawn twice, the second time from
the end, to follow the ancestors of the path that was taken.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.corruption.drift import DriftMeter
from odomcorrupt.mapping.conditioned import MAX_TRIES
from odomcorrupt.mapping.conditioned_runs import FreeRuns
from odomcorrupt.mapping.constrained_increments import NoFreePoseError
from odomcorrupt.mapping.constrained_path import FreePath
from odomcorrupt.rng import stream

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from odomcorrupt.corruption.path import PathSamples
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.mapping.free_space import Check, FreeSpace
    from odomcorrupt.model.motion_model import MotionModel

__all__ = ["PARTICLES", "Plan", "plan_path", "whole_path"]

PARTICLES = 64
_BLOCK = 1024
_TOO_FAR = 6.0
"""A drift at the end of more than so many of its standard deviations is the map's doing and not the noise's."""


@dataclass(frozen=True, slots=True)
class Plan:
    """Normals of a path that is free as a whole.

    stamps_ns : (n,) of the poses that the increments end at
    normals : (n, 4) of rot1, trans, across and rot2
    particles, resampled : how many paths were drawn side by side, and how often one was replaced
    """

    stamps_ns: NDArray[np.int64]
    normals: Array
    particles: int
    resampled: int

    def at(self, stamps_ns: NDArray[np.int64], otherwise: Array) -> Array:
        """Return the normals (m, 4) of increments that end at stamps (m,); for unknown stamps those given instead."""
        place = np.minimum(np.searchsorted(self.stamps_ns, stamps_ns), len(self.stamps_ns) - 1)
        known = self.stamps_ns[place] == stamps_ns
        return np.where(known[:, None], self.normals[place], otherwise)


def plan_path(
    stamps_ns: NDArray[np.int64],
    clean_xyt: Array,
    model: MotionModel,
    space: FreeSpace,
    *,
    seed: int,
    run: int = 0,
    check: Check = "endpoint",
    tries: int = MAX_TRIES,
) -> Plan:
    """Return the normals of a path that is free as a whole.

    Parameters
    ----------
    stamps_ns, clean_xyt : (n,) and (n, 3)
        The odometry, nanoseconds, metres and radians.

    Raises
    ------
    MapError
        Where the drive's first pose is not free, or all paths are stuck at one place.

    """
    runs = FreeRuns(model, space, seed=seed, runs=range(run, run + 1), check=check, tries=tries, particles=PARTICLES)
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
    stamps_ns: NDArray[np.int64],
    clean_xyt: Array,
    model: MotionModel,
    space: FreeSpace,
    *,
    seed: int,
    run: int = 0,
    check: Check = "endpoint",
    tries: int = MAX_TRIES,
) -> FreePath:
    """Return where one run of a known drive goes within free space; increment by increment where that reaches the end.

    See `plan_path` for parameters.

    Raises
    ------
    MapError
        Where the map and the drive do not fit: no path is free, or the only free ones are far from what noise does.

    """
    try:
        samples = FreePath(model, space, seed=seed, run=run, check=check, tries=tries).feed(stamps_ns, clean_xyt)
        _refuse_held_back(samples)
    except NoFreePoseError:
        plan = plan_path(stamps_ns, clean_xyt, model, space, seed=seed, run=run, check=check, tries=tries)
        trial = FreePath(model, space, seed=seed, run=run, check=check, tries=tries, plan=plan)
        _refuse_held_back(trial.feed(stamps_ns, clean_xyt))
        return FreePath(model, space, seed=seed, run=run, check=check, tries=tries, plan=plan)
    return FreePath(model, space, seed=seed, run=run, check=check, tries=tries)


def _refuse_held_back(samples: PathSamples) -> None:
    """Raise NoFreePoseError where a path ends further from the odometry than its noise leads."""
    meter = DriftMeter()
    meter.add(samples)
    drift = meter.result()
    if drift is not None and drift.end_drawn_m > _TOO_FAR * drift.end_expected_m > 0.0:
        raise NoFreePoseError(
            f"the map and the drive do not fit: within the map the odometry ends {drift.end_drawn_m:.3g} m from where "
            f"it was recorded, and noise of this model makes about {drift.end_expected_m:.2g} m; check --map-pose, "
            "--robot-radius and --unknown, or leave out --map"
        )
