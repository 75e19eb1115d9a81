"""Robust weights are kept while the clock moves; down-weighted slips are reported as bursts within their bounds."""

from dataclasses import replace

import numpy as np
from wandering import noisy_path, recording, wander

from odomcorrupt.effects.effect import check_bounds
from odomcorrupt.geometry.se2 import accumulate
from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.model.noise_laws import Coefficients
from odomcorrupt.study.estimate.config import Approach
from odomcorrupt.study.estimate.gauss_newton import fit, fit_problem
from odomcorrupt.study.estimate.noise_likelihood import outliers
from odomcorrupt.study.estimate.outliers import slip_bursts
from odomcorrupt.study.estimate.problem import pose_problem
from odomcorrupt.study.io.clock import Clock

QUIET = Coefficients(0.01, 0.005, 0.005, 0.005)


def slipping(seed: int, part: float):
    """Return a drive in whose odometry a few short stretches go farther than the truth, which keeps `part` of them."""
    steps = wander(seed, 300.0)
    kept = np.ones(len(steps))
    for start in np.flatnonzero(steps.ds_m > 0.008)[::400][:12]:
        kept[start : start + 30] = part
    odometry = noisy_path(steps, QUIET, seed)
    run = recording(steps, odometry, truth_mm=1.0, truth_rad=0.001, seed=seed)
    truth = accumulate(np.zeros(3), replace(steps, ds_m=steps.ds_m * kept))
    noise = np.random.default_rng(seed).standard_normal(truth.shape) * 0.001
    return replace(run, truth=Trajectory(run.truth.stamps_ns, truth + noise))


def test_a_clock_that_moves_past_a_node_takes_the_weights_along():
    run = slipping(1, 0.5)
    late = replace(run, odometry=Trajectory(run.odometry.stamps_ns + 37_000_000, run.odometry.xyt))
    # weights kept from an earlier fit, and a first guess of the clock from which a node more or less is in sight
    for guess in (0.6, -0.6):
        first = fit([late], clocks=[Clock(guess)], approach=Approach())
        kept = np.where(np.arange(len(first.problem.intervals)) == 100, 9.0, 1.0)
        held = replace(first, noise=replace(first.noise, weights=kept))
        again = fit_problem(
            pose_problem([late], clocks=[Clock(guess)], approach=Approach()), [(True, False)], weights_of=held
        )
        intervals = again.problem.intervals
        assert again.problem.clocks[0].offset_s != guess
        assert len(again.noise.weights) == len(intervals)
        heavy = np.flatnonzero(again.noise.weights == 9.0)
        assert 1 <= len(heavy) <= 2
        before = first.problem.intervals.start_s[100]
        assert np.abs(intervals.start_s[heavy] - before).min() <= 0.5


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
    steps = wander(3, 400.0)
    run = recording(steps, noisy_path(steps, QUIET, 3), truth_mm=1.0, truth_rad=0.001, seed=3)
    aside = np.where(np.arange(len(run.truth.xyt)) > len(run.truth.xyt) // 2, 0.5, 0.0)
    jumped = run.truth.xyt + np.column_stack((aside, 0.0 * aside, 0.0 * aside))
    weights = fit([replace(run, truth=replace(run.truth, xyt=jumped))], approach=Approach()).noise.weights
    assert len(weights) > 500
    assert 1 <= np.count_nonzero(weights > 100.0) <= 2


def test_intervals_no_more_and_no_larger_than_by_chance_are_no_outliers():
    square = np.full(1000, 3.0)
    assert not outliers(np.where(np.arange(1000) == 7, 21.0, square)).any()
    assert outliers(np.where(np.arange(1000) == 7, 40.0, square)).sum() == 1
    assert outliers(np.where(np.arange(1000) < 3, 21.0, square)).sum() == 3
