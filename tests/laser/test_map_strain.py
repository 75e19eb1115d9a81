"""The map of a laser may be stretched or sheared: random terms of the noise, and no dependence on heading."""

from __future__ import annotations

import numpy as np
import pytest
import raycaster

from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.study.estimate.config import Approach
from odomcorrupt.study.estimate.problem import pose_problem
from odomcorrupt.study.estimate.truth_bias import SCAN_SCALE, SHARED, bias_roots
from odomcorrupt.study.io.recording import Recording


@pytest.mark.parametrize(("column", "strain"), [(0, [[1.0, 0.0], [0.0, -1.0]]), (1, [[0.0, 1.0], [1.0, 0.0]])])
def test_a_strained_map_has_the_residuals_of_its_column(column, strain):
    t_s, path, _, _ = raycaster.path()
    stamps = np.round(t_s * 1e9).astype(np.int64)
    strained = path.copy()
    strained[:, :2] += SCAN_SCALE * path[:, :2] @ np.array(strain)
    truth = Trajectory(stamps, strained, covariance=np.tile(np.eye(3), (len(path), 1, 1)))
    problem = pose_problem([Recording("run", Trajectory(stamps, path), truth, 0)], approach=Approach())
    own = bias_roots(problem)[:, :, SHARED + column]
    assert np.abs(own).max() > 1e-4
    assert problem.intervals.residual == pytest.approx(own, abs=0.02 * np.abs(own).max())
