"""Effects put into a clean drive."""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import pytest
from drives import error_in_any_cut, office, silent

from odomcorrupt.corruption.inverse import Drive, EffectInverse, SystematicEffects
from odomcorrupt.corruption.path import NoisyPath
from odomcorrupt.effects import effect_from_values
from odomcorrupt.effects.compensation import corrected_increments
from odomcorrupt.effects.effect import Effect, TwistError, parameter, stacked
from odomcorrupt.effects.expression import user_effect
from odomcorrupt.errors import EffectError
from odomcorrupt.geometry.motion import motion_of
from odomcorrupt.geometry.se2 import Increments, accumulate, increments


def drive_of(t, poses):
    return Drive(increments(poses), np.diff(t) * 1e-9, (t[1:] - t[0]) * 1e-9, poses[:-1])


def test_a_robot_that_turns_several_times_as_far_as_its_odometry_says_is_put_in_and_taken_out():
    """Plain rounds run away where an effect is larger than the motion it acts on; cuts still give the same bits."""
    t, poses = office(50.0, 20.0)
    effects = [user_effect("geared", "yaw += k * omega", {"k": 3.4}), effect_from_values("wheel_scale", {"e": 0.05})]
    whole = error_in_any_cut(silent(effects), t, poses)
    back = corrected_increments(effects, motion_of((t - t[0]) * 1e-9, poses + whole))
    assert back.dtheta_rad == pytest.approx(increments(poses).dtheta_rad, abs=1e-11)
    assert back.ds_m == pytest.approx(increments(poses).ds_m, abs=1e-11)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("k", [0.05, -0.05])
def test_a_law_that_sets_in_at_a_speed_is_put_in_at_every_speed(k):
    """Of true speeds just above it no odometry speaks; that of one just below or above is at most the jump away."""
    law = user_effect("spins", "wheels += v * (k * where(abs(v) > 0.5, 1, 0))", {"k": k})
    v = np.linspace(0.4, 0.6, 500)
    t, poses = speeding(v, curvature=0.2)
    whole = error_in_any_cut(silent([law], track_m=0.4), t, poses)
    back = corrected_increments([law], motion_of((t - t[0]) * 1e-9, poses + whole, track_m=0.4)).ds_m * 50.0
    jump = np.abs(back - v) > 1e-9
    assert np.abs(back - v).max() < 0.051 * 0.52
    assert np.all((v[jump] > 0.48) & (v[jump] < 0.55))


@dataclass(frozen=True, slots=True)
class Runaway(Effect):
    name: ClassVar[str] = "runaway"
    kind: ClassVar[str] = "effect"
    summary: ClassVar[str] = "grows faster than anything can undo"
    k: float = parameter("s/m", "growth", low=-100.0, high=100.0, typical=1.0)

    def twist_error(self, motion, state):
        return TwistError(stacked(self.k * motion.v**3 + self.k * motion.v, 0.0, 0.0, motion.v), state)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    "effects", [(effect_from_values("side_slip", {"k": 0.5}), Runaway(-40.0)),
    (user_effect("stuck", "along += -3 * v * k * max(abs(v) - 0.1, 0)", {"k": 1.0}),)]
)  # fmt: skip
def test_effects_that_no_odometry_obeys_are_called_too_strong(effects):
    with pytest.raises(EffectError, match=r"too strong.*weaker"):
        NoisyPath(silent(effects), 1).feed(*office(10.0, 10.0))


def called(along):
    """Return an effect of the speed by a function of the motion."""

    @dataclass(frozen=True, slots=True)
    class Called(Runaway):
        name: ClassVar[str] = "called"

        def twist_error(self, motion, state):
            return TwistError(stacked(along(motion), 0.0, 0.0, motion.v), state)

    return Called(1.0)


@dataclass(frozen=True, slots=True)
class RandomEffectCovariance(Effect):
    """A random walk of the yaw rate that draws from its own stream: it has a state and randomness."""

    name: ClassVar[str] = "wander"
    kind: ClassVar[str] = "noise"
    summary: ClassVar[str] = "walks"
    density: float = parameter("rad/s", "of one step", low=0.0, high=1.0, typical=0.1)
    pull: float = parameter("", "of the yaw rate itself", low=0.0, high=0.5, typical=0.1)

    def start(self, rng):
        return rng, 0.0

    def twist_error(self, motion, state):
        rng, level = state
        walk = np.cumsum(np.concatenate(([level], self.density * rng.standard_normal(len(motion)))))
        return TwistError(stacked(0.0, 0.0, walk[1:] + self.pull * motion.omega, motion.v), (rng, walk[-1]))


def test_an_effect_that_draws_is_the_same_however_the_path_is_cut():
    t, poses = office(50.0, 20.0)
    chosen = silent([RandomEffectCovariance(0.01, 0.2), RandomEffectCovariance(0.02, 0.0)])
    whole = error_in_any_cut(chosen, t, poses, 37)
    twin = replace(chosen, effects=(RandomEffectCovariance(0.01, 0.2),))
    assert not np.array_equal(NoisyPath(twin, 4).feed(t, poses).error_xyt, whole)


def test_acceleration_uses_the_past_and_does_not_depend_on_cuts():
    seen = []
    watch = called(lambda motion: seen.append(motion) or 0.0)
    t = np.arange(101) * 20_000_000
    poses = np.column_stack((0.5 * 1.2 * (t * 1e-9) ** 2, np.zeros(101), np.zeros(101)))
    drive = drive_of(t, poses)
    EffectInverse(silent([watch]), 1, 0).error(drive)
    whole = seen[-1].a
    assert whole[20:] == pytest.approx(np.full(80, 1.2), abs=1e-6)
    pieces, inverse, steps = [], EffectInverse(silent([watch]), 1, 0), drive.steps
    for rows in (slice(0, 1), slice(1, 8), slice(8, 60), slice(60, 100)):
        part = Increments(steps.ds_m[rows], steps.dl_m[rows], steps.dtheta_rad[rows])
        inverse.error(Drive(part, drive.dt_s[rows], drive.t_s[rows], drive.start_xyt[rows]))
        pieces.append(seen[-1].a)
    assert np.array_equal(np.concatenate(pieces), whole)


CAPPED = user_effect("spins", "along += v * (k * max(abs(v) - 1.2, 0))", {"k": -0.5})
"""The robot reaches 1.27 m/s at 1.6 m/s of its odometry, and no more than that."""


def speeding(v, rate=50.0, curvature=0.0):
    t = 10**11 + (np.arange(len(v) + 1) * 1e9 / rate).astype(np.int64)
    return t, accumulate(np.zeros(3), Increments(v / rate, 0.0 * v, curvature * v / rate))


def test_a_learned_law_keeps_its_relative_error_at_speeds_that_it_has_no_inverse_for():
    v = np.linspace(0.9, 2.0, 400)
    t, poses = speeding(v)
    plain = silent([CAPPED], track_m=0.4)
    with pytest.raises(EffectError, match="too strong"):
        NoisyPath(plain, 1).feed(t, poses)
    learned = replace(plain, source={"recordings": ["a.mcap"]})
    samples = NoisyPath(learned, 1).feed(t, poses)
    reported = np.linalg.norm(np.diff((poses + samples.error_xyt)[:, :2], axis=0), axis=1) * 50.0
    top = 1.6 * (1.0 - 0.5 * 0.4)
    slow, fast = v < 0.999 * top, v > top
    lower_root = 1.6 - np.sqrt(np.maximum(1.6**2 - 2.0 * v, 0.0))  # of v' - 0.5 v' (v' - 1.2) = v
    assert reported[slow] == pytest.approx(np.where(v <= 1.2, v, lower_root)[slow], rel=1e-9)
    assert reported[fast] / v[fast] == pytest.approx(np.full(fast.sum(), 1.6 / top), rel=2e-3)
    assert samples.slowed.duration_s == pytest.approx(fast.sum() / 50.0)
    assert samples.slowed.to == pytest.approx(top / 2.0, rel=1e-5)


LAG = effect_from_values("channel_lag", {"tau": 0.1})


@pytest.mark.parametrize("others", [(), pytest.param((LAG,), marks=pytest.mark.slow)])
def test_a_law_beyond_its_inverse_is_the_same_however_the_path_is_cut(others):
    t, poses = speeding(np.linspace(0.9, 1.5, 100))  # beyond from 1.28 m/s on, in two of the three parts
    error_in_any_cut(learned(CAPPED, *others), t, poses)


BURSTS = effect_from_values("slip_burst", {"rate": 4.0, "slip": 0.4, "duration": 0.5})


def learned(*effects):
    return replace(silent(effects, track_m=0.4), source={"recordings": ["a.mcap"]})


@pytest.mark.parametrize(("others", "size"), [((LAG,), 41), pytest.param((), 1000, marks=pytest.mark.slow)])
def test_runs_that_share_the_systematic_part_have_the_bits_of_single_runs(others, size):
    t, poses = speeding(np.linspace(0.9, 1.5, 100))
    model = learned(CAPPED, BURSTS, *others)
    shared = SystematicEffects(model)
    paths = [NoisyPath(model, 3, run, systematic=shared) for run in range(2)]
    parts = [[path.feed(t[i : i + size], poses[i : i + size]).error_xyt for path in paths] for i in range(0, 101, size)]
    for run in range(2):
        alone = NoisyPath(model, 3, run).feed(t, poses).error_xyt
        assert np.array_equal(np.concatenate([part[run] for part in parts]), alone)
    assert not np.array_equal(parts[-1][0], parts[-1][1])


def test_the_systematic_part_of_a_drive_is_computed_once_for_all_runs():
    """Also where each run is fed several parts before the next one, and after a restart of time."""
    calls = []

    def feed(path):
        path.feed(t, poses)
        path.restart()
        for i in range(0, len(t), 41):
            path.feed(t[i : i + 41], poses[i : i + 41])

    t, poses = office(10.0, 10.0)
    model = learned(called(lambda motion: calls.append(1) or 0.01 * motion.v), BURSTS)
    shared = SystematicEffects(model)
    feed(NoisyPath(model, 3, 0, systematic=shared))
    once = len(calls)
    for run in range(1, 5):
        feed(NoisyPath(model, 3, run, systematic=shared))
    assert once
    assert len(calls) == once


def test_what_is_kept_for_further_runs_does_not_grow_with_the_drive():
    t, poses = speeding(np.full(60_000, 0.5))
    model = learned(CAPPED)
    shared = SystematicEffects(model)
    path = NoisyPath(model, 1, systematic=shared)
    for i in range(0, len(t), 1000):
        path.feed(t[i : i + 1000], poses[i : i + 1000])
    assert sum(len(drive.steps) for _, drive, _ in shared._kept) <= 20_000


def test_only_unsolved_intervals_are_evaluated_again():
    """Bursts of slip need dozens of rounds, the time between them two."""
    rows = []

    def along(motion):
        rows.append(len(motion))
        return np.where((motion.t_s > 2.0) & (motion.t_s < 2.2), -0.6, 0.01) * motion.v

    t, poses = speeding(np.full(2000, 0.5))
    NoisyPath(silent([called(along)]), 1).feed(t, poses)
    assert len(rows) > 30
    assert sum(rows) < 0.4 * 2000 * len(rows)
