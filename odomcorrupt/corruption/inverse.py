"""Effects applied to a clean drive: the reported motion u' that solves u' = u - f(u').

The f of systematic effects add up. Random effects follow, one after the other, each on what those before it have made.

Functions that were learned up to some speed may have no inverse beyond it. `learn` writes only models that have one on
its recordings, so in a learned model such a motion is a faster one. Its relative error is then that of the same motion
slowed down until there is an inverse.
"""

from __future__ import annotations

import copy
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from odomcorrupt.corruption.covariance import has_random_part
from odomcorrupt.effects.effect import Motion
from odomcorrupt.errors import EffectError
from odomcorrupt.geometry.motion import accelerations
from odomcorrupt.rng import stream

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from odomcorrupt.effects.effect import Effect, Gain, State
    from odomcorrupt.geometry.increments import Increments
    from odomcorrupt.geometry.motion import Accelerations, SpeedMemory
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.model.motion_model import MotionModel

TOLERANCE = 1e-12
"""An increment is solved when it moves by less than this between two rounds, metres or radians."""

MAX_ROUNDS = 200
_RUNAWAY = 1e6
"""An increment that changes by more metres than this diverges."""
_SAME = 1e-6
"""Two changes that differ by less than this part of them are the same."""
_JUMP = 0.5
"""A law that sets in all at once may change less than this part of a motion."""
NEWTON_ROUNDS = 60
_NUDGE = 1e-6
"""By how much a speed is changed to see what that does to f, m/s and rad/s."""
_FARTHEST, _JITTER = 20.0, 1e-3
"""Odometry is not off by more than so many times the true motion, but where both are next to nothing, metres."""
_HALVINGS, _AT_ONCE = 20, 4
"""Halvings of the interval in which the highest speed with an inverse is searched: to a millionth, because the
odometry's speed there goes with the root of the rest; and how many of them are made at once, where rows allow it."""


def acts(effect: Effect) -> bool:
    """Whether an effect does anything: some amplitude is off its identity."""
    return effect.acts


class Drive(NamedTuple):
    """n clean increments, with the poses and times at which they were made.

    steps : the increments
    dt_s : (n,) their lengths in time, seconds
    t_s : (n,) since the first stamp, at the end of each, seconds
    start_xyt : (n, 3) clean pose where each begins
    """

    steps: Increments
    dt_s: Array
    t_s: Array
    start_xyt: Array


class Slowed(NamedTuple):
    """Part of a drive with motions that learned effects have no inverse for.

    duration_s : time of these motions, seconds
    to : least fraction of the motion to which one was slowed down for its relative error
    """

    duration_s: float = 0.0
    to: float = 1.0


class EffectInverse:
    """The effects of a model acting on a stream of increments; their states pass from call to call.

    random : the effects that draw something whose variance they state
    gains : what these drew from in the last call of `error`
    slowed : motions without an inverse in the last call of `error`
    """

    def __init__(self, model: MotionModel, seed: int, run: int) -> None:
        ordinals: dict[str, int] = {}
        started = []
        for effect in model.effects:
            if not effect.clock and acts(effect):
                ordinal = ordinals.get(effect.name, 0)
                ordinals[effect.name] = ordinal + 1
                started.append((effect, effect.start(stream(seed, run, effect.name, ordinal))))
        # the listed order does not matter: the f add up, and faults of encoders are applied in order of name
        started.sort(key=lambda pair: pair[0].name)
        motion = [pair for pair in started if pair[0].layer == "motion"]
        motion.sort(key=lambda pair: pair[0].kind == "setup")
        together = [pair for pair in motion if pair[0].kind != "noise"]
        random = [[pair] for pair in motion if pair[0].kind == "noise"]
        self._stages = [stage for stage in (together, *random) if stage]
        self._recording = [pair for pair in started if pair[0].layer == "record"]
        self._drawing = [pair for pair in started if pair[0].layer == "draws"]
        self._track_m = model.track_m
        self._learned = bool(model.source.get("recordings"))
        self.slowed = Slowed()
        self.random = tuple(effect for effect, _ in motion + self._recording if has_random_part(effect, model.track_m))
        self.gains: tuple[Gain, ...] = ()
        self.restart()

    def restart(self) -> None:
        """Forget the motion before: a new stretch begins. The effects' own states go on."""
        self._speeds: SpeedMemory | None = None
        self._distance_m = 0.0

    def drawn(self, normals: Array) -> Array:
        """Return what is drawn in place of standard normals (n, 4)."""
        drawing: list[tuple[Effect, State]] = []
        for effect, state in self._drawing:
            normals, after = effect.drawn(normals, state)
            drawing.append((effect, after))
        self._drawing = drawing
        return normals

    def error(self, drive: Drive) -> Array:
        """Return what the effects add to n increments: (n, 3) metres along, metres left, radians.

        Raises
        ------
        EffectError
            Where the effects are so strong that no motion of the odometry explains the clean one, in a learned model
            not even at a lower speed.
        """
        added = self._error(drive)
        steps = np.stack((drive.steps.ds_m, drive.steps.dl_m, drive.steps.dtheta_rad), axis=1) + added
        recording: list[tuple[Effect, State]] = []
        for effect, state in self._recording:
            reported, after = effect.recorded(steps, drive.t_s, self._track_m, state)
            added = added + (reported - steps)
            steps = reported
            recording.append((effect, after))
        self._recording = recording
        return added

    def _error(self, drive: Drive) -> Array:
        n = len(drive.steps)
        self.slowed = Slowed()
        if not (self._stages or self.random) or n == 0:
            return np.zeros((n, 3))
        dt = drive.dt_s[:, None]
        clean = np.stack((drive.steps.ds_m, drive.steps.dl_m, drive.steps.dtheta_rad), axis=1)
        clean = np.divide(clean, dt, out=np.zeros_like(clean), where=dt > 0.0)
        faster = accelerations(clean, drive.dt_s, self._speeds)
        travel = np.hypot(drive.steps.ds_m, drive.steps.dl_m)
        distance = np.cumsum(np.concatenate(([self._distance_m], travel)))
        true = _motion(clean, drive, faster, distance[1:], self._track_m)

        # what is systematic acts at once, as it was fitted; each random effect on what those before it have made, so
        # that a wheel which spins is not also beyond what a law was fitted to
        gone, stages, least = np.zeros((n, 3)), [], np.ones(n)
        for stage in self._stages:
            solved = _solved(stage, clean - gone, true, learned=self._learned)
            stages.append(list(zip((effect for effect, _ in stage), solved.states, strict=True)))
            gone, least = gone + solved.f, np.minimum(least, solved.scale)
        self._stages = stages
        if (least < 1.0).any():
            self.slowed = Slowed(float(drive.dt_s[least < 1.0].sum()), float(least.min()))
        if self.random:
            self.gains = tuple(gain for effect in self.random for gain in effect.gains(true))
        self._speeds = faster.memory
        self._distance_m = float(distance[-1])
        return -gone * dt


def _largest(steps: Array) -> Array:
    """Return the largest of three numbers without their signs, (n,) of (n, 3): rows of three are slow to reduce."""
    along, across, yaw = np.abs(steps).T
    largest: Array = np.maximum(np.maximum(along, across), yaw)
    return largest


class _Solved(NamedTuple):
    """The f (n, 3) of effects, their states after it, and the fractions (n,) of the motions that it was solved at."""

    f: Array
    states: list[State]
    scale: Array


def _solved(stage: Sequence[tuple[Effect, State]], clean: Array, true: Motion, *, learned: bool) -> _Solved:
    """Return the f of effects on the motion that is left of the clean one by f; of learned effects also beyond them.

    A motion without an inverse is scaled down, with its accelerations, to the largest fraction that has one, and that
    fraction's f is scaled up again: the relative error stays as it is there.
    """
    f, states, unsolved = _iterated(stage, clean, true)
    scale = np.where(unsolved, 0.0, 1.0)
    if learned and unsolved.any():
        # the rows of effects with memory depend on each other, so only one fraction at a time can be tried for them
        remembers = any(state is not None for _, state in stage)
        rows = np.flatnonzero(unsolved | remembers)
        halvings = 1 if remembers else _AT_ONCE
        parts = np.arange(1, 2**halvings)[:, None] / 2**halvings
        tried, several = np.arange(len(parts))[:, None], np.tile(rows, len(parts))
        low, high, f_low = np.where(unsolved[rows], 0.0, 1.0), np.ones(len(rows)), f[rows]
        for _ in range(_HALVINGS // halvings):
            scales = low + (high - low) * parts
            slower, _, failed = _iterated(
                stage, clean[several] * scales.reshape(-1, 1), _slowed(true, several, scales.ravel())
            )
            failed = failed.reshape(scales.shape)
            solved = np.logical_and.accumulate(~failed, axis=0)
            best = solved & (tried == solved.sum(axis=0) - 1) & unsolved[rows]
            which, row = np.nonzero(best)
            f_low[row] = slower.reshape(*scales.shape, 3)[which, row] / scales[which, row][:, None]
            low = np.where(solved, scales, low).max(axis=0)
            high = np.where(solved, high, scales).min(axis=0)
        f[rows], scale[rows] = f_low, low
    if not scale.all():
        names = ", ".join(effect.name for effect, _ in stage)
        raise EffectError(
            f"effects ({names}): too strong for this drive, u' = u - f(u') does not converge; make "
            "them weaker, or delete them from the model"
        )
    return _Solved(f, states, scale)


def _slowed(motion: Motion, rows: NDArray[np.intp], scale: Array) -> Motion:
    """Return these rows of a motion, with their accelerations and the speeds in step multiplied by `scale`."""
    assert motion.trail is not None  # noqa: S101 - a drive's motion has it
    assert motion.before is not None  # noqa: S101 - as above
    return replace(
        motion,
        **{name: getattr(motion, name)[rows] for name in ("t_s", "dt_s", "x", "y", "theta", "distance")},
        acceleration=motion.acceleration[rows] * scale[:, None],
        trail=motion.trail[rows] * scale[:, None],
        before=motion.before[rows] * scale[:, None, None],
    )


def _iterated(
    stage: Sequence[tuple[Effect, State]], clean: Array, true: Motion
) -> tuple[Array, list[State], NDArray[np.bool_]]:
    """Return f (n, 3), the states after it, and which rows (n,) have no solution.

    Plain rounds settle wherever effects change less than the whole of a motion. Newton's follow for the rest: for
    errors as large as the motion, as of a robot that turns several times as far as its odometry says.
    """
    dt = true.dt_s[:, None]

    def motion_at(twist: Array) -> Motion:
        v, vy, omega = np.ascontiguousarray(twist.T)
        return replace(true, v=v, vy=vy, omega=omega)

    def error_at(f: Array) -> tuple[Array, list[State]]:
        motion = motion_at(clean - f)
        total, states = np.zeros_like(clean), []
        for effect, state in stage:
            if effect.kind == "setup":  # these come last, one after the other, and see how the robot truly moves
                motion = motion_at(clean - f + total)
            # an effect may draw from its state: every round must see the same draws
            with np.errstate(over="ignore", invalid="ignore"):  # divergence is reported below
                answer = effect.twist_error(motion, copy.deepcopy(state))
            total += answer.f
            states.append(answer.state)
        return total, states

    f = np.zeros_like(clean)
    open_ = np.ones(len(clean), dtype=bool)
    was, last = f, np.zeros(len(clean))
    for _ in range(MAX_ROUNDS):
        f_next, states = error_at(f)
        # a row that is solved stays as it is, so that its bits do not depend on its neighbours; nor does one that
        # runs away take them along
        change = _largest((f_next - f) * dt)
        settling = open_ & (change < _RUNAWAY)
        was, f = f, np.where(settling[:, None], f_next, f)
        open_ &= ~(change <= TOLERANCE)
        if not open_.any():
            return f, states, open_
        swinging, last = np.abs(change - last) <= _SAME * change, change
    # a law that sets in at a speed may take the odometry below it, where it is off: no speed is reported for such a
    # true one, and of the two that it swings between the one nearer to the truth stands; what takes all of a motion
    # away in one round and puts it back in the next is no such law
    swinging &= open_ & (change < _JUMP * np.abs(clean * dt).max(axis=1))
    nearer = swinging & (np.linalg.norm(was, axis=1) < np.linalg.norm(f, axis=1))
    f = np.where(nearer[:, None], was, f)
    open_ &= ~swinging
    if open_.any():
        open_ = _by_newton(lambda f: error_at(f)[0], f, open_, clean, dt)
    return f, error_at(f)[1], open_


def _by_newton(
    error_at: Callable[[Array], Array], f: Array, open_: NDArray[np.bool_], clean: Array, dt: Array
) -> NDArray[np.bool_]:
    """Solve the open rows of f (n, 3) in place by Newton's method, each from where the effects do nothing.

    Returns the rows (n,) without a solution in which the robot still moves the more, the more its odometry does; their
    f is zero.
    """
    unsolved = open_.copy()
    rows = np.flatnonzero(open_)
    f[rows] = 0.0
    for _ in range(NEWTON_ROUNDS):
        miss = (error_at(f) - f)[rows]
        settled = np.abs(miss * dt[rows]).max(axis=1) <= TOLERANCE
        slope = np.empty((len(rows), 3, 3))
        for i in range(3):
            nudge = np.zeros(3)
            nudge[i] = _NUDGE
            slope[:, :, i] = (error_at(f - nudge) - error_at(f + nudge))[rows] / (2.0 * _NUDGE)
        slope += np.eye(3)  # of the true motion by the odometry's
        usable: NDArray[np.bool_] = np.all(np.isfinite(np.column_stack((slope.reshape(-1, 9), miss))), axis=1)
        usable[usable] = np.abs(np.linalg.det(slope[usable])) > 0.0
        done: NDArray[np.bool_] = settled & usable
        done[done] = (np.linalg.eigvals(slope[done]).real > 0.0).all(axis=1)
        unsolved[rows[done]] = False
        going = usable & ~settled
        rows, miss, slope = rows[going], miss[going], slope[going]
        if not len(rows):
            break
        f[rows] += np.linalg.solve(slope, miss[:, :, None])[:, :, 0]
    far = open_ & (np.abs(f).max(axis=1) > _FARTHEST * np.abs(clean).max(axis=1))
    unsolved |= far & (np.abs(f * dt).max(axis=1) > _JITTER)
    f[unsolved] = 0.0
    return unsolved


def _motion(twist: Array, drive: Drive, faster: Accelerations, distance_m: Array, track_m: float | None) -> Motion:
    return Motion(
        t_s=drive.t_s,
        dt_s=drive.dt_s,
        v=np.ascontiguousarray(twist[:, 0]),
        vy=np.ascontiguousarray(twist[:, 1]),
        omega=np.ascontiguousarray(twist[:, 2]),
        acceleration=faster.rate,
        trail=faster.trail,
        before=faster.before,
        x=np.ascontiguousarray(drive.start_xyt[:, 0]),
        y=np.ascontiguousarray(drive.start_xyt[:, 1]),
        theta=np.ascontiguousarray(drive.start_xyt[:, 2]),
        distance=distance_m,
        track_m=track_m,
    )
