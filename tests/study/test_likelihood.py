"""The noise fit: the banded likelihood is the dense normal one, and its maximum has the planted values."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from dense_covariance import dense_covariance
from hidden import as_recording
from scipy.optimize import minimize
from scipy.stats import binom, multivariate_normal
from wandering import PLANTED, RATE_HZ, drive, noisy_path, recording, wander

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
from odomcorrupt.study.estimate.whitener import whitener
from odomcorrupt.study.estimate.windows import position_windows
from odomcorrupt.study.io.headings import with_headings
from odomcorrupt.study.select.decisions import DECISIONS
from odomcorrupt.study.select.random_effects import random_coefficients


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
    blind = np.column_stack((run.truth.xyt[:, :2], np.full(len(run.truth), np.nan)))
    run = with_headings(replace(run, truth=Trajectory(run.truth.stamps_ns, blind)))
    return position_windows(run, intervals_between(run, np.arange(100, 900, 250)))


def test_a_model_file_has_it_with_its_unit():
    noise = Noise("diffusion", replace(QUIET, rot_time=GYRO))
    text = format_model(MotionModel(noise))
    assert "rot_time = 0.0005  # rad per sqrt(s)" in text
    assert parse_model(text).noise == noise
