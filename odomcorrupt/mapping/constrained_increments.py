"""Increments of a drive with their noise, in the form in which a map constrains and redraws them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.corruption.path import JUMP_MIN_S, JUMP_SPEED, StepGrowth, noise_variances
from odomcorrupt.errors import MapError, ModelError
from odomcorrupt.geometry.increments import Increments, increments

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.mapping.free_space import FreeSpace
    from odomcorrupt.model.motion_model import MotionModel

__all__ = ["FIRST_TRIES", "MotionReader", "Motions", "NoFreePoseError", "moved", "require_free", "rounds", "swing_of",
           "without_effects"]  # fmt: skip

FIRST_TRIES = 12
"""Number of tries of the first round, usually sufficient; a stuck robot needs all rounds."""


class NoFreePoseError(MapError):
    """No try of an increment ended in free space."""


def rounds(tries: int) -> tuple[int, ...]:
    """Return the numbers of simultaneous tries, round by round, after a first draw that was not free."""
    left = tries - 1
    return tuple(count for count in (min(FIRST_TRIES, left), left - FIRST_TRIES) if count > 0)


def without_effects(model: MotionModel) -> MotionModel:
    """Return a model that a map can constrain; ModelError if it has acting effects."""
    acting = [effect.name for effect in model.effects if effect.acts]
    if acting:
        raise ModelError(f"--map: {acting[0]} is no noise and cannot be drawn again; leave out effects, or --map")
    return model


def require_free(space: FreeSpace, first_xyt: Array) -> None:
    """Raise MapError if a drive's first pose (3,) is not free."""
    if not space.free(first_xyt[None, :2])[0]:
        x, y = first_xyt[:2]
        raise MapError(
            f"the drive begins at ({x:.3f} m, {y:.3f} m), which the map does not leave free for this robot; check "
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
        steps = Increments(*(np.where(jump, 0.0, part) for part in (whole.ds_m, whole.dl_m, whole.dtheta_rad)))
        grown = noise_variances(self._noise, steps, np.where(jump, 0.0, dt_s), self._growth)
        v = grown.variances
        sd = np.sqrt(np.stack((v.rot1, v.trans, v.across, v.rot2), axis=1))
        bearing = np.arctan2(steps.dl_m, steps.ds_m) * self._noise.law.along_travel
        self._growth, self._last = grown.growth, (int(stamps_ns[-1]), clean_xyt[-1].copy())
        return Motions(poses, jump, np.column_stack((steps.ds_m, steps.dl_m, steps.dtheta_rad, bearing)), sd)


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
