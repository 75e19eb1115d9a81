"""A marker anywhere on the robot, at any angle, moves with the robot's true turns."""

from dataclasses import replace

import numpy as np
import pytest
from wandering import noisy_path, recording, wander

from odomcorrupt.geometry.se2 import Increments, accumulate, compose
from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.model.noise_laws import Coefficients
from odomcorrupt.study.select.selection import learn

CURVATURE = -0.02


@pytest.mark.slow
@pytest.mark.parametrize("yaw", [0.0, np.pi / 3])
def test_a_far_marker_on_a_robot_that_bends_is_where_it_is_and_nothing_besides(yaw):
    # breaks where the lever is multiplied by the odometry's turn: lever times bend are then a scale and a mounting
    reported = wander(701, 300.0)
    driven = Increments(reported.ds_m, reported.dl_m, reported.dtheta_rad + CURVATURE * reported.ds_m)
    run = recording(driven, noisy_path(reported, Coefficients(0.01, 0.01, 0.01, 0.005), 701), seed=701)
    rng = np.random.default_rng(701)
    marker = compose(accumulate(np.zeros(3), driven), np.array([0.3, -0.25, yaw]))
    marker = marker + rng.standard_normal(marker.shape) * [1e-3, 1e-3, 2e-3]
    learned = learn([replace(run, truth=Trajectory(run.truth.stamps_ns, marker))])
    found = {effect.name: effect for effect in learned.fit.effects}
    assert set(found) == {"lever_arm", "unequal_wheels"} | ({"mount_yaw"} if yaw else set())
    assert (found["lever_arm"].x, found["lever_arm"].y) == pytest.approx((0.3, -0.25), abs=0.002)
    assert found["unequal_wheels"].curvature == pytest.approx(CURVATURE, abs=0.002)
    assert not yaw or found["mount_yaw"].yaw == pytest.approx(yaw, abs=0.002)
