"""Correlated noise: whitening with it, its evidence in both halves of a drive, its size beside white noise."""

from dataclasses import replace

import numpy as np
import pytest
from dense_covariance import dense_covariance
from hidden import as_recording
from scipy.signal import lfilter
from wandering import RATE_HZ, drive, noisy_path, recording, wander

from odomcorrupt.effects import effect_from_values
from odomcorrupt.geometry.se2 import Increments
from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.model.motion_model import TruthNoise
from odomcorrupt.model.noise_laws import Coefficients
from odomcorrupt.simulation import simulate
from odomcorrupt.study.estimate.config import choose_approach
from odomcorrupt.study.estimate.gauss_newton import fit
from odomcorrupt.study.estimate.problem import pose_problem
from odomcorrupt.study.estimate.random_process import knots_of, widened
from odomcorrupt.study.estimate.whitener import whitener
from odomcorrupt.study.estimate.windows import distance_windows
from odomcorrupt.study.select.decisions import DECISIONS
from odomcorrupt.study.select.random_effects import random_coefficients
from odomcorrupt.study.select.selection import learn
from odomcorrupt.study.validate.evaluation import process_roots, random_covariance

RANDOM = (
    effect_from_values("gauss_markov", {"sigma": 0.05, "tau": 8.0}),
    effect_from_values("gyro_bias_walk", {"density": 1e-3}),
)


@pytest.mark.parametrize("biased", [False, True])
def test_residuals_are_whitened_by_the_whole_covariance(biased):
    recording = as_recording(simulate(93, "wheel_scale", duration_s=45.0))
    recording = replace(recording, truth_scale_error=0.002 if biased else 0.0)
    problem = pose_problem([recording], approach=choose_approach([recording]))
    intervals, truth = problem.intervals, TruthNoise(0.002, 0.003, 1e-4)
    q = np.tile(np.diag([1e-6, 1e-6, 1e-5]), (len(intervals), 1, 1))
    white = widened(whitener(intervals, q, truth), problem, RANDOM)
    roots = np.concatenate([knots_of(effect, problem).columns for effect in RANDOM], axis=1)
    whole = dense_covariance(intervals, q, truth) + roots @ roots.T
    if biased:
        travel = [np.stack((m.v, m.vy, 0.0 * m.v), axis=1) * m.dt_s[:, None] for m in problem.motions]
        along = 0.002 * (intervals.column(-np.concatenate(travel)) * (1.0, 1.0, 0.0)).ravel()
        whole = whole + np.outer(along, along)
    x = np.random.default_rng(4).normal(size=(3 * len(intervals), 2)) * 1e-3
    w, solved = white.whitened(x), np.linalg.solve(whole, x)
    np.testing.assert_allclose(w.T @ w, x.T @ solved, rtol=1e-5)
    np.testing.assert_allclose(2.0 * white.log_det, np.linalg.slogdet(whole)[1], rtol=1e-8)
    pulled = white.pulled(w[:, 0]).ravel()
    np.testing.assert_allclose(pulled, solved[:, 0], rtol=0.0, atol=1e-6 * np.abs(solved).max())


QUIET = Coefficients(0.004, 0.004, 0.002, 0.001)


def processes_of(run):
    """Return the random coefficients that a recording shows, and the fit."""
    fitted = fit([run], approach=choose_approach([run]))
    return [one.effect for one in random_coefficients(fitted, DECISIONS)], fitted


def turned(yaw_rate, seed=3):
    """Return a recording of a robot that turned at this rate (n,) rad/s besides, unknown to its odometry."""

    def besides(steps):
        return replace(steps, dtheta_rad=steps.dtheta_rad + yaw_rate / RATE_HZ)

    return drive(seed, len(yaw_rate) / RATE_HZ, driven=besides, truth_mm=2.0)


@pytest.mark.parametrize(("begin_s", "end_s", "rate"), [(144.0, 146.4, 0.5), (72.0, 86.4, 0.04), (44.0, 84.0, 0.008)])
def test_what_happened_once_is_no_bias_that_walks(begin_s, end_s, rate):
    t_s = np.arange(12_000) / RATE_HZ
    rate = np.where((t_s > begin_s) & (t_s < end_s), rate, 0.0)
    assert processes_of(turned(rate))[0] == []


def test_a_bias_that_walks_all_the_time_is_found():
    walk = np.cumsum(np.random.default_rng(4).normal(0.0, 2e-3 / np.sqrt(RATE_HZ), 12_000))
    assert [found.name for found in processes_of(turned(walk))[0]] == ["gyro_bias_walk"]


@pytest.mark.parametrize("seed", [14, 34])
def test_a_bias_that_hardly_walks_in_one_half_by_chance_is_found(seed):
    walk = np.cumsum(np.random.default_rng(seed).normal(0.0, 6e-4 / np.sqrt(RATE_HZ), 12_000))
    found, *others = processes_of(turned(walk, seed))[0]
    assert found.name == "gyro_bias_walk"
    assert {(other.name, other.channel) for other in others} <= {("gauss_markov", "wheels")}  # the same, but for rests
    assert found.density == pytest.approx(6e-4, rel=0.25)


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("gauss_markov", {"sigma": 0.02, "tau": 30.0, "channel": "along"}),
        ("gauss_markov", {"sigma": 0.02, "tau": 30.0, "channel": "wheels"}),
        ("gyro_bias_walk", {"density": 1e-3, "tau": 40.0}),
    ],
)
def test_what_windows_share_has_the_covariance_of_each_of_them(name, values):
    recording = as_recording(simulate(93, None, duration_s=180.0))
    problem = pose_problem([recording], approach=choose_approach([recording]))
    windows, motion = distance_windows(problem.left[0], 2.0), problem.motions[0]
    effect = effect_from_values(name, values)
    root, own = process_roots([effect], windows, motion), random_covariance([effect], windows, motion)
    shared = np.einsum("kim,kjm->kij", root, root)
    there = np.einsum("kii->ki", own) > 1e-8
    ratio = np.einsum("kii->ki", shared)[there] / np.einsum("kii->ki", own)[there]
    # a process between its knots varies less; forth and back over one of them it cancels
    assert np.quantile(ratio, 0.1) > 0.9
    assert np.quantile(ratio, 0.9) < 1.1


def _learned(seed, cause, parameters, yaw_from):
    run = simulate(seed, cause, duration_s=400.0, parameters=parameters, yaw_from=yaw_from)
    without = as_recording(simulate(seed, None, duration_s=400.0, yaw_from=yaw_from))
    clean, noisy = fit([without], approach=choose_approach([without])), learn([as_recording(run)])
    return clean.noise.coefficients, noisy.fit.noise.coefficients, [gain.effect for gain in noisy.noise]


@pytest.mark.slow
def test_a_gain_and_its_time_are_found_and_white_noise_stays_what_it_was():
    planted = {"sigma": 0.04, "tau": 8.0, "channel": "wheels"}
    clean, noisy, (found,) = _learned(301, "gauss_markov", planted, yaw_from="encoders")
    assert (found.name, found.channel) == ("gauss_markov", "wheels")
    assert found.sigma == pytest.approx(0.04, rel=0.3)
    assert 4.0 < found.tau < 16.0
    # what the gain moves between knots 1.5 s apart is left, and looks white: sigma (v h / 3 tau)^0.5 of half a second
    before, after = (np.hypot(k.rot_rot, k.rot_trans) for k in (clean, noisy))
    assert after < 3.0 * before


@pytest.mark.slow
def test_a_walking_bias_is_measured_and_white_noise_stays_what_it_was():
    clean, noisy, (found,) = _learned(302, "gyro_bias_walk", {"density": 6e-4}, yaw_from="gyro")
    assert found.name == "gyro_bias_walk"
    assert found.density == pytest.approx(6e-4, rel=0.3)
    assert clean.rot_time == pytest.approx(2e-4, rel=0.2)
    # as above, what the bias moves between knots looks white; beside a walk one drive hardly separates noise in time
    # from noise of turns, and the draws of the walk assign it to either
    assert heading_noise(noisy) < 3.0 * heading_noise(clean)


def heading_noise(k):
    """Return the noise of the heading in a second at usual speeds, 0.3 m/s and 0.3 rad/s."""
    return np.sqrt(k.rot_time**2 + 0.3 * (k.rot_rot**2 + k.rot_trans**2))


@pytest.mark.slow
def test_a_bias_that_comes_back_is_no_walk_that_runs_away():
    # as a walk, this one would have wandered 3 deg/s away after ten minutes; it never does more than 0.4
    rng, planned = np.random.default_rng(304), wander(304)
    keep = np.exp(-1.0 / RATE_HZ / 8.0)
    kicks = 0.005 * np.sqrt(1.0 - keep**2) * rng.standard_normal(len(planned))
    bias = lfilter([1.0], [1.0, -keep], kicks)
    steps = Increments(planned.ds_m, planned.dl_m, planned.dtheta_rad + bias / RATE_HZ)
    noisy = noisy_path(steps, Coefficients(0.005, 0.005, 0.01, 0.005), 304)
    (found,), _ = processes_of(recording(planned, noisy, seed=304))
    assert found.name == "gyro_bias_walk"
    assert found.density * np.sqrt(found.tau / 2.0) == pytest.approx(0.005, rel=0.3)
    assert 4.0 < found.tau < 16.0


@pytest.mark.slow
def test_headings_of_a_truth_that_err_alike_for_a_second_are_no_bias_of_the_robot():
    # as those of a SLAM that is taken for the truth
    rng, planned = np.random.default_rng(305), wander(305, 300.0)
    keep, kicks = np.exp(-1.0 / RATE_HZ / 1.0), rng.standard_normal(len(planned) + 1)
    smooth = lfilter([1.0], [1.0, -keep], lfilter([1.0], [1.0, -keep], kicks))
    off = np.stack((0.0 * smooth, 0.0 * smooth, 0.02 * smooth / smooth.std()), axis=1)
    run = recording(planned, noisy_path(planned, Coefficients(0.005, 0.005, 0.01, 0.005), 305), seed=305)
    truth = Trajectory(run.truth.stamps_ns, run.truth.xyt + off)
    assert [gain.effect.name for gain in learn([replace(run, truth=truth)]).noise] == []
