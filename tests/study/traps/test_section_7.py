"""Pitfalls of a study on simulated drives: noisy truth, and regressors that contain the error."""

from dataclasses import replace

import numpy as np
import pytest
from hidden import as_recording, scanned
from wandering import noisy_path, recording, wander

from odomcorrupt.effects import registry
from odomcorrupt.geometry.se2 import Increments, increments
from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.model.noise_laws import Coefficients
from odomcorrupt.simulation import simulate
from odomcorrupt.study.estimate.calibrate import coefficient_intervals
from odomcorrupt.study.estimate.clocks import find_clocks
from odomcorrupt.study.estimate.config import Approach, choose_approach
from odomcorrupt.study.estimate.gauss_newton import fit
from odomcorrupt.study.estimate.windows import time_windows
from odomcorrupt.study.select.candidates import score_terms
from odomcorrupt.study.select.decisions import DECISIONS
from odomcorrupt.study.select.dictionary import Dictionary
from odomcorrupt.study.select.selection import learn
from odomcorrupt.study.terms.term import LibraryTerm

PLANTED = Coefficients(0.05, 0.02, 0.05, 0.01)


def noisy(seed: int, k: Coefficients, seconds: float = 300.0, **truth: float):
    steps = wander(seed, seconds)
    return recording(steps, noisy_path(steps, k, seed), seed=seed, **truth)


def test_1_noise_of_the_truth_does_not_pass_for_noise_of_the_odometry():
    # breaks where the truth's noise is left out of the covariance: increments alone say three times too much
    run = noisy(21, PLANTED, truth_mm=10.0)
    apart = increments(run.odometry.xyt).ds_m - increments(run.truth.xyt).ds_m
    naive = np.sqrt(np.sum(apart**2) / np.sum(np.abs(increments(run.odometry.xyt).ds_m)))
    assert naive > 2.5 * PLANTED.trans_trans
    fitted = fit([run], approach=choose_approach([run]))
    assert fitted.noise.coefficients.trans_trans == pytest.approx(PLANTED.trans_trans, rel=0.3)
    assert fitted.noise.truth.xy_m == pytest.approx(0.01, rel=0.15)


def test_2_drivers_do_not_carry_the_noise_they_are_regressed_on():
    # breaks where columns are built from odometry that jitters sample by sample: scale is then attenuated
    names = ("wheel_scale", "wheelbase", "speed_scale")
    z = {side: [] for side in ("truth", "odometry")}
    for seed in (22, 23, 24):
        run = noisy(seed, Coefficients(0.15, 0.06, 0.15, 0.03), truth_mm=1.0)
        assert choose_approach([run]).side == "truth"
        for side, found in z.items():
            fitted = fit([run], approach=Approach(side))
            scores = score_terms(fitted, [LibraryTerm(registry()[n]()) for n in names], Dictionary(DECISIONS))
            found.append([abs(float(s.estimate[0] / s.standard_error[0])) for s in scores])
    assert np.mean(z["truth"]) < 1.6
    assert np.max(z["truth"]) < 4.0


@pytest.fixture(scope="module")
def late():
    return as_recording(simulate(25, "time_offset", duration_s=300.0, parameters={"offset": 0.03}))


@pytest.mark.slow
def test_3_a_late_clock_is_no_slip_and_no_play(late):
    # breaks where clocks are not looked for before everything else
    learned = learn([late])
    assert learned.added == ()
    assert learned.clocks.free[0][0]


@pytest.mark.slow
def test_4_an_offset_is_estimated_without_the_bias_of_a_smoothed_derivative():
    # breaks where the offset is read off a slope of smoothed speeds (5 % short) and not by shifting the stamps
    offsets, errors = [], []
    for seed in range(25, 33):
        late = as_recording(simulate(seed, "time_offset", duration_s=300.0, parameters={"offset": 0.03}))
        clocks = find_clocks([late], choose_approach([late]))
        offsets.append(clocks.clocks[0].offset_s)
        errors.append(clocks.errors[0][0])
    assert np.max(np.abs(np.subtract(offsets, 0.03) / errors)) < 3.0
    assert np.mean(offsets) == pytest.approx(0.03, rel=0.03)


def test_4_an_offset_that_rounded_or_late_stamps_or_a_scanners_clock_hide_needs_no_evidence():
    # breaks if the offset is left at zero and the slip, play or lag that resembles it is named
    run = as_recording(simulate(26, None, duration_s=120.0))
    stamps = run.odometry.stamps_ns + 700_000
    hidden = replace(run, odometry=Trajectory(stamps, run.odometry.xyt), origin_ns=int(stamps[0]))
    assert not find_clocks([hidden], choose_approach([hidden])).free[0][0]
    rounded, late = (replace(hidden, **known) for known in ({"stamp_error_s": 0.003}, {"stamp_jitter_s": 0.004}))
    for known in (rounded, late, scanned(hidden)):
        clocks = find_clocks([known], choose_approach([known]))
        assert clocks.free[0][0]
        assert clocks.clocks[0].offset_s == pytest.approx(0.0007, abs=3.0 * clocks.errors[0][0])


def test_5_nodes_of_a_truth_that_wanders_lie_farther_apart():
    # breaks where the spacing does not look at the truth's noise
    seen = as_recording(simulate(26, None, duration_s=120.0, truth="rtk"))
    sharp = as_recording(simulate(26, None, duration_s=120.0))
    assert choose_approach([seen]).spacing_s > choose_approach([sharp]).spacing_s
    assert choose_approach([sharp, seen]) == choose_approach([seen])
    blind = sharp.truth.xyt * [1.0, 1.0, np.nan]
    positions = replace(sharp, truth=Trajectory(sharp.truth.stamps_ns, blind))
    assert choose_approach([positions]).spacing_s > choose_approach([seen]).spacing_s


@pytest.mark.slow
@pytest.mark.parametrize(
    ("cause", "seed"),
    [(cause, seed) for cause in ("gauss_markov", "slip_burst") for seed in (27, 28)],
)
def test_6_correlated_noise_and_bursts_are_no_bias_and_no_scale(cause, seed):
    # breaks where noise that wanders is not offered as an explanation, or bursts are not weighted down
    learned = learn([as_recording(simulate(seed, cause))])
    assert learned.added == ()
    assert learned.clocks.free == ((False, False),)


@pytest.mark.slow
def test_7_what_acts_in_few_places_is_not_without_power():
    # breaks where the score's variance is taken from the few blocks alone that an effect is active in
    reverses = as_recording(simulate(30, "backlash", route="umbmark", parameters={"travel": 0.006}))
    assert learn([reverses]).added[:1] == ("backlash",)


def test_8_a_window_may_turn_more_than_once_and_a_coefficient_may_be_zero():
    # breaks where headings of long windows are not wrapped, or zero is forced into a symmetric interval
    n = 6000
    steps = Increments(np.full(n, 0.004), np.zeros(n), np.full(n, 0.02))
    run = recording(steps, noisy_path(steps, Coefficients(0.02, 0.0, 0.05, 0.0), 31), seed=31)
    windows = time_windows(run)
    assert np.ptp(run.odometry.xyt[:500, 2]) > 2.0 * np.pi
    assert np.abs(windows.residual[:, 2]).max() < 0.3
    moving = noisy(32, Coefficients(0.05, 0.02, 0.05, 0.0))
    fitted = fit([moving], approach=Approach("truth"))
    intervals = coefficient_intervals(fitted, fitted.design_matrix)
    assert next(i for i in intervals if i.name == "trans_rot").low == 0.0


@pytest.mark.slow
def test_9_noise_is_fitted_again_after_every_addition():
    # breaks where the second look keeps noise that the first cause has inflated
    run = as_recording(simulate(33, "wheelbase", duration_s=300.0, parameters={"e": 0.05}))
    first, second = learn([run]).rounds[:2]
    assert second.before.noise.coefficients.rot_rot < 0.7 * first.before.noise.coefficients.rot_rot
