"""A lasting step between odometry and a localisation is found with its time and size; jumps that return are not."""

from dataclasses import replace

import numpy as np
import pytest
from wandering import noisy_path, recording, wander

from odomcorrupt.geometry.se2 import Increments, accumulate
from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.model.noise_laws import Coefficients
from odomcorrupt.study.estimate.config import Approach
from odomcorrupt.study.estimate.correlation_length import with_pose_steps
from odomcorrupt.study.estimate.gauss_newton import fit
from odomcorrupt.study.estimate.intervals import intervals_of
from odomcorrupt.study.estimate.outliers import single_events

PUSHED_S = 200.0


def localised(seed, *, pushed_m=0.0, turned_rad=0.0, jump_m=0.0):
    """Return a recording with poses of a localisation at 1.25 Hz, correlated errors, and a push or a jump."""
    steps = wander(seed, 420.0)
    run = recording(steps, noisy_path(steps, Coefficients(0.003, 0.003, 0.003, 0.001), seed), seed=seed)
    travel = steps.ds_m.copy()
    turn = steps.dtheta_rad.copy()
    travel[round(50 * PUSHED_S) : round(50 * PUSHED_S) + 75] += pushed_m / 75.0
    turn[round(50 * PUSHED_S) : round(50 * PUSHED_S) + 75] += turned_rad / 75.0
    true = accumulate(np.zeros(3), Increments(travel, steps.dl_m, turn))[::40]
    rng = np.random.default_rng(seed)
    errors = np.zeros_like(true)
    for i in range(1, len(true)):
        errors[i] = 0.8 * errors[i - 1] + 0.6 * rng.normal(0.0, [0.025, 0.025, 0.01])
    jumps = (np.arange(len(true)) >= 250) & (np.arange(len(true)) < 256)
    errors[jumps, 0] += jump_m
    return replace(run, truth=Trajectory(run.odometry.stamps_ns[::40], true + errors), localised=True)


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "pushed_m"), [(0, 0.6), (1, -0.6), (2, 0.25)])
def test_a_push_is_found_with_time_and_size_and_no_interval_contains_it(seed, pushed_m):
    run = with_pose_steps(localised(seed, pushed_m=pushed_m))
    (step,) = run.pose_steps
    assert PUSHED_S - 2.0 < step.start_s < step.end_s < PUSHED_S + 4.0
    assert np.hypot(*step.apart[:2]) == pytest.approx(abs(pushed_m), abs=0.12)
    assert step.apart[2] == pytest.approx(0.0, abs=0.04)
    intervals = intervals_of(run, 2.0)
    assert not np.any((intervals.start_s < step.end_s) & (intervals.end_s > step.start_s))
    assert np.abs(intervals.residual[:, :2]).max() < 0.3


@pytest.mark.slow
@pytest.mark.parametrize("turned_rad", [0.4, -0.4])
def test_a_robot_that_is_turned_is_not_moved_far(turned_rad):
    """The step is described where it happened; seconds before, a turn is a displacement of metres."""
    (step,) = with_pose_steps(localised(0, turned_rad=turned_rad)).pose_steps
    assert step.apart[2] == pytest.approx(turned_rad, abs=0.05)
    assert np.hypot(*step.apart[:2]) < 0.3


@pytest.mark.slow
def test_a_jump_of_the_localisation_shortly_before_a_push_is_no_part_of_it():
    run = localised(0, pushed_m=0.6)
    truth = run.truth.xyt.copy()
    truth[247:250, :2] += 0.4
    jumped = with_pose_steps(replace(run, truth=Trajectory(run.truth.stamps_ns, truth)))
    (event,) = single_events(fit([jumped], approach=Approach(spacing_s=2.0)))
    assert PUSHED_S - 2.0 < event.start_s < event.end_s < PUSHED_S + 4.0
    assert np.hypot(event.along_m, event.across_m) == pytest.approx(0.6, abs=0.12)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("jump_m", [0.0, 0.3])
def test_errors_of_the_localisation_are_no_steps(seed, jump_m):
    assert with_pose_steps(localised(seed, jump_m=jump_m)).pose_steps == ()


def test_simulated_odometry_that_equals_its_localisation_has_no_step():
    run = localised(3)
    truth = Trajectory(run.odometry.stamps_ns[::40], run.odometry.xyt[::40])
    assert with_pose_steps(replace(run, truth=truth)).pose_steps == ()
