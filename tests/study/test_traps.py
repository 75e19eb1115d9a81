"""Known pitfalls of estimation: sections 7, 12 and 13 of the notes on method, by their numbers."""

from dataclasses import replace

import numpy as np
import pytest
from hidden import as_recording, library_candidates, ten_second_error
from wandering import PLANTED, RATE_HZ, drive, late, noisy_path, positions_only, recording, wander

from odomcorrupt.effects import registry
from odomcorrupt.geometry.se2 import Increments, accumulate, increments
from odomcorrupt.model.noise_laws import Coefficients
from odomcorrupt.simulation import Segment, simulate, simulate_without
from odomcorrupt.study.estimate.calibrate import coefficient_intervals
from odomcorrupt.study.estimate.clocks import find_clocks
from odomcorrupt.study.estimate.config import Approach, choose_approach
from odomcorrupt.study.estimate.gauss_newton import fit
from odomcorrupt.study.estimate.problem import pose_problem
from odomcorrupt.study.estimate.windows import time_windows
from odomcorrupt.study.io.encoders import encoder_effects, restore_lost
from odomcorrupt.study.io.recording import Recording
from odomcorrupt.study.select.candidates import objection, score_terms
from odomcorrupt.study.select.decisions import DECISIONS
from odomcorrupt.study.select.dictionary import Dictionary
from odomcorrupt.study.select.selection import learn
from odomcorrupt.study.terms.term import LibraryTerm


def test_1_noise_of_the_truth_does_not_pass_for_noise_of_the_odometry():
    run = drive(21, 300.0, PLANTED, truth_mm=10.0)
    apart = increments(run.odometry.xyt).ds_m - increments(run.truth.xyt).ds_m
    naive = np.sqrt(np.sum(apart**2) / np.sum(np.abs(increments(run.odometry.xyt).ds_m)))
    assert naive > 2.5 * PLANTED.trans_trans
    fitted = fit([run], approach=choose_approach([run]))
    assert fitted.noise.coefficients.trans_trans == pytest.approx(PLANTED.trans_trans, rel=0.3)
    assert fitted.noise.truth.xy_m == pytest.approx(0.01, rel=0.15)


def test_2_drivers_do_not_carry_the_noise_they_are_regressed_on():
    names = ("wheel_scale", "wheelbase", "speed_scale")
    z = {side: [] for side in ("truth", "odometry")}
    for seed in (22, 23, 24):
        run = drive(seed, 300.0, Coefficients(0.15, 0.06, 0.15, 0.03), truth_mm=1.0)
        assert choose_approach([run]).side == "truth"
        for side, found in z.items():
            fitted = fit([run], approach=Approach(side))
            scores = score_terms(fitted, [LibraryTerm(registry()[n]()) for n in names], Dictionary(DECISIONS))
            found.append([abs(float(s.estimate[0] / s.standard_error[0])) for s in scores])
    assert np.mean(z["truth"]) < 1.6
    assert np.max(z["truth"]) < 4.0


@pytest.mark.slow
def test_4_an_offset_is_estimated_without_the_bias_of_a_smoothed_derivative():
    offsets, errors = [], []
    for seed in range(25, 33):
        run = as_recording(simulate(seed, "time_offset", duration_s=180.0, parameters={"offset": 0.03}))
        clocks = find_clocks([run], choose_approach([run]))
        offsets.append(clocks.clocks[0].offset_s)
        errors.append(clocks.errors[0][0])
    assert np.max(np.abs(np.subtract(offsets, 0.03) / errors)) < 3.0
    assert np.mean(offsets) == pytest.approx(0.03, rel=0.03)


def test_4_an_offset_that_rounded_or_late_stamps_or_a_scanners_clock_hide_needs_no_evidence():
    run = as_recording(simulate(26, None, duration_s=120.0))
    hidden = late(run, 7e-4)
    assert not find_clocks([hidden], choose_approach([hidden])).free[0][0]
    rounded, jittered = (replace(hidden, **known) for known in ({"stamp_error_s": 0.003}, {"stamp_jitter_s": 0.004}))
    covariance = np.tile(np.diag([1e-6, 1e-6, 1e-6]), (len(hidden.truth), 1, 1))
    scanned = replace(hidden, truth=replace(hidden.truth, covariance=covariance))
    for known in (rounded, jittered, scanned):
        clocks = find_clocks([known], choose_approach([known]))
        assert clocks.free[0][0]
        assert clocks.clocks[0].offset_s == pytest.approx(0.0007, abs=3.0 * clocks.errors[0][0])


def test_5_nodes_of_a_truth_that_wanders_lie_farther_apart():
    seen = as_recording(simulate(26, None, duration_s=120.0, truth="rtk"))
    sharp = as_recording(simulate(26, None, duration_s=120.0))
    assert choose_approach([seen]).spacing_s > choose_approach([sharp]).spacing_s
    assert choose_approach([sharp, seen]) == choose_approach([seen])
    assert choose_approach([positions_only(sharp)]).spacing_s > choose_approach([seen]).spacing_s


def test_8_a_window_may_turn_more_than_once_and_a_coefficient_may_be_zero():
    n = 6000
    steps = Increments(np.full(n, 0.004), np.zeros(n), np.full(n, 0.02))
    run = recording(steps, noisy_path(steps, Coefficients(0.02, 0.0, 0.05, 0.0), 31), seed=31)
    windows = time_windows(run)
    assert np.ptp(run.odometry.xyt[:500, 2]) > 2.0 * np.pi
    assert np.abs(windows.residual[:, 2]).max() < 0.3
    moving = drive(32, 300.0, Coefficients(0.05, 0.02, 0.05, 0.0))
    fitted = fit([moving], approach=Approach("truth"))
    intervals = coefficient_intervals(fitted, fitted.design_matrix)
    assert next(i for i in intervals if i.name == "trans_rot").low == 0.0


@pytest.mark.slow
def test_1_a_truth_by_satellites_raises_no_false_alarm():
    learned = learn([as_recording(simulate(40, None, truth="rtk", duration_s=300.0))])
    assert learned.added == ()
    assert learned.noise == ()


@pytest.mark.slow
def test_1_a_strong_cause_is_named_beneath_a_truth_by_satellites():
    run = as_recording(simulate(40, "wheelbase", truth="rtk", parameters={"e": 0.06}, duration_s=300.0))
    learned = learn([run])
    assert learned.added == ("wheelbase",)
    assert learned.fit.noise.truth.xy_m > 0.006


def steered_on_the_truth(seed: int, seconds: float = 300.0) -> Recording:
    """Return a drive whose controller sees where the truth is at once, so that contact noise acts on the wheels."""
    rng = np.random.default_rng((6, seed))
    n, dt = int(seconds * RATE_HZ), 1.0 / RATE_HZ
    wanted = 0.5 + 0.3 * np.sign(np.sin(2 * np.pi * np.arange(n) * dt / 17.0))
    turn = 0.3 * np.sin(2 * np.pi * np.arange(n) * dt / 11.0)
    wheels, body = np.zeros((n, 2)), np.zeros((n, 2))
    way = goal = heading = goal_heading = speed = 0.0
    for i in range(n):
        goal, goal_heading = goal + wanted[i] * dt, goal_heading + turn[i] * dt
        speed += np.clip(wanted[i] + 2.0 * (goal - way) - speed, -dt, dt)
        wheels[i] = speed * dt, (turn[i] + 2.0 * (goal_heading - heading)) * dt
        slip = rng.standard_normal(2) * np.array([0.004, 0.006]) * np.sqrt(np.abs(wheels[i, 0]))
        body[i] = wheels[i] + slip
        way, heading = way + body[i, 0], heading + body[i, 1]
    turned, moved = (Increments(p[:, 0].copy(), np.zeros(n), p[:, 1].copy()) for p in (wheels, body))
    return replace(recording(moved, accumulate(np.zeros(3), turned), truth_mm=2.0, seed=seed), track_m=0.4)


def test_2_a_controller_that_steers_on_the_truth_is_no_slip():
    learned = learn([steered_on_the_truth(0, 200.0)])
    assert "accel_slip" not in learned.added
    assert learned.added == ()


@pytest.mark.slow
@pytest.mark.parametrize("route", ["yard", "umbmark"])
def test_3_noise_of_the_heading_is_no_wandering_gain_where_a_drive_stops_and_goes(route):
    assert learn([as_recording(simulate(46, None, route=route, duration_s=300.0))]).noise == ()


@pytest.mark.slow
def test_5_a_strong_cause_leaves_no_ghost_of_second_order():
    turned = as_recording(simulate(51, "mount_yaw", duration_s=300.0, parameters={"yaw": np.radians(3.0)}))
    assert learn([turned]).added == ("mount_yaw",)


def test_7_lost_increments_are_filled_and_not_corrected_as_a_scale():
    run = as_recording(simulate(52, "lost_increments", parameters={"fraction": 0.02}))
    floor = as_recording(simulate_without(52, "lost_increments"))
    found = encoder_effects(run)
    assert [effect.name for effect in found] == ["lost_increments"]
    scaled = fit([run], [registry()["wheel_scale"]()], approach=choose_approach([run])).effects
    filled, corrected = ten_second_error([restore_lost(run, found)]), ten_second_error([run], scaled)
    assert filled < 1.15 * ten_second_error([floor])
    assert corrected > 1.4 * filled


@pytest.fixture(scope="module")
def control():
    run = as_recording(simulate(60, None, duration_s=300.0))
    return run, fit([run], approach=choose_approach([run]))


def test_1_what_drives_is_the_odometry_of_wheels_and_the_truth_of_noise_that_was_made(control):
    assert control[1].problem.approach.side == "odometry"
    assert choose_approach([drive(60, 120.0, PLANTED)]).side == "truth"
    for truth in ("mocap", "rtk"):  # motors that hunt are no noise where a drive hardly turns
        run = as_recording(simulate(9301, None, duration_s=300.0, route="shuttle", truth=truth))
        assert choose_approach([run]).side == "odometry"


def test_2_what_a_drive_does_not_show_is_not_testable_and_never_huge():
    ahead = (Segment(0.0, 0.0, 1.0, 1.0), Segment(0.5, 0.0, 110.0, 1.0), Segment(0.0, 0.0, np.inf, 2.0))
    run = as_recording(simulate(61, None, duration_s=120.0, route=ahead))
    fitted = fit([run], approach=choose_approach([run]))
    looked = {c.score.effect.name: c for c in library_candidates(fitted)}
    assert all(c.refused for c in looked.values())
    assert "not testable" in looked["turn_asymmetry"].refused
    known = looked["accel_slip"].score
    huge = replace(
        known, estimate=np.array([1.05]), standard_error=np.array([0.01]), separable=True, p=0.0, held_out_nats=1e4
    )
    assert "physically possible" in objection(fitted, huge, Dictionary(DECISIONS))


def test_3_a_cause_is_linearised_again_where_it_was_found():
    run = as_recording(simulate(62, "wheelbase", duration_s=300.0, parameters={"e": 0.1}))
    fitted = fit([run], [registry()["wheelbase"]()], approach=choose_approach([run]))
    assert fitted.effects[0].e == pytest.approx(0.1, abs=max(3.0 * fitted.standard_errors[0], 5e-4))
    assert np.abs(fitted.noise.theta).max() < 0.2 * fitted.standard_errors[0]


def test_4_every_recording_has_a_clock_of_its_own_with_a_skew(control):
    run, fitted = control
    planted = (0.12, 4e-4), (-0.3, -3e-4)
    moved = [replace(late(run, *one), name=name) for name, one in zip("ab", planted, strict=True)]
    clocks = find_clocks(moved, fitted.problem.approach)
    for clock, (offset_s, rate) in zip(clocks.clocks, planted, strict=True):
        assert clock.offset_s == pytest.approx(offset_s, abs=0.004)
        assert clock.rate == pytest.approx(rate, abs=3e-5)


def slipping(every: int) -> Recording:
    """Return a drive whose wheels spin for a tenth of a second in every so many seconds."""
    steps = wander(63, 240.0)
    lost = np.where(np.arange(len(steps)) % (every * 50) < 5, 0.5 * steps.ds_m, 0.0)
    body = Increments(steps.ds_m - lost, steps.dl_m, steps.dtheta_rad)
    rng = np.random.default_rng(63)
    rough = body.ds_m + rng.standard_normal(len(body)) * 0.003 * np.sqrt(np.abs(body.ds_m))
    run = recording(replace(body, ds_m=rough), accumulate(np.zeros(3), steps), truth_mm=1.0, truth_rad=1e-3, seed=63)
    return replace(run, track_m=0.4)


def test_7_few_outliers_are_weighted_down_and_many_are_signal():
    rare, often = slipping(40), slipping(2)
    for run, weighted in ((rare, True), (often, False)):
        fitted = fit([run], approach=choose_approach([run]))
        assert (np.mean(fitted.noise.weights > 1.0) > 0.0) == weighted


def test_10_a_robot_that_goes_sideways_has_a_scale_and_a_noise_there_too():
    steps = wander(65, 120.0)
    holonomic = Increments(steps.ds_m, 0.7 * np.roll(steps.ds_m, 1500), steps.dtheta_rad)
    rng = np.random.default_rng(65)
    body = Increments(
        1.02 * holonomic.ds_m + 0.003 * rng.standard_normal(len(steps)) * np.sqrt(np.abs(steps.ds_m)),
        1.02 * holonomic.dl_m + 0.006 * rng.standard_normal(len(steps)) * np.sqrt(np.abs(holonomic.dl_m)),
        1.02 * holonomic.dtheta_rad,
    )
    run = recording(body, accumulate(np.zeros(3), holonomic), truth_mm=1.0, truth_rad=1e-3, seed=65)
    problem = pose_problem([run], approach=choose_approach([run]))
    assert np.abs(problem.steps.dl_m).sum() > 0.5 * np.abs(holonomic.dl_m).sum()
    fitted = fit([run], [registry()["wheel_scale"]()], approach=choose_approach([run]))
    assert fitted.effects[0].e == pytest.approx(0.02, abs=max(4.0 * fitted.standard_errors[0], 5e-4))
    assert fitted.noise.coefficients.across_trans > 0.0


MIXED = {"mount_yaw": {"yaw": -0.02}, "unequal_wheels": {"curvature": -0.01}}


@pytest.mark.slow
def test_two_causes_that_make_up_for_each_other_on_the_path_are_both_named():
    run = simulate(9102, tuple(MIXED), duration_s=300.0, route="loops", parameters=MIXED)
    learned = learn([as_recording(run)])
    first = learned.rounds[0].candidates[0]
    assert first.score.effect.name == "mount_yaw"
    assert first.rmse[1] > first.rmse[0]
    assert set(learned.added) == set(MIXED)
    assert learned.error_m < 0.6 * first.rmse[0]
