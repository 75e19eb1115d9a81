"""Effects put into a clean drive: the odometry's motion u' that solves u' = u - f(u')."""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.effects.effect import Motion, parameters
from odomcorrupt.errors import EffectError
from odomcorrupt.rng import stream

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.increments import Increments
    from odomcorrupt.model import MotionModel
    from odomcorrupt.pose import Array

__all__ = ["Drive", "EffectInverse", "acts"]

TOLERANCE = 1e-12
"""An increment is solved when it moves by less than this between two rounds, metres or radians."""

MAX_ROUNDS = 200


def acts(effect: Effect) -> bool:
    """Whether an effect does anything: some parameter is off its identity."""
    return any(getattr(effect, p.name) != p.identity for p in parameters(effect))


@dataclass(frozen=True, slots=True)
class Drive:
    """n clean increments and where they were made.

    steps : the increments
    dt_s : (n,) their lengths in time, seconds
    t_s : (n,) since the first stamp, at the end of each, seconds
    start_xyt : (n, 3) clean pose where each begins
    """

    steps: Increments
    dt_s: Array
    t_s: Array
    start_xyt: Array


class EffectInverse:
    """The effects of a model acting on a stream of increments; their states pass from call to call."""

    def __init__(self, model: MotionModel, seed: int, run: int) -> None:
        self._effects = tuple(e for e in model.effects if not e.clock and acts(e))
        ordinals: dict[str, int] = {}
        self._states = []
        for effect in self._effects:
            ordinal = ordinals.get(effect.name, 0)
            ordinals[effect.name] = ordinal + 1
            self._states.append(effect.start(stream(seed, run, effect.name, ordinal)))
        self._track_m = model.track_m
        self.restart()

    def restart(self) -> None:
        """Forget the motion before: a new stretch begins. The effects' own states go on."""
        self._last_twist: NDArray[np.float64] | None = None
        self._last_dt_s = 0.0
        self._distance_m = 0.0

    def error(self, drive: Drive) -> Array:
        """Return what the effects add to n increments: (n, 3) metres along, metres left, radians.

        Raises
        ------
        EffectError
            Where the effects are so strong that no motion of the odometry explains the clean one.

        """
        n = len(drive.steps)
        if not self._effects or n == 0:
            return np.zeros((n, 3))
        dt = drive.dt_s[:, None]
        clean = np.stack((drive.steps.ds_m, drive.steps.dl_m, drive.steps.dtheta_rad), axis=1)
        clean = np.divide(clean, dt, out=np.zeros_like(clean), where=dt > 0.0)
        acceleration = self._acceleration(clean, drive.dt_s)
        travel = np.hypot(drive.steps.ds_m, drive.steps.dl_m)
        distance = np.cumsum(np.concatenate(([self._distance_m], travel)))

        f = np.zeros((n, 3))
        open_ = np.ones(n, dtype=bool)
        states = self._states
        for _ in range(MAX_ROUNDS):
            motion = _motion(clean - f, drive, acceleration, distance[1:], self._track_m)
            f_next = np.zeros((n, 3))
            states = []
            for effect, state in zip(self._effects, self._states, strict=True):
                # an effect may draw from its state: every round must see the same draws
                with np.errstate(over="ignore", invalid="ignore"):  # what runs away is told below
                    answer = effect.twist_error(motion, copy.deepcopy(state))
                f_next += answer.f
                states.append(answer.state)
            # a row that is solved stays as it is, so that its bits do not depend on its neighbours
            change = np.abs((f_next - f) * dt).max(axis=1)
            f = np.where(open_[:, None], f_next, f)
            open_ &= ~(change <= TOLERANCE)
            if not open_.any():
                break
        else:
            names = ", ".join(effect.name for effect in self._effects)
            raise EffectError(
                f"effects ({names}): too strong to be put into this drive, u' = u - f(u') does not settle after "
                f"{MAX_ROUNDS} rounds; make them weaker"
            )
        self._states = states
        self._last_twist, self._last_dt_s = clean[-1], float(drive.dt_s[-1])
        self._distance_m = float(distance[-1])
        return -f * dt

    def _acceleration(self, twist: Array, dt_s: Array) -> Array:
        """Return the clean twist's rate of change (n, 3) between the middles of an interval and the one before it.

        It looks back only, so that it does not depend on where a stream is cut; it is zero in the first interval.
        """
        first = twist[:1] if self._last_twist is None else self._last_twist[None]
        apart_s = (dt_s + np.concatenate(([self._last_dt_s], dt_s[:-1]))) / 2.0
        change = np.diff(np.concatenate((first, twist)), axis=0)
        return np.divide(change, apart_s[:, None], out=np.zeros_like(change), where=(dt_s > 0.0)[:, None])


def _motion(twist: Array, drive: Drive, acceleration: Array, distance_m: Array, track_m: float | None) -> Motion:
    return Motion(
        t_s=drive.t_s,
        dt_s=drive.dt_s,
        v=np.ascontiguousarray(twist[:, 0]),
        vy=np.ascontiguousarray(twist[:, 1]),
        omega=np.ascontiguousarray(twist[:, 2]),
        acceleration=acceleration,
        x=np.ascontiguousarray(drive.start_xyt[:, 0]),
        y=np.ascontiguousarray(drive.start_xyt[:, 1]),
        theta=np.ascontiguousarray(drive.start_xyt[:, 2]),
        distance=distance_m,
        track_m=track_m,
    )
