"""The fit of white and correlated noise: its likelihood is the dense normal one, its maximum has the planted values."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from dense_covariance import dense_covariance
from hidden import as_recording
from scipy.optimize import minimize
from scipy.signal import lfilter
from scipy.stats import binom, multivariate_normal
from wandering import PLANTED, RATE_HZ, drive, noisy_path, positions_only, recording, wander

from odomcorrupt.effects import effect_from_values
from odomcorrupt.geometry.se2 import Increments, accumulate, increments
from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.model.model_file import format_model, parse_model
from odomcorrupt.model.motion_model import MotionModel, Noise, TruthNoise
from odomcorrupt.model.noise_laws import LAWS, Coefficients
from odomcorrupt.report.findings import fit_text
from odomcorrupt.simulation import simulate
from odomcorrupt.study.estimate.calibrate import coefficient_intervals, fit_correlation, fit_robot
from odomcorrupt.study.estimate.config import Approach, choose_approach
from odomcorrupt.study.estimate.gauss_newton import fit
from odomcorrupt.study.estimate.intervals import intervals_between
from odomcorrupt.study.estimate.noise_likelihood import NoiseLikelihood, VarianceComponents
from odomcorrupt.study.estimate.problem import pose_problem
from odomcorrupt.study.estimate.random_process import knots_of, widened
from odomcorrupt.study.estimate.whitener import whitener
from odomcorrupt.study.estimate.windows import position_windows
from odomcorrupt.study.io.headings import with_headings
from odomcorrupt.study.select.decisions import DECISIONS
from odomcorrupt.study.select.random_effects import random_coefficients
from odomcorrupt.study.select.selection import learn


def short_problem(seed: int = 0):
    return pose_problem([drive(seed, 20.0, PLANTED)], approach=Approach())


@pytest.mark.parametrize("law", LAWS)
def test_banded_likelihood_equals_the_dense_normal(law):
    problem = short_problem()
    intervals = problem.intervals
    q = intervals.covariance(LAWS[law], Coefficients(0.05, 0.02, 0.05, 0.01, 0.003), problem.steps)
    truth = TruthNoise(0.004, 0.006, 0.002)
    white = whitener(intervals, q, truth)
    banded = white.log_likelihood(white.whiten(intervals.residual))
    dense = multivariate_normal(cov=dense_covariance(intervals, q, truth)).logpdf(intervals.residual.ravel())
    assert banded == pytest.approx(dense, abs=1e-8 * abs(dense))


@pytest.mark.parametrize("law", [name for name, law in LAWS.items() if law.fitted])
def test_polarised_pieces_are_the_law(law):
    problem = short_problem()
    k = np.array([0.05, 0.02, 0.07, 0.03, 0.004, 0.01, 0.02, 0.03])
    pieces = VarianceComponents(LAWS[law], problem.intervals, problem.steps, gyro_noise=True)
    total = np.tensordot(pieces.shares(k), np.array(pieces.parts()), axes=1)
    direct = problem.intervals.covariance(LAWS[law], Coefficients(*k[:7], rot_time=k[7]), problem.steps)
    np.testing.assert_allclose(total, direct, rtol=1e-10, atol=1e-18)


def test_a_gap_in_the_truth_breaks_the_chain_and_nothing_else():
    whole = drive(1, 60.0, PLANTED)
    truth = whole.truth
    keep = np.ones(len(truth), dtype=bool)
    keep[1000:1500] = False
    holed = replace(whole, truth=Trajectory(truth.stamps_ns[keep], truth.xyt[keep]))
    full, cut = (
        pose_problem([whole], approach=Approach()).intervals,
        pose_problem([holed], approach=Approach()).intervals,
    )
    assert len(cut) < len(full)
    assert (cut.end_s - cut.start_s).max() < 1.6
    assert (~cut.linked).sum() == 2


@pytest.mark.parametrize("law", ["diffusion", "quadratic"])
def test_the_slope_of_the_likelihood_is_its_difference(law):
    problem = short_problem(3)
    pieces = VarianceComponents(LAWS[law], problem.intervals, problem.steps)
    likelihood = NoiseLikelihood(
        problem.intervals, pieces, np.ones((len(problem.intervals), 3, 1)), np.ones(len(problem.intervals))
    )
    at = likelihood.initial_guess()
    measured = [
        (likelihood.evaluate(at + move).log_likelihood - likelihood.evaluate(at - move).log_likelihood) / 2e-4
        for move in 1e-4 * np.eye(len(at))
    ]
    slope, information = likelihood.derivatives(likelihood.evaluate(at), np.arange(len(at)))
    np.testing.assert_allclose(slope, measured, rtol=1e-5, atol=1e-5 * np.max(information))


@pytest.mark.parametrize(("seed", "route"), [(50018, "office"), (50021, "slalom")])
def test_noise_of_the_wheels_is_not_left_to_a_wander_of_the_truth(seed, route):
    # 64 and 45 nats were left on the way where headings come from a gyro, and a wandering gain was named for them
    run = as_recording(simulate(seed, None, route=route, yaw_from="gyro"))
    approach = choose_approach([run])
    found = fit([run], approach=approach)
    start = found.noise.free.copy()
    names = found.components.active
    start[names.index(2)], start[-1] = np.log(0.002), np.log(1e-6)
    assert found.log_likelihood == pytest.approx(fit([run], approach=approach, start=start).log_likelihood, abs=0.5)
    assert found.noise.coefficients.trans_trans == pytest.approx(0.0018, rel=0.2)


@pytest.mark.parametrize("law", ["diffusion", "quadratic"])
def test_a_climb_from_anywhere_ends_at_the_top_that_a_textbook_optimiser_finds(law):
    run = drive(7, 200.0, PLANTED)
    problem = pose_problem([run], approach=Approach("truth"))
    nothing = np.zeros((len(problem.intervals), 3, 0))
    likelihood = NoiseLikelihood(
        problem.intervals,
        VarianceComponents(LAWS[law], problem.intervals, problem.steps),
        nothing,
        np.ones(len(problem.intervals)),
    )
    guess = likelihood.initial_guess()
    rng = np.random.default_rng(7)
    starts = [guess, *(guess + rng.normal(0.0, 1.5, len(guess)) for _ in range(5))]
    tops = [likelihood.maximise(start).log_likelihood for start in starts]
    low = np.log(1e-5)
    textbook = minimize(
        lambda free: -likelihood.evaluate(free).log_likelihood,
        guess,
        method="L-BFGS-B",
        bounds=[(low, 0.0)] * len(guess),
    )
    # a coefficient that may as well be nothing is left where its slope ends
    np.testing.assert_allclose(tops, max(tops), atol=0.1)
    assert max(tops) > -textbook.fun - 0.01


SEEDS = range(300, 310)


@pytest.mark.slow
@pytest.mark.parametrize("truth_mm", [1.0, 5.0])
def test_planted_coefficients_lie_in_their_intervals(truth_mm):
    inside: dict[str, list[bool]] = {}
    for seed in SEEDS:
        run = drive(seed, 300.0, PLANTED, truth_mm=truth_mm)
        fitted = fit([run], approach=choose_approach([run]))
        for interval in coefficient_intervals(fitted, np.zeros((len(fitted.problem.intervals), 3, 0))):
            planted = getattr(PLANTED, interval.name)
            if planted > 0.0:
                inside.setdefault(interval.name, []).append(interval.low <= planted <= interval.high)
    assert inside.keys() == {"rot_rot", "rot_trans", "trans_trans", "trans_rot"}
    for name, hits in inside.items():
        # as few as this happen to a right interval once in a thousand
        assert sum(hits) >= binom.ppf(0.001, len(hits), 0.95), f"{name}: {sum(hits)} of {len(hits)}"
    every = np.concatenate(list(inside.values()))
    assert 0.9 <= every.mean() <= 1.0


LARGE = Coefficients(0.04, 0.03, 0.04, 0.02)
NAMES = ("rot_rot", "rot_trans", "trans_trans", "trans_rot")


def left_arcs(duration_s=90.0):
    """A drive of left curves, some narrower: track and straightness are hard to tell apart."""
    n = int(duration_s * RATE_HZ)
    t = np.arange(n) / RATE_HZ
    v, omega = 0.5 + 0.1 * np.sin(t / 3.0), 0.4 + 0.12 * np.sin(t / 7.0)
    return Increments(v / RATE_HZ, np.zeros(n), omega / RATE_HZ)


@pytest.mark.slow
def test_reported_correlations_are_those_of_many_fits():
    steps = left_arcs()
    effects = [effect_from_values(name, {}) for name in ("wheelbase", "unequal_wheels")]
    estimates, stated = [], []
    for seed in range(40):
        run = recording(steps, noisy_path(steps, LARGE, seed), truth_mm=1.0, truth_rad=0.001, seed=seed)
        approach = choose_approach([run], "diffusion")
        found = fit([run], effects, approach=approach)
        k = found.noise.coefficients
        estimates.append([found.effects[0].e, found.effects[1].curvature, *(getattr(k, name) for name in NAMES)])
        known = {"wheelbase.e", "unequal_wheels.curvature", *NAMES}
        one = fit_correlation(found, found.design_matrix, known)
        matrix = one.among(["wheelbase.e", "unequal_wheels.curvature", *NAMES])
        if len(matrix) == 6:
            stated.append(matrix.matrix)
    assert len(stated) > 20
    shown, stated = np.corrcoef(np.array(estimates).T), np.median(stated, axis=0)
    assert stated[0, 1] > 0.9
    # of forty draws a correlation of 0 shows up to 0.35 either way
    np.testing.assert_allclose(stated, shown, atol=0.4)
    assert abs(stated[0, 1] - shown[0, 1]) < 0.05
    assert not stated[:2, 2:].any()


def test_fitted_model_keeps_its_correlations_in_its_file():
    run = drive(3, 120.0, LARGE)
    model = fit_robot([run], [effect_from_values(name, {}) for name in ("wheel_scale", "lever_arm")],
                      law_name="diffusion").model  # fmt: skip
    names = model.correlation.names
    assert "wheel_scale.e" in names
    assert "trans_trans" in names
    assert not any(name.startswith("lever_arm") for name in names)
    again = parse_model(format_model(model))
    assert set(again.correlation.names) == set(names)


def test_noise_of_turns_is_not_identifiable_where_nothing_turned():
    drive = wander(8, 120.0)
    straight = replace(drive, dtheta_rad=np.zeros(len(drive)))
    # encoders are smooth; a truth that drives would seem to turn by its own noise
    run = recording(straight, accumulate(np.zeros(3), straight), seed=8)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = fit_robot([run], [], law_name="diffusion")
    known = {interval.name: interval.identifiable for interval in found.intervals}
    assert list(known) == ["rot_rot", "rot_trans", "trans_trans", "trans_rot", "across_trans"]
    assert not known["rot_rot"]
    assert not known["trans_rot"]
    assert known["trans_trans"]
    lines = [line for line in fit_text(found).splitlines() if line.strip().startswith("rot_rot")]
    assert "not identifiable from this drive" in lines[0]


QUIET = Coefficients(0.0005, 0.0005, 0.002, 0.001)
GYRO = 5e-4
"""Angle random walk of a cheap gyro, rad/sqrt(s)."""


def resting(seed: int, gyro: float, *, walk: float = 0.0):
    """Return a recording of a robot that stands two thirds of the time, with a gyro of white noise and walking bias."""
    n = round(400.0 * RATE_HZ)
    moves = np.arange(n) / RATE_HZ % 30.0 < 10.0
    drive = wander(seed, 400.0)
    steps = Increments(drive.ds_m * moves, drive.dl_m, drive.dtheta_rad * moves)
    rng = np.random.default_rng((7, seed))
    rate = walk * np.cumsum(rng.normal(0.0, 1.0 / np.sqrt(RATE_HZ), n))
    turned = rng.normal(0.0, 1.0, n) * gyro / np.sqrt(RATE_HZ) + rate / RATE_HZ
    of_wheels = increments(noisy_path(steps, QUIET, seed))
    noisy = accumulate(np.zeros(3), replace(of_wheels, dtheta_rad=of_wheels.dtheta_rad + turned))
    return recording(steps, noisy, truth_mm=1.0, truth_rad=0.0015, seed=seed)


def test_white_noise_of_a_gyro_is_noise_over_time_and_no_bias():
    run = resting(4, GYRO)
    fitted = fit([run], approach=choose_approach([run]))
    k = fitted.noise.coefficients
    assert k.rot_time == pytest.approx(GYRO, rel=0.3)
    assert max(k.rot_rot, k.rot_trans) < 4.0 * QUIET.rot_rot
    assert random_coefficients(fitted, DECISIONS) == []
    without = fit([run], approach=replace(choose_approach([run]), gyro_noise=False))
    assert "gyro_bias_walk" in {one.effect.name for one in random_coefficients(without, DECISIONS)}


def test_a_bias_that_walks_is_found_beside_the_white_noise():
    run = resting(6, GYRO, walk=1.5e-4)
    fitted = fit([run], approach=choose_approach([run]))
    (found,) = random_coefficients(fitted, DECISIONS)
    assert found.effect.name == "gyro_bias_walk"
    assert found.effect.density == pytest.approx(1.5e-4, rel=0.2)


def test_a_heading_from_wheels_has_no_noise_over_time():
    run = resting(3, 0.0)
    assert not choose_approach([run]).gyro_noise
    assert fit([run], approach=choose_approach([run])).noise.coefficients.rot_time == 0.0


@pytest.mark.parametrize("law", ["diffusion", "velocity"])
def test_at_a_constant_yaw_rate_noise_over_time_is_noise_of_turns(law):
    rate, n = 0.4, 1000
    steps = Increments(np.full(n, 0.01), np.zeros(n), np.full(n, rate / RATE_HZ))
    run = recording(steps, accumulate(np.zeros(3), steps))
    problem = pose_problem([run], approach=Approach())
    own = LAWS["diffusion"]._replace(arc=law == "velocity")  # with rot1 along the arc, as that of table 5.3
    timed, turned = Coefficients(0, 0, 0, 0, rot_time=0.02), Coefficients(0.02 / np.sqrt(rate), 0, 0, 0)
    for windows in (problem.intervals, of_positions(run)):
        expected = windows.covariance(own, turned, problem.steps)
        np.testing.assert_allclose(windows.covariance(own, timed, problem.steps), expected, rtol=1e-6, atol=1e-15)


def of_positions(run):
    """Return windows of 5 s beside a truth of positions only."""
    run = with_headings(positions_only(run))
    return position_windows(run, intervals_between(run, np.arange(100, 900, 250)))


def test_a_model_file_has_it_with_its_unit():
    noise = Noise("diffusion", replace(QUIET, rot_time=GYRO))
    text = format_model(MotionModel(noise))
    assert "rot_time = 0.0005  # rad per sqrt(s)" in text
    assert parse_model(text).noise == noise


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
