"""A dead band of the yaw rate is recognised: exact zeros, no small rates, and a truth that turns meanwhile."""

import numpy as np
import pytest

from odomcorrupt.geometry.se2 import increments
from odomcorrupt.study.io.encoders import encoder_effects
from odomcorrupt.study.io.raw_trajectory import Samples
from odomcorrupt.study.io.reader import recordings_of
from odomcorrupt.study.io.yaw_dead_band import yaw_dead_band

HZ, SECONDS, BAND = 50, 160.0, 0.015
TIMES = np.arange(0.0, SECONDS, 1.0 / HZ)


def driven(rng):
    """Return speed and yaw rate (n,): slow bends, turns, and rests of 4 s."""
    kind = rng.choice(3, int(SECONDS / 4.0), p=[0.6, 0.25, 0.15])
    v, w = np.where(kind < 2, 0.3, 0.0), rng.normal(0.0, 1.0, len(kind)) * np.array([0.02, 0.4, 0.0])[kind]
    smooth = np.hanning(HZ) / np.hanning(HZ).sum()
    return (np.convolve(np.repeat(x, 4 * HZ), smooth, "same") for x in (v, w))


def samples(name, v, rates, noise=(0.0, 0.0), rng=None):
    turn, travel = np.concatenate(([0.0], rates[1:])) / HZ, np.concatenate(([0.0], v[1:])) / HZ
    yaw = np.cumsum(turn)
    x, y = (np.cumsum(travel * f(yaw - turn / 2.0)) for f in (np.cos, np.sin))
    if rng is not None:
        spread = (noise[0], noise[0], noise[1])
        x, y, yaw = (a + rng.normal(0.0, s, len(a)) for a, s in zip((x, y, yaw), spread, strict=True))
    stamps = (1.7e18 + TIMES * 1e9).astype(np.int64)
    heading = np.angle(np.exp(1j * yaw))
    empty = np.zeros(0)
    return Samples(name, name, "", stamps, np.column_stack((x, y, 0.0 * x)), heading, empty.astype(np.int64), empty)


def run(reported, seed=3):
    """Return odometry and truth; `reported` makes the odometry's yaw rates of the true ones."""
    rng = np.random.default_rng(seed)
    v, w = driven(rng)
    return samples("/odom", v, reported(w, rng)), samples("/mocap/pose", v, w, (5e-4, 1e-3), rng)


def gyro(w, rng):
    return w + rng.normal(0.0, 0.002, len(w))


def banded(w, rng):
    rates = gyro(w, rng)
    return np.where(np.abs(rates) < BAND, 0.0, rates)


def test_a_dead_band_is_recognised_with_its_threshold():
    assert yaw_dead_band(*run(banded)) == pytest.approx(BAND, rel=0.02)
    (recording,) = recordings_of("run", *run(banded))
    assert recording.yaw_dead_band_radps == pytest.approx(BAND, rel=0.02)
    assert any("below 0.015 rad/s read exactly zero" in note for note in recording.notes)


def test_a_dead_band_is_recognised_where_jitter_interrupts_the_zeros():
    def rough(w, rng):
        rates = w + rng.normal(0.0, 0.7 * BAND, len(w))
        return np.where(np.abs(rates) < BAND, 0.0, rates)

    assert yaw_dead_band(*run(rough)) == pytest.approx(BAND, rel=0.02)


def remainder(w):
    """Rates (n,) that decay to zero as those of commands do: a few are not rounded to zero yet."""
    k = np.arange(len(w))
    return np.where(k % (2 * HZ) < 4, BAND * 1e-5 * (1.0 + 0.3 * (k % 3)), 0.0)


@pytest.mark.parametrize(
    "reported",
    [
        gyro,
        lambda w, rng: np.where(w == 0.0, 0.0, gyro(w, rng)),  # exact zeros at rest only
        lambda w, rng: BAND * np.trunc(gyro(w, rng) / BAND),  # truncated to steps
        lambda w, _: BAND / 20.0 * np.rint(w / BAND * 20.0),  # fine steps, of ticks
        lambda w, _: w,  # exact
        lambda w, _: np.where(np.abs(w) < BAND, remainder(w), w),
    ],
)
def test_other_zeros_are_no_dead_band(reported):
    assert yaw_dead_band(*run(reported)) == 0.0


def test_a_robot_that_never_turns_slowly_has_no_dead_band():
    rng = np.random.default_rng(3)
    v, w = driven(rng)
    w = np.where(np.abs(w) < BAND, 0.0, w)
    truth = samples("/mocap/pose", v, w, (5e-4, 1e-3), rng)
    assert yaw_dead_band(samples("/odom", v, w), truth) == 0.0


def test_unequal_wheels_that_turn_a_robot_with_straight_commands_are_no_dead_band():
    rng = np.random.default_rng(3)
    v, w = driven(rng)
    w = np.where(np.abs(w) < BAND, 0.0, w)
    truth = samples("/mocap/pose", v, w + 0.05 * v, (5e-4, 1e-3), rng)
    assert yaw_dead_band(samples("/odom", v, w), truth) == 0.0


def test_the_detected_band_is_an_effect_with_which_corruption_makes_such_odometry():
    odometry, truth = run(banded)
    (recording,) = recordings_of("run", odometry, truth)
    (effect,) = encoder_effects(recording)
    assert effect.name == "gyro_dead_band"
    steps = increments(truth.trajectory().xyt)
    smooth = np.column_stack((steps.ds_m, steps.dl_m, np.diff(np.unwrap(run(lambda w, _: w)[0].yaw_rad))))
    reported = effect.recorded(smooth, TIMES[1:], None, effect.start(np.random.default_rng(1))).steps[:, 2]
    own = increments(odometry.trajectory().xyt).dtheta_rad
    assert np.mean(reported == 0.0) == pytest.approx(np.mean(np.abs(own) < 1e-9), abs=0.02)
    assert np.array_equal(reported[reported != 0.0], smooth[reported != 0.0, 2])
