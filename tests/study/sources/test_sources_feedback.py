"""Odometry that other sensors correct, and gyros with a dead band, are distinguished from errors that accumulate."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scipy.signal import lfilter
from sourcedrive import Rows, path, samples

from odomcorrupt.geometry.se2 import between, compose, increments
from odomcorrupt.study.io.encoders import encoder_effects
from odomcorrupt.study.io.feedback import pull_of
from odomcorrupt.study.io.first_look import first_look
from odomcorrupt.study.io.motion_windows import Look
from odomcorrupt.study.io.reader import recordings_of

RATE_HZ, SECONDS = 20.0, 200.0
TIMES = np.arange(0.0, SECONDS, 1.0 / RATE_HZ)
REAL = path(TIMES)


def sideways():
    """Return the poses of a robot that drives in circles of a few metres and sideways as often as along."""
    x, y = 1.5 * np.cos(0.21 * TIMES) + 0.5 * np.sin(0.55 * TIMES), 1.5 * np.sin(0.21 * TIMES)
    return np.column_stack((x, y, 0.6 * np.sin(0.17 * TIMES)))


def odometry(errors, pull=0.0, every=20, real=REAL):
    """Return poses composed of the truth's steps and errors (n - 1, 3); a filter takes a part of them out."""
    rng = np.random.default_rng(8)
    steps = between(real[:-1], real[1:])
    now, out = real[0], [real[0]]
    for i, step in enumerate(steps + errors(steps, rng)):
        now = compose(now, step)
        if pull and i % every == 0:
            given = real[i + 1] + rng.normal(0.0, [0.01, 0.01, 0.005])
            now = now + pull * (given - now)
        out.append(now)
    return np.array(out)


def noise(steps, rng):
    return rng.normal(0.0, [0.001, 0.0005, 0.002], steps.shape)


CAUSES = {
    "noise": noise,
    "wide wheels": lambda steps, rng: noise(steps, rng) + steps * [0.03, 0.0, 0.02],
    "a biased gyro": lambda steps, rng: noise(steps, rng) + np.array([0.0, 0.0, 0.0003]),
    "late turns": lambda steps, rng: noise(steps, rng) + np.diff(steps[:, 2], prepend=0.0)[:, None] * [0.0, 0.0, 2.0],
}


def run_of(read, poses, true=None):
    def rows(xyt):
        return Rows((1.7e18 + TIMES * 1e9).astype(np.int64), np.column_stack((xyt[:, :2], 0.0 * TIMES)), xyt[:, 2])

    true = REAL + np.random.default_rng(9).normal(0.0, 0.002, REAL.shape) if true is None else true
    (recording,) = read(rows(poses), rows(true), truth="/mocap")
    return recording


@pytest.mark.parametrize("cause", CAUSES)
def test_errors_that_pile_up_are_no_filters(read, cause):
    recording = run_of(read, odometry(CAUSES[cause]))
    assert "filter" not in " ".join(recording.notes)
    assert recording.pulled_per_s == 0.0


@pytest.mark.parametrize(("cause", "pull"), [("noise", 0.1), ("wide wheels", 0.2), ("a biased gyro", 0.2)])
def test_errors_that_fade_are_and_what_can_be_learned_is_said(read, cause, pull):
    recording = run_of(read, odometry(CAUSES[cause], pull))
    said = " ".join(recording.notes)
    assert "its errors fade by" in said
    assert "(clocks and lags are unaffected); record wheel-only odometry" in said
    assert 0.3 * pull < recording.pulled_per_s < 1.5 * pull


def test_a_compass_corrects_headings_and_no_positions(read):
    rng, error = np.random.default_rng(8), np.zeros(len(REAL))
    deflection = 0.2 * np.sin(REAL[:, 2] + 0.8) + rng.normal(0.0, 0.004, len(REAL))
    for i in range(1, len(REAL)):
        error[i] = error[i - 1] + (deflection[i] - error[i - 1]) / (2.0 * RATE_HZ)
    steps = between(REAL[:-1], REAL[1:]) + rng.normal(0.0, [0.001, 0.0002, 0.0], (len(REAL) - 1, 3))
    steps[:, 2] += np.diff(error)
    poses = np.array([now := REAL[0], *(now := compose(now, step) for step in steps)])
    recording = run_of(read, poses)
    assert "its errors of heading fade by" in (said := " ".join(recording.notes))
    assert "as those of a compass or of a yaw error that depends on the heading" in said
    assert recording.pulled_per_s > 0.1


def test_steps_towards_poses_are_taken_out_of_odometry_whose_wheels_make_none(read):
    def wheels(steps, rng):
        return rng.normal(0.0, [1e-4, 0.0, 2e-4], steps.shape) + steps * [0.03, 0.0, 0.02]

    free = odometry(wheels, 0.0)
    recording = run_of(read, odometry(wheels, 0.2))
    assert recording.pulled_per_s == 0.0
    assert recording.pose_corrections > 0.95 * SECONDS
    assert "sudden steps towards such poses were removed" in " ".join(recording.notes)
    gained = between(recording.odometry.xyt[:-1], recording.odometry.xyt[1:]) - between(free[:-1], free[1:])
    assert np.abs(gained.sum(axis=0)).max() < 0.01


@pytest.mark.parametrize("pull", [0.0, 0.2])
def test_sideways_errors_of_wheels_are_no_filters(read, pull):
    real = sideways()
    poses = odometry(lambda steps, rng: noise(steps, rng) + steps * [0.0, 0.08, 0.0], pull, real=real)
    recording = run_of(read, poses, real + np.random.default_rng(9).normal(0.0, 0.002, real.shape))
    assert ("its errors fade by" in " ".join(recording.notes)) == bool(pull)


def test_a_truth_that_is_corrected_is_no_filter_of_the_odometry(read):
    wheels = odometry(lambda steps, rng: rng.normal(0.0, [1e-4, 0.0, 3e-4], steps.shape))
    keeps, rng = np.exp(-1.0 / (RATE_HZ * 6.0)), np.random.default_rng(4)
    error = np.zeros(REAL.shape)
    for i, new in enumerate(rng.normal(0.0, [0.03, 0.03, 0.004], REAL.shape)[1:], start=1):
        error[i] = keeps * error[i - 1] + np.sqrt(1.0 - keeps**2) * new
    assert "fade" not in " ".join(run_of(read, wheels, REAL + error).notes)


def test_headings_that_a_map_of_scans_corrects_are_no_filter_of_the_odometry():
    times = np.arange(0.0, 2000.0, 0.2)
    real, rng = path(times), np.random.default_rng(4)
    turned = lfilter([0.2], [1.0, -np.exp(-0.2 / 6.0)], rng.normal(0.0, 0.03, len(times)))
    wheels, scans = (samples(times, real[:, :2], yaw) for yaw in (real[:, 2], real[:, 2] + turned))
    assert pull_of(wheels, scans).heading > 0.0
    matched = replace(scans, covariance=np.tile(1e-6 * np.eye(3), (len(times), 1, 1)))
    assert pull_of(wheels, matched) == (0.0, 0.0)


HZ, BAND_S, BAND = 50, 160.0, 0.015
AT_S = np.arange(0.0, BAND_S, 1.0 / HZ)


def driven(rng):
    """Return speed and yaw rate (n,): slow bends, turns, and rests of 4 s."""
    kind = rng.choice(3, int(BAND_S / 4.0), p=[0.6, 0.25, 0.15])
    v, w = np.where(kind < 2, 0.3, 0.0), rng.normal(0.0, 1.0, len(kind)) * np.array([0.02, 0.4, 0.0])[kind]
    smooth = np.hanning(HZ) / np.hanning(HZ).sum()
    return (np.convolve(np.repeat(x, 4 * HZ), smooth, "same") for x in (v, w))


def seen(name, v, rates, noise=(0.0, 0.0), rng=None):
    turn, travel = np.concatenate(([0.0], rates[1:])) / HZ, np.concatenate(([0.0], v[1:])) / HZ
    yaw = np.cumsum(turn)
    x, y = (np.cumsum(travel * f(yaw - turn / 2.0)) for f in (np.cos, np.sin))
    if rng is not None:
        spread = (noise[0], noise[0], noise[1])
        x, y, yaw = (a + rng.normal(0.0, s, len(a)) for a, s in zip((x, y, yaw), spread, strict=True))
    return samples(1.7e9 + AT_S, np.column_stack((x, y)), np.angle(np.exp(1j * yaw)), name=name)


def banded_run(reported, seed=3):
    """Return odometry and truth; `reported` makes the odometry's yaw rates of the true ones."""
    rng = np.random.default_rng(seed)
    v, w = driven(rng)
    return seen("/odom", v, reported(w, rng)), seen("/mocap/pose", v, w, (5e-4, 1e-3), rng)


def gyro(w, rng):
    return w + rng.normal(0.0, 0.002, len(w))


def dead_band_radps(odometry, truth):
    return first_look(Look((odometry, truth))).dead_band_radps


def banded(w, rng, noise=0.002):
    rates = w + rng.normal(0.0, noise, len(w))
    return np.where(np.abs(rates) < BAND, 0.0, rates)


@pytest.mark.parametrize("noise", [0.002, 0.7 * BAND])
def test_a_dead_band_is_recognised_with_its_threshold_also_where_jitter_interrupts_the_zeros(noise):
    pair = banded_run(partial(banded, noise=noise))
    (recording,) = recordings_of("run", *pair)
    assert recording.yaw_dead_band_radps == dead_band_radps(*pair) == pytest.approx(BAND, rel=0.02)
    assert any("reports no turns slower than 0.86 deg/s" in note for note in recording.notes)


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
    assert dead_band_radps(*banded_run(reported)) == 0.0


@pytest.mark.parametrize("curvature_radpm", [0.0, 0.05], ids=["equal wheels", "unequal wheels"])
def test_a_robot_that_is_never_told_to_turn_slowly_has_no_dead_band(curvature_radpm):
    rng = np.random.default_rng(3)
    v, w = driven(rng)
    w = np.where(np.abs(w) < BAND, 0.0, w)
    truth = seen("/mocap/pose", v, w + curvature_radpm * v, (5e-4, 1e-3), rng)
    assert dead_band_radps(seen("/odom", v, w), truth) == 0.0


def test_the_detected_band_is_an_effect_with_which_corruption_makes_such_odometry():
    odometry, truth = banded_run(banded)
    (recording,) = recordings_of("run", odometry, truth)
    (effect,) = encoder_effects(recording)
    assert effect.name == "gyro_dead_band"
    steps = increments(truth.trajectory().xyt)
    smooth = np.column_stack((steps.ds_m, steps.dl_m, np.diff(np.unwrap(banded_run(lambda w, _: w)[0].yaw_rad))))
    reported = effect.recorded(smooth, AT_S[1:], None, effect.start(np.random.default_rng(1))).steps[:, 2]
    own = increments(odometry.trajectory().xyt).dtheta_rad
    assert np.mean(reported == 0.0) == pytest.approx(np.mean(np.abs(own) < 1e-9), abs=0.02)
    assert np.array_equal(reported[reported != 0.0], smooth[reported != 0.0, 2])
