"""A part of a learned model is kept unless held-out data clearly contradict it."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hidden import as_recording
from wandering import noisy_path, recording, wander

from odomcorrupt.effects import effect_from_values
from odomcorrupt.geometry.se2 import Increments, accumulate
from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.model.motion_model import MotionModel, Noise
from odomcorrupt.model.noise_laws import Coefficients
from odomcorrupt.report.findings import clocks_found
from odomcorrupt.simulation import simulate
from odomcorrupt.study import pipeline
from odomcorrupt.study.estimate.calibrate import fit_robot
from odomcorrupt.study.estimate.clocks import Clocks
from odomcorrupt.study.estimate.config import Approach
from odomcorrupt.study.estimate.drift_error import Drift
from odomcorrupt.study.estimate.gauss_newton import fit
from odomcorrupt.study.estimate.random_process import part_name
from odomcorrupt.study.io.clock import Clock
from odomcorrupt.study.select.confidence import confidence, support_of
from odomcorrupt.study.select.random_effects import DetectedRandomEffect
from odomcorrupt.study.select.result import Learned, Step
from odomcorrupt.study.select.selection import learn
from odomcorrupt.study.validate import held_out
from odomcorrupt.study.validate.evaluation import Evaluation
from odomcorrupt.study.validate.evaluation_clocks import clocks_beside
from odomcorrupt.study.validate.held_out import drop_unsupported_parts, without_parts
from odomcorrupt.study.validate.round_trip import RoundTrip

QUIET = Coefficients(0.004, 0.004, 0.002, 0.001)


def drive(seed, *, scale=1.0, wide=1.0, seconds=240.0):
    """Return a drive whose odometry goes `scale` as far, and turns `wide` as far, as the robot."""
    steps = wander(seed, seconds)
    true = accumulate(np.zeros(3), steps)
    said = Increments(scale * steps.ds_m, steps.dl_m, wide * steps.dtheta_rad)
    return recording(replace(said), noisy_path(said, QUIET, seed), seed=seed), true


def with_truth(pair, seed):
    """Return the recording of a drive beside its own truth, a little noisy."""
    run, true = pair
    noise = np.random.default_rng(seed).normal(0.0, [0.002, 0.002, 0.003], true.shape)
    return replace(run, truth=Trajectory(run.odometry.stamps_ns, true + noise))


def learned_with(run, *effects):
    """Return what a search would have left that included these effects."""
    fitted = fit([run], [*(effect_from_values(name, {}) for name in effects)], approach=Approach())
    plain = {name: (SimpleNamespace(name=name, gain=40.0, refused=""),) for name in effects}
    return Learned(
        clocks=Clocks((Clock(),), ((False, False),), ((0.0, 0.0),)),
        rounds=tuple(Step(before=fitted, candidates=plain[name], added=name) for name in effects),
        noise=(), unknown=(), against={}, fit=fitted, error_m=0.0, laws=(),
    )  # fmt: skip


def test_what_was_true_of_one_half_alone_is_dropped_and_what_is_true_of_both_stays():
    """In the first half alone the wheels slipped: as a scale of the whole drive it makes the other half worse."""
    run = with_truth(drive(4, wide=1.02), 5)
    late = run.odometry.stamps_ns > run.truth.stamps_ns[len(run.truth) // 2]
    steps = np.diff(run.odometry.xyt, axis=0)
    steps[~late[1:], :2] *= 1.03
    changed = np.concatenate((run.odometry.xyt[:1], run.odometry.xyt[0] + np.cumsum(steps, axis=0)))
    run = replace(run, odometry=Trajectory(run.odometry.stamps_ns, changed))
    kept, said = drop_unsupported_parts(learned_with(run, "wheelbase", "wheel_scale"))
    assert [effect.name for effect in kept.fit.effects] == ["wheelbase"]
    (failure,) = (one.failure for one in said if one.failure)
    assert "mm" in failure or "nats" in failure


@pytest.mark.slow
def test_other_recordings_of_the_robot_decide_where_there_are_any():
    learned = learned_with(with_truth(drive(4, scale=1.03, wide=1.03), 5), "wheel_scale")
    same, other = with_truth(drive(6, scale=1.03, wide=1.03), 7), with_truth(drive(6), 7)
    assert drop_unsupported_parts(learned, [replace(same, name="same")])[0].fit.effects
    assert not drop_unsupported_parts(learned, [replace(other, name="other")])[0].fit.effects


@pytest.mark.parametrize("axes", [[0, 1, 2], [0, 1]])
def test_noise_that_is_larger_than_the_model_has_it_costs_its_logarithm_where_its_size_is_free(axes):
    white = np.random.default_rng(1).normal(size=(50, 3))

    def nats(times):
        larger = white * np.where(np.isin(range(3), axes), times, 1.0)
        own = -0.5 * np.sum(larger**2, axis=1)
        stretch = SimpleNamespace(innovations=larger.ravel(), interval_nats=own, recording=SimpleNamespace(axes=axes))
        return Evaluation.sized_nats.fget(stretch)

    np.testing.assert_allclose(nats(4.0), nats(1.0) - len(axes) * np.log(4.0))


def test_the_drift_of_held_out_windows_is_evidence_where_single_intervals_are_none():
    errors = np.random.default_rng(1).chisquare(2.0, (5, 40))
    near, far = Drift(tuple(1e-4 * errors)), Drift(tuple(4e-4 * errors))
    assert near.nats_over(far) == pytest.approx(40.0 * np.log(4.0))
    assert far.nats_over(near) == -near.nats_over(far)


@pytest.mark.parametrize(("nats", "needed"), [(58.0, True), (12.0, False)])
def test_a_part_that_makes_held_out_data_likelier_is_needed_where_the_error_does_not_show_it(monkeypatch, nats, needed):
    monkeypatch.setattr(held_out, "block_differences", lambda *_, **__: nats / 10.0 + 5.0 * np.resize([-1.0, 1.0], 10))
    monkeypatch.setattr(held_out, "phased_misses", lambda _: np.full((5, 40), 1e-4))
    pieces = [SimpleNamespace(left=None)]
    found = held_out._verdict([effect_from_values("wheel_scale", {})], pieces, pieces)
    assert (found.needed, found.failure) == (needed, "")


@pytest.mark.parametrize(
    ("with_it_m", "odds", "kept"), [(0.0100, 0.4, True), (0.0110, 0.4, False), (0.0110, 0.6, True)]
)
def test_a_likelier_model_below_even_odds_is_dropped_where_the_error_grows_with_it(monkeypatch, with_it_m, odds, kept):
    monkeypatch.setattr(held_out, "block_differences", lambda *_, **__: 5.8 + 5.0 * np.resize([-1.0, 1.0], 10))
    # windows of which half get worse and half better, so that the larger error is not significant
    spread = np.resize([0.1, 1.9], (5, 40))
    monkeypatch.setattr(held_out, "phased_misses", lambda left: left[0][0] ** 2 * np.roll(spread, left[0][1], axis=1))
    monkeypatch.setattr(held_out, "confidence", lambda *_: odds)
    whole, without = ([SimpleNamespace(left=left)] for left in ((with_it_m, 0), (0.0100, 1)))
    learned = learned_with(with_truth(drive(4), 5), "wheel_scale")
    part = (effect_from_values("wheel_scale", {}),)
    found = held_out._verdict(part, whole, without)
    assert (found.needed, found.failure) == (True, "")
    assert (held_out._least_confident([(part, found)], learned) is None) == kept


@pytest.mark.slow
def test_a_name_that_is_hardly_likely_stays_only_where_held_out_data_need_it():
    learned = learned_with(with_truth(drive(4, wide=1.05), 5), "wheelbase", "wheel_scale")
    doubted = replace(learned, against={"wheelbase": 1e12, "wheel_scale": 1e12})
    assert [effect.name for effect in drop_unsupported_parts(learned)[0].fit.effects] == ["wheelbase", "wheel_scale"]
    kept, said = drop_unsupported_parts(doubted)
    assert [effect.name for effect in kept.fit.effects] == ["wheelbase"]
    assert ["confidence 0.00" in one.failure for one in said] == [True, False]


@pytest.mark.slow
def test_a_gain_that_held_out_data_do_not_show_caps_the_confidence():
    learned = learn([with_truth(drive(4, wide=1.02), 5)])
    (step,) = learned.steps
    tested = replace(learned, held_out={step.added: (3.0, 2.0)})
    assert support_of(step, learned).own > 7.0
    assert support_of(step, tested).own == pytest.approx(7.0)


def test_a_clock_is_found_with_the_model_where_its_effect_hides_it():
    run = with_truth(drive(8, wide=0.25), 9)
    late = replace(run, odometry=Trajectory(run.odometry.stamps_ns + 300_000_000, run.odometry.xyt))
    model = MotionModel(Noise("diffusion", QUIET), (effect_from_values("wheelbase", {"e": -0.75}),))
    assert clocks_beside([late], Approach(), model).clocks[0].offset_s == pytest.approx(0.3, abs=0.02)


def test_odometry_that_is_given_poses_leaves_even_odds_to_what_a_filter_does():
    learned = learned_with(with_truth(drive(4), 5), "wheel_scale")
    candidates = (SimpleNamespace(gain=40.0, refused="", name="wheel_scale"),)
    (step,) = (replace(step, candidates=candidates) for step in learned.rounds)
    (run,) = learned.fit.problem.recordings
    pulled = replace(learned.fit.problem, recordings=(replace(run, pulled_per_s=0.2),))
    assert confidence(support_of(step, learned)) > 0.9
    assert confidence(support_of(step, replace(learned, fit=replace(learned.fit, problem=pulled)))) < 0.6


def test_a_clock_beside_which_errors_depend_on_the_acceleration_is_the_less_sure():
    clocks = Clocks((Clock(-0.009),), ((True, False),), ((0.0005, 0.0),))
    (doubtful,) = clocks_found(replace(clocks, left_nats=80.0))
    (large,) = clocks_found(replace(clocks, clocks=(Clock(-0.2),), left_nats=80.0))
    assert doubtful.confidence < 0.8
    assert large.confidence > 0.9


def test_of_two_processes_of_one_name_only_the_one_that_fails_leaves_the_model():
    """The other one has the same name and acts on another channel: both stayed, and one was said to be left out."""
    run = with_truth(drive(4, seconds=60.0), 5)
    both = [effect_from_values("gauss_markov", {"sigma": 0.02, "channel": channel}) for channel in ("along", "yaw")]
    fitted = fit([run], random=both, approach=Approach())
    learned = replace(learned_with(run), fit=fitted, noise=tuple(DetectedRandomEffect(one, 20.0) for one in both))
    left = without_parts(learned, {"gauss_markov (yaw)": "it fails"})
    assert left.fit.random == (both[0],)
    assert [gain.effect for gain in left.noise] == [both[0]]
    assert part_name(both[1]) in left.left_out


def test_a_drive_too_short_to_be_halved_tests_nothing_and_drops_nothing():
    learned = learned_with(with_truth(drive(4, scale=1.03, seconds=20.0), 5), "wheel_scale")
    kept, said = drop_unsupported_parts(learned)
    assert (kept.fit.effects, said) == (learned.fit.effects, ())


@pytest.mark.slow
def test_what_no_odometry_satisfies_is_left_out_and_the_others_are_refitted(monkeypatch):
    """Two parts may balance each other: kept alone as it was fitted, one made another drive ten times worse."""
    run = as_recording(simulate(5, ["unequal_wheels", "wheelbase"], duration_s=240.0))
    checked = pipeline.verified_model

    def without_wheelbase(model, recordings):
        others = tuple(effect for effect in model.effects if effect.name != "wheelbase")
        if len(others) == len(model.effects):
            return checked(model, recordings)
        why = "no odometry satisfies it"
        return RoundTrip(replace(model, effects=others), (f"wheelbase left out: {why}",), {"wheelbase": why})

    both = pipeline.learn_robot([run]).proof.model
    monkeypatch.setattr(pipeline, "verified_model", without_wheelbase)
    found = pipeline.learn_robot([run])
    alone = fit_robot([run], [effect_from_values("unequal_wheels", {})], law_name="diffusion").model
    (kept,) = (effect for effect in found.proof.model.effects if effect.name == "unequal_wheels")
    assert found.search.left_out == {"wheelbase": "no odometry satisfies it"}
    assert any("wheelbase left out" in remark for remark in found.dropped)
    assert kept.curvature == pytest.approx(alone.effects[0].curvature, rel=1e-3)
    assert {effect.name for effect in both.effects} > {effect.name for effect in found.proof.model.effects}
