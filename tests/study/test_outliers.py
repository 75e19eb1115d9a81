"""Single events, slips, heavy tails and ticks are distinguished, and a model drifts about as far as its recordings."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hidden import as_recording
from scipy.stats import t as student
from wandering import drive, noisy_path, recording, slewed, wander

from odomcorrupt.corruption.path import NoisyPath
from odomcorrupt.effects import effect_from_values
from odomcorrupt.effects.effect import check_bounds
from odomcorrupt.geometry.se2 import Increments, accumulate, increments
from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.model.motion_model import MotionModel, Noise
from odomcorrupt.model.noise_laws import Coefficients
from odomcorrupt.report.comparison import reproduction_sentence
from odomcorrupt.report.findings import reproduction_json
from odomcorrupt.simulation import simulate
from odomcorrupt.study.estimate.calibrate import model_of
from odomcorrupt.study.estimate.config import Approach, choose_approach
from odomcorrupt.study.estimate.gauss_newton import fit
from odomcorrupt.study.estimate.outliers import (
    during,
    heavy_tails,
    log_density_of_sums,
    odd_steps,
    single_events,
    slip_bursts,
)
from odomcorrupt.study.io.clock import Clock
from odomcorrupt.study.io.encoders import encoder_effects
from odomcorrupt.study.select.confidence import confidence, noise_support
from odomcorrupt.study.select.random_effects import DetectedRandomEffect
from odomcorrupt.study.select.selection import learn
from odomcorrupt.study.validate.predictive_check import reproduction_of


def pushed(seed, *, yaw_deg=0.0, begin_s=100.0, lasts_s=3.0):
    """Return a recording in which somebody turned the robot by so much, of which its odometry knows nothing."""
    run, steps = drive(seed, noise=Coefficients(0.01, 0.01, 0.003, 0.001)), wander(seed, 240.0)
    during = (np.arange(len(steps)) >= 50 * begin_s) & (np.arange(len(steps)) < 50 * (begin_s + lasts_s))
    turn = steps.dtheta_rad + during * np.radians(yaw_deg) / during.sum()
    true = accumulate(np.zeros(3), Increments(steps.ds_m, steps.dl_m, turn))
    noise = np.random.default_rng(seed).normal(0.0, [0.002, 0.002, 0.003], true.shape)
    return replace(run, truth=Trajectory(run.odometry.stamps_ns, true + noise))


def events_of(run):
    return single_events(fit([run], approach=choose_approach([run])))


def test_a_push_is_reported_with_its_time_place_and_size():
    run = pushed(3, yaw_deg=16.0)
    events = events_of(run)
    assert sum(np.degrees(event.yaw_rad) for event in events) == pytest.approx(-16.0, abs=3.0)
    for event in events:
        assert 99.0 < event.start_s < event.end_s < 104.0
        at = run.truth.at(np.array([event.start_s]), run.origin_ns)[0]
        assert event.place_xy == pytest.approx((at[0], at[1]), abs=0.02)


def test_a_truth_that_jumps_and_comes_back_is_no_event():
    run = pushed(3)
    truth = run.truth.xyt.copy()
    truth[5000:5400, :2] += 0.3
    assert events_of(replace(run, truth=Trajectory(run.truth.stamps_ns, truth))) == []


def hidden_from_the_truth(run, begin_s=99.0, end_s=104.0):
    """Return a recording whose truth saw nothing of a stretch."""
    t_s = run.truth.seconds_since(run.origin_ns)
    seen = (t_s < begin_s) | (t_s > end_s)
    return replace(run, truth=Trajectory(run.truth.stamps_ns[seen], run.truth.xyt[seen]))


@pytest.mark.parametrize("seed", range(5))
def test_noise_and_a_gap_of_the_truth_by_itself_hold_no_event(seed):
    run = pushed(seed)
    assert events_of(run) == events_of(hidden_from_the_truth(run)) == []


def test_a_push_is_one_event_and_no_evidence_for_noise():
    run = pushed(3, yaw_deg=40.0, lasts_s=1.0)
    fitted = fit([run], approach=choose_approach([run]))
    (event,) = single_events(fitted)
    own = during(fitted, [event])
    assert own.any()
    assert slip_bursts(fitted) is None
    assert heavy_tails(fitted) is None


GROUND = Coefficients(0.01, 0.005, 0.005, 0.005)


def slipping(seed, part):
    """Return a drive in whose odometry a few short stretches go farther than the truth, which keeps `part` of them."""

    def lost(steps):
        kept = np.ones(len(steps))
        for start in np.flatnonzero(steps.ds_m > 0.008)[::400][:12]:
            kept[start : start + 30] = part
        return replace(steps, ds_m=steps.ds_m * kept)

    return drive(seed, 300.0, GROUND, driven=lost, truth_mm=1.0, truth_rad=0.001)


def test_a_refit_keeps_the_weights_of_a_fit_at_another_clock_although_that_has_more_intervals():
    run = slipping(1, 0.5)
    here, there = (fit([run], clocks=[Clock(offset)], approach=Approach()) for offset in (0.0, 2.6))
    assert len(here.problem.intervals) != len(there.problem.intervals)
    kept = here.refit(weights_of=there).noise.weights
    assert len(kept) == len(here.problem.intervals)
    assert set(kept) <= {1.0, *there.noise.weights}


def test_slips_of_nearly_the_whole_way_become_bursts_within_their_bounds():
    bursts = slip_bursts(fit([slipping(2, 0.0)], approach=Approach()))
    assert bursts is not None
    check_bounds(bursts)


def test_a_single_jump_is_down_weighted_in_a_long_recording():
    run = drive(3, 400.0, GROUND, truth_mm=1.0, truth_rad=0.001)
    aside = np.where(np.arange(len(run.truth.xyt)) > len(run.truth.xyt) // 2, 0.5, 0.0)
    jumped = run.truth.xyt + np.column_stack((aside, 0.0 * aside, 0.0 * aside))
    weights = fit([replace(run, truth=replace(run.truth, xyt=jumped))], approach=Approach()).noise.weights
    assert len(weights) > 500
    assert 1 <= np.count_nonzero(weights > 100.0) <= 2


def fitted(recording):
    return fit([recording], approach=choose_approach([recording]))


@pytest.mark.parametrize("inverse_dof", [0.05, 0.2, 0.4])
def test_a_single_draw_has_the_density_of_students_t(inverse_dof):
    dof, width = 1.0 / inverse_dof, np.sqrt(1.0 - 2.0 * inverse_dof)
    places, density = log_density_of_sums(inverse_dof, 1)
    near = np.abs(places) < 10.0
    assert density[near] == pytest.approx(student.logpdf(places[near] / width, dof) - np.log(width), abs=2e-3)


def test_heavy_tails_of_the_librarys_own_are_named_and_normal_noise_is_not():
    run = as_recording(simulate(301, None, duration_s=400.0))
    noise = Noise("diffusion", Coefficients(0.02, 0.03, 0.01, 0.01))
    shown = {}
    for inverse_dof in (0.0, 0.45):
        effects = (effect_from_values("heavy_tails", {"inverse_dof": inverse_dof}),)
        samples = NoisyPath(MotionModel(noise, effects), 4).feed(run.odometry.stamps_ns, run.odometry.xyt)
        odometry = Trajectory(run.odometry.stamps_ns, run.odometry.xyt + samples.error_xyt)
        shown[inverse_dof] = heavy_tails(fitted(replace(run, odometry=odometry)))
    assert shown[0.0] is None
    effect, nats = shown[0.45]
    assert nats > 20.0
    # the truth's noise and the robot's own, which are normal, make it look milder
    assert 0.2 < effect.inverse_dof <= 0.45


def test_a_truth_that_is_elsewhere_for_seconds_and_comes_back_is_no_noise_of_the_odometry():
    # as a localisation that loses its way, or fixes that float: out and back are stretches of their own
    run = as_recording(simulate(302, None, duration_s=300.0))
    truth = run.truth.xyt.copy()
    for begin in range(700, len(truth) - 400, 1500):
        truth[begin : begin + 300, :2] += [0.2, -0.1]
    hit = fitted(replace(run, truth=Trajectory(run.truth.stamps_ns, truth)))
    assert len(odd_steps(hit)) > 6
    assert not any(event.lasting for event in odd_steps(hit))
    assert heavy_tails(hit) is None
    assert slip_bursts(hit) is None


@pytest.mark.slow
def test_what_odd_steps_come_from_is_named():
    learned = learn([as_recording(simulate(303, "heavy_tails", size=2.0, yaw_from="encoders", duration_s=300.0))])
    assert [gain.effect.name for gain in learned.noise] == ["heavy_tails"]
    assert learned.added == ()


@pytest.mark.parametrize("yaw_from", ["encoders", "gyro"])
def test_ticks_are_seen_whatever_tells_the_heading(yaw_from):
    run = simulate(310, "quantization", yaw_from=yaw_from, duration_s=120.0)
    (ticks,) = encoder_effects(as_recording(run))
    assert ticks.name == "quantization"
    assert ticks.step == pytest.approx(run.answer["parameters"]["step"], rel=0.01)
    assert encoder_effects(as_recording(simulate(310, None, yaw_from=yaw_from, duration_s=120.0))) == []


@pytest.mark.parametrize("too_far", [False, True])
def test_drifts_beyond_the_recordings_have_even_odds_at_most(too_far):
    fit = SimpleNamespace(problem=SimpleNamespace(recordings=(SimpleNamespace(yaw_dead_band_radps=0.0),)))
    learned = SimpleNamespace(held_out={}, left_nats=0.0, drifts_too_far=too_far, fit=fit, misfit=1.0)
    sizes = {"gyro_bias_walk": {"density": 1e-3}, "slip_burst": {"rate": 0.1}}
    for process in (DetectedRandomEffect(effect_from_values(name, own), 500.0) for name, own in sizes.items()):
        assert (confidence(noise_support(process, learned)) > 0.5) != too_far


CALM = Coefficients(0.006, 0.003, 0.004, 0.0)


def four_minutes(slips=(), *, excursion_m=0.0):
    """Return four minutes with slips of 15 degrees in a second, and a truth that is elsewhere for six seconds."""
    run = drive(7, 240.0, CALM, said=slewed(slips, 15.0), truth_mm=2.0, truth_rad=0.002)
    true = run.truth.xyt.copy()
    true[100 * 50 : 106 * 50, 0] += excursion_m
    return replace(run, truth=replace(run.truth, xyt=true))


@pytest.fixture(scope="module")
def plain():
    return fit([four_minutes()], approach=Approach())


def test_a_model_that_holds_reproduces_the_drift_it_was_learned_from(plain):
    one = reproduction_of(plain, model_of(plain))
    assert one.holds
    assert one.drawn_m == pytest.approx(one.measured_m, rel=0.4)
    assert reproduction_sentence(one) == ""


def test_slips_that_a_robust_fit_left_out_are_missed():
    slipped = fit([four_minutes((20, 60, 100, 140, 180, 220))], approach=Approach())
    one = reproduction_of(slipped, model_of(slipped))
    assert one.too_small
    assert one.outliers == 6
    assert one.outlier_share > 0.8
    assert "6 stretches (" in reproduction_sentence(one)
    assert "slip_burst or push" in reproduction_sentence(one)
    assert reproduction_json(one)["holds"] is False


def test_a_model_that_draws_far_too_much_is_said_to(plain):
    wild = model_of(plain)
    wild = replace(wild, noise=replace(wild.noise, coefficients=Coefficients(0.1, 0.05, 0.08, 0.0)))
    one = reproduction_of(plain, wild)
    assert one.too_large
    assert "its noise is too large" in reproduction_sentence(one)


def test_errors_of_places_in_the_truth_that_were_taken_for_noise_show_in_the_long_run():
    t_s = np.arange(0.0, 480.0, 0.02)
    xy = np.column_stack((2.0 * np.cos(0.13 * t_s), 1.5 * np.sin(0.19 * t_s)))
    steps = increments(np.column_stack((xy, np.unwrap(np.arctan2(*np.gradient(xy, axis=0).T[::-1])))))
    path = noisy_path(steps, Coefficients(1e-4, 1e-4, 1e-4, 0.0), 7)
    run = recording(steps, path, truth_mm=4.0, truth_rad=5e-3, seed=7)
    xyt, places = run.truth.xyt.copy(), np.random.default_rng(2)
    waves, phases = places.normal(0.0, 1.4, (2, 40)), places.uniform(0.0, 2.0 * np.pi, (3, 40))
    xyt += [[5e-3, 5e-3, 3e-3]] * np.sum(np.cos((xyt[:, :2] @ waves)[:, None] + phases), axis=2) / np.sqrt(20.0)
    fitted = fit([replace(run, truth=replace(run.truth, xyt=xyt))], approach=Approach())
    one = reproduction_of(fitted, model_of(fitted))
    assert one.long is not None
    assert one.long.too_large
    assert one.drawn_m < 1.5 * one.measured_m
    assert "after a quarter of the drive (120 s), the recording" in reproduction_sentence(one)


def test_an_excursion_of_the_truth_alone_is_no_drift_of_the_robot():
    away = fit([four_minutes(excursion_m=0.5)], approach=Approach())
    one = reproduction_of(away, model_of(away))
    assert one.holds
    assert one.outliers == 0


def spinning(slips, *, part=0.5, seconds=2.0, track_m=0.4):
    """Return two minutes on a floor where the right wheel spins now and then, so that it rolls a part less."""

    def spun(steps):
        ds, turned = steps.ds_m.copy(), steps.dtheta_rad.copy()
        for at in slips:
            inside = slice(round(at * 50), round((at + seconds) * 50))
            more = (ds[inside] + turned[inside] * track_m / 2.0) * part / (1.0 - part)
            ds[inside] += more / 2.0
            turned[inside] += more / track_m
        return Increments(ds, steps.dl_m, turned)

    return replace(drive(7, 120.0, CALM, said=spun, truth_mm=2.0, truth_rad=0.002), track_m=track_m)


AT = (7, 20, 33, 44, 58, 71, 85, 98, 110)


def test_a_model_with_bursts_slips_about_as_far_as_the_robot_did():
    fitted = fit([spinning(AT)], approach=Approach())
    bursts = slip_bursts(fitted)
    assert bursts is not None
    assert reproduction_of(fitted, model_of(fitted)).too_small
    assert reproduction_of(fitted, model_of(fitted, [bursts]), runs=5).holds
