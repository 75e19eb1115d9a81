"""Random effects: what a reader of their page expects to see in a bag."""

import numpy as np
import pytest
from manoeuvres import CIRCLE, SPIN, STOP, STRAIGHT, motion

from odomcorrupt.corruption.path import NoisyPath
from odomcorrupt.effects import effect_from_values
from odomcorrupt.errors import EffectError
from odomcorrupt.model.motion_model import MotionModel, Noise
from odomcorrupt.model.noise_laws import Coefficients
from odomcorrupt.rng import stream


def drawn(name, values, drive, run=0):
    effect = effect_from_values(name, values)
    return effect.twist_error(drive, effect.start(stream(5, run, name))).f


def recorded(name, values, drive, run=0):
    effect = effect_from_values(name, values)
    steps = np.stack((drive.v, drive.vy, drive.omega), axis=1) * drive.dt_s[:, None]
    return steps, effect.recorded(steps, drive.t_s, drive.track_m, effect.start(stream(5, run, name))).steps


def test_a_bias_walk_goes_on_at_rest_and_a_gain_does_not():
    assert drawn("gyro_bias_walk", {"density": 1e-3}, motion(**STOP))[:, 2].all()
    assert not drawn("gauss_markov", {"sigma": 0.1}, motion(**STOP)).any()


def test_a_bias_with_a_time_comes_back_and_is_as_wide_as_it_says():
    bias = drawn("gyro_bias_walk", {"density": 1e-3, "tau": 8.0}, motion(0.0, 0.0, seconds=4000.0))[:, 2]
    assert bias.std() == pytest.approx(1e-3 * np.sqrt(8.0 / 2.0), rel=0.15)
    lag = round(8.0 * 50)
    assert np.corrcoef(bias[:-lag], bias[lag:])[0, 1] == pytest.approx(np.exp(-1.0), abs=0.15)


def test_a_gain_acts_on_its_channel_alone():
    along = drawn("gauss_markov", {"sigma": 0.1}, motion(**CIRCLE))
    yaw = drawn("gauss_markov", {"sigma": 0.1, "channel": "yaw"}, motion(**CIRCLE))
    assert along[:, 0].all()
    assert not along[:, 1:].any()
    assert yaw[:, 2].all()
    assert not yaw[:, :2].any()


@pytest.mark.parametrize("tau", [0.5, 5.0])
def test_a_gain_forgets_itself_within_its_correlation_time(tau):
    drive = motion(1.0, 0.0, seconds=2000.0)
    gain = drawn("gauss_markov", {"sigma": 0.02, "tau": tau}, drive)[:, 0]
    lag = round(tau * 50)
    assert gain.std() == pytest.approx(0.02, rel=0.15)
    assert np.corrcoef(gain[:-lag], gain[lag:])[0, 1] == pytest.approx(np.exp(-1.0), abs=0.15)


def test_bursts_come_at_their_rate_last_their_time_and_only_slow_the_truth():
    drive = motion(**STRAIGHT, seconds=2000.0)
    lost = drawn("slip_burst", {"rate": 0.1, "slip": 0.4, "duration": 0.3}, drive)[:, 0] / 0.5
    assert lost.max() <= 0.0
    assert lost.min() >= -0.75
    on = lost < 0.0
    begins = np.count_nonzero(on[1:] & ~on[:-1])
    assert begins == pytest.approx(200, abs=5 * np.sqrt(200))
    assert on.sum() / 50.0 / begins == pytest.approx(0.31, abs=0.02)
    assert lost[on].mean() == pytest.approx(-0.4, rel=0.15)


def test_with_a_track_a_burst_of_one_wheel_turns_the_robot():
    f = drawn("slip_burst", {"rate": 1.0, "slip": 0.4}, motion(**STRAIGHT, seconds=200.0, track=0.4))
    assert (f[:, 2] > 1e-3).any()
    assert (f[:, 2] < -1e-3).any()
    assert ((np.abs(f[:, 2]) < 1e-12) & (f[:, 0] < -1e-3)).any()  # both wheels
    # a right wheel that is left behind turns the robot to the right
    assert np.all(f[f[:, 0] == 0.0, 2] == 0.0)


def test_ticks_come_in_a_lattice_and_their_error_does_not_grow():
    drive = motion(0.013, 0.02, seconds=200.0, track=0.4)
    steps, reported = recorded("quantization", {"step": 0.002}, drive)
    ticks = np.stack((reported[:, 0] + 0.2 * reported[:, 2], reported[:, 0] - 0.2 * reported[:, 2])) / 0.002
    assert ticks == pytest.approx(np.round(ticks), abs=1e-9)
    off = np.cumsum(reported - steps, axis=0)
    assert np.abs(off[:, 0]).max() <= 0.002
    assert np.abs(off[:, 2]).max() <= 0.002 / 0.2
    assert np.abs(off[-100:, 0]).max() > 1e-5


def test_lost_increments_are_zero_and_the_others_untouched():
    steps, reported = recorded("lost_increments", {"fraction": 0.1}, motion(**CIRCLE, seconds=100.0))
    gone = ~reported.any(axis=1)
    assert gone.mean() == pytest.approx(0.1, abs=5 * np.sqrt(0.09 / 5000))
    assert np.array_equal(reported[~gone], steps[~gone])


@pytest.mark.parametrize(("wheel", "side"), [("right", 1.0), ("left", -1.0)])
def test_a_lost_increment_of_one_wheel_leaves_the_other_wheels(wheel, side):
    steps, reported = recorded("lost_increments", {"fraction": 0.1, "wheel": wheel}, motion(0.4, 0.3, 100.0, track=0.4))
    own, other = (np.stack([s[:, 0] + at * 0.2 * s[:, 2] for s in (steps, reported)]) for at in (side, -side))
    gone = np.abs(own[1]) < 1e-12
    assert gone.mean() == pytest.approx(0.1, abs=5 * np.sqrt(0.09 / 5000))
    assert own[1, ~gone] == pytest.approx(own[0, ~gone])
    assert other[1] == pytest.approx(other[0])


def test_ticks_and_losses_of_one_wheel_need_the_track():
    for name, values in (("quantization", {"step": 0.002}), ("lost_increments", {"fraction": 0.1, "wheel": "left"})):
        with pytest.raises(EffectError, match="track"):
            recorded(name, values, motion(**STRAIGHT))


def office():
    n = 20001
    stamps = 10**11 + np.arange(n) * 20_000_000
    return stamps, np.column_stack((np.arange(n) * 0.01, np.zeros(n), np.zeros(n)))


def test_heavy_tails_keep_the_laws_variance_and_make_large_steps_more_frequent():
    def steps(effects):
        law = Noise("diffusion", Coefficients(0.0, 0.0, 0.05, 0.0))
        error = NoisyPath(MotionModel(law, effects), 3).feed(*office()).error_xyt
        return np.diff(error[:, 0]) / (0.05 * 0.1)

    plain, heavy = steps(()), steps((effect_from_values("heavy_tails", {"inverse_dof": 0.2}),))
    assert plain.std() == pytest.approx(1.0, rel=0.03)
    assert heavy.std() == pytest.approx(1.0, rel=0.06)
    assert np.count_nonzero(np.abs(plain) > 4.0) <= 8
    assert np.count_nonzero(np.abs(heavy) > 4.0) > 40
    # the median step gets smaller in exchange: 0.7267 sqrt(3/5) of a t with five degrees of freedom
    assert np.median(np.abs(heavy)) == pytest.approx(0.7267 * np.sqrt(0.6), rel=0.04)


def test_losses_in_a_bag_are_seen_as_isolated_stops():
    model = MotionModel(
        Noise("diffusion", Coefficients(0, 0, 0, 0)), (effect_from_values("lost_increments", {"fraction": 0.05}),)
    )
    stamps, poses = office()
    x = poses[:, 0] + NoisyPath(model, 3).feed(stamps, poses).error_xyt[:, 0]
    still = np.abs(np.diff(x)) < 1e-9
    assert still.mean() == pytest.approx(0.05, abs=0.01)
    assert np.diff(x)[~still] == pytest.approx(0.01, abs=1e-9)


def test_a_spin_loses_turn_in_bursts():
    f = drawn("slip_burst", {"rate": 1.0, "slip": 0.4}, motion(**SPIN, seconds=50.0))
    assert f[:, 2].min() < -0.01
    assert f[:, 2].max() <= 0.0
