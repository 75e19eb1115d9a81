"""Heavy tails, slip bursts and ticks are distinguished from each other and from a truth that jumps."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hidden import as_recording
from scipy.stats import t as student

from odomcorrupt.corruption.path import NoisyPath
from odomcorrupt.effects import effect_from_values
from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.model.motion_model import MotionModel, Noise
from odomcorrupt.model.noise_laws import Coefficients
from odomcorrupt.simulation import simulate
from odomcorrupt.study.estimate.config import choose_approach
from odomcorrupt.study.estimate.gauss_newton import fit
from odomcorrupt.study.estimate.outliers import events, odd_steps, slip_bursts
from odomcorrupt.study.estimate.tails import heavy_tails, log_density_of_sums
from odomcorrupt.study.io.encoders import encoder_effects
from odomcorrupt.study.select.confidence import confidence, noise_support
from odomcorrupt.study.select.random_effects import DetectedRandomEffect
from odomcorrupt.study.select.selection import learn


def fitted(recording):
    return fit([recording], approach=choose_approach([recording]))


@pytest.mark.parametrize("inverse_dof", [0.05, 0.2, 0.4])
def test_a_single_draw_has_the_density_of_students_t(inverse_dof):
    dof = 1.0 / inverse_dof
    width = np.sqrt((dof - 2.0) / dof)
    places, density = log_density_of_sums(inverse_dof, 1)
    near = np.abs(places) < 10.0
    assert density[near] == pytest.approx(student.logpdf(places[near] / width, dof) - np.log(width), abs=2e-3)


def test_sums_have_the_density_that_a_count_finds():
    rng = np.random.default_rng(5)
    sums = (rng.standard_t(3.0, (200_000, 8)) / np.sqrt(3.0)).sum(axis=1) / np.sqrt(8.0)
    places, density = log_density_of_sums(1.0 / 3.0, 8)
    for low, high in ((-0.5, 0.5), (1.0, 2.0), (3.0, 6.0)):
        share = np.mean((sums > low) & (sums < high))
        inside = (places > low) & (places < high)
        assert np.exp(density[inside]).sum() * (places[1] - places[0]) == pytest.approx(share, rel=0.05)


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


def test_a_truth_that_jumps_for_a_moment_is_no_noise_of_the_odometry():
    run = as_recording(simulate(302, None, duration_s=300.0))
    truth = run.truth.xyt.copy()
    truth[500::1500, 0] += 0.2
    nodes_hit = fitted(replace(run, truth=Trajectory(run.truth.stamps_ns, truth)))
    assert not any(event.lasting for event in events(nodes_hit))
    assert heavy_tails(nodes_hit) is None
    assert slip_bursts(nodes_hit) is None


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


@pytest.mark.parametrize("too_far", [False, True])
def test_a_process_that_drifts_further_than_the_recordings_has_even_odds_at_most(too_far):
    fitted = SimpleNamespace(problem=SimpleNamespace(recordings=()))
    learned = SimpleNamespace(held_out={}, left_nats=0.0, steps=[], drifts_too_far=too_far, fit=fitted)
    walk = DetectedRandomEffect(effect_from_values("gyro_bias_walk", {"density": 1e-3}), 500.0)
    assert (confidence(noise_support(walk, learned)) > 0.5) != too_far


@pytest.mark.slow
@pytest.mark.parametrize(
    ("cause", "yaw_from", "seed"),
    [
        ("heavy_tails", "encoders", 303),
        pytest.param("slip_burst", "encoders", 305, marks=pytest.mark.xfail(reason="a cluster of bursts is a place")),
        ("slip_burst", "gyro", 307),
        ("quantization", "gyro", 308), ("quantization", "encoders", 309),
    ],
)  # fmt: skip
def test_what_odd_steps_come_from_is_named(cause, yaw_from, seed):
    run = simulate(seed, cause, size=2.0, yaw_from=yaw_from, duration_s=600.0)
    learned = learn([as_recording(run)])
    assert [gain.effect.name for gain in learned.noise] == [cause]
    # many bursts cost way on average, and that is a scale
    assert set(learned.added) <= ({"wheel_scale"} if cause == "slip_burst" else set())


@pytest.mark.parametrize("yaw_from", ["encoders", "gyro"])
def test_ticks_are_seen_whatever_tells_the_heading(yaw_from):
    run = simulate(310, "quantization", yaw_from=yaw_from, duration_s=120.0)
    (ticks,) = encoder_effects(as_recording(run))
    assert ticks.name == "quantization"
    assert ticks.step == pytest.approx(run.answer["parameters"]["step"], rel=0.01)
    assert encoder_effects(as_recording(simulate(310, None, yaw_from=yaw_from, duration_s=120.0))) == []


@pytest.mark.parametrize(("channel", "own_scale"), [("along", True), ("along", False), ("yaw", True)])
def test_a_varying_gain_of_travel_may_be_a_varying_scale_of_the_truth(channel, own_scale):
    run = SimpleNamespace(own_scale=own_scale, yaw_dead_band_radps=0.0)
    fitted = SimpleNamespace(problem=SimpleNamespace(recordings=(run,)))
    learned = SimpleNamespace(held_out={}, left_nats=0.0, steps=[], drifts_too_far=False, fit=fitted)
    gain = DetectedRandomEffect(effect_from_values("gauss_markov", {"sigma": 0.01, "channel": channel}), 500.0)
    assert (confidence(noise_support(gain, learned)) > 0.5) != (own_scale and channel == "along")
