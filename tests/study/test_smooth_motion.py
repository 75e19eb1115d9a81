"""The motion of the regressors is that of the side whose noise biases them less."""

import numpy as np
from scipy.ndimage import gaussian_filter1d

from odomcorrupt.geometry.se2 import Increments, accumulate
from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.study.estimate.regressors import choose_side, driving_motion
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


def test_jitter_of_encoders_is_no_regressor_beside_a_truth_whose_noise_smoothing_removes():
    """The truth is noisier than the odometry from step to step, but its noise is white: 100 poses a second average."""
    rng = np.random.default_rng(4)
    t_s = np.arange(0.0, 300.0, 0.02)
    rate_radps = 0.6 * np.sin(0.3 * t_s[1:])
    step = np.full(len(rate_radps), 0.008)
    still = 0.0 * step
    jitter = 8e-3 * np.sqrt(0.02) * rng.standard_normal(len(step))
    stamps = np.round(1e9 * t_s).astype(np.int64)
    true = Trajectory(stamps, accumulate(np.zeros(3), Increments(step, still, 0.02 * rate_radps)))
    smooth, rough = (
        Trajectory(stamps, accumulate(np.zeros(3), Increments(step, still, 0.02 * rate_radps + j)))
        for j in (0.0, jitter)
    )
    seen_s = np.arange(0.1037, 299.0, 0.01)
    poses = true.at(seen_s, 0) + np.array([0.001, 0.001, 0.002]) * rng.standard_normal((len(seen_s), 3))
    truth = Trajectory(np.round(1e9 * seen_s).astype(np.int64), poses)
    assert choose_side(Recording("rough", rough, truth, 0), 0.5) == "truth"
    assert choose_side(Recording("smooth", smooth, truth, 0), 0.5) == "odometry"


def test_places_are_those_where_intervals_begin():
    t_s = np.arange(500) / 25.0
    xyt = np.stack((0.3 * t_s, np.zeros_like(t_s), np.zeros_like(t_s)), axis=1)
    path = Trajectory((1e9 * t_s).astype(np.int64), xyt)
    motion = driving_motion(Recording("drive", path, path, 0), "odometry")
    assert np.abs(motion.x - xyt[:-1, 0]).max() < 1e-9


def test_starts_and_stops_are_no_noise_of_the_odometry():
    """Most of a drive is straight at constant speed, so that starts, stops and turns are far rougher than the rest."""
    rng = np.random.default_rng(6)
    t_s = np.arange(0.0, 300.0, 0.02)
    phase_s = t_s[1:] % 14.0
    ramp = np.ones(75) / 75
    speed_mps = np.convolve(np.where(phase_s < 10.0, 0.3, 0.0), ramp, "same")
    rate_radps = np.convolve(np.where((phase_s > 9.5) & (phase_s < 13.5), 0.1, 0.0), ramp, "same")
    moved = speed_mps + rate_radps > 1e-3
    still = 0.0 * speed_mps
    noise = 1e-3 * np.sqrt(0.02) * moved * rng.standard_normal((2, len(still)))
    step, turn = 0.02 * speed_mps + 0.2 * noise[0], 0.02 * rate_radps + noise[1]
    stamps = np.round(1e9 * t_s).astype(np.int64)
    odometry = Trajectory(stamps, accumulate(np.zeros(3), Increments(step, still, turn)))
    seen_s = np.arange(0.1037, 299.0, 0.01)
    poses = odometry.at(seen_s, 0) + np.array([0.002, 0.002, 0.0035]) * rng.standard_normal((len(seen_s), 3))
    truth = Trajectory(np.round(1e9 * seen_s).astype(np.int64), poses)
    assert choose_side(Recording("exact", odometry, truth, 0), 0.5) == "odometry"
