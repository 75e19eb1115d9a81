"""Problems posed on recordings: shared parts, headings of positions, the side of the regressors, mounting, clocks."""

from dataclasses import fields, replace
from itertools import pairwise

import numpy as np
import pytest
from hidden import as_recording
from scipy.ndimage import gaussian_filter1d
from wandering import PLANTED, drive, positions_only

from odomcorrupt.effects import effect_from_values
from odomcorrupt.geometry.se2 import Increments, accumulate, compose, increments
from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.model.motion_model import MotionModel
from odomcorrupt.model.noise_laws import LAWS
from odomcorrupt.model.presets import preset_named
from odomcorrupt.simulation import simulate
from odomcorrupt.study.estimate.calibrate import effects_to_fit, fit_every_law, fit_robot, model_of
from odomcorrupt.study.estimate.clocks import Clocks
from odomcorrupt.study.estimate.config import Approach, choose_approach
from odomcorrupt.study.estimate.gauss_newton import fit
from odomcorrupt.study.estimate.intervals import Intervals
from odomcorrupt.study.estimate.problem import pose_problem
from odomcorrupt.study.estimate.regressors import MotionSmoother, choose_side
from odomcorrupt.study.io.clock import Clock
from odomcorrupt.study.io.headings import with_headings
from odomcorrupt.study.io.recording import Recording
from odomcorrupt.study.validate.compare import clocks_beside, compare

EFFECTS = (effect_from_values("wheel_scale", {"e": 0.02}), effect_from_values("accel_slip", {"k": 0.01}))


@pytest.fixture(scope="module")
def one_run():
    return as_recording(simulate(93, "wheel_scale", duration_s=60.0))


@pytest.mark.parametrize("side", ["odometry", "truth"])
@pytest.mark.parametrize("clock", [Clock(), Clock(0.03)])
def test_a_problem_after_an_earlier_one_is_the_problem_by_itself(one_run, side, clock):
    approach = replace(choose_approach([one_run]), side=side)
    earlier = pose_problem([one_run], approach=approach)
    after = pose_problem([one_run], EFFECTS, [clock], approach=approach, before=earlier)
    alone = pose_problem([one_run], EFFECTS, [clock], approach=approach)
    for field in fields(Intervals):
        assert np.array_equal(getattr(after.intervals, field.name), getattr(alone.intervals, field.name))
    for name in ("v", "omega", "acceleration", "x", "theta", "distance"):
        assert np.array_equal(getattr(after.motions[0], name), getattr(alone.motions[0], name))
    assert (after.smoothers == earlier.smoothers) == (clock == Clock())


def stretches(one_run, *times_s):
    """Return the stretches of a recording whose truth jumps, each with the odometry from the beginning."""
    cut = []
    for i, (first_s, last_s) in enumerate(pairwise((0.0, *times_s, np.inf))):
        truth_s, own = one_run.truth.seconds_since(one_run.origin_ns), one_run.odometry
        rows = (truth_s >= first_s) & (truth_s < last_s)
        known = one_run.odometry_s <= truth_s[rows][-1] + 1.0
        jumped = one_run.truth.xyt[rows] + (float(i), 0.5 * i, 0.0)
        truth = Trajectory(one_run.truth.stamps_ns[rows], jumped)
        odometry = Trajectory(own.stamps_ns[known], own.xyt[known])
        cut.append(replace(one_run, name=f"part {i}", clock="one", odometry=odometry, truth=truth))
    return cut


@pytest.mark.parametrize("side", ["odometry", "truth"])
def test_stretches_of_a_run_share_its_motion_and_pose_the_problem_that_each_poses_alone(one_run, side):
    parts = stretches(one_run, 17.3, 38.0)
    approach = replace(choose_approach([one_run]), side=side)
    lever = effect_from_values("lever_arm", {"x": 0.1})
    tried = (lever, *EFFECTS, *(effect_from_values(name, {}) for name in ("slope", "time_offset", "region_slip")))
    together = pose_problem(parts, EFFECTS, [Clock(0.03)] * 3, approach=approach)
    apart = [pose_problem([part], EFFECTS, [Clock(0.03)], approach=approach) for part in parts]
    assert len(together.motions) == 1
    assert len(together.motions[0]) == len(one_run.odometry) - 1
    for name in ("start_s", "residual", "share", "lever", "truth_xyt"):
        whole = np.concatenate([getattr(one.intervals, name) for one in apart])
        np.testing.assert_allclose(getattr(together.intervals, name), whole, rtol=0.0, atol=1e-12)
    # about a jump the motion of one stretch ends and that of the other begins
    inner = together.intervals.linked & np.append(together.intervals.linked[1:], True)
    for effect in tried:
        whole = np.concatenate([one.columns(effect) for one in apart])
        most = (1e-3 if side == "odometry" else 0.02) * np.abs(whole).max()
        np.testing.assert_allclose(together.columns(effect), whole, rtol=0.0, atol=most)
        if side == "odometry":
            np.testing.assert_allclose(together.columns(effect)[inner], whole[inner], rtol=0.0, atol=1e-7)


def test_a_wheel_rolls_as_far_as_the_odometry_reports_also_if_speeds_are_the_truths(one_run):
    wheels = replace(one_run, track_m=0.4)
    sides = {side: MotionSmoother([wheels], side).recorded for side in ("odometry", "truth")}
    steps = increments(one_run.odometry.xyt)
    for arm_m in (0.2, -0.2):
        assert np.allclose(sides["truth"].rolled(arm_m)[1:], np.cumsum(steps.ds_m + arm_m * steps.dtheta_rad))
    # the scale hidden in this odometry is 2 %, so integrals of the truth's speeds end elsewhere
    speeds = np.cumsum(sides["truth"].v * sides["truth"].dt_s)
    assert abs(sides["odometry"].rolled(0.0)[-1] - sides["truth"].rolled(0.0)[-1]) < 1e-3 * abs(speeds[-1])


AHEAD_M = 0.5  # of the axle, where the antenna is


def weaving(ahead_m=0.0, without_s=()):
    """Return a car that weaves, backs up around a corner at 40 s and goes on, with fixes of 5 Hz; and its headings."""
    t_s = np.arange(0.0, 80.0, 0.02)
    speed = np.where(np.abs(t_s - 41.0) < 1.5, -1.0, 1.0)
    turn = 0.5 * np.sin(0.7 * t_s) + np.where(np.abs(t_s - 41.0) < 3.0, -0.6, 0.0)
    yaw = 0.4 + np.cumsum(turn) * 0.02
    x, y = np.cumsum(speed * np.cos(yaw)) * 0.02, np.cumsum(speed * np.sin(yaw)) * 0.02
    stamps = np.round(t_s * 1e9).astype(np.int64)
    fixes = np.arange(5, len(t_s), 10)
    for first, last in without_s:
        fixes = fixes[(t_s[fixes] < first) | (t_s[fixes] > last)]
    xy = np.column_stack((x + ahead_m * np.cos(yaw), y + ahead_m * np.sin(yaw)))[fixes]
    xy += np.random.default_rng(5).normal(0.0, 0.005, xy.shape)
    truth = np.column_stack((xy, np.full(len(xy), np.nan)))
    turned = np.column_stack((x * np.cos(1.1) - y * np.sin(1.1), x * np.sin(1.1) + y * np.cos(1.1), yaw + 1.1))
    one_run = Recording(
        name="run", odometry=Trajectory(stamps, turned), truth=Trajectory(stamps[fixes], truth), origin_ns=0,
        track_m=None, notes=(),
    )  # fmt: skip
    return one_run, yaw[fixes]


def errors(one_run, yaw):
    return (one_run.truth.xyt[:, 2] - yaw + np.pi) % (2.0 * np.pi) - np.pi


@pytest.mark.parametrize("without_s", [((0.25, 20.0),), ((30.0, 45.0), (45.4, 60.0))], ids=["first", "between two"])
def test_fixes_that_an_outage_leaves_alone_get_the_heading_of_those_beside_them(without_s):
    one_run, yaw = weaving(without_s=without_s)
    assert np.abs(errors(with_headings(one_run), yaw)).max() < 0.01


def test_a_fast_car_with_few_fixes_has_the_headings_of_its_path():
    one_run, yaw = weaving()
    truth, odometry = one_run.truth, one_run.odometry
    few = Trajectory(truth.stamps_ns[::5], truth.xyt[::5] * [8.0, 8.0, 1.0])
    fast = replace(one_run, odometry=replace(odometry, xyt=odometry.xyt * [8.0, 8.0, 1.0]), truth=few)
    assert np.abs(errors(with_headings(fast), yaw[::5])).max() < 0.05


def test_headings_are_those_of_the_model_so_that_an_antenna_ahead_of_the_axle_turns_none_of_them():
    one_run, yaw = weaving(AHEAD_M, without_s=((34.0, 39.5), (42.6, 50.0)))
    plain = with_headings(one_run)
    assert np.abs(errors(plain, yaw)).max() > 0.05
    problem = pose_problem([plain], [effect_from_values("lever_arm", {"x": AHEAD_M})], approach=Approach())
    assert np.abs(errors(problem.left[0], yaw)).max() < 0.02
    assert np.abs(problem.intervals.residual[:, :2]).max() < 0.05


STEPS_S = np.arange(0.0, 300.0, 0.02)[1:]


def path(step, turn):
    """Return the trajectory of steps (n,) m and turns (n,) rad that end at `STEPS_S`."""
    stamps = np.round(1e9 * np.concatenate(([0.0], STEPS_S))).astype(np.int64)
    return Trajectory(stamps, accumulate(np.zeros(3), Increments(step, 0.0 * step, turn)))


def seen(trajectory, at_s, deviation, rng):
    """Return poses of a trajectory at times (n,) s, with noise of these deviations of x, y (m) and yaw (rad)."""
    poses = trajectory.at(at_s, 0) + deviation * rng.standard_normal((len(at_s), 3))
    return Trajectory(np.round(1e9 * at_s).astype(np.int64), poses)


def test_turns_that_change_between_two_sweeps_of_a_laser_are_no_noise_of_exact_odometry():
    rng = np.random.default_rng(3)
    swerve = gaussian_filter1d(rng.normal(size=len(STEPS_S)), 0.16 / 0.02)
    rate_radps = 0.5 * np.sin(0.3 * STEPS_S) + 0.5 * swerve / swerve.std()
    odometry = path(np.full(len(rate_radps), 0.01), 0.02 * rate_radps)
    deviation = np.array([0.002, 0.002, 0.0006])
    truth = seen(odometry, np.arange(0.13, 299.0, 0.2), deviation, rng)
    truth = replace(truth, covariance=np.tile(np.diag(deviation**2), (len(truth), 1, 1)))
    assert choose_side(Recording("swerves", odometry, truth, 0), 0.5) == "odometry"


def test_jitter_of_encoders_is_no_regressor_beside_a_truth_whose_noise_smoothing_removes():
    rng = np.random.default_rng(4)
    turn, step = 0.02 * 0.6 * np.sin(0.3 * STEPS_S), np.full(len(STEPS_S), 0.008)
    jitter = 8e-3 * np.sqrt(0.02) * rng.standard_normal(len(step))
    smooth, rough = path(step, turn), path(step, turn + jitter)
    truth = seen(smooth, np.arange(0.1037, 299.0, 0.01), [0.001, 0.001, 0.002], rng)
    assert choose_side(Recording("rough", rough, truth, 0), 0.5) == "truth"
    assert choose_side(Recording("smooth", smooth, truth, 0), 0.5) == "odometry"
    # one of several recordings does not decide for all
    alike = [Recording(f"drive {i}", path, truth, 0) for i, path in enumerate((rough, smooth, smooth))]
    assert choose_approach(alike).side == "odometry"


def test_starts_and_stops_are_no_noise_of_the_odometry():
    rng = np.random.default_rng(6)
    phase_s = STEPS_S % 14.0
    ramp = np.ones(75) / 75
    speed_mps = np.convolve(np.where(phase_s < 10.0, 0.3, 0.0), ramp, "same")
    rate_radps = np.convolve(np.where((phase_s > 9.5) & (phase_s < 13.5), 0.1, 0.0), ramp, "same")
    moved = speed_mps + rate_radps > 1e-3
    noise = 1e-3 * np.sqrt(0.02) * moved * rng.standard_normal((2, len(moved)))
    odometry = path(0.02 * speed_mps + 0.2 * noise[0], 0.02 * rate_radps + noise[1])
    truth = seen(odometry, np.arange(0.1037, 299.0, 0.01), [0.002, 0.002, 0.0035], rng)
    assert choose_side(Recording("exact", odometry, truth, 0), 0.5) == "odometry"


MOUNTED = (0.08, -0.03, 0.02)
"""Where the truth's marker sits on the base: x, y (m), yaw (rad)."""


@pytest.fixture(scope="module")
def clean():
    return as_recording(simulate(3, None, duration_s=240.0))


@pytest.fixture(scope="module")
def mounted(clean):
    xyt = compose(clean.truth.xyt, np.broadcast_to(MOUNTED, clean.truth.xyt.shape))
    return replace(clean, truth=Trajectory(clean.truth.stamps_ns, xyt))


def test_a_marker_beside_the_base_frame_is_found_in_the_setup_and_not_in_the_robot(mounted):
    result = fit_robot([mounted], (), law_name="diffusion")
    found = {effect.name: effect for effect in result.model.setup.effects}
    errors = result.model.standard_errors
    assert found.keys() == {"lever_arm", "mount_yaw"}
    assert abs(found["lever_arm"].x - MOUNTED[0]) < 4.0 * errors["lever_arm.x"] < 0.01
    assert abs(found["lever_arm"].y - MOUNTED[1]) < 4.0 * errors["lever_arm.y"] < 0.01
    assert abs(found["mount_yaw"].yaw - MOUNTED[2]) < 4.0 * errors["mount_yaw.yaw"] < 0.01
    assert result.model.effects == ()


def test_a_marker_on_the_base_frame_leaves_the_setup_empty(clean):
    assert fit_robot([clean], (), law_name="diffusion").model.setup.effects == ()


def test_what_cannot_be_separated_from_an_effect_that_is_asked_for_is_not_searched(mounted):
    result = fit_robot([mounted], effects_to_fit(None, ["icr_shift"]), law_name="diffusion")
    assert "lever_arm" not in {effect.name for effect in result.model.setup.effects}


@pytest.mark.slow
def test_of_all_laws_the_one_that_made_the_noise_is_the_likeliest():
    run = drive(5, 300.0, PLANTED)
    results = fit_every_law([run], ())
    assert set(results) == {name for name, law in LAWS.items() if law.fitted}
    assert next(iter(results)) == "diffusion"
    nats = [result.information_nats for result in results.values()]
    assert nats == sorted(nats, reverse=True)
    assert nats[0] > nats[1]


@pytest.mark.slow
def test_stretches_of_one_run_share_their_clock(clean):
    moved = replace(clean.odometry, stamps_ns=clean.odometry.stamps_ns + 40_000_000)
    middle = len(moved) // 2
    halves = slice(0, middle), slice(middle, None)
    parts = [replace(clean, name=f"part {i}", odometry=moved.only(s), clock="one") for i, s in enumerate(halves)]
    shared = fit_robot(parts, (), law_name="diffusion").clocks
    assert shared.clocks[0] == shared.clocks[1]
    assert abs(shared.clocks[0].offset_s - 0.04) < 4.0 * shared.errors[0][0] < 0.01
    own = fit_robot([replace(part, clock="") for part in parts], (), law_name="diffusion").clocks
    assert own.clocks[0] != own.clocks[1]
    assert shared.errors[0][0] < 0.9 * own.errors[0][0]


LATE_S = 0.06
"""How much later the truth is stamped than the odometry on the held-out with_unequal_wheels."""


def with_unequal_wheels(seed: int, late_s: float = 0.0):
    """Return three minutes of a robot with unequal wheels beside a total station, which measures positions only."""
    run = as_recording(simulate(seed, "unequal_wheels", duration_s=180.0, robot_seed=93), f"drive {seed}")
    truth = positions_only(run).truth
    return replace(run, truth=replace(truth, stamps_ns=truth.stamps_ns + round(late_s * 1e9)))


@pytest.fixture(scope="module")
def right():
    run = with_unequal_wheels(94)
    return model_of(fit([run], [effect_from_values("unequal_wheels", {})], approach=choose_approach([run])))


@pytest.fixture(scope="module")
def held():
    return with_unequal_wheels(144, LATE_S)


def test_beside_a_truth_of_positions_the_clock_is_estimated_without_the_bends_of_the_model(right, held):
    found = clocks_beside([held], choose_approach([held]), right)
    assert abs(found.clocks[0].offset_s + LATE_S) < 0.002


@pytest.mark.slow
def test_a_right_model_is_rejected_for_an_error_of_the_clock_only_if_the_clock_is_known_better(right, held):
    at_s, wrong = 0.006 - LATE_S, {"without effects": replace(right, effects=())}
    found = {}
    for error_s, models in ((0.0005, {}), (0.004, wrong)):
        clocks = Clocks((Clock(at_s),), ((True, False),), ((error_s, 0.0),))
        *others, found[error_s] = compare([held], models | {"right": right}, clocks=clocks).evaluations
        assert all(one.verdict.fails for one in others)
    assert [one.verdict.fails for one in found.values()] == [True, False]
    assert len({(one.nats.per_m, one.nats.error, one.ten_second_error_m) for one in found.values()}) == 1


def test_slip_at_starts_and_stops_is_not_passed_off_as_a_clock():
    run = as_recording(simulate(93, "accel_slip", duration_s=180.0))
    fitted = fit([run], [effect_from_values("accel_slip", {})], approach=choose_approach([run]))
    bare = replace(model_of(fitted), effects=(), source={})
    assert compare([run], {"without effects": bare}).evaluations[0].verdict.fails


def test_an_effect_of_the_heading_in_the_world_is_taken_out_of_a_recording_whose_truth_has_none():
    recording = positions_only(as_recording(simulate(93, "slope", duration_s=60.0)))
    slope = effect_from_values("slope", {"creep": 0.01, "direction": 0.5})
    model = MotionModel(preset_named("typical").noise, effects=(slope,))
    clocks = clocks_beside([recording], choose_approach([recording]), model)
    assert abs(clocks.clocks[0].offset_s) < 0.05
