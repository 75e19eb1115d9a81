"""Acceptance of effects: impossible signs and redundant effects are refused, and others are not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter
from test_held_out import QUIET, drive, with_truth
from wandering import noisy_path, recording, wander

from odomcorrupt.effects import effect_from_values, registry
from odomcorrupt.effects.expression import user_effect
from odomcorrupt.geometry.increments import Increments, accumulate
from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.model.noise_laws import Coefficients
from odomcorrupt.study.estimate.config import Approach, choose_approach
from odomcorrupt.study.estimate.gauss_newton import fit
from odomcorrupt.study.estimate.tails import heavy_tails
from odomcorrupt.study.io.clock import Clock
from odomcorrupt.study.select import elimination
from odomcorrupt.study.select.candidates import library_candidates, objection
from odomcorrupt.study.select.closed_loop import may_be_of_lags, of_pulls
from odomcorrupt.study.select.decisions import DECISIONS
from odomcorrupt.study.select.elimination import eliminate_untested
from odomcorrupt.study.select.score import score_terms
from odomcorrupt.study.select.stepwise import learn
from odomcorrupt.study.terms.term import LibraryTerm


@pytest.mark.parametrize("times", [4.4, 1.9, 0.5])
def test_a_robot_that_turns_several_times_as_far_as_its_odometry_says_is_named(times):
    run = with_truth(drive(4, wide=1.0 / times, seconds=120.0), 5)
    best = library_candidates(fit([run], approach=choose_approach([run])), DECISIONS)[0]
    assert (best.name, best.refused) == ("wheelbase", "")
    (e,) = (effect.e for effect in best.fit.refit().effects if effect.name == "wheelbase")
    assert 1.0 / (1.0 + e) == pytest.approx(times, rel=0.01)


def inward(seed, k=-0.05):
    """Return a recording whose truth slips into its turns, as no tyre does."""
    steps = wander(seed, 240.0)
    run = recording(steps, noisy_path(steps, QUIET, seed), seed=seed)
    across = -k * steps.ds_m * steps.dtheta_rad * 50.0
    true = accumulate(np.zeros(3), Increments(steps.ds_m, across, steps.dtheta_rad))
    noise = np.random.default_rng(seed).normal(0.0, [0.002, 0.002, 0.003], true.shape)
    return replace(run, truth=Trajectory(run.odometry.stamps_ns, true + noise))


@pytest.mark.slow
def test_a_sign_that_physics_forbids_is_an_alarm_about_the_data_and_no_name():
    learned = learn([inward(3)])
    assert [one.name for one in learned.contradicted] == ["side_slip"]
    assert learned.added == ()
    assert learned.unknown == ()


@pytest.mark.parametrize(("k", "named"), [(-0.01, True), (-0.05, False)])
def test_a_slip_of_minus_half_the_message_period_is_eulers_method(k, named):
    run = inward(3, k)  # messages at 50 Hz
    refused = {c.name: c.refused for c in library_candidates(fit([run], approach=choose_approach([run])), DECISIONS)}
    assert "of a physically impossible sign" in refused["side_slip"]
    assert ("minus half the 0.02 s between messages" in refused["side_slip"]) == named


def test_an_effect_that_others_explain_in_full_leaves_and_a_true_one_stays():
    run = with_truth(drive(4, wide=1.03, seconds=120.0), 5)
    both = [registry()["wheelbase"](), effect_from_values("speed_scale", {})]
    fitted = fit([run], both, approach=choose_approach([run]))
    assert [e.name for e in eliminate_untested(fitted, (), DECISIONS).effects] == ["wheelbase"]


def test_an_effect_that_the_drift_needs_stays_although_blocks_contradict_each_other(monkeypatch):
    run = with_truth(drive(4, wide=1.03, seconds=120.0), 5)
    both = [registry()["wheelbase"](), effect_from_values("speed_scale", {})]
    fitted = fit([run], both, approach=choose_approach([run]))

    def contradictory(fit, terms, decisions):
        return [replace(score, inflation=1e6) for score in score_terms(fit, terms, decisions)]

    monkeypatch.setattr(elimination, "score_terms", contradictory)
    assert [e.name for e in eliminate_untested(fitted, (), DECISIONS).effects] == ["wheelbase"]


def test_tails_of_a_truth_that_is_noisier_than_the_odometry_are_not_the_odometrys():
    steps = wander(5, 240.0)
    run = recording(steps, noisy_path(steps, Coefficients(0.002, 0.002, 0.001, 0.001), 5), seed=5)
    true = accumulate(np.zeros(3), steps)
    noise = np.random.default_rng(5).standard_t(2.5, true.shape) * [0.02, 0.02, 0.02]
    noisy = replace(run, truth=Trajectory(run.odometry.stamps_ns, true + noise))
    assert heavy_tails(fit([noisy], approach=choose_approach([noisy]))) is None


def pulled(seed, *, scale=1.0, late_s=0.06, per_s=0.2):
    """Return a recording whose odometry is late, and every second goes a part of the way to where the robot is."""
    steps = wander(seed, 240.0)
    true = accumulate(np.zeros(3), steps)
    rows, late = np.arange(len(true)), round(late_s * 50.0)
    said = true[np.maximum(rows - late, 0)].copy()
    step = np.diff(said[:, :2], axis=0) * scale
    odometry = said.copy()
    for i in range(1, len(odometry)):
        odometry[i, :2] = odometry[i - 1, :2] + step[i - 1]
        if i % 50 == 0:
            odometry[i, :2] += per_s * (true[i, :2] - odometry[i, :2])
    run = recording(steps, odometry, seed=seed)
    noise = np.random.default_rng(seed).normal(0.0, [0.002, 0.002, 0.003], true.shape)
    return replace(run, truth=Trajectory(run.odometry.stamps_ns, true + noise), pulled_per_s=per_s)


def test_a_gain_as_small_as_what_poses_make_of_late_odometry_is_no_name():
    # odometry that is 60 ms late and pulled by a fifth a second seems to go 1.2 % too far
    run = pulled(4)
    fitted = fit([run], clocks=[Clock(0.06)], approach=choose_approach([run]))
    refused = {one.name: one.refused for one in library_candidates(fitted, DECISIONS)}
    assert refused["wheel_scale"]
    assert of_pulls(fitted, effect_from_values("wheel_scale", {"e": 0.012}))
    assert not of_pulls(fitted, effect_from_values("wheel_scale", {"e": 0.05}))
    alone = fit([replace(run, pulled_per_s=0.0)], clocks=[Clock(0.06)], approach=choose_approach([run]))
    assert not library_candidates(alone, DECISIONS)[0].refused


def test_a_wave_of_the_heading_is_no_artefact_of_poses():
    # iron near a compass deflects it with the heading: as small as what poses make of late odometry, but no gain
    fitted = fit([run := pulled(4)], clocks=[Clock(0.06)], approach=choose_approach([run]))
    size = 0.012 * float(np.sqrt(np.mean(fitted.problem.motions[0].omega ** 2)))
    wave, gain = (user_effect("own", f"yaw += {of}", {}) for of in (f"{size:.4g} * cos(theta)", "0.012 * omega"))
    assert of_pulls(fitted, gain)
    assert not of_pulls(fitted, wave)


@pytest.mark.parametrize("e", [0.0, 0.002])
def test_a_gain_as_small_as_the_form_of_a_lag_makes_is_no_name(e):
    # travel behind a filter of 100 ms and turns behind one of 40 ms, in the model a late clock and a filter of the rest
    steps = wander(4, 480.0)
    ways = [lfilter([1.0 - a], [1.0, -a], d) for a, d in ((np.exp(-0.2), steps.ds_m), (np.exp(-0.5), steps.dtheta_rad))]
    said = accumulate(np.zeros(3), replace(steps, ds_m=ways[0] / (1.0 + e), dtheta_rad=ways[1]))
    run = recording(steps, said, truth_mm=0.5, truth_rad=1e-3, seed=4)
    lag = effect_from_values("channel_lag", {"tau": 0.06, "channel": "along"})
    fitted = fit([run], [lag], clocks=[Clock(0.03)], free_clocks=[(True, False)], approach=choose_approach([run]))
    (score,) = score_terms(fitted, [LibraryTerm(effect_from_values("wheel_scale", {"heading": "gyro"}))], DECISIONS)
    assert abs(score.estimate[0]) > 2.0 * score.standard_error[0]
    assert may_be_of_lags(fitted, score) == (e == 0.0)


def creeping(seed, per_s=0.002):
    """Return a recording whose odometry creeps on while the robot stands, beside a truth of a tenth of a millimetre."""
    steps = wander(seed, 240.0)
    still = (np.abs(steps.ds_m) < 1e-9) & (np.abs(steps.dtheta_rad) < 1e-9)
    said = replace(steps, ds_m=np.where(still, per_s / 50.0, steps.ds_m))
    return recording(steps, noisy_path(said, QUIET, seed), truth_mm=0.1, truth_rad=1e-4, seed=seed), still


def objection_to(fitted, name, **shape):
    (score,) = score_terms(fitted, [LibraryTerm(effect_from_values(name, shape))], DECISIONS)
    return score, objection(fitted, score, DECISIONS, level=DECISIONS.level, still=False)


def test_creep_at_rest_is_no_dead_band_and_a_bias_at_rest_is_one():
    run, still = creeping(6)
    score, refused = objection_to(fit([run], approach=Approach()), "dead_band", speed=0.02, beyond="full", track=0.3)
    assert score.significant(DECISIONS.level)
    assert "only while the robot stands" in refused
    turned = np.cumsum(np.concatenate(([0.0], still))) * 1e-3 / 50.0
    xyt = run.odometry.xyt + turned[:, None] * [0.0, 0.0, 1.0]
    biased = replace(run, odometry=replace(run.odometry, xyt=xyt))
    _, refused = objection_to(fit([biased], approach=Approach()), "gyro_bias")
    assert refused == ""


@pytest.mark.slow
def test_wheels_that_fall_short_at_speed_contradict_no_physics():
    # the opposite of counts that are lost there: its sign is no alarm about the data, and the law is no copy of it
    steps = wander(3, 240.0)
    half = 0.2 * steps.dtheta_rad
    fast = 0.6 / 50.0
    right, left = (u - 0.3 * (u - np.clip(u, -fast, fast)) for u in (steps.ds_m + half, steps.ds_m - half))
    run = replace(recording(steps, noisy_path(steps, QUIET, 3), seed=3), track_m=0.4)
    true = accumulate(np.zeros(3), Increments((right + left) / 2.0, steps.dl_m, (right - left) / 0.4))
    learned = learn([with_truth((run, true), 3)])
    assert [law.name for law in learned.laws] == ["wheels_over_speed"]
    assert learned.added == ()
    assert learned.contradictions == ()
