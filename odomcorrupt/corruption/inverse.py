"""Effects applied to a clean drive: the reported motion u' that solves u' = u - f(u').

The f of systematic effects add up. Random effects follow, one after the other, each on what those before it have made.

Functions that were learned up to some speed may have no inverse beyond it. `learn` writes only models that have one on
its recordings, so in a learned model such a motion is a faster one. Its relative error is then that of the same motion
slowed down until there is an inverse.
"""

from __future__ import annotations

import copy
from collections import deque
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from odomcorrupt.corruption.covariance import has_random_part
from odomcorrupt.effects.effect import Motion
from odomcorrupt.errors import EffectError
from odomcorrupt.geometry.motion import accelerations
from odomcorrupt.rng import stream

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from odomcorrupt.effects.effect import ByRows, Effect, RandomCoefficient, State
    from odomcorrupt.geometry.motion import Accelerations, SpeedMemory
    from odomcorrupt.geometry.se2 import Array, Increments
    from odomcorrupt.model.motion_model import MotionModel


TOLERANCE = 1e-12
"""An increment is solved when it moves by less than this between two rounds, metres or radians."""

MAX_ROUNDS = 200
_NUDGE = 1e-6
"""By how much a speed is changed to see what that does to f, m/s and rad/s."""
_FARTHEST, _JITTER, _LINEAR = 20.0, 1e-3, 2
"""Odometry is not off by more than so many times the true motion, but where both are next to nothing, metres; nor where
so many of Newton's rounds solve it: a wrong factor, as of a track in centimetres, is linear."""
_HALVINGS, _AT_ONCE = 20, 4
"""Halvings of the interval in which the highest speed with an inverse is searched: to a millionth, because near it the
odometry's speed changes as the square root of the difference; and how many are made at once, where rows allow it."""


class Solution(NamedTuple):
    """The f (n, 3) of effects, their states after it, and the fractions (n,) of the motions that it was solved at."""

    f: Array
    states: list[State]
    scale: Array


def solve(stage: Sequence[tuple[Effect, State]], clean: Array, true: Motion, *, learned: bool) -> Solution:
    """Return the f of effects on the motion that is left of the clean one by f; of learned effects also beyond them.

    A motion without an inverse is scaled down, with its accelerations, to the largest fraction that has one, and that
    fraction's f is scaled up again: the relative error stays as it is there.

    stage : effects that act at once, with their states
    clean : (n, 3) true twists, less the f of earlier stages, m/s and rad/s
    true : the true motion
    learned : whether the effects were learned, so that a motion without an inverse is scaled down

    Raises
    ------
    EffectError
        If a motion has no inverse, of learned effects no fraction of it.
    """
    equations = _Equations(tuple((*pair, pair[0].by_rows(true, pair[1])) for pair in stage), clean, true)
    f, states, unsolved = _iterated(equations)
    scale = np.where(unsolved, 0.0, 1.0)
    if learned and unsolved.any():
        _scale_down(equations, unsolved, f, scale)
    if not scale.all():
        names = ", ".join(effect.name for effect, _ in stage)
        raise EffectError(
            f"effects ({names}): too strong for this drive, u' = u - f(u') does not converge; make "
            "them weaker, or delete them from the model"
        )
    return Solution(f, states, scale)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class _Equations:
    """u' = clean - f(u') over n intervals.

    parts : effects with their states, and their f by single intervals of the whole motion, if they have it
    clean : (n, 3) m/s and rad/s
    true : the true motion of these intervals
    index : (n,) of these intervals in the whole motion; None: all of them
    """

    parts: tuple[tuple[Effect, State, ByRows | None], ...]
    clean: Array
    true: Motion
    index: NDArray[np.intp] | None = None

    @property
    def apart(self) -> bool:
        """Whether an interval's f does not depend on other intervals, so that any of them can be solved alone."""
        return all(by_rows is not None for _, _, by_rows in self.parts)

    @property
    def dt_s(self) -> Array:
        """Lengths of the intervals, (n, 1)."""
        return self.true.dt_s[:, None]

    def of(self, rows: NDArray[np.intp], scale: Array | float = 1.0) -> _Equations:
        """Return the equations of some of the intervals, with their motion multiplied by `scale`."""
        m, scale = self.true, np.broadcast_to(scale, len(rows))
        assert m.trail is not None  # noqa: S101 - a drive's motion has it
        assert m.before is not None  # noqa: S101 - as above
        true = replace(
            m,
            **{name: getattr(m, name)[rows] for name in ("t_s", "dt_s", "x", "y", "theta", "distance")},
            acceleration=m.acceleration[rows] * scale[:, None],
            trail=m.trail[rows] * scale[:, None],
            before=m.before[rows] * scale[:, None, None],
        )
        index = rows if self.index is None else self.index[rows]
        return _Equations(self.parts, self.clean[rows] * scale[:, None], true, index)

    def error_at(self, f: Array) -> tuple[Array, list[State]]:
        """Return f (n, 3) on the motion that a given f (n, 3) leaves, and the states after it."""
        motion, total, states = self._motion_at(self.clean - f), np.zeros_like(self.clean), []
        for effect, state, by_rows in self.parts:
            if effect.kind == "setup":  # these come last, one after the other, and see how the robot truly moves
                motion = self._motion_at(self.clean - f + total)
            with np.errstate(over="ignore", invalid="ignore"):  # divergence is reported below
                if by_rows is not None:
                    total += by_rows.f(motion, slice(None) if self.index is None else self.index)
                    after = by_rows.state
                else:
                    # an effect may draw from its state: every round must see the same draws
                    answer = effect.twist_error(motion, copy.deepcopy(state))
                    total += answer.f
                    after = answer.state
            states.append(after)
        return total, states

    def _motion_at(self, twist: Array) -> Motion:
        v, vy, omega = np.ascontiguousarray(twist.T)
        return replace(self.true, v=v, vy=vy, omega=omega)


def _largest(steps: Array) -> Array:
    """Return the largest of three numbers without their signs, (n,) of (n, 3): rows of three are slow to reduce."""
    along, across, yaw = np.abs(steps).T
    return np.maximum(np.maximum(along, across), yaw)


def _iterated(equations: _Equations) -> tuple[Array, list[State], NDArray[np.bool_]]:
    """Return f (n, 3), the states after it, and which rows (n,) have no solution.

    Plain rounds settle wherever effects change less than the whole of a motion. Newton's follow for the rest: for
    errors as large as the motion, as of a robot that turns several times as far as its odometry says.
    """
    n = len(equations.clean)
    f, was, last = np.zeros((n, 3)), np.zeros((n, 3)), np.zeros(n)
    open_, swinging = np.ones(n, dtype=bool), np.zeros(n, dtype=bool)
    live, rows, now, earlier, changed = equations, np.arange(n), f, f, last
    for left in range(MAX_ROUNDS - 1, -1, -1):
        f_next, states = live.error_at(now)
        # a row that is solved stays as it is, so that its bits do not depend on its neighbours; nor does one that
        # runs away take them along
        before, change = changed, _largest((f_next - now) * live.dt_s)
        # an increment that changes by more metres than this diverges
        settling = open_[rows] & (change < 1e6)
        oldest, earlier, now, changed = earlier, now, np.where(settling[:, None], f_next, now), change
        open_[rows] &= ~(change <= TOLERANCE)
        # a row that ran away, or swings between the same two numbers, has reached what the last round would give
        ended = ~settling if left % 2 else ~settling | (now == oldest).all(axis=1)
        going = open_[rows] & ~(ended & equations.apart)
        few = 2 * np.count_nonzero(going) < len(rows) if equations.apart else not going.any()
        if few or not left:
            f[rows], was[rows], last[rows] = now, earlier, change
            # two changes that differ by less than this part of them are the same
            swinging[rows] = np.abs(change - before) <= 1e-6 * change
            if not open_.any():
                return f, states, open_
            if not going.any() or not left:
                break
            rows = rows[going]
            now, earlier, changed = now[going], earlier[going], changed[going]
            live = equations.of(rows)
    # a law that sets in at a speed may take the odometry below it, where it is off: no speed is reported for such a
    # true one, and of the two that it swings between the one nearer to the truth stands; what takes all of a motion
    # away in one round and puts it back in the next is no such law
    # a law that sets in all at once may change less than this part of a motion
    swinging &= open_ & (last < 0.5 * np.abs(equations.clean * equations.dt_s).max(axis=1))
    nearer = swinging & (np.linalg.norm(was, axis=1) < np.linalg.norm(f, axis=1))
    f = np.where(nearer[:, None], was, f)
    open_ &= ~swinging
    if open_.any():
        open_ = _by_newton(equations, f, open_)
    return f, states if equations.apart else equations.error_at(f)[1], open_


def _by_newton(equations: _Equations, f: Array, open_: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Solve the open rows of f (n, 3) in place by Newton's method, each from where the effects do nothing.

    Returns the rows (n,) without a solution in which the robot still moves the more, the more its odometry does; their
    f is zero.
    """
    unsolved, linear = open_.copy(), np.zeros_like(open_)
    rows = np.flatnonzero(open_)
    f[rows] = 0.0
    for made in range(60):
        alone = equations.apart
        live, here = (equations.of(rows), f[rows]) if alone else (equations, f)
        own = slice(None) if alone else rows
        miss = (live.error_at(here)[0] - here)[own]
        converged = np.abs(miss * equations.dt_s[rows]).max(axis=1) <= TOLERANCE
        slope = np.empty((len(rows), 3, 3))
        for i in range(3):
            nudge = np.zeros(3)
            nudge[i] = _NUDGE
            slope[:, :, i] = (live.error_at(here - nudge)[0] - live.error_at(here + nudge)[0])[own] / (2.0 * _NUDGE)
        slope += np.eye(3)  # of the true motion by the odometry's
        usable: NDArray[np.bool_] = np.all(np.isfinite(np.column_stack((slope.reshape(-1, 9), miss))), axis=1)
        usable[usable] = np.abs(np.linalg.det(slope[usable])) > 0.0
        done: NDArray[np.bool_] = converged & usable
        done[done] = (np.linalg.eigvals(slope[done]).real > 0.0).all(axis=1)
        unsolved[rows[done]] = False
        linear[rows[done]] = made <= _LINEAR
        going = usable & ~converged
        rows, miss, slope = rows[going], miss[going], slope[going]
        if not len(rows):
            break
        f[rows] += np.linalg.solve(slope, miss[:, :, None])[:, :, 0]
    far = open_ & ~linear & (np.abs(f).max(axis=1) > _FARTHEST * np.abs(equations.clean).max(axis=1))
    unsolved |= far & (np.abs(f * equations.dt_s).max(axis=1) > _JITTER)
    f[unsolved] = 0.0
    return unsolved


def _scale_down(equations: _Equations, unsolved: NDArray[np.bool_], f: Array, scale: Array) -> None:
    """Write the f (n, 3) of unsolved rows at the largest fraction (n,) of their motions that has one, in place."""
    # the rows of effects with memory depend on each other, so only one fraction at a time can be tried for them
    rows = np.flatnonzero(unsolved | (not equations.apart))
    halvings = _AT_ONCE if equations.apart else 1
    parts = np.arange(1, 2**halvings)[:, None] / 2**halvings
    tried, several = np.arange(len(parts))[:, None], np.tile(rows, len(parts))
    low, high, f_low = np.where(unsolved[rows], 0.0, 1.0), np.ones(len(rows)), f[rows]
    for _ in range(_HALVINGS // halvings):
        scales = low + (high - low) * parts
        slower, _, failed = _iterated(equations.of(several, scales.ravel()))
        failed = failed.reshape(scales.shape)
        solved = np.logical_and.accumulate(~failed, axis=0)
        best = solved & (tried == solved.sum(axis=0) - 1) & unsolved[rows]
        which, row = np.nonzero(best)
        f_low[row] = slower.reshape(*scales.shape, 3)[which, row] / scales[which, row][:, None]
        low = np.where(solved, scales, low).max(axis=0)
        high = np.where(solved, high, scales).min(axis=0)
    f[rows], scale[rows] = f_low, low


_KEPT = 20_000
"""Increments whose systematic part is kept for further runs, besides those of the last drive: about 5 MB. A portion
of a batch, which run after run is fed, has 2000 messages or one block of the bag."""


def changes_nothing(model: MotionModel) -> bool:
    """Return whether a model has no noise, and no effect that acts."""
    return model.noise.coefficients.noise_free and not any(effect.acts for effect in model.effects)


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


class _State(NamedTuple):
    """What a run's systematic effects and motion carry from one drive to the next."""

    effects: tuple[State, ...]
    speeds: SpeedMemory | None
    distance_m: float


class _Systematic(NamedTuple):
    """Systematic part of a drive: true motion, f (n, 3), fractions (n,) of the motions, and the state after it."""

    true: Motion
    f: Array
    scale: Array
    after: _State


class SystematicEffects:
    """The effects of a model that draw nothing; what they add to a drive is computed once for runs of the same drive.

    The last parts of drives are kept, so runs share them if each is fed a whole path, or all of them a part in turn.

    start : the state in which every run begins
    """

    def __init__(self, model: MotionModel, seed: int = 0, run: int = 0) -> None:
        started = [(e, s) for e, s in _started(model, seed, run) if e.layer == "motion" and e.kind != "noise"]
        started.sort(key=lambda pair: pair[0].kind == "setup")
        self._effects = tuple(effect for effect, _ in started)
        self._track_m = model.track_m
        self._learned = bool(model.source.get("recordings"))
        self.start = _State(tuple(state for _, state in started), None, 0.0)
        self._restarted = (self.start, self.start)
        self._kept: deque[tuple[_State, Drive, _Systematic]] = deque()

    @property
    def acts(self) -> bool:
        """Whether there are any."""
        return bool(self._effects)

    def restarted(self, state: _State) -> _State:
        """Return the state at the begin of a new stretch: the effects' own states go on."""
        if state.speeds is None and not state.distance_m:
            return state
        if self._restarted[0] is not state:  # the same state for all runs, which is how they are known to agree
            self._restarted = state, _State(state.effects, None, 0.0)
        return self._restarted[1]

    def on(self, drive: Drive, state: _State) -> _Systematic:
        """Return the systematic part of a drive, from the state before it."""
        for before, known, found in self._kept:
            arrays = ((d.steps.ds_m, d.steps.dl_m, d.steps.dtheta_rad, *d[1:]) for d in (known, drive))
            if before is state and all(np.array_equal(a, b) for a, b in zip(*arrays, strict=True)):
                return found
        dt = drive.dt_s[:, None]
        clean = np.stack((drive.steps.ds_m, drive.steps.dl_m, drive.steps.dtheta_rad), axis=1)
        clean = np.divide(clean, dt, out=np.zeros_like(clean), where=dt > 0.0)
        faster = accelerations(clean, drive.dt_s, state.speeds)
        travel = np.hypot(drive.steps.ds_m, drive.steps.dl_m)
        distance = np.cumsum(np.concatenate(([state.distance_m], travel)))
        true = _motion(clean, drive, faster, distance[1:], self._track_m)
        f, scale, effects = np.zeros_like(clean), np.ones(len(clean)), state.effects
        if self._effects:
            pairs = list(zip(self._effects, effects, strict=True))
            solved = solve(pairs, clean, true, learned=self._learned)
            f, scale, effects = f + solved.f, solved.scale, tuple(solved.states)
        found = _Systematic(true, f, scale, _State(effects, faster.memory, float(distance[-1])))
        self._kept.append((state, drive, found))
        while len(self._kept) > 1 and sum(len(known.steps) for _, known, _ in self._kept) > _KEPT:
            self._kept.popleft()
        return found


class EffectInverse:
    """The effects of a model acting on a stream of increments; their states pass from call to call.

    systematic : those that draw nothing, if shared with other runs of the same model
    random : the effects that draw something whose variance they state
    gains : what these drew from in the last call of `error`
    slowed : motions without an inverse in the last call of `error`
    """

    def __init__(self, model: MotionModel, seed: int, run: int, systematic: SystematicEffects | None = None) -> None:
        self._systematic = SystematicEffects(model, seed, run) if systematic is None else systematic
        started = _started(model, seed, run)
        self._noise = [pair for pair in started if pair[0].layer == "motion" and pair[0].kind == "noise"]
        self._recording = [pair for pair in started if pair[0].layer == "record"]
        self._drawing = [pair for pair in started if pair[0].layer == "draws"]
        self._track_m = model.track_m
        self._learned = bool(model.source.get("recordings"))
        self.slowed = Slowed()
        drawn = self._noise + self._recording
        self.random = tuple(effect for effect, _ in drawn if has_random_part(effect, model.track_m))
        self.gains: tuple[RandomCoefficient, ...] = ()
        self._state = self._systematic.start

    def restart(self) -> None:
        """Forget the motion before: a new stretch begins. The effects' own states go on."""
        self._state = self._systematic.restarted(self._state)

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
        if not (self._systematic.acts or self._noise or self.random) or n == 0:
            return np.zeros((n, 3))
        # what is systematic acts at once, as it was fitted; each random effect on what those before it have made, so
        # that a wheel which spins is not also beyond what a law was fitted to
        true, gone, least, self._state = self._systematic.on(drive, self._state)
        clean = np.stack((true.v, true.vy, true.omega), axis=1)
        noise: list[tuple[Effect, State]] = []
        for effect, state in self._noise:
            solved = solve([(effect, state)], clean - gone, true, learned=self._learned)
            noise.append((effect, solved.states[0]))
            gone, least = gone + solved.f, np.minimum(least, solved.scale)
        self._noise = noise
        if (least < 1.0).any():
            self.slowed = Slowed(float(drive.dt_s[least < 1.0].sum()), float(least.min()))
        if self.random:
            self.gains = tuple(gain for effect in self.random for gain in effect.gains(true))
        return -gone * drive.dt_s[:, None]


def _started(model: MotionModel, seed: int, run: int) -> list[tuple[Effect, State]]:
    """Return the acting effects but those of clocks, by name, each with its state before the first interval."""
    ordinals: dict[str, int] = {}
    started = []
    for effect in model.effects:
        if not effect.clock and effect.acts:
            ordinal = ordinals.get(effect.name, 0)
            ordinals[effect.name] = ordinal + 1
            started.append((effect, effect.start(stream(seed, run, effect.name, ordinal))))
    # the listed order does not matter: the f add up, and faults of encoders are applied in order of name
    return sorted(started, key=lambda pair: pair[0].name)


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
