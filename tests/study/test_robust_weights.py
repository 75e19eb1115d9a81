"""Robust weights are kept while the clock moves; down-weighted slips are reported as bursts within their bounds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from wandering import noisy_path, recording, wander

from odomcorrupt.effects.effect import check_bounds
from odomcorrupt.geometry.increments import accumulate
from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.model.noise_laws import Coefficients
from odomcorrupt.study.estimate.config import Approach
from odomcorrupt.study.estimate.gauss_newton import fit
from odomcorrupt.study.estimate.outliers import slip_bursts
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
        kept = np.where(np.arange(len(first.problem.nodes)) == 100, 9.0, 1.0)
        again = fit([late], clocks=[Clock(guess)], free_clocks=[(True, False)], approach=Approach(), weights=kept)
        nodes = again.problem.nodes
        assert again.problem.clocks[0].offset_s != guess
        assert len(again.noise.weights) == len(nodes)
        heavy = np.flatnonzero(again.noise.weights == 9.0)
        assert 1 <= len(heavy) <= 2
        before = first.problem.nodes.start_s[100]
        assert np.abs(nodes.start_s[heavy] - before).min() <= 0.5


def test_slips_of_nearly_the_whole_way_become_bursts_within_their_bounds():
    bursts = slip_bursts(fit([slipping(2, 0.0)], approach=Approach()))
    assert bursts is not None
    check_bounds(bursts)
