"""Whitening with a random process agrees with the full dense covariance."""

from dataclasses import replace

import numpy as np
import pytest
from dense_covariance import dense_covariance
from hidden import as_recording
from scipy.linalg import lapack

from odomcorrupt.effects import effect_from_values
from odomcorrupt.model.motion_model import TruthNoise
from odomcorrupt.simulation import simulate
from odomcorrupt.study.estimate.config import choose_approach
from odomcorrupt.study.estimate.problem import pose_problem
from odomcorrupt.study.estimate.random_process import joined, knots_of, widened
from odomcorrupt.study.estimate.whitener import KnotPosterior, whitener

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


def test_knots_of_two_processes_have_the_posterior_of_the_whole_covariance():
    recording = as_recording(simulate(93, "wheel_scale", duration_s=45.0))
    problem = pose_problem([recording], approach=choose_approach([recording]))
    intervals, truth = problem.intervals, TruthNoise(0.002, 0.003, 1e-4)
    q = np.tile(np.diag([1e-6, 1e-6, 1e-5]), (len(intervals), 1, 1))
    knots, white = joined([knots_of(effect, problem) for effect in RANDOM]), whitener(intervals, q, truth)
    posterior = KnotPosterior.of(white.knots(knots.spread), knots.precision)
    assert np.all(np.diff(knots.time_s) >= 0.0)
    roots, spread = knots.columns, knots.spread.toarray()
    prior = np.linalg.inv(knots.precision.toarray())
    np.testing.assert_allclose(roots @ roots.T, spread @ prior @ spread.T, rtol=0.0, atol=1e-9 * np.ptp(roots) ** 2)
    gain = prior @ spread.T @ np.linalg.inv(dense_covariance(intervals, q, truth) + spread @ prior @ spread.T)
    r = np.random.default_rng(4).normal(size=(len(intervals), 3)) * 1e-3
    mean = posterior.values(posterior.scores(white.whiten(r)[:, None]))[:, 0]
    np.testing.assert_allclose(mean, gain @ r.ravel(), rtol=0.0, atol=1e-6 * np.abs(mean).max())
    deviations = posterior.values(np.eye(len(mean)))
    left = prior - gain @ spread @ prior
    np.testing.assert_allclose(deviations @ deviations.T, left, rtol=0.0, atol=1e-6 * np.abs(left).max())


@pytest.mark.parametrize("way_m", [0.0, 2.0])
def test_knots_that_fade_inform_as_their_columns_written_out_do(way_m):
    recording = as_recording(simulate(93, "wheel_scale", duration_s=240.0))
    recording = replace(recording, truth_correlation_m=way_m)
    problem = pose_problem([recording], approach=choose_approach([recording]))
    q = np.tile(np.diag([1e-6, 1e-6, 1e-5]), (len(problem.intervals), 1, 1))
    white = widened(whitener(problem.intervals, q, TruthNoise(0.002, 0.003, 0.0)), problem, RANDOM[1:])
    spread = knots_of(RANDOM[0], problem).spread
    written_out = white.whitened(spread.toarray())
    scale = np.sum(written_out**2)
    np.testing.assert_allclose(white.information(spread), written_out.T @ written_out, rtol=0.0, atol=1e-9 * scale)
    knots = white.knots(spread)
    assert knots.nnz < 0.8 * spread.shape[0] * spread.shape[1]
    band = replace(white, process=None).whitened(spread.toarray())
    np.testing.assert_allclose(knots.T @ written_out, band.T @ written_out, rtol=0.0, atol=1e-9 * scale)


def test_nothing_is_whitened_without_a_call_of_lapack_which_would_write_where_there_is_nothing(monkeypatch):
    recording = as_recording(simulate(93, "wheel_scale", duration_s=45.0))
    problem = pose_problem([recording], approach=choose_approach([recording]))
    intervals = problem.intervals
    q = np.tile(np.diag([1e-6, 1e-6, 1e-5]), (len(intervals), 1, 1))
    white = widened(whitener(intervals, q, TruthNoise(0.002, 0.003, 1e-4)), problem, RANDOM)
    solve = lapack.dtbtrs

    def counted(factor, columns, **options):
        assert columns.size
        return solve(factor, columns, **options)

    monkeypatch.setattr(lapack, "dtbtrs", counted)
    assert white.whiten(np.zeros((len(intervals), 3, 0))).shape == (3 * len(intervals), 0)
    assert white.pulled(white.whiten(intervals.residual)).shape == intervals.residual.shape
