"""Errors of a localisation, correlated along the path or in space, are not attributed to the odometry."""

from dataclasses import replace

import numpy as np
import pytest
from dense_covariance import dense_covariance
from scipy.stats import multivariate_normal
from wandering import noisy_path, recording, wander

from odomcorrupt.effects import registry
from odomcorrupt.geometry.se2 import Increments, accumulate
from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.model.motion_model import MotionModel, Noise, Setup, TruthNoise
from odomcorrupt.model.noise_laws import LAWS, Coefficients
from odomcorrupt.study.estimate.calibrate import fit_robot
from odomcorrupt.study.estimate.clocks import nuisance_of
from odomcorrupt.study.estimate.config import Approach, choose_approach
from odomcorrupt.study.estimate.correlation_length import with_correlation_lengths
from odomcorrupt.study.estimate.drive_type import MOUNTING
from odomcorrupt.study.estimate.gauss_newton import fit
from odomcorrupt.study.estimate.noise_likelihood import NoiseLikelihood, VarianceComponents
from odomcorrupt.study.estimate.problem import pose_problem, undo
from odomcorrupt.study.estimate.whitener import interval_covariance, map_axes, whitener
from odomcorrupt.study.estimate.windows import phased_rmse
from odomcorrupt.study.io.raw_trajectory import Samples
from odomcorrupt.study.io.reader import recordings_of
from odomcorrupt.study.terms.library import library_families
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


def localised(error_of, *, seed=3, seconds=300.0, noise=QUIET, drive=wander, yaw_rate=0.0):
    """Return a drive whose truth has errors (n, 3) on the map, given by its way (n,) and its places (n, 2).

    yaw_rate : rate (n,) in rad/s of turning that the odometry does not see
    """
    steps = wander(seed, seconds) if drive is wander else drive(seconds)
    run = recording(steps, noisy_path(steps, noise, seed), seed=seed)
    true = accumulate(np.zeros(3), replace(steps, dtheta_rad=steps.dtheta_rad + yaw_rate / 50.0))[::EVERY]
    error = error_of(np.random.default_rng(seed), way_of(steps)[::EVERY], true[:, :2])
    return replace(run, truth=Trajectory(run.odometry.stamps_ns[::EVERY], true + error), localised=True)


def way_of(steps):
    """Return the way (n + 1,) in metres over which errors of a localisation change; turns count, too."""
    return np.concatenate(([0.0], np.cumsum(np.abs(steps.ds_m) + 0.3 * np.abs(steps.dtheta_rad))))


def alike_over(length_m):
    def error_of(rng, way, places):
        error = rng.normal(0.0, [0.02, 0.02, 0.008], (len(way), 3))
        for i in range(1, len(way)):
            kept = np.exp(-(way[i] - way[i - 1]) / length_m)
            error[i] = kept * error[i - 1] + np.sqrt(1.0 - kept**2) * error[i]
        return error

    return error_of


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


def test_the_slope_of_the_likelihood_is_its_difference():
    problem = small()
    pieces = VarianceComponents(LAWS["diffusion"], problem.intervals, problem.steps)
    likelihood = NoiseLikelihood(
        problem.intervals, pieces, np.zeros((len(problem.intervals), 3, 0)), np.ones(len(problem.intervals))
    )
    at, every = likelihood.initial_guess(), np.arange(len(pieces.active) + 2)
    moves = 1e-4 * np.eye(len(at))[every]

    def nats(free):
        return likelihood.posterior(likelihood.evaluate(free))

    assert nats(at) < likelihood.evaluate(at).log_likelihood
    measured = [(nats(at + m) - nats(at - m)) / 2e-4 for m in moves]
    slope, information = likelihood.derivatives(likelihood.evaluate(at), every)
    np.testing.assert_allclose(slope, measured, rtol=1e-5, atol=1e-5 * np.max(information))


@pytest.mark.slow
@pytest.mark.parametrize("error_of", [alike_over(1.0), alike_over(2.5), by_place])
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
    base, gyro = replace(run, of_base=True), replace(run, positioned=False)
    for one in (base, gyro):
        assert not set(MOUNTING) & (set(nuisance_of([one])) | tested(one))
    positions = replace(run, heading_error_rad=0.1)
    assert set(MOUNTING) & set(nuisance_of([positions])) == set(MOUNTING) & tested(positions) == {"lever_arm"}


def test_a_constant_error_of_a_localisations_headings_is_no_drift_of_the_odometry():
    run = replace(localised(alike_over(1.0), seconds=150.0, noise=PRECISE), of_base=True)
    askew = replace(run, truth=replace(run.truth, xyt=run.truth.xyt + np.array([0.0, 0.0, 0.05])))
    (mended,) = with_correlation_lengths([askew], Approach(spacing_s=4.0))
    assert np.mean(mended.truth.xyt[:, 2] - run.truth.xyt[:, 2]) == pytest.approx(0.0, abs=0.01)
    assert phased_rmse([mended]) < 0.8 * phased_rmse([askew])
    assert "off the direction of its own positions" in mended.notes[-1]


def test_sliding_in_turns_to_one_side_is_no_error_of_the_headings():
    run = replace(localised(alike_over(1.0), seconds=150.0, noise=PRECISE, drive=left), of_base=True)
    run = undo(run, [registry()["icr_shift"](x=0.05)])
    (found,) = with_correlation_lengths([run], Approach(spacing_s=4.0))
    assert found.truth is run.truth


def test_noise_beside_a_localisation_of_high_rate_is_a_bound():
    """Errors of 1 cm in each of ten poses a second, with 2 cm that last for 1.5 m, are no noise of odometry."""
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
