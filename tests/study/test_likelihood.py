"""The banded likelihood equals the dense normal one, and its fit recovers planted values."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from dense_covariance import dense_covariance
from scipy.stats import multivariate_normal
from wandering import noisy_path, recording, wander

from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.model.motion_model import TruthNoise
from odomcorrupt.model.noise_laws import LAWS, Coefficients
from odomcorrupt.study.estimate import calibrate
from odomcorrupt.study.estimate.calibrate import Interval, coefficient_intervals
from odomcorrupt.study.estimate.config import Approach, choose_approach
from odomcorrupt.study.estimate.gauss_newton import fit
from odomcorrupt.study.estimate.intervals import cut_at
from odomcorrupt.study.estimate.noise_likelihood import HIGHEST, NoiseLikelihood, VarianceComponents, pseudo_inverse
from odomcorrupt.study.estimate.problem import pose_problem
from odomcorrupt.study.estimate.whitener import whitener

PLANTED = Coefficients(0.05, 0.02, 0.05, 0.01)


def short_problem(seed: int = 0):
    steps = wander(seed, 20.0)
    return pose_problem([recording(steps, noisy_path(steps, PLANTED, seed), seed=seed)], approach=Approach())


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
    steps = wander(1, 60.0)
    whole = recording(steps, noisy_path(steps, PLANTED, 1))
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


@pytest.mark.slow
def test_coefficients_come_back_from_simulated_drives_with_a_truth_of_1_to_20_mm():
    inside = []
    for seed, truth_mm in enumerate((1.0, 1.0, 3.0, 3.0, 10.0, 10.0, 20.0, 20.0)):
        steps = wander(seed)
        run = recording(steps, noisy_path(steps, PLANTED, seed), truth_mm=truth_mm, seed=seed)
        approach = choose_approach([run])
        assert approach.side == "truth"  # this noise sits in the odometry, sample by sample
        fitted = fit([run], approach=approach)
        k = fitted.noise.coefficients
        assert k.rot_rot == pytest.approx(PLANTED.rot_rot, rel=0.15)
        assert k.rot_trans == pytest.approx(PLANTED.rot_trans, rel=0.15)
        assert k.trans_trans == pytest.approx(PLANTED.trans_trans, rel=0.15)
        assert fitted.noise.truth.xy_m == pytest.approx(truth_mm * 1e-3, rel=0.15)
        nothing = fitted.design_matrix
        weak = next(i for i in coefficient_intervals(fitted, nothing) if i.name == "trans_rot")
        inside.append(weak.low <= PLANTED.trans_rot <= weak.high)
    assert sum(inside) >= 7, "a 95 % interval misses one in twenty, not two in eight"


def test_whitened_innovations_are_standard_normal_at_the_planted_model():
    squares = []
    for seed in range(4):
        steps = wander(seed, 300.0)
        problem = pose_problem(
            [recording(steps, noisy_path(steps, PLANTED, seed), seed=seed)], approach=Approach("truth")
        )
        q = problem.intervals.covariance(LAWS["diffusion"], PLANTED, problem.steps)
        white = whitener(problem.intervals, q, TruthNoise(0.003, 0.003, 0.0))
        squares.append(white.whiten(problem.intervals.residual) ** 2)
    all_squares = np.concatenate(squares)
    assert all_squares.mean() == pytest.approx(1.0, abs=4.0 * np.sqrt(2.0 / len(all_squares)))


@pytest.mark.parametrize("law", ["diffusion", "quadratic"])
def test_the_slope_of_the_likelihood_is_its_difference(law):
    problem = short_problem(3)
    pieces = VarianceComponents(LAWS[law], problem.intervals, problem.steps)
    likelihood = NoiseLikelihood(
        problem.intervals, pieces, np.ones((len(problem.intervals), 3, 1)), np.ones(len(problem.intervals))
    )
    at = likelihood.initial_guess()
    every = np.arange(len(at))
    step = 1e-4 * np.eye(len(at))
    measured = [
        (likelihood.evaluate(at + move).log_likelihood - likelihood.evaluate(at - move).log_likelihood) / 2e-4
        for move in step
    ]
    slope, information = likelihood.derivatives(likelihood.evaluate(at), every)
    np.testing.assert_allclose(slope, measured, rtol=1e-5, atol=1e-5 * np.max(information))


def test_odometry_cut_at_nodes_keeps_every_sample_once_and_in_order():
    steps = wander(5, 10.0)
    run = recording(steps, noisy_path(steps, PLANTED, 5))
    odo_s = run.odometry_s
    for node_s in (odo_s[[3, 60, 61, 200]], np.array([0.005, 0.02, 0.031, 1.0, 7.7]), odo_s[[0, -1]]):
        cut = cut_at(run.odometry, odo_s, node_s, run.origin_ns)
        wanted = np.union1d(odo_s[(odo_s > node_s[0]) & (odo_s < node_s[-1])], node_s)
        np.testing.assert_array_equal(cut.t_s, wanted)
        np.testing.assert_array_equal(cut.t_s[cut.at_node], node_s)
        np.testing.assert_array_equal(cut.source, np.searchsorted(odo_s, wanted, side="right") - 1)
        np.testing.assert_allclose(cut.xyt, run.odometry.at(wanted, run.origin_ns), atol=1e-15)


def test_a_coefficient_that_nothing_bounds_is_profiled_no_further_than_a_coefficient_may_be():
    def maximise(free, **_):
        assert np.exp(free).max() < HIGHEST
        return SimpleNamespace(free=free)

    flat = SimpleNamespace(maximise=maximise, posterior=lambda _: 0.0)
    start = np.log([0.5, 0.02])
    low, high = (calibrate._edge(flat, start, 0, way, 0.0) for way in (-1.0, 1.0))
    assert (low, high) == (0.0, np.inf)
    assert Interval("rot_rot", 0.5, low, high).standard_error == pytest.approx(0.5 / 1.96)


def test_a_parameter_on_which_no_data_depend_has_no_covariance():
    # a place that one half of a drive does not reach, beside parameters of very different units
    others = np.array([[1.481, -3.337, -233.459], [0.0, 1.161e6, -503.137], [0.0, 0.0, 1.131e5]])
    others = others + np.triu(others, 1).T
    used = [0, 2, 3]
    normal = np.zeros((4, 4))
    normal[np.ix_(used, used)] = others
    covariance = pseudo_inverse(normal)
    assert not covariance[1].any()
    assert not covariance[:, 1].any()
    assert covariance[np.ix_(used, used)] == pytest.approx(np.linalg.inv(others), rel=1e-9)
