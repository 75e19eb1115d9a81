"""Effects applied to a clean drive: the reported motion u' that solves u' = u - f(u').

The f of systematic effects add up. Random effects follow, one after the other, each on what those before it have made.

Functions that were learned up to some speed may have no inverse beyond it. `learn` writes only models that have one on
its recordings, so in a learned model such a motion is a faster one. Its relative error is then that of the same motion
slowed down until there is an inverse.
"""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from odomcorrupt.corruption.covariance import has_random_part
from odomcorrupt.corruption.fixed_point import solve
from odomcorrupt.effects.effect import Motion
from odomcorrupt.geometry.motion import accelerations
from odomcorrupt.rng import stream

if TYPE_CHECKING:
    from odomcorrupt.effects.effect import Effect, RandomCoefficient, State
    from odomcorrupt.geometry.motion import Accelerations, SpeedMemory
    from odomcorrupt.geometry.se2 import Array, Increments
    from odomcorrupt.model.motion_model import MotionModel


_KEPT = 20_000
"""Increments whose systematic part is kept for further runs, besides those of the last drive: about 5 MB. A portion
of a batch, which run after run is fed, has 2000 messages or one block of the bag."""


def acts(effect: Effect) -> bool:
    """Return whether an effect does anything: some amplitude is off its identity."""
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
            if before is state and _same(known, drive):
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
        if not effect.clock and acts(effect):
            ordinal = ordinals.get(effect.name, 0)
            ordinals[effect.name] = ordinal + 1
            started.append((effect, effect.start(stream(seed, run, effect.name, ordinal))))
    # the listed order does not matter: the f add up, and faults of encoders are applied in order of name
    return sorted(started, key=lambda pair: pair[0].name)


def _same(one: Drive, other: Drive) -> bool:
    arrays = ((d.steps.ds_m, d.steps.dl_m, d.steps.dtheta_rad, *d[1:]) for d in (one, other))
    return all(np.array_equal(a, b) for a, b in zip(*arrays, strict=True))


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
