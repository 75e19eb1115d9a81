"""Odometry corrected by external poses is distinguished from odometry with accumulating errors of any cause."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter
from sourcebags import topic, write
from sourcedrive import Rows, path

from odomcorrupt.effects.gears import AT_REST, crossed
from odomcorrupt.geometry.se2 import between, compose
from odomcorrupt.report.diagnosis import recordings_json
from odomcorrupt.study.io import Source, read_runs
from odomcorrupt.study.io.feedback import pull_of
from odomcorrupt.study.io.raw_trajectory import Samples

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


def run_of(tmp_path, poses, true=None):
    def rows(xyt):
        return Rows((1.7e18 + TIMES * 1e9).astype(np.int64), np.column_stack((xyt[:, :2], 0.0 * TIMES)), xyt[:, 2])

    true = REAL + np.random.default_rng(9).normal(0.0, 0.002, REAL.shape) if true is None else true
    bag = topic("/odom", "Odometry", rows(poses)), topic("/mocap", "PoseStamped", rows(true))
    (recording,) = read_runs(Source(write(tmp_path / "run.mcap", *bag)))
    return recording


def said_of(tmp_path, poses, true=None):
    return " ".join(run_of(tmp_path, poses, true).notes)


def pulled_per_s(recording):
    (entry,) = recordings_json([recording])
    return entry["odometry_pulled_per_s"]


@pytest.mark.parametrize("cause", CAUSES)
def test_errors_that_pile_up_are_no_filters(tmp_path, cause):
    recording = run_of(tmp_path, odometry(CAUSES[cause]))
    assert "filter" not in " ".join(recording.notes)
    assert pulled_per_s(recording) == 0.0


@pytest.mark.parametrize(
    ("cause", "pull"), [("noise", 0.1), ("noise", 0.3), ("wide wheels", 0.2), ("a biased gyro", 0.2)]
)
def test_errors_that_fade_are_and_what_can_be_learned_is_said(tmp_path, cause, pull):
    recording = run_of(tmp_path, odometry(CAUSES[cause], pull))
    said = " ".join(recording.notes)
    assert "its errors fade by" in said
    assert "(clocks and lags are unaffected); record wheel-only odometry" in said
    assert 0.3 * pull < pulled_per_s(recording) < 1.5 * pull


def test_a_compass_corrects_headings_and_no_positions(tmp_path):
    """With the deflection of iron on the robot, taken over with a time constant of two seconds."""
    rng, error = np.random.default_rng(8), np.zeros(len(REAL))
    deflection = 0.2 * np.sin(REAL[:, 2] + 0.8) + rng.normal(0.0, 0.004, len(REAL))
    for i in range(1, len(REAL)):
        error[i] = error[i - 1] + (deflection[i] - error[i - 1]) / (2.0 * RATE_HZ)
    steps = between(REAL[:-1], REAL[1:]) + rng.normal(0.0, [0.001, 0.0002, 0.0], (len(REAL) - 1, 3))
    steps[:, 2] += np.diff(error)
    poses = np.array([now := REAL[0], *(now := compose(now, step) for step in steps)])
    recording = run_of(tmp_path, poses)
    assert "its errors of heading fade by" in (said := " ".join(recording.notes))
    assert "as those of a compass or of a yaw error that depends on the heading" in said
    assert pulled_per_s(recording) > 0.1


def test_steps_towards_poses_are_taken_out_of_odometry_whose_wheels_make_none(tmp_path):
    def wheels(steps, rng):
        return rng.normal(0.0, [1e-4, 0.0, 2e-4], steps.shape) + steps * [0.03, 0.0, 0.02]

    free = odometry(wheels, 0.0)
    recording = run_of(tmp_path, odometry(wheels, 0.2))
    (entry,) = recordings_json([recording])
    assert entry["odometry_pulled_per_s"] == 0.0
    assert entry["odometry_pose_corrections"] > 0.95 * SECONDS
    assert "sudden steps towards such poses were removed" in " ".join(recording.notes)
    gained = between(recording.odometry.xyt[:-1], recording.odometry.xyt[1:]) - between(free[:-1], free[1:])
    assert np.abs(gained.sum(axis=0)).max() < 0.01


@pytest.mark.parametrize("pull", [0.0, 0.2])
def test_sideways_errors_of_wheels_are_no_filters(tmp_path, pull):
    """In a room what a mecanum robot gains sideways it loses again, as if its errors faded."""
    real = sideways()
    poses = odometry(lambda steps, rng: noise(steps, rng) + steps * [0.0, 0.08, 0.0], pull, real=real)
    said = said_of(tmp_path, poses, real + np.random.default_rng(9).normal(0.0, 0.002, real.shape))
    assert ("its errors fade by" in said) == bool(pull)


def test_a_truth_that_is_corrected_is_no_filter_of_the_odometry(tmp_path):
    """A localisation errs by 3 cm for seconds and comes back, wheels without a sideways step hardly drift."""
    wheels = odometry(lambda steps, rng: rng.normal(0.0, [1e-4, 0.0, 3e-4], steps.shape))
    keeps, rng = np.exp(-1.0 / (RATE_HZ * 6.0)), np.random.default_rng(4)
    error = np.zeros(REAL.shape)
    for i, new in enumerate(rng.normal(0.0, [0.03, 0.03, 0.004], REAL.shape)[1:], start=1):
        error[i] = keeps * error[i - 1] + np.sqrt(1.0 - keeps**2) * new
    assert "fade" not in said_of(tmp_path, wheels, REAL + error)


def test_headings_that_a_map_of_scans_corrects_are_no_filter_of_the_odometry():
    times, none = np.arange(0.0, 2000.0, 0.2), np.zeros(0)
    real, rng = path(times), np.random.default_rng(4)
    turned = lfilter([0.2], [1.0, -np.exp(-0.2 / 6.0)], rng.normal(0.0, 0.03, len(times)))
    stamps, positions = (1e9 * times).astype(np.int64), np.column_stack((real[:, :2], 0.0 * times))
    wheels, scans = (
        Samples("run", "/odom", "odom", stamps, positions, yaw, none, none) for yaw in (real[:, 2], real[:, 2] + turned)
    )
    assert pull_of(wheels, scans).heading > 0.0
    matched = replace(scans, covariance=np.tile(1e-6 * np.eye(3), (len(times), 1, 1)))
    assert pull_of(wheels, matched) == (0.0, 0.0)


def test_castors_that_turn_the_robot_forth_and_back_are_no_filter():
    """A kick after each reversal undoes the last one, as if the error of the heading faded; a real fading is found."""
    times, none, rng = np.arange(0.0, 2000.0, 0.1), np.zeros(0), np.random.default_rng(5)
    turn = np.cumsum(0.2 * np.sin(0.13 * times) + 0.15 * np.sin(0.31 * times)) * 0.1
    ends_s = np.cumsum(0.5 + rng.exponential(3.0, 1000))
    travel = 0.06 * (-1.0) ** np.searchsorted(ends_s, times)
    xy = np.cumsum(np.column_stack((np.cos(turn), np.sin(turn))) * travel[:, None], axis=0)
    stamps, positions = (1e9 * times).astype(np.int64), np.column_stack((xy, 0.0 * times))
    kicked = np.cumsum(0.5 * crossed(travel, AT_REST, 0.1)[0])
    faded = lfilter([1.0], [1.0, -np.exp(-0.1 * 0.2)], rng.normal(0.0, 0.01, len(times)))
    real, castors, filtered = (
        Samples("run", "/odom", "odom", stamps, positions, turn + error, none, none)
        for error in (rng.normal(0.0, 0.001, len(times)), kicked, kicked + faded)
    )
    assert pull_of(castors, real).heading == 0.0
    assert pull_of(filtered, real).heading > 0.1


@pytest.mark.slow
@pytest.mark.parametrize("turned_deg", [38.0, -10.0])
def test_one_slip_is_no_filter(tmp_path, turned_deg):
    def slip(steps, rng):
        errors = noise(steps, rng)
        errors[140:180, 2] += np.radians(turned_deg) / 40.0
        return errors

    assert "filter" not in said_of(tmp_path, odometry(slip))
