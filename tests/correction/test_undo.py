"""Corrections of arrays: effects undone, biases read at rest, and steps of a filter."""

from dataclasses import replace

import numpy as np
import pytest

from odomcorrupt.correction.run import CorrectedPath, corrected_samples
from odomcorrupt.correction.undo import ClockInverse, pose_corrections, true_stamps, undo_effects
from odomcorrupt.corruption.covariance import pose_covariance
from odomcorrupt.corruption.path import NoisyPath
from odomcorrupt.effects import effect_from_values, registry
from odomcorrupt.effects.effect import parameters
from odomcorrupt.effects.expression import user_effect
from odomcorrupt.effects.gains import WheelScale
from odomcorrupt.effects.heading_sensors import GyroBias
from odomcorrupt.effects.random_processes import GyroBiasWalk
from odomcorrupt.errors import BagError
from odomcorrupt.geometry.se2 import Increments, accumulate, compose, increments, inverse, wrap
from odomcorrupt.model.model_file import format_model, parse_model
from odomcorrupt.model.motion_model import MotionModel, Noise, Setup
from odomcorrupt.model.noise_laws import Coefficients

SILENT = Noise("diffusion", Coefficients(0.0, 0.0, 0.0, 0.0))
LOSSY = ("truncated_velocity", "truncated_counts")
"""What integers cut off is lost: correction adds its mean."""
SYSTEMATIC = [
    name
    for name, kind in registry().items()
    if kind.kind not in {"noise", "event"} and not kind.clock and name not in LOSSY
]
AMPLE = {"region_slip": {"slip": 0.05, "x": 3.0, "y": 0.0, "radius": 1.5}}


def drive(seconds=40.0, rate_hz=50.0, *, sideways=False):
    """A drive with straights, bends both ways, a stop, a turn on the spot and a reverse: stamps and poses."""
    t = np.arange(round(seconds * rate_hz) + 1) / rate_hz
    v = np.interp(t % 20.0, [0, 1, 8, 9, 13, 14, 17, 18, 20], [0, 0.6, 0.6, 0, 0, 0.5, 0.5, -0.3, 0])
    w = np.interp(t % 13.0, [0, 3, 4, 6, 8, 9, 13], [0, 0, 0.5, 0.1, -0.6, 0.2, 0])
    steps = np.stack((v, 0.2 * np.sin(t) * sideways, w))[:, :-1] / rate_hz
    return 10**11 + (t * 1e9).astype(np.int64), accumulate(np.array([2.0, -1.0, 0.4]), Increments(*steps))


def model(*effects, noise=SILENT):
    return MotionModel(noise, effects, track_m=0.4)


def usual(name):
    kind = registry()[name]
    values = AMPLE.get(name) or {p.name: p.typical for p in parameters(kind) if p.amplitude}
    return effect_from_values(name, values)


def there_and_back(chosen, stamps_ns, clean):
    """Return how far corruption moved the poses, and how far correction leaves them from where they were."""
    wrong = clean + NoisyPath(chosen, 1).feed(stamps_ns, clean).error_xyt
    back = wrong + corrected_samples(chosen, stamps_ns, wrong, first_ns=int(stamps_ns[0])).error_xyt
    return np.abs(wrong - clean).max(), np.abs(back - clean).max()


def test_rounded_stamps_do_not_make_a_law_of_the_acceleration_flicker():
    stamps_ns, measured = drive(rate_hz=29.4)
    law = user_effect("soft", "left += v * (k * where(a * sign(v) > -0.25, 1, 0))", {"k": -0.02})
    exact, rounded = (
        corrected_samples(model(law), at_ns, measured, first_ns=int(at_ns[0])).error_xyt
        for at_ns in (stamps_ns, stamps_ns // 10_000_000 * 10_000_000)
    )
    assert np.abs(exact).max() > 0.2
    assert np.abs(rounded - exact).max() < 0.02 * np.abs(exact).max()


@pytest.mark.parametrize("when", ["abs(a) > 0.3", "-a * sign(v) > 0.3"])
def test_noise_of_the_odometry_does_not_switch_an_effect_with_a_threshold(when):
    stamps_ns, clean = drive()
    slips = model(user_effect("slips", f"right += v * (k * where({when}, 1, 0))", {"k": -0.06}))
    wrong = clean + NoisyPath(slips, 1).feed(stamps_ns, clean).error_xyt
    noisy = wrong + np.random.default_rng(2).uniform(-2.5e-4, 2.5e-4, wrong.shape)
    back = noisy + corrected_samples(slips, stamps_ns, noisy, first_ns=int(stamps_ns[0])).error_xyt
    assert np.abs(wrong - clean).max() > 0.1
    assert np.abs(back - clean).max() < 0.1 * np.abs(wrong - clean).max()


@pytest.mark.parametrize("name", SYSTEMATIC)
def test_every_systematic_effect_is_taken_out_exactly(name):
    moved, left = there_and_back(model(usual(name)), *drive(sideways=registry()[name].needs_sideways))
    assert moved > 1e-3
    assert left < 1e-9


@pytest.mark.parametrize("name", LOSSY)
def test_of_speeds_that_shake_and_were_cut_down_the_mean_comes_back(name):
    stamps_ns, clean = drive()
    rows = np.random.default_rng(2).normal(increments(clean).rows, (4e-4, 0.0, 1e-3))
    clean = accumulate(clean[0], Increments.of_rows(rows))
    moved, left = there_and_back(model(usual(name)), stamps_ns, clean)
    assert left < 0.3 * moved


NAMES = ("unequal_wheels", "gyro_bias", "accel_slip", "slope", "region_slip", "backlash", "lever_arm", "mount_yaw")
MIXTURE = tuple(map(usual, NAMES))


def test_a_mixture_is_taken_out_across_a_jump_of_the_pose_and_messages_with_the_same_stamp():
    stamps_ns, clean = drive()
    stamps_ns[200] = stamps_ns[199]
    clean[900:] += [5.0, -2.0, 0.0]
    moved, left = there_and_back(model(*MIXTURE), stamps_ns, clean)
    assert moved > 0.1
    assert left < 1e-9
    undone = undo_effects(MIXTURE, (stamps_ns - stamps_ns[0]) * 1e-9, clean, 0.4)
    assert undone.jump.nonzero()[0].tolist() == [899]


def test_places_are_those_of_the_frame_that_effects_read():
    stamps_ns, clean = drive()
    chosen = model(usual("slope"), usual("region_slip"))
    t_s = (stamps_ns - stamps_ns[0]) * 1e-9
    wrong = clean + NoisyPath(chosen, 1).feed(stamps_ns, clean).error_xyt
    frame = np.array([7.0, -3.0, 2.0])  # of odometry that begins elsewhere and looks elsewhere
    moved = compose(inverse(frame), wrong)
    back = compose(frame, moved + undo_effects(chosen.effects, t_s, moved, 0.4, frame_xyt=frame).error_xyt)
    assert np.abs(back - clean).max() < 1e-9
    unaware = compose(frame, moved + undo_effects(chosen.effects, t_s, moved, 0.4).error_xyt)
    assert np.abs(unaware - clean).max() > 0.02


def test_effects_that_ask_for_places_are_known():
    asking = {name for name in SYSTEMATIC if usual(name).reads_places}
    assert asking == {"slope", "region_slip", "hard_iron"}
    assert user_effect("bend", "yaw += k * sin(theta)", {"k": 0.01}).reads_places
    assert not user_effect("skid", "along += k * a", {"k": 0.01}).reads_places


def test_random_effects_are_passed_by_to_the_bit():
    stamps_ns, clean = drive(10.0)
    samples = corrected_samples(model(usual("gauss_markov"), usual("quantization")), stamps_ns, clean, first_ns=0)
    assert not samples.error_xyt.any()


@pytest.mark.parametrize("rate", [0.0, 1e-4, -0.1, 0.1])
def test_clocks_are_put_right_to_the_nanosecond(rate):
    clocks = (effect_from_values("time_offset", {"offset": -0.3}), effect_from_values("clock_skew", {"rate": rate}))
    was_ns, _ = drive()
    t_s = (was_ns - was_ns[0]) * 1e-9
    wrong_ns = was_ns + np.rint(sum(clock.stamp_shift_s(t_s) for clock in clocks) * 1e9).astype(np.int64)
    assert np.abs(true_stamps(clocks, wrong_ns, int(wrong_ns[0])) - was_ns).max() <= 1
    assert not ClockInverse((replace(clocks[0], offset=0.0),)).acts


def test_covariances_are_those_of_the_noise_along_the_corrected_path():
    noise = Noise("diffusion", Coefficients(0.05, 0.03, 0.05, 0.02))
    stamps_ns, clean = drive()
    effects = (usual("unequal_wheels"), usual("wheelbase"))
    wrong = clean + NoisyPath(model(*effects), 1).feed(stamps_ns, clean).error_xyt
    samples = corrected_samples(model(*effects, noise=noise), stamps_ns, wrong, first_ns=int(stamps_ns[0]))
    ends = np.array([NoisyPath(model(noise=noise), seed).feed(stamps_ns, clean).error_xyt[-1] for seed in range(250)])
    corrected = (wrong + samples.error_xyt)[-1:, :2] - samples.origin_xy
    forecast = pose_covariance(samples.sums[:, -1:], corrected.T)[0]
    np.testing.assert_allclose(np.diag(forecast), ends.var(axis=0), rtol=0.25)


def test_another_odometry_in_the_second_pass_is_refused():
    stamps_ns, clean = drive(5.0)
    path = CorrectedPath([corrected_samples(model(usual("wheel_scale")), stamps_ns, clean, first_ns=0)])
    assert len(path.feed(stamps_ns[:10], clean[:10])) == 10
    with pytest.raises(BagError, match="changed while"):
        path.feed(stamps_ns[11:], clean[11:])


HZ = 50.0
LEG_S = 20.0
"""A leg is driven for all but its last 3 s, in which the robot stands."""


def resting(*, rests=True, slow_turn=False):
    """Return times (n,) and twists (n - 1, 2) of arcs with rests between them."""
    t_s = np.arange(round(600.0 * HZ) + 1) / HZ
    phase, leg = t_s[:-1] % LEG_S, (t_s[:-1] // LEG_S).astype(int)
    moves = (phase < LEG_S - 3.0) | (not rests)
    v = np.where(moves, 0.5, 0.0)
    omega = np.where(moves, 0.3 * np.cos(leg), 0.0)
    if slow_turn:
        omega = np.where(~moves & (leg == 14), 0.03, omega)
    return t_s, np.column_stack((v, omega))


def path(t_s, twist):
    steps = twist * np.diff(t_s)[:, None]
    return accumulate(np.zeros(3), Increments(steps[:, 0].copy(), np.zeros(len(steps)), steps[:, 1].copy()))


def walked(t_s, density, tau, seed=4):
    """Return a bias (n - 1,) that walks from .004 rad/s, with white noise of a gyro."""
    rng = np.random.default_rng(seed)
    keep = np.exp(-1.0 / HZ / tau) if tau else 1.0
    kick = density * np.sqrt(0.5 * tau * (1.0 - keep**2) if tau else 1.0 / HZ)
    bias = [0.004]
    for draw in rng.standard_normal(len(t_s) - 2):
        bias.append(keep * bias[-1] + kick * draw)
    return np.array(bias) + 1e-4 * np.sqrt(HZ) * rng.standard_normal(len(bias))


def heading_errors(effects, t_s, twist, bias):
    """Return the largest error of heading (rad) of the odometry, and after correction."""
    true = path(t_s, twist)
    odometry = path(t_s, twist + np.column_stack((np.zeros_like(bias), bias)))
    error = undo_effects(effects, t_s, odometry, 0.4).error_xyt
    return np.abs(odometry - true)[:, 2].max(), np.abs(odometry + error - true)[:, 2].max()


@pytest.mark.parametrize("tau", [0.0, 200.0])
def test_rests_show_the_bias(tau):
    t_s, twist = resting()
    walk = GyroBiasWalk(density=1e-4, tau=tau)
    before, after = heading_errors([walk], t_s, twist, walked(t_s, walk.density, tau))
    assert after < 0.05 * before


def test_a_constant_bias_in_the_model_is_removed_once():
    t_s, twist = resting()
    walk = GyroBiasWalk(density=1e-4)
    bias = walked(t_s, walk.density, 0.0)
    _, alone = heading_errors([walk], t_s, twist, bias)
    _, both = heading_errors([walk, GyroBias(bias=0.004)], t_s, twist, bias)
    assert both == pytest.approx(alone, rel=0.05)


def test_a_slow_turn_on_the_spot_is_no_bias():
    t_s, twist = resting(slow_turn=True)
    walk = GyroBiasWalk(density=1e-4)
    _, after = heading_errors([walk], t_s, twist, walked(t_s, walk.density, 0.0))
    assert after < 0.02  # it turns by 0.09


@pytest.mark.parametrize(("effects", "rests"), [([GyroBiasWalk(density=1e-4)], False), ([WheelScale(e=0.0)], True)])
def test_nothing_is_removed_without_rests_or_without_the_effect(effects, rests):
    t_s, twist = resting(rests=rests)
    before, after = heading_errors(effects, t_s, twist, walked(t_s, 1e-4, 0.0))
    assert after == before


def test_wheels_that_show_no_bias_at_rest_are_not_corrected():
    t_s, twist = resting()
    bias = np.where(twist[:, 0] == 0.0, 0.0, walked(t_s, 1e-4, 0.0))
    before, after = heading_errors([GyroBiasWalk(density=1e-4)], t_s, twist, bias)
    assert after == pytest.approx(before, rel=1e-9)


STEPPED = MotionModel(SILENT, setup=Setup(pose_corrections=True))


def stepped(xyt, every=50, scatter=(0.006, 0.006, 0.002)):
    """Return poses (n, 3) with a step added at every so many of them, and the rows of the steps."""
    at = np.arange(every, len(xyt) - 1, every)
    steps = increments(xyt)
    for column, sigma in zip((steps.ds_m, steps.dl_m, steps.dtheta_rad), scatter, strict=True):
        column[at - 1] += np.random.default_rng(3).choice([-1.0, 1.0], len(at)) * sigma
    return accumulate(xyt[0], steps), at


@pytest.mark.parametrize("sideways", [False, True])
def test_free_odometry_has_no_steps(sideways):
    stamps_ns, xyt = drive(sideways=sideways)
    found = pose_corrections(stamps_ns * 1e-9, xyt)
    assert found.steps == 0
    assert not found.error_xyt.any()


@pytest.mark.parametrize("sideways", [False, True])
def test_odometry_between_steps_is_found_again(sideways):
    stamps_ns, xyt = drive(sideways=sideways)
    measured, at = stepped(xyt)
    measured[:, 2] = wrap(measured[:, 2])  # as quaternions give it
    found = pose_corrections(stamps_ns * 1e-9, measured)
    assert found.steps == len(at)
    left = measured + found.error_xyt - xyt
    left[:, 2] = wrap(left[:, 2])
    assert np.abs(left).max() < 1e-3
    assert np.abs(measured - xyt)[:, :2].max() > 0.02


def test_a_reset_of_the_pose_stays():
    stamps_ns, xyt = drive()
    xyt[1000:, :2] += [3.0, -4.0]
    assert pose_corrections(stamps_ns * 1e-9, xyt).steps == 0


def test_a_model_of_what_lies_between_steps_takes_them_out_with_its_effects():
    stamps_ns, xyt = drive()
    measured, _ = stepped(xyt)
    model = replace(STEPPED, effects=(effect_from_values("wheel_scale", {"e": 0.02}),), track_m=0.4)
    first_ns = int(stamps_ns[0])

    def corrected(chosen, poses):
        return poses + corrected_samples(chosen, stamps_ns, poses, first_ns=first_ns).error_xyt

    free = corrected(replace(model, setup=Setup()), xyt)
    assert corrected(model, measured) == pytest.approx(free, abs=1e-3)
    assert np.abs(corrected(replace(model, setup=Setup()), measured) - free).max() > 0.02


def test_model_files_say_so():
    assert parse_model(format_model(STEPPED)).setup.pose_corrections
    assert "pose_corrections" not in format_model(replace(STEPPED, setup=Setup()))
