"""Errors of a localisation, correlated along the path or in space, are not attributed to the odometry."""

from dataclasses import replace

import numpy as np
import pytest
from dense_covariance import dense_covariance
from scipy.stats import multivariate_normal
from wandering import RATE_HZ, noisy_path, recording, wander

from odomcorrupt.effects import effect_from_values, registry
from odomcorrupt.geometry.se2 import Increments, accumulate
from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.model.motion_model import MotionModel, Noise, Setup, TruthNoise
from odomcorrupt.model.noise_laws import LAWS, Coefficients
from odomcorrupt.study.estimate.calibrate import coefficient_intervals, fit_robot
from odomcorrupt.study.estimate.clocks import nuisance_of
from odomcorrupt.study.estimate.config import INTERVAL_S, Approach, choose_approach, independent_spacing_s
from odomcorrupt.study.estimate.correlation_length import with_correlation_lengths
from odomcorrupt.study.estimate.drive_type import MOUNTING
from odomcorrupt.study.estimate.gauss_newton import fit
from odomcorrupt.study.estimate.problem import pose_problem, undo
from odomcorrupt.study.estimate.whitener import interval_covariance, map_axes, whitener
from odomcorrupt.study.estimate.windows import drift_of
from odomcorrupt.study.io.raw_trajectory import Samples
from odomcorrupt.study.io.reader import recordings_of
from odomcorrupt.study.select.decisions import DECISIONS
from odomcorrupt.study.select.random_effects import random_coefficients
from odomcorrupt.study.select.selection import learn
from odomcorrupt.study.terms.term import library_families
from odomcorrupt.study.validate.calibration import HORIZONS_M
from odomcorrupt.study.validate.evaluation import evaluate_stretch, horizons_of
from odomcorrupt.study.validate.goodness_of_fit import verdict_of

QUIET = Coefficients(0.002, 0.0024, 0.0005, 0.0, 0.0005)
PRECISE = Coefficients(0.0, 1e-4, 1e-4, 0.0, 1e-4)
TRUTH = TruthNoise(0.02, 0.008, 0.0)
EVERY = 25
"""Samples of the odometry between two corrections: 0.5 s."""


def left(seconds):
    """Return circles of 1 m, at 0.4 m/s."""
    along = np.full(int(seconds / 0.02), 0.4 * 0.02)
    return Increments(along, np.zeros(len(along)), along)


def localised(error_of, *, seed=3, seconds=300.0, noise=QUIET, drive=wander, yaw_rate=0.0, every=EVERY):
    """Return a drive whose truth has errors (n, 3) on the map, given by its way (n,) and its places (n, 2).

    yaw_rate : rate (n,) in rad/s of turning that the odometry does not see
    """
    steps = wander(seed, seconds) if drive is wander else drive(seconds)
    run = recording(steps, noisy_path(steps, noise, seed), seed=seed)
    true = accumulate(np.zeros(3), replace(steps, dtheta_rad=steps.dtheta_rad + yaw_rate / 50.0))[::every]
    error = error_of(np.random.default_rng(seed), way_of(steps)[::every], true[:, :2])
    return replace(run, truth=Trajectory(run.odometry.stamps_ns[::every], true + error), localised=True)


def way_of(steps):
    """Return the way (n + 1,) in metres over which errors of a localisation change; turns count, too."""
    return np.concatenate(([0.0], np.cumsum(np.abs(steps.ds_m) + 0.3 * np.abs(steps.dtheta_rad))))


def correlated(rng, kept, deviation):
    """Return errors (n, 3) of which each keeps a part (n - 1,) of the one before."""
    error = rng.normal(0.0, deviation, (len(kept) + 1, 3))
    for i, keep in enumerate(kept, start=1):
        error[i] = keep * error[i - 1] + np.sqrt(1.0 - keep**2) * error[i]
    return error


def alike_over(length_m):
    return lambda rng, way, _: correlated(rng, np.exp(-np.diff(way) / length_m), [0.02, 0.02, 0.008])


def fading(rng, way, _places):
    """Return errors that are alike for 3 s, of corrections every 0.4 s."""
    return correlated(rng, np.full(len(way) - 1, np.exp(-0.4 / 3.0)), [0.02, 0.02, 0.009])


def by_place(rng, way, places):
    wave, phase = rng.normal(0.0, 1.0 / 1.5, (3, 12, 2)), rng.uniform(0.0, 2.0 * np.pi, (3, 12))
    size = np.array([0.022, 0.022, 0.008]) * np.sqrt(2.0 / 12.0)
    field = (size * np.cos(np.einsum("ckx,nx->nck", wave, places) + phase).transpose(2, 0, 1)).sum(axis=0)
    return field + rng.normal(0.0, [0.01, 0.01, 0.004], (len(way), 3))


def small(length_m=2.0, **changes):
    run = replace(localised(alike_over(2.0), seconds=60.0), truth_correlation_m=length_m, **changes)
    return pose_problem([run], approach=Approach(spacing_s=2.0))


def test_quasi_differences_are_as_likely_as_residuals_with_every_correlation():
    problem = small()
    intervals, k = problem.intervals, len(problem.intervals)
    assert intervals.linked[1:].all()
    q = intervals.covariance(LAWS["diffusion"], QUIET, problem.steps)
    # errors c of all k + 1 nodes on the map, and what they do to the residuals
    at = np.concatenate(([0.0], np.cumsum(-np.log(intervals.memory))))
    alike = np.exp(-np.abs(at[:, None] - at))
    _, end, b = map_axes(replace(intervals, memory=np.zeros(k)))
    carry = np.zeros((3 * k, 3 * (k + 1)))
    full = np.zeros((3 * k, 3 * k))
    for i in range(k):
        rows = slice(3 * i, 3 * i + 3)
        carry[rows, rows], carry[rows, 3 * i + 3 : 3 * i + 6] = b[i], -end[i]
        full[rows, rows] = q[i]
    errors = np.kron(alike, np.diag([TRUTH.xy_m**2, TRUTH.xy_m**2, TRUTH.yaw_rad**2]))
    full += carry @ errors @ carry.T
    white = whitener(intervals, q, TRUTH)
    banded = white.log_likelihood(white.whiten(intervals.residual))
    assert banded == pytest.approx(multivariate_normal(cov=full).logpdf(intervals.residual.ravel()), abs=1e-3)
    np.testing.assert_allclose(dense_covariance(intervals, q, TRUTH), full, rtol=1e-5, atol=1e-8)
    single = np.stack([full[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] for i in range(k)])
    np.testing.assert_allclose(interval_covariance(intervals, q, TRUTH), single, rtol=1e-6, atol=1e-9)
    other = np.random.default_rng(0).normal(size=3 * k)
    assert white.pulled(other).ravel() @ intervals.residual.ravel() == pytest.approx(
        other @ white.whiten(intervals.residual)
    )


@pytest.mark.slow
@pytest.mark.parametrize("error_of", [alike_over(2.5), by_place])
def test_a_localisations_errors_are_no_noise_of_the_robot(error_of):
    run = localised(error_of)
    approach = choose_approach([run])
    (run,) = with_correlation_lengths([run], approach)
    noise = fit([run], approach=approach).noise.coefficients
    assert noise.trans_trans < 0.004
    assert noise.across_trans < 0.004
    assert QUIET.rot_trans / 1.6 < np.hypot(noise.rot_trans, noise.rot_rot) < 1.6 * np.hypot(QUIET.rot_trans, 0.002)


@pytest.mark.slow
def test_noise_of_a_robot_that_is_larger_than_the_truths_is_still_its_own():
    strong = Coefficients(0.01, 0.015, 0.03, 0.0, 0.02)
    run = localised(alike_over(1.5), noise=strong)
    approach = choose_approach([run])
    (run,) = with_correlation_lengths([run], approach)
    found = fit([run], approach=approach).noise.coefficients
    assert found.trans_trans == pytest.approx(strong.trans_trans, rel=0.35)
    assert found.rot_trans == pytest.approx(strong.rot_trans, rel=0.35)


def test_a_model_beside_a_localisation_is_rejected_for_errors_that_are_larger_not_for_smaller_ones():
    run = replace(localised(alike_over(1.5), seconds=200.0), truth_correlation_m=1.5)
    right = MotionModel(Noise("diffusion", QUIET), setup=Setup(truth=TRUTH))
    bound = replace(right, noise=Noise("diffusion", Coefficients(0.01, 0.02, 0.03, 0.0, 0.03)))
    wide = replace(run, odometry=Trajectory(run.odometry.stamps_ns, run.odometry.xyt * (1.03, 1.03, 1.0)))
    found = [
        verdict_of(horizons_of([evaluate_stretch(one, model, Approach(spacing_s=4.0))], HORIZONS_M), {}, {})
        for one, model in ((run, right), (run, bound), (wide, right))
    ]
    assert [verdict.fails for verdict in found] == [False, False, True]


def test_a_truth_has_the_mounting_that_it_can_show():
    run = localised(by_place, seconds=60.0)
    motions = pose_problem([run], approach=Approach()).motions

    def tested(r):
        return {term.name for family in library_families([r], motions, ()) for term in family}

    assert set(MOUNTING) <= set(nuisance_of([run]))
    assert set(MOUNTING) <= tested(run)
    for one, own in ((replace(run, of_base=True), {"lever_arm"}), (replace(run, positioned=False), set())):
        assert set(MOUNTING) & (set(nuisance_of([one])) | tested(one)) == own
    positions = replace(run, heading_error_rad=0.1)
    assert set(MOUNTING) & set(nuisance_of([positions])) == set(MOUNTING) & tested(positions) == {"lever_arm"}


def test_a_constant_error_of_a_localisations_headings_is_no_drift_of_the_odometry():
    run = replace(localised(alike_over(1.0), seconds=150.0, noise=PRECISE), of_base=True)
    askew = replace(run, truth=replace(run.truth, xyt=run.truth.xyt + np.array([0.0, 0.0, 0.05])))
    (mended,) = with_correlation_lengths([askew], Approach(spacing_s=4.0))
    assert np.mean(mended.truth.xyt[:, 2] - run.truth.xyt[:, 2]) == pytest.approx(0.0, abs=0.01)
    assert drift_of([mended]).rmse < 0.8 * drift_of([askew]).rmse
    assert "off the direction of its own positions" in mended.notes[-1]


def test_sliding_in_turns_to_one_side_is_no_error_of_the_headings():
    run = replace(localised(alike_over(1.0), seconds=150.0, noise=PRECISE, drive=left), of_base=True)
    run = undo(run, [registry()["icr_shift"](x=0.05)])
    (found,) = with_correlation_lengths([run], Approach(spacing_s=4.0))
    assert found.truth is run.truth


def test_noise_beside_a_localisation_of_high_rate_is_a_bound():
    steps = wander(5, 300.0)
    own = noisy_path(steps, QUIET, 5)
    stamps = recording(steps, own).odometry.stamps_ns
    true, way = accumulate(np.zeros(3), steps)[::5], way_of(steps)[::5]
    error = alike_over(1.5)(np.random.default_rng(5), way, true[:, :2])
    error += np.random.default_rng(6).normal(0.0, [0.01, 0.01, 0.004], error.shape)
    (run,) = recordings_of(
        "drive", samples("/odom", "odom", stamps, own), samples("/amcl_pose", "map", stamps[::5], true + error)
    )
    robot = fit_robot([run], [], law_name="diffusion")
    bounds = {one.name: one for one in robot.noise_at_most}
    assert set(bounds) == {"rot_rot", "rot_trans", "trans_trans", "trans_rot", "across_trans"}
    for name, one in bounds.items():
        assert getattr(QUIET, name) <= one.high < 0.008, name


def samples(name, frame, stamps_ns, xyt):
    xyz, none = np.column_stack((xyt[:, :2], 0.0 * stamps_ns)), np.zeros(0)
    return Samples(name, name, frame, stamps_ns, xyz, xyt[:, 2], none.astype(np.int64), none)


WHEELS = Coefficients(0.004, 0.004, 0.002, 0.001)


def along_the_path(**changes):
    return localised(alike_over(1.0), **{"noise": WHEELS, "seconds": 260.0} | changes)


@pytest.fixture(scope="module")
def run():
    return along_the_path()


def test_errors_that_are_alike_over_a_metre_ask_for_seconds(run):
    assert independent_spacing_s(run) >= 4.0
    assert choose_approach([run]).spacing_s == independent_spacing_s(run)


def test_a_good_truth_keeps_its_close_nodes_and_a_noisy_one_without_correlation_one_second():
    steps = wander(3, 240.0)
    odometry = noisy_path(steps, WHEELS, 3)
    assert choose_approach([recording(steps, odometry)]).spacing_s == INTERVAL_S
    noisy = recording(steps, odometry, truth_mm=30.0, truth_rad=0.01)
    assert choose_approach([noisy]).spacing_s == 1.0


def test_a_short_drive_keeps_nodes_enough_for_its_halves():
    assert independent_spacing_s(along_the_path(seconds=110.0)) <= 2.0


@pytest.mark.slow
def test_a_bias_that_walks_is_distinguished_from_one_that_stays_although_nodes_lie_seconds_apart():
    seed, count = 5, int(260.0 * RATE_HZ)
    walk = np.cumsum(np.random.default_rng(seed).normal(0.0, 3e-4 / np.sqrt(RATE_HZ), count))
    found = {}
    for name, yaw_rate in (("walks", walk), ("stays", np.full(count, 0.01)), ("none", np.zeros(count))):
        run = along_the_path(seed=seed, yaw_rate=yaw_rate)
        fitted = fit([run], [effect_from_values("gyro_bias", {})], approach=choose_approach([run]))
        found[name] = [one.effect.name for one in random_coefficients(fitted, DECISIONS)]
        walking = fitted.refit(random=[effect_from_values("gyro_bias_walk", {"density": 3e-4})])
        bounds = coefficient_intervals(walking, walking.design_matrix)
        assert all(one.high < 0.03 for one in bounds), "a process in the model is no noise of every step"
    assert found == {"walks": ["gyro_bias_walk"], "stays": [], "none": []}


STEADY = Coefficients(0.0015, 0.0015, 0.001, 0.0005)


def test_the_truths_own_errors_are_no_noise_of_the_odometry():
    run = localised(fading, every=20, noise=STEADY, seconds=420.0)
    fitted = fit([run], approach=choose_approach([run]))
    assert fitted.noise.truth.yaw_rad == pytest.approx(0.009, rel=0.4)
    assert fitted.noise.coefficients.rot_rot < 0.006


@pytest.mark.slow
def test_a_small_bias_of_the_gyro_is_found_beside_a_localisation():
    learned = learn([localised(fading, every=20, noise=STEADY, seconds=420.0, yaw_rate=0.001)])
    (bias,) = (effect.bias for effect in learned.fit.effects if effect.name == "gyro_bias")
    assert bias == pytest.approx(-0.001, rel=0.2)
