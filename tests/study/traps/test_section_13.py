"""Pitfalls shown by real recordings and independent drives."""

from dataclasses import replace

import numpy as np
import pytest
from hidden import as_recording, library_candidates, ten_second_error
from wandering import noisy_path, recording, wander

from odomcorrupt.effects import registry
from odomcorrupt.geometry.se2 import Increments, accumulate
from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.model.noise_laws import Coefficients
from odomcorrupt.simulation import Segment, simulate
from odomcorrupt.study.estimate.clocks import find_clocks
from odomcorrupt.study.estimate.config import choose_approach
from odomcorrupt.study.estimate.gauss_newton import fit
from odomcorrupt.study.estimate.noise_likelihood import NAMES
from odomcorrupt.study.estimate.problem import pose_problem
from odomcorrupt.study.io.recording import Recording
from odomcorrupt.study.select.candidates import objection, score_terms
from odomcorrupt.study.select.decisions import DECISIONS
from odomcorrupt.study.select.dictionary import Dictionary, families
from odomcorrupt.study.select.selection import learn
from odomcorrupt.study.terms.term import LibraryTerm

PLANTED = Coefficients(0.05, 0.02, 0.05, 0.01)


@pytest.fixture(scope="module")
def control():
    run = as_recording(simulate(60, None, duration_s=300.0))
    return run, fit([run], approach=choose_approach([run]))


def scored(fitted, *names):
    kinds = [registry()[name]() for name in names]
    return score_terms(fitted, [LibraryTerm(kind) for kind in kinds], Dictionary(DECISIONS))


def test_1_what_drives_is_the_odometry_of_wheels_and_the_truth_of_noise_that_was_made(control):
    # breaks where one side is taken always: smoothed truth undershoots at stops, and noisy odometry attenuates
    _, fitted = control
    assert fitted.problem.approach.side == "odometry"
    steps = wander(60, 120.0)
    assert choose_approach([recording(steps, noisy_path(steps, PLANTED, 60), seed=60)]).side == "truth"


@pytest.mark.parametrize("truth", ["mocap", "rtk"])
def test_1_motors_that_hunt_are_no_noise_where_a_drive_hardly_turns(truth):
    # breaks where roughness is held against a share of turning that is nearly nothing: the truth's turns, which carry
    # the noise of the contact, then drove, and "yaw depends on the yaw rate" was told of robots without a flaw
    run = as_recording(simulate(9301, None, duration_s=300.0, route="shuttle", truth=truth))
    assert choose_approach([run]).side == "odometry"


def test_2_what_a_drive_does_not_show_is_not_testable_and_never_huge():
    # breaks where an estimate is believed whatever its error: a tricycle was given a reverse scale of -1.05
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
    # breaks where one linear step is all: 10 % of track is 1 % away from its own tangent
    run = as_recording(simulate(62, "wheelbase", duration_s=300.0, parameters={"e": 0.1}))
    fitted = fit([run], [registry()["wheelbase"]()], approach=choose_approach([run]))
    assert fitted.effects[0].e == pytest.approx(0.1, abs=max(3.0 * fitted.standard_errors[0], 5e-4))
    assert np.abs(fitted.noise.theta).max() < 0.2 * fitted.standard_errors[0]


def test_4_every_recording_has_a_clock_of_its_own_with_a_skew(control):
    # breaks where one clock is fitted for a robot, or its rate is left out
    run, fitted = control
    moved = []
    for name, offset_s, rate in (("a", 0.12, 4e-4), ("b", -0.3, -3e-4)):
        t_ns = run.odometry.stamps_ns - run.origin_ns
        stamps = run.odometry.stamps_ns + np.round(offset_s * 1e9 + rate * t_ns).astype(np.int64)
        moved.append(replace(run, name=name, odometry=Trajectory(stamps, run.odometry.xyt), origin_ns=int(stamps[0])))
    clocks = find_clocks(moved, fitted.problem.approach)
    for clock, (offset_s, rate) in zip(clocks.clocks, ((0.12, 4e-4), (-0.3, -3e-4)), strict=True):
        assert clock.offset_s == pytest.approx(offset_s, abs=0.004)
        assert clock.rate == pytest.approx(rate, abs=3e-5)


def test_6_the_law_has_a_noise_to_the_side_and_the_truth_may_wander(control):
    # breaks where the law that raised no false alarm is not the one that is searched with
    _, fitted = control
    assert fitted.problem.approach.law_name == "diffusion"
    assert "across_trans" in {NAMES[i] for i in fitted.components.active}
    assert fitted.noise.truth.xy_m == pytest.approx(0.002, rel=0.3)
    seen = as_recording(simulate(60, None, duration_s=300.0, truth="rtk"))
    assert fit([seen], approach=choose_approach([seen])).noise.truth.random_walk > 0.0


@pytest.mark.slow
def test_6_what_is_learned_does_not_depend_on_how_far_apart_the_nodes_lie():
    # breaks where noise that remembers is taken for white: an effect then moves by many of its errors with the nodes
    causes = {"wheel_scale": {"e": 0.02}, "gauss_markov": {"sigma": 0.06, "tau": 6.0, "channel": "along"}}
    # the heading of a gyro says nothing of the wheels' scale
    run = as_recording(simulate(68, tuple(causes), parameters=causes, duration_s=600.0, yaw_from="gyro"))
    learned = learn([run])
    assert [gain.effect.name for gain in learned.noise] == ["gauss_markov"]
    scale, approach = registry()["wheel_scale"](heading="gyro"), learned.fit.problem.approach
    fits = [
        fit([run], [scale], approach=replace(approach, spacing_s=spacing_s), random=learned.fit.random)
        for spacing_s in (0.5, 2.0, 5.0)
    ]
    values, errors = (
        np.array(found) for found in zip(*((f.effects[0].e, f.standard_errors[0]) for f in fits), strict=True)
    )
    assert np.ptp(values) < errors.min()
    assert np.ptp(errors) < 0.2 * errors.min()
    assert np.all(np.abs(values - 0.02) < 3.0 * errors)
    white = fit([run], [scale], approach=approach)
    assert white.standard_errors[0] < 0.3 * errors.min()


def slipping(every: int) -> Recording:
    """Return a drive whose wheels spin for a tenth of a second in every so many seconds."""
    steps = wander(63, 240.0)
    lost = np.where(np.arange(len(steps)) % (every * 50) < 5, 0.5 * steps.ds_m, 0.0)
    body = Increments(steps.ds_m - lost, steps.dl_m, steps.dtheta_rad)
    rng = np.random.default_rng(63)
    rough = body.ds_m + rng.standard_normal(len(body)) * 0.003 * np.sqrt(np.abs(body.ds_m))
    truth = accumulate(np.zeros(3), Increments(rough, body.dl_m, body.dtheta_rad))
    seen = truth + rng.standard_normal(truth.shape) * [0.001, 0.001, 0.001]
    stamps = (np.arange(len(truth)) * 2e7).astype(np.int64)
    return Recording("slipping", Trajectory(stamps, accumulate(np.zeros(3), steps)), Trajectory(stamps, seen), 0, 0.4)


def test_7_few_outliers_are_weighted_down_and_many_are_signal():
    # breaks where robust weights are taken always, or never
    rare, often = slipping(40), slipping(2)
    for run, weighted in ((rare, True), (often, False)):
        fitted = fit([run], approach=choose_approach([run]))
        assert (np.mean(fitted.noise.weights > 1.0) > 0.0) == weighted


def test_8_the_track_gives_unequal_wheels_their_way_along_and_lets_single_wheels_be_named(control):
    # breaks where a track is guessed for what needs none: ghosts of lever arms and clocks come of a wrong one
    run, fitted = control
    kind = registry()["unequal_wheels"](curvature=0.01)
    motion = fitted.problem.motions[0]
    along = kind.twist_error(motion, None).f[:, 0]
    np.testing.assert_allclose(along, 0.01 * run.track_m**2 / 4.0 * motion.omega, rtol=1e-6, atol=1e-12)
    assert "backlash" in {family[0].name for family in families(fitted)}
    blind = fit([replace(run, track_m=None)], approach=fitted.problem.approach)
    single = {name for name, own in registry().items() if own.needs_track}
    tried = [term.start for family in families(blind) for term in family if term.name in single]
    assert tried
    assert all(effect.track > 0.0 for effect in tried)
    assert kind.twist_error(blind.problem.motions[0], None).f[:, 0].any() == np.False_


@pytest.mark.slow
def test_9_play_is_no_time_offset_and_a_time_offset_no_play():
    # breaks where play is a pulse at each reversal and not the width of a gap that is run through
    stop_and_go = {"route": "yard", "seed": 64}
    late = learn([as_recording(simulate(cause="time_offset", parameters={"offset": 0.04}, **stop_and_go))])
    assert late.added == ()
    assert late.clocks.free[0][0]
    worn = learn([as_recording(simulate(cause="backlash", parameters={"travel": 0.008}, **stop_and_go))])
    assert worn.added[:1] == ("backlash",)
    assert worn.fit.effects[0].travel == pytest.approx(0.008, rel=0.1)
    assert abs(worn.fit.problem.clocks[0].offset_s) < 0.003


def test_10_a_robot_that_goes_sideways_has_a_scale_and_a_noise_there_too():
    # breaks where a sideways way is taken for an artefact of smoothing
    steps = wander(65, 120.0)
    holonomic = Increments(steps.ds_m, 0.7 * np.roll(steps.ds_m, 1500), steps.dtheta_rad)
    rng = np.random.default_rng(65)
    body = Increments(
        1.02 * holonomic.ds_m + 0.003 * rng.standard_normal(len(steps)) * np.sqrt(np.abs(steps.ds_m)),
        1.02 * holonomic.dl_m + 0.006 * rng.standard_normal(len(steps)) * np.sqrt(np.abs(holonomic.dl_m)),
        1.02 * holonomic.dtheta_rad,
    )
    truth = accumulate(np.zeros(3), body) + rng.standard_normal((len(steps) + 1, 3)) * [0.001, 0.001, 0.001]
    stamps = (np.arange(len(truth)) * 2e7).astype(np.int64)
    run = Recording("sideways", Trajectory(stamps, accumulate(np.zeros(3), holonomic)), Trajectory(stamps, truth), 0)
    problem = pose_problem([run], approach=choose_approach([run]))
    assert np.abs(problem.steps.dl_m).sum() > 0.5 * np.abs(holonomic.dl_m).sum()
    fitted = fit([run], [registry()["wheel_scale"]()], approach=choose_approach([run]))
    assert fitted.effects[0].e == pytest.approx(0.02, abs=max(4.0 * fitted.standard_errors[0], 5e-4))
    assert fitted.noise.coefficients.across_trans > 0.0


def test_11_what_has_two_numbers_is_tested_as_a_group(control):
    # breaks where x and y of a lever compete with each other, or a direction is not scanned
    _, fitted = control
    lever = scored(fitted, "lever_arm")[0]
    assert len(lever.estimate) == 2
    named = {family[0].name: family for family in families(fitted)}
    assert len({f.start.direction for f in named["slope"]}) > 1
    assert len({(f.start.x, f.start.y) for f in named["region_slip"]}) > 10


def test_12_a_flat_nees_proves_nothing_and_nats_and_drift_do():
    # breaks where a model is judged by its NEES alone: noise grows until it covers what is missing
    run = as_recording(simulate(66, "unequal_wheels", duration_s=300.0, parameters={"curvature": 0.01}))
    approach = choose_approach([run], "linear")
    missing = fit([run], approach=approach)
    whole = fit([run], [registry()["unequal_wheels"]()], approach=approach)
    assert np.mean(missing.noise.innovations**2) == pytest.approx(1.0, abs=0.1)
    assert whole.log_likelihood > missing.log_likelihood + 10.0
    assert ten_second_error([run], whole.effects) < 0.7 * ten_second_error([run])
