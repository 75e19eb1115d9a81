"""The motion of the regressors is the odometry's where a truth is too slow to show what the odometry does."""

import numpy as np
from scipy.ndimage import gaussian_filter1d

from odomcorrupt.geometry.increments import Increments, accumulate
from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.study.estimate.regressors import choose_side
from odomcorrupt.study.io.recording import Recording


def test_turns_that_change_between_two_sweeps_of_a_laser_are_no_noise_of_exact_odometry():
    rng = np.random.default_rng(3)
    t_s = np.arange(0.0, 300.0, 0.02)
    swerve = gaussian_filter1d(rng.normal(size=len(t_s) - 1), 0.16 / 0.02)
    rate_radps = 0.5 * np.sin(0.3 * t_s[1:]) + 0.5 * swerve / swerve.std()
    step = np.full(len(rate_radps), 0.01)
    xyt = accumulate(np.zeros(3), Increments(step, 0.0 * step, 0.02 * rate_radps))
    odometry = Trajectory(np.round(1e9 * t_s).astype(np.int64), xyt)
    sweeps_s, deviation = np.arange(0.13, 299.0, 0.2), np.array([0.002, 0.002, 0.0006])
    poses = odometry.at(sweeps_s, 0) + deviation * rng.standard_normal((len(sweeps_s), 3))
    covariance = np.tile(np.diag(deviation**2), (len(sweeps_s), 1, 1))
    truth = Trajectory(np.round(1e9 * sweeps_s).astype(np.int64), poses, covariance)
    assert choose_side(Recording("swerves", odometry, truth, 0), 0.5) == "odometry"
