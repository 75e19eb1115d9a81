"""ATE and RPE are equal to evo's for the same trajectories."""

import numpy as np
import pytest
from wandering import noisy_path, recording, wander

from odomcorrupt.geometry.se2 import accumulate, compose
from odomcorrupt.model.noise_laws import Coefficients
from odomcorrupt.study.validate.trajectory_error import (
    absolute_errors,
    aligned_at_origin,
    aligned_rigidly,
    relative_errors,
    trajectory_error,
)


@pytest.fixture(params=[1, 2, 3])
def pair(request):
    steps = wander(request.param, 120.0)
    truth = accumulate(np.array([3.0, -2.0, 2.5]), steps)
    noisy = compose(np.array([-7.0, 4.0, -1.2]), noisy_path(steps, Coefficients(0.1, 0.05, 0.1, 0.02), request.param))
    return truth[::10], noisy[::10]


def as_evo(xyt):
    trajectory = pytest.importorskip("evo.core.trajectory", reason="evo is not installed; it is the oracle here")
    half = xyt[:, 2] / 2.0
    quaternion = np.column_stack((np.cos(half), np.zeros((len(xyt), 2)), np.sin(half)))
    return trajectory.PosePath3D(
        positions_xyz=np.column_stack((xyt[:, :2], np.zeros(len(xyt)))), orientations_quat_wxyz=quaternion
    )


def test_ate_after_rigid_alignment_is_evos(pair):
    metrics = pytest.importorskip("evo.core.metrics", reason="evo is not installed; it is the oracle here")
    truth, odometry = pair
    reference, estimate = as_evo(truth), as_evo(odometry)
    estimate.align(reference, correct_scale=False)
    ate = metrics.APE(metrics.PoseRelation.translation_part)
    ate.process_data((reference, estimate))
    own = absolute_errors(truth, aligned_rigidly(truth, odometry))
    np.testing.assert_allclose(own, ate.error, atol=1e-6)


def test_ate_from_the_same_start_is_evos(pair):
    metrics = pytest.importorskip("evo.core.metrics", reason="evo is not installed; it is the oracle here")
    truth, odometry = pair
    reference, estimate = as_evo(truth), as_evo(odometry)
    estimate.align_origin(reference)
    ate = metrics.APE(metrics.PoseRelation.translation_part)
    ate.process_data((reference, estimate))
    own = absolute_errors(truth, aligned_at_origin(truth, odometry))
    np.testing.assert_allclose(own, ate.error, atol=1e-6)


@pytest.mark.parametrize("delta_m", [0.5, 1.0, 5.0])
def test_rpe_is_evos(pair, delta_m):
    metrics = pytest.importorskip("evo.core.metrics", reason="evo is not installed; it is the oracle here")
    from evo.core.units import Unit

    truth, odometry = pair
    both = as_evo(truth), as_evo(odometry)
    own = relative_errors(truth, odometry, delta_m)
    for relation, errors in (
        (metrics.PoseRelation.translation_part, own.translation_m),
        (metrics.PoseRelation.rotation_angle_rad, own.rotation_rad),
    ):
        rpe = metrics.RPE(relation, delta=delta_m, delta_unit=Unit.meters)
        rpe.process_data(both)
        assert len(errors) > 5
        np.testing.assert_allclose(errors, rpe.error, atol=1e-6)


def test_alignment_never_helps_the_other_way_and_finds_a_rigid_motion_exactly():
    truth = accumulate(np.zeros(3), wander(4, 60.0))
    moved = compose(np.array([5.0, -3.0, 2.0]), truth)
    np.testing.assert_allclose(aligned_rigidly(truth, moved)[:, :2], truth[:, :2], atol=1e-9)
    mirrored = truth * np.array([1.0, -1.0, -1.0])
    assert absolute_errors(truth, aligned_rigidly(truth, mirrored)).max() > 0.5


def test_a_recording_is_compared_at_the_truths_stamps():
    steps = wander(5, 60.0)
    run = recording(steps, noisy_path(steps, Coefficients(0.05, 0.02, 0.05, 0.01), 5), truth_mm=0.0, truth_rad=0.0)
    errors = trajectory_error([run])
    truth, odometry = run.truth.xyt, run.odometry.xyt
    assert errors.ate_origin_m == pytest.approx(
        np.sqrt(np.mean(absolute_errors(truth, aligned_at_origin(truth, odometry)) ** 2)), rel=1e-9
    )
    assert errors.ate_m < errors.ate_origin_m
