"""Noisy paths: their law, their steps, the published node, and effects put into a clean drive."""

import math
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import pytest
from bagged import rows_of
from drives import LAW_COEFFICIENTS, error_in_any_cut, model, office, silent, stamps, textbook_run, textbook_sigmas

from odomcorrupt.cli import run
from odomcorrupt.corruption.covariance import pose_covariance
from odomcorrupt.corruption.inverse import Drive, EffectInverse, SystematicEffects
from odomcorrupt.corruption.path import NoisyPath, StepGrowth, noise_variances
from odomcorrupt.effects import effect_from_values
from odomcorrupt.effects.compensation import corrected_increments
from odomcorrupt.effects.effect import Effect, TwistError, parameter, stacked
from odomcorrupt.effects.expression import user_effect
from odomcorrupt.errors import EffectError
from odomcorrupt.geometry.motion import motion_of
from odomcorrupt.geometry.se2 import Increments, accumulate, compose, increments
from odomcorrupt.model.motion_model import MotionModel, Noise, Step
from odomcorrupt.model.noise_laws import LAWS, Coefficients
from odomcorrupt.trajectories import read_drive
from recordings import OFFICE

EFFECTS = (
    effect_from_values("unequal_wheels", {"curvature": 0.02}),
    effect_from_values("gyro_bias", {"bias": 0.01}),
    effect_from_values("side_slip", {"k": 0.1}),
)


def last_errors(chosen, drive, runs):
    return np.array([NoisyPath(chosen, 5, k).feed(*drive).error_xyt[-1] for k in range(runs)])


def strafing(rate_hz=2.0, seconds=40.0):
    """A holonomic robot that drives ahead, to its left, and across, turning a little."""
    t = np.arange(round(seconds * rate_hz) + 1) / rate_hz
    phase = t % 15.0
    v = np.select([phase < 5, phase < 10], [0.5, 0.0], 0.3)
    vy = np.select([phase < 5, phase < 10], [0.0, 0.5], -0.4)
    steps = np.column_stack((v, vy, np.full(len(t), 0.02 * rate_hz)))[:-1] / rate_hz
    return stamps(len(t), rate_hz), accumulate(np.array([0.0, 0.0, 0.02]), Increments(*np.ascontiguousarray(steps.T)))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("law", "drive"), [*((law, office(2.5, 20.0)) for law in sorted(LAWS)), ("omni", strafing())],
    ids=[*sorted(LAWS), "omni, strafing"],
)  # fmt: skip
def test_moments_agree_with_the_textbook_loop(law, drive):
    poses, rng = drive[1], np.random.default_rng(1)
    ours = last_errors(model(law), drive, 1300)
    theirs = np.array([textbook_run(law, LAW_COEFFICIENTS[law], poses, rng)[-1] - poses[-1] for _ in range(1300)])
    spread = theirs.std(axis=0)
    assert ours.std(axis=0) == pytest.approx(spread, rel=0.07)
    assert (np.abs(ours.mean(axis=0) - theirs.mean(axis=0)) < 4.5 * spread / math.sqrt(1000)).all()
    assert np.abs(np.corrcoef(ours.T) - np.corrcoef(theirs.T)).max() < 0.12


@pytest.mark.parametrize(
    ("law", "step"),
    [(law, None) for law in LAWS] + [(law, "0.25m,0.2rad") for law, rule in LAWS.items() if rule.per_step],
)
def test_any_cut_into_batches_gives_the_same_bits(law, step):
    for most in (2, 40):
        error_in_any_cut(model(law, step=step, effects=EFFECTS, track_m=0.5), *office(15.0, 12.0), most)


@pytest.mark.parametrize(
    ("law", "step"), [("diffusion", None), ("linear", "0.25m,0.2rad"), ("quadratic", "0.3m,10deg")]
)
def test_the_same_drive_promises_the_same_spread_at_every_message_rate(law, step):
    chosen = model(law, step=step)
    samples = {rate: NoisyPath(chosen, 1).feed(*office(rate, 40.0)) for rate in (4.0, 10.0, 50.0, 200.0)}
    heading = {rate: k.sums[0, -1] for rate, k in samples.items()}
    travel = {rate: k.sums[6, -1] + k.sums[8, -1] for rate, k in samples.items()}
    for rate in (4.0, 10.0, 200.0):
        assert heading[rate] == pytest.approx(heading[50.0], rel=0.005)
        assert travel[rate] == pytest.approx(travel[50.0], rel=0.005)


@pytest.mark.parametrize("rate", [1.0, 4.0, 10.0, 50.0, 200.0])
@pytest.mark.parametrize("law", sorted(LAWS))
def test_three_metres_backwards_arrive_three_metres_behind(law, rate):
    n = round(10 * rate) + 1
    poses = np.zeros((n, 3))
    poses[:, 0] = np.linspace(0.0, -3.0, n)
    samples = NoisyPath(model(law, Coefficients(1e-6, 1e-6, 1e-6, 1e-6)), 1).feed(stamps(n, rate), poses)
    noisy = samples.clean_xyt + samples.error_xyt
    assert noisy[-1] == pytest.approx([-3.0, 0.0, 0.0], abs=0.02)
    assert np.all(np.diff(noisy[:, 0]) < 0.0)


def test_a_parked_robot_with_ten_micrometres_of_jitter_does_not_spin():
    rng = np.random.default_rng(2)
    poses = np.column_stack((rng.normal(0, 1e-5, (3000, 2)), np.full(3000, 0.7)))
    for law in LAWS:
        samples = NoisyPath(model(law), 1).feed(stamps(3000, 50.0), poses)
        assert np.abs(samples.error_xyt[:, 2]).max() < 0.03
        assert np.abs(samples.error_xyt[:, :2]).max() < 0.05


PARKED = stamps(500, 50.0), np.tile([12.3, -4.5, 2.0], (500, 1))
AT_IDENTITY = (effect_from_values("wheel_scale", {"e": 0.0}), effect_from_values("gyro_bias", {}))


@pytest.mark.parametrize(
    ("chosen", "drive"), [*((model(law), PARKED) for law in LAWS), (silent(AT_IDENTITY), office())]
)
def test_standstill_silent_models_and_effects_at_identity_change_nothing_to_the_bit(chosen, drive):
    samples = NoisyPath(chosen, 1).feed(*drive)
    assert not samples.error_xyt.any()
    assert not samples.correction_xyt.any()


def test_the_first_pose_is_unchanged_and_noise_before_a_stop_is_held_during_it():
    t, poses = office(50.0, 10.0)
    samples = NoisyPath(model(), 1).feed(t, poses)
    stopped = slice(402, 500)
    assert np.ptp(samples.clean_xyt[stopped], axis=0) == pytest.approx(0.0)
    assert not np.ptp(samples.error_xyt[stopped], axis=0).any()
    assert samples.error_xyt[-1].all()
    assert not samples.error_xyt[0].any()


def test_correction_takes_clean_poses_to_noisy_ones():
    t, poses = office()
    poses += [400.0, -700.0, 9.0]
    samples = NoisyPath(model(), 1).feed(t, poses)
    assert compose(samples.correction_xyt, poses) == pytest.approx(poses + samples.error_xyt, abs=1e-9)


def test_a_jump_of_the_pose_is_counted_and_holds_the_correction():
    t, poses = office(50.0, 20.0)
    jumped = poses.copy()
    jumped[600:] = compose(np.array([30.0, 5.0, 1.0]), jumped[600:])
    samples = NoisyPath(model(), 1).feed(t, jumped)
    assert samples.jumps == 1
    assert samples.correction_xyt[600] == pytest.approx(samples.correction_xyt[599], abs=1e-12)
    assert np.array_equal(samples.sums[:, 600], samples.sums[:, 599])
    assert samples.travelled_m[600] == samples.travelled_m[599]


def test_two_messages_of_one_stamp_are_no_jump_and_no_division_by_zero():
    t, poses = office(50.0, 10.0)
    t[100] = t[101]
    samples = NoisyPath(model(effects=EFFECTS), 1).feed(t, poses)
    assert samples.jumps == 0
    assert np.isfinite(samples.error_xyt).all()


def test_headings_may_wrap():
    t, poses = office(50.0, 40.0)
    wrapped = poses.copy()
    wrapped[:, 2] = np.arctan2(np.sin(poses[:, 2]), np.cos(poses[:, 2]))
    straight = NoisyPath(model(), 1).feed(t, poses).error_xyt
    assert NoisyPath(model(), 1).feed(t, wrapped).error_xyt == pytest.approx(straight, abs=1e-9)


@pytest.mark.parametrize(
    ("chosen", "drive", "places"), [(model(), office(10.0, 40.0), [40, 130, 200, 400]),
    (model("linear", Coefficients(0.02, 0.04, 0.02, 0.01), "0.25m,0.2rad"), office(10.0, 40.0), [40, 130, 200, 400]),
    (model("quadratic", Coefficients(0.01, 0.01, 0.01, 0.01)), office(10.0, 40.0), [40, 130, 200, 400]),
    (model(coefficients=Coefficients(0.05, 0.02, 0.05, 0.01, across_trans=0.04)), office(10.0, 20.0), [200]),
    (model("velocity", Coefficients(0.005, 0.005, 0.01, 0.005, 0.0, 0.004, 0.01)), office(4.0, 40.0), [160]),
    (model("omni", Coefficients(0.005, 0.005, 0.01, 0.005, 0.02)), strafing(), [80])], ids=["diffusion", "linear",
    "quadratic", "sideways", "velocity", "omni"]
)  # fmt: skip
def test_covariance_is_calibrated_while_headings_are_well_known(chosen, drive, places):
    """NEES of many runs is the number of dimensions, at several places of the path."""
    runs = 600
    nees = np.empty((runs, len(places)))
    for k in range(runs):
        samples = NoisyPath(chosen, 11, k).feed(*drive)
        noisy = samples.clean_xyt[places, :2] + samples.error_xyt[places, :2] - samples.origin_xy
        P = pose_covariance(samples.sums[:, places], noisy.T)
        assert np.sqrt(P[:, 2, 2]).max() < 0.2
        e = samples.error_xyt[places]
        nees[k] = np.einsum("ni,ni->n", e, np.linalg.solve(P, e[:, :, None])[:, :, 0])
    assert nees.mean(axis=0) / 3.0 == pytest.approx(np.ones(len(places)), abs=0.12)


def test_white_noise_on_twists_is_the_rob521_projects():
    """A robot that drives straight at 10 Hz for 10 s: noise of 0.2 m/s and 0.04 rad/s on every twist, at rest too."""
    n = 101
    poses = np.column_stack((np.linspace(0.0, 5.0, n), np.zeros(n), np.zeros(n)))
    k = Coefficients(0, 0, 0, 0, white_v=0.2, white_omega=0.04)
    assert not k.noise_free
    for drive in (poses, poses * 0.0):
        errors = last_errors(model(coefficients=k), (stamps(n, 10.0), drive), 1500)
        assert errors[:, 2].std() == pytest.approx(0.04 * 0.1 * math.sqrt(100), rel=0.06)
        assert errors[:, 0].std() == pytest.approx(0.2 * 0.1 * math.sqrt(100), rel=0.06)
    assert errors[:, 1].std() < 0.01


@pytest.mark.parametrize("rate_hz", [5.0, 20.0])
@pytest.mark.parametrize("law", ["diffusion", "quadratic"])
def test_the_angle_random_walk_of_a_gyro_grows_with_time_at_any_rate_and_at_rest(law, rate_hz):
    n = round(8.0 * rate_hz) + 1
    t, poses = stamps(n, rate_hz), np.column_stack((np.linspace(0.0, 4.0, n), np.zeros(n), np.zeros(n)))
    chosen = model(law, Coefficients(0, 0, 0, 0, rot_time=0.01))
    for drive in (poses, poses * 0.0):
        assert last_errors(chosen, (t, drive), 500)[:, 2].std() == pytest.approx(0.01 * math.sqrt(8.0), rel=0.08)
        samples = NoisyPath(chosen, 5, 0).feed(t, drive)
        place = (samples.clean_xyt[-1:, :2] + samples.error_xyt[-1:, :2] - samples.origin_xy).T
        assert pose_covariance(samples.sums[:, -1:], place)[0, 2, 2] == pytest.approx(0.01**2 * 8.0, rel=1e-5)


def crawl(law, k, step, moves):
    """Walk along a path from one end of a step or of a move to the next: slow and obvious."""
    gone_m = gone_rad = 0.0
    out = []
    for ds, dtheta in np.abs(moves):
        left, grown = 1.0, np.zeros(3)
        while left > 0.0:
            by_m = (step.distance_m - gone_m) / ds if ds > 0 else np.inf
            by_rad = (step.angle_rad - gone_rad) / dtheta if dtheta > 0 else np.inf
            part = min(left, by_m, by_rad)
            before = np.square(textbook_sigmas(law, k, gone_rad / 2, gone_m, gone_rad / 2))
            gone_m, gone_rad, left = gone_m + part * ds, gone_rad + part * dtheta, left - part
            grown += np.square(textbook_sigmas(law, k, gone_rad / 2, gone_m, gone_rad / 2)) - before
            if part in {by_m, by_rad}:
                gone_m = gone_rad = 0.0
        out.append(grown)
    return np.array(out)


def grown(law, step, moves, growth=None):
    """Return the variances of moves (n, 2), ahead and turning, within steps, and where the last step is then."""
    ahead, turn = np.ascontiguousarray(moves.T)
    noise, rows = Noise(law, LAW_COEFFICIENTS[law], step), Increments(ahead, np.zeros(len(moves)), turn)
    return noise_variances(noise, rows, np.ones(len(moves)), StepGrowth() if growth is None else growth)


@pytest.mark.parametrize("law", ["linear", "quadratic", "velocity", "omni"])
def test_growth_within_steps_agrees_with_crawling_along_the_path(law):
    rng = np.random.default_rng(3)
    moves = np.column_stack((rng.uniform(-0.3, 0.7, 60), rng.uniform(-0.5, 0.5, 60)))
    moves[10:14] = 0.0
    moves[20] = 2.4, 0.0
    step = Step(0.25, 0.2)
    got = grown(law, step, moves).variances
    expected = crawl(law, LAW_COEFFICIENTS[law], step, moves)
    for ours, theirs in zip((got.rot1, got.trans, got.rot2), expected.T, strict=True):
        assert ours == pytest.approx(theirs, rel=1e-9, abs=1e-14)
    assert not got.rot1[10:14].any()


def test_an_increment_of_many_whole_steps_counts_each_and_none_is_no_variance():
    k = LAW_COEFFICIENTS["linear"]
    got = grown("linear", Step(0.25, 0.2), np.array([[1.0, 0.0]]))
    assert got.variances.rot1[0] == pytest.approx(4 * (k.rot_trans * 0.25) ** 2)
    assert got.variances.trans[0] == pytest.approx(4 * (k.trans_trans * 0.25) ** 2)
    assert got.growth.began_m == pytest.approx(1.0)
    none = grown("linear", Step(1, 1), np.zeros((0, 2)), StepGrowth(0.3, 0.1))
    assert (len(none.variances.rot1), none.growth) == (0, StepGrowth(0.3, 0.1))


def test_subtraction_publishes_noisy_minus_clean_and_correction_the_rigid_motion(tmp_path):
    words = ["--odom-topic", "/odom", "--law", "article-code", "--alpha", "9", "9", "9", "9", "--seed", "4"]
    found = {}
    for how in ("subtraction", "correction"):
        out = tmp_path / f"{how}.mcap"
        assert run([str(OFFICE), str(out), *words, "--tf", how, "--new-odom-frame", "noisy"]) == 0
        found[how] = rows_of(out, "/tf", ("noisy", "odom"))
    drive = read_drive(OFFICE, "/odom")
    np.testing.assert_array_equal(found["subtraction"].stamps_ns, drive.stamps_ns)
    model = MotionModel(Noise("article-code", Coefficients(9.0, 9.0, 9.0, 9.0)))
    samples = NoisyPath(model, 4).feed(drive.stamps_ns, drive.xyt)
    np.testing.assert_allclose(found["subtraction"].xyt[:, :2], samples.error_xyt[:, :2], atol=1e-9)
    np.testing.assert_allclose(found["correction"].xyt[:, :2], samples.correction_xyt[:, :2], atol=1e-9)
    assert np.abs(found["subtraction"].xyt - found["correction"].xyt).max() > 1e-3


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
    for number in range(2):
        alone = NoisyPath(model, 3, number).feed(t, poses).error_xyt
        assert np.array_equal(np.concatenate([part[number] for part in parts]), alone)
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
    for number in range(1, 5):
        feed(NoisyPath(model, 3, number, systematic=shared))
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
