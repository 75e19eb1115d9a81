"""A gyro and wheel angles in the bag: axis, bias and its walk, lag, radius and track, and what they show alone."""

import json
from dataclasses import replace

import laserbags
import numpy as np
import pytest

import odomcorrupt as oc
from odomcorrupt.geometry.se2 import Increments, accumulate, increments
from odomcorrupt.simulation import Tracker, simulate
from odomcorrupt.study.estimate.config import choose_approach
from odomcorrupt.study.estimate.gauss_newton import fit
from odomcorrupt.study.estimate.outliers import single_events, slip_bursts
from odomcorrupt.study.estimate.problem import pose_problem
from odomcorrupt.study.estimate.truth_bias import bias_steps, with_bias_walks
from odomcorrupt.study.io import Source, read_runs
from odomcorrupt.study.io.gyro import SCALE_ACCURACY as GYRO_SCALE
from odomcorrupt.study.io.wheel_ticks import find_joints
from odomcorrupt.study.select.decisions import DECISIONS
from odomcorrupt.study.select.random_effects import outlier_effects
from odomcorrupt.study.select.selection import learn

EXACT = Tracker(rate_hz=100.0, sampling_jitter_s=0.0, noise_m=0.0, noise_rad=0.0, dropouts_per_min=0.0)
GAIN, BIAS, NOISE = 1.004, 0.01, 0.002


def drive(seed=11, cause=None, duration_s=150.0, **options):
    return simulate(seed, cause, truth=EXACT, duration_s=duration_s, **options)


def gyro_of(simulated, *, axis=(0.0, 0.0, 1.0), late_s=0.0, seed=3):
    """Stamps and rates of a gyro on a simulated robot: gain, bias and white noise of its own."""
    stamps = simulated.truth_stamps_ns
    t_s = (stamps - stamps[0]) * 1e-9
    yaw = np.unwrap(simulated.truth_xyt[:, 2])
    rate = GAIN * np.gradient(yaw, t_s) + BIAS
    rates = rate[:, None] * np.array(axis) + NOISE * np.random.default_rng(seed).standard_normal((len(t_s), 3))
    return stamps + round(late_s * 1e9), rates


def bag(path, simulated, *groups, **options):
    stamps, rates = gyro_of(simulated, **options)
    return laserbags.write(
        path, laserbags.odometry(simulated.odom_stamps_ns, simulated.odom_xyt), laserbags.imu(stamps, rates), *groups
    )


def truth_of(simulated):
    return laserbags.odometry(simulated.truth_stamps_ns[::5], simulated.truth_xyt[::5], "/ground_truth")


def test_the_upward_axis_bias_and_lag_are_found_without_tf(tmp_path):
    simulated = drive(yaw_from="encoders")
    path = bag(tmp_path / "run.mcap", simulated, axis=(0.0, -1.0, 0.0), late_s=0.12)
    (recording,) = read_runs(Source(path))
    said = " ".join(recording.notes)
    assert "about its -y axis" in said
    assert f"bias is {-np.degrees(BIAS) * -1.0:.3f} deg/s" in said or "0.57" in said
    assert "0.12" in said
    assert not recording.positioned
    turned = recording.truth.xyt[-1, 2] - recording.truth.xyt[0, 2]
    first, last = (np.searchsorted(simulated.truth_stamps_ns, s) for s in recording.truth.stamps_ns[[0, -1]])
    real = np.unwrap(simulated.truth_xyt[:, 2])
    assert turned == pytest.approx(GAIN * (real[min(last, len(real) - 1)] - real[first]), abs=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("source", ["encoders", "gyro"])
def test_wheels_or_gyro_as_the_source_of_the_heading_is_reported_by_what_they_say_at_rest(tmp_path, source):
    simulated = drive(yaw_from="encoders")
    stamps, rates = gyro_of(simulated)
    odometry = simulated.odom_xyt.copy()
    if source == "gyro":
        t_s = (stamps - stamps[0]) * 1e-9
        heading = np.concatenate(([0.0], np.cumsum(0.5 * (rates[1:, 2] + rates[:-1, 2]) * np.diff(t_s))))
        odometry[:, 2] = np.interp((simulated.odom_stamps_ns - stamps[0]) * 1e-9, t_s, heading)
    path = laserbags.write(
        tmp_path / "run.mcap",
        laserbags.odometry(simulated.odom_stamps_ns, odometry),
        laserbags.imu(stamps, rates),
        truth_of(simulated),
    )
    (recording,) = read_runs(Source(path, truth="/ground_truth"))
    assert recording.heading_source == {"encoders": "wheels", "gyro": "gyro"}[source]


@pytest.mark.slow
def test_wheels_and_gyro_alone_name_a_wrong_track_and_no_travel(tmp_path, invoke):
    simulated = drive(23, "wheelbase", 180.0, parameters={"e": 0.06}, yaw_from="encoders", route="slalom")
    path = bag(tmp_path / "run.mcap", simulated)
    said = json.loads(invoke(["diagnose", path, "--json"]).out)
    effects = {one["effect"]: one for one in said["found"] if one["kind"] == "effect"}
    assert list(effects) == ["wheelbase"]
    value = effects["wheelbase"]["parameters"]["e"]
    assert value["value"] == pytest.approx(simulated.answer["causes"]["wheelbase"]["e"], abs=0.02)
    # no gain of turns is known better than the gyro's own
    assert value["standard_error"] > 0.008


@pytest.mark.slow
@pytest.mark.parametrize("e", [-0.05, 0.05])
def test_a_gain_of_turns_of_four_errors_of_the_gyros_scale_is_evidence_of_either_sign(tmp_path, e):
    # taking it out of the odometry scales the noise of turns, which is no evidence for or against it
    simulated = drive(23, "wheelbase", 120.0, parameters={"e": e}, yaw_from="encoders", route="slalom")
    turned = np.abs(np.diff(np.unwrap(simulated.odom_xyt[:, 2])))
    noise = 0.02 * np.sqrt(turned) * np.random.default_rng(1).standard_normal(len(turned))
    simulated.odom_xyt[1:, 2] += np.cumsum(noise)
    runs = list(read_runs(Source(bag(tmp_path / "run.mcap", simulated))))
    learned = learn(runs)
    assert learned.added == ("wheelbase",)
    own = learned.steps[0].candidates[0]
    assert 2.0 < own.gain < 0.5 * (abs(own.fitted.e) / GYRO_SCALE + 1.0) ** 2


def jumped(fitted, jump, weights):
    """Return a fit with some residuals (n, 3) more, and other weights of its noise."""
    intervals = fitted.problem.intervals
    problem = replace(fitted.problem, intervals=replace(intervals, residual=intervals.residual + jump))
    return replace(fitted, problem=problem, noise=replace(fitted.noise, weights=weights))


def test_slips_of_wheels_are_not_named_where_a_gyro_alone_is_the_truth(tmp_path):
    simulated = drive(31, duration_s=90.0, yaw_from="encoders")
    runs = list(read_runs(Source(bag(tmp_path / "run.mcap", simulated))))
    fitted = fit(runs, approach=choose_approach(runs))
    odd = np.where(np.arange(len(fitted.problem.intervals)) % 7 == 3, 9.0, 1.0)
    slipped = jumped(fitted, (odd > 1.0)[:, None] * np.array([1e-4, 0.0, 0.05]), odd)
    assert slip_bursts(slipped) is not None
    assert outlier_effects(slipped, DECISIONS, tails=True) == []


def test_what_happened_once_is_a_turn_where_a_gyro_alone_is_the_truth(tmp_path):
    simulated = drive(31, duration_s=90.0, yaw_from="encoders")
    fitted = fit(runs := list(read_runs(Source(bag(tmp_path / "run.mcap", simulated)))), approach=choose_approach(runs))
    jump = np.zeros((len(fitted.problem.intervals), 3))
    jump[40], jump[80] = (0.02, 0.03, 0.5), (0.02, 0.03, 0.0)
    (event,) = single_events(jumped(fitted, jump, 1.0 + 8.0 * jump.any(axis=1)))
    assert (event.along_m, event.across_m) == (0.0, 0.0)
    assert event.yaw_rad == pytest.approx(0.5, abs=0.05)


def test_a_model_needs_travel_and_a_gyro_has_none(tmp_path, invoke):
    path = bag(tmp_path / "run.mcap", drive(duration_s=40.0))
    assert "do not measure travel" in invoke(["learn", path], 1).err


def test_a_gyro_of_another_robot_is_refused_where_it_is_named(tmp_path, invoke):
    one, other = drive(11, duration_s=60.0), drive(99, duration_s=60.0)
    stamps, rates = gyro_of(other)
    shifted = stamps - stamps[0] + one.odom_stamps_ns[0]
    path = laserbags.write(
        tmp_path / "run.mcap", laserbags.odometry(one.odom_stamps_ns, one.odom_xyt), laserbags.imu(shifted, rates)
    )
    assert "turns unlike the odometry" in invoke(["diagnose", path, "--imu", "/imu/data"], 1).err


def walking(path, seed, walk, cause=None, **options):
    """Write the bag of a robot with wheels and a gyro whose bias walks (rad/s/sqrt(s))."""
    simulated = drive(seed, cause, yaw_from="encoders", **options)
    stamps, rng = simulated.truth_stamps_ns, np.random.default_rng(seed)
    rate = np.gradient(np.unwrap(simulated.truth_xyt[:, 2]), stamps * 1e-9)
    bias = BIAS + walk * np.cumsum(rng.normal(size=len(stamps))) / np.sqrt(EXACT.rate_hz)
    yaw = rate + bias + 0.003 * rng.normal(size=len(stamps))
    rates = np.column_stack((np.zeros((len(yaw), 2)), yaw))
    return laserbags.write(
        path, laserbags.odometry(simulated.odom_stamps_ns, simulated.odom_xyt), laserbags.imu(stamps, rates)
    )


@pytest.mark.slow
@pytest.mark.parametrize("walk", [5e-5, 5e-4])
def test_the_level_of_the_walk_is_estimated_to_a_factor_of_two(tmp_path, walk):
    runs = list(read_runs(Source(walking(tmp_path / "run.mcap", 5, walk, duration_s=180.0))))
    (found,) = with_bias_walks(runs, choose_approach(runs))
    assert 0.5 * walk < found.turn_bias_walk < 2.0 * walk


def test_each_drive_has_a_bias_and_a_walk_of_its_own(tmp_path):
    (run,) = read_runs(Source(walking(tmp_path / "run.mcap", 5, 1e-4, duration_s=60.0)))
    other = replace(run, name="other", positioned=True)
    problem = pose_problem([run, run, other], approach=choose_approach([run]))
    start, steps = bias_steps(problem)
    assert start.shape[2] == 2
    for column in np.concatenate((start, steps), axis=2).transpose(2, 0, 1):
        assert not column[:, :2].any()
        assert len(np.unique(problem.run[column[:, 2] != 0.0])) == 1


@pytest.mark.slow
def test_a_bias_that_walks_five_times_as_fast_as_usual_is_no_error_of_the_odometry(tmp_path):
    path = walking(tmp_path / "run.mcap", 5, 5e-4, duration_s=180.0, route="loops")
    said = oc.diagnose(path).to_dict()
    assert (said["found"], said["unknown"]) == ([], [])


@pytest.mark.slow
def test_unequal_wheels_are_found_though_the_bias_was_taken_from_an_odometry_that_hardly_rests(tmp_path, monkeypatch):
    """That bias contains the turns of unequal wheels, so that their inclusion seemed to increase the error."""
    monkeypatch.setattr("odomcorrupt.study.io.gyro._MIN_STILL_S", 1e9)
    path = walking(tmp_path / "run.mcap", 4, 1e-4, "unequal_wheels", parameters={"curvature": 0.03}, duration_s=180.0)
    found = oc.diagnose(path)
    (one,) = found.to_dict()["found"]
    assert (one["effect"], one["confidence"] > 0.9) == ("unequal_wheels", True)
    assert one["parameters"]["curvature"]["value"] == pytest.approx(0.03, abs=0.005)
    first, last = found.result.sequence.evaluations[0], found.result.sequence.evaluations[-1]
    assert last.ten_second_error_m < 0.7 * first.ten_second_error_m


RADIUS, TRACK = 0.08, 0.46


def counting(path, *, tick=None, heading_off=0.0, names=("wheel_left_joint", "wheel_right_joint")):
    """A drive whose odometry is the sum of wheel angles, and these."""
    simulated = drive(7, duration_s=80.0, yaw_from="encoders")
    step = increments(simulated.odom_xyt)
    turn = step.dtheta_rad * TRACK / 2.0
    angle = np.cumsum(np.stack((step.ds_m - turn, step.ds_m + turn), axis=1) / RADIUS, axis=0)
    angle = np.concatenate((np.zeros((1, 2)), angle))
    if tick is not None:
        angle = np.floor(angle / tick) * tick
    other = step.dtheta_rad + heading_off * np.sin(np.arange(len(step.ds_m)) / 40.0) * 0.1
    odometry = accumulate(simulated.odom_xyt[0], Increments(step.ds_m, step.dl_m, other))
    return laserbags.write(
        path,
        laserbags.odometry(simulated.odom_stamps_ns, odometry),
        laserbags.joints(simulated.odom_stamps_ns, ("caster", *names), np.column_stack((angle[:, 0] * 0.3, angle))),
        truth_of(simulated),
    )


@pytest.mark.parametrize(
    ("names", "found"),
    [
        (["caster", "left_wheel", "right_wheel"], ("left_wheel", "right_wheel")),
        (["wheel_r_joint", "wheel_l_joint"], ("wheel_l_joint", "wheel_r_joint")),
        (["front_left_wheel", "rear_left_wheel", "front_right_wheel", "rear_right_wheel"], None),
        (["left_arm", "right_arm"], None),
    ],
)
def test_wheels_are_found_by_their_names_where_there_is_one_each(names, found):
    assert find_joints(names) == found


def test_radius_and_track_are_those_that_the_odometry_sums_with(tmp_path):
    (recording,) = read_runs(Source(counting(tmp_path / "run.mcap")))
    assert recording.track_m == pytest.approx(TRACK, rel=2e-3)
    assert any("wheels of 0.08" in note for note in recording.notes)


def test_counts_of_an_encoder_are_seen_and_the_wheels_can_be_the_odometry(tmp_path):
    tick = 2.0 * np.pi / 1024
    path = counting(tmp_path / "run.mcap", tick=tick)
    (recording,) = read_runs(Source(path, joints=("wheel_left_joint", "wheel_right_joint")))
    assert any("1024 a turn" in note for note in recording.notes)
    (own,) = read_runs(Source(path))
    assert recording.odometry.xyt[-1, 2] - recording.odometry.xyt[0, 2] == pytest.approx(
        own.odometry.xyt[-1, 2] - own.odometry.xyt[0, 2], abs=0.02
    )
    assert np.linalg.norm(recording.odometry.xyt[-1, :2] - own.odometry.xyt[-1, :2]) < 0.2


def test_wheels_that_the_odometry_does_not_turn_by_are_no_odometry(tmp_path, invoke):
    path = counting(tmp_path / "run.mcap", heading_off=0.2)
    assert "turns are not those of" in invoke(["fit", path, "--joints", "wheel_left_joint", "wheel_right_joint"], 1).err
    assert "--joints" in invoke(["fit", path, "--joints", "wheel_left_joint", "right"], 1).err
