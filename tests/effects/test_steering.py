"""Play and lag of a steering linkage: in tight curves, at limits, and under noise of the path."""

import numpy as np
import pytest
from manoeuvres import motion

from odomcorrupt.effects.steering import SteeringLag, SteeringPlay

RATE_HZ, SECONDS, SPEED_MPS = 50.0, 60.0, 2.0
PLAY, AXLES_M = 0.02, 1.65


def steered_path(rad_per_root_m=0.0, top=0.2):
    """Return increments (n, 3) and ends (n,), s, of a path that steers to both sides, with noise of its heading."""
    t_s = np.arange(1, int(SECONDS * RATE_HZ) + 1) / RATE_HZ
    way = np.full(len(t_s), SPEED_MPS / RATE_HZ)
    turn = way * top * np.sin(0.5 * t_s)
    noise = rad_per_root_m * np.sqrt(way) * np.random.default_rng(1).standard_normal(len(way))
    return np.stack((way, np.zeros_like(way), turn + noise), axis=1), t_s


def added(effect, steps, t_s):
    """Return the turn (n,), rad, that corruption adds so far."""
    start = effect.start(np.random.default_rng(0))
    return np.cumsum(effect.recorded(steps, t_s, None, start).steps[:, 2] - steps[:, 2])


def test_play_is_one_of_the_steering_angle():
    steps, t_s = steered_path()
    effect = SteeringPlay(play=PLAY, axles=AXLES_M)
    reported = effect.recorded(steps, t_s, None, effect.start(np.random.default_rng(0))).steps
    angles = [np.arctan(AXLES_M * path[:, 2] / path[:, 0]) for path in (steps, reported)]
    assert np.abs(angles[1] - angles[0])[1:] == pytest.approx(0.5 * AXLES_M * PLAY)
    assert np.ptp(np.abs(reported[1:, 2] - steps[1:, 2])) > 0.05 * 0.5 * PLAY * steps[0, 0]


def test_noise_of_the_path_does_not_remove_the_play():
    # breaks where the noise of single intervals crosses the play: its path drifted by a tenth
    effect = SteeringPlay(play=PLAY, axles=AXLES_M)
    drift = np.ptp(added(effect, *steered_path()))
    noisy = np.ptp(added(effect, *steered_path(0.0008)))
    assert noisy == pytest.approx(drift, rel=0.1)


@pytest.mark.parametrize("axles", [0.0, AXLES_M])
@pytest.mark.parametrize("rad_per_root_m", [0.0, 0.0008, 0.003])
def test_correction_follows_the_linkage_of_corruption_under_noise(axles, rad_per_root_m):
    effect = SteeringPlay(play=PLAY, axles=axles)
    steps, t_s = steered_path(rad_per_root_m)
    reported = effect.recorded(steps, t_s, None, effect.start(np.random.default_rng(0))).steps
    seen = motion(reported[:, 0] * RATE_HZ, reported[:, 2] * RATE_HZ, seconds=SECONDS)
    f = effect.twist_error(seen, effect.start(np.random.default_rng(0))).f[:, 2]
    left = np.cumsum(reported[:, 2] + f / RATE_HZ - steps[:, 2])
    assert np.ptp(left[int(RATE_HZ) * 10 :]) < 1e-9


@pytest.mark.parametrize("phase", range(0, 20, 4))
def test_a_reversal_between_two_samples_crosses_the_play(phase):
    # breaks where the angle at the reversal is what a sample shows: the linkage stayed in its play on a long straight
    fine = int(1000.0 / RATE_HZ)
    t_s = (np.arange(int(SECONDS) * 1000) - phase) / 1000.0
    wheels = np.interp(t_s, [0.0, 1.0, 5.0, 5.5, 5.55], [0.0, -0.2, -0.2, 0.001, 0.0])
    sensor = wheels + 0.5 * PLAY * np.where((t_s > 5.0) & (t_s < 5.5), 1.0, -1.0)
    curvature = sensor.reshape(-1, fine).mean(axis=1)
    v = np.full(len(curvature), SPEED_MPS)
    f = SteeringPlay(play=PLAY).twist_error(motion(v, v * curvature, seconds=SECONDS), SteeringPlay().start(None)).f
    assert np.abs(curvature + f[:, 2] / v)[int(10.0 * RATE_HZ) :].max() < 0.1 * PLAY


@pytest.mark.parametrize(
    ("limits", "largest_rate", "largest_lag"), [({"rate": 0.05}, 0.05, np.inf), ({"stop": 0.012}, np.inf, 0.012)]
)
def test_wheels_turn_no_faster_than_their_rate_and_lag_no_further_than_their_stop(limits, largest_rate, largest_lag):
    steps, _ = steered_path()
    seen = motion(steps[:, 0] * RATE_HZ, steps[:, 2] * RATE_HZ, seconds=SECONDS)
    for effect in (SteeringLag(tau=0.2), SteeringLag(tau=0.2, **limits)):
        f = effect.twist_error(seen, effect.start(np.random.default_rng(0))).f[:, 2]
        wheels, lag = (seen.omega + f) / seen.v, np.abs(f / seen.v)
        rate = np.abs(np.diff(wheels)) * RATE_HZ
        within = rate.max() <= largest_rate + 1e-9 and lag.max() <= largest_lag + 1e-9
        assert within == (effect.rate + effect.stop > 0.0)


def test_limits_of_large_angles_are_those_of_the_angle_and_not_of_its_tangent():
    # breaks where the curvature is limited: at 30 degrees it changes by a third more than the angle
    steps, _ = steered_path(top=0.35)
    seen = motion(steps[:, 0] * RATE_HZ, steps[:, 2] * RATE_HZ, seconds=SECONDS)
    effect = SteeringLag(tau=0.2, stop=0.005, axles=AXLES_M)
    f = effect.twist_error(seen, effect.start(None)).f[:, 2]
    shown, wheels = (np.arctan(AXLES_M * turn / seen.v) / AXLES_M for turn in (seen.omega, seen.omega + f))
    assert np.abs(wheels - shown).max() == pytest.approx(0.005)
    limited = np.isclose(np.abs(wheels - shown), 0.005)
    assert np.ptp(np.abs(f / seen.v)[limited]) > 0.2 * 0.005


@pytest.mark.parametrize("limits", [{}, {"rate": 0.15}, {"stop": 0.012}, {"stop": 0.012, "axles": AXLES_M}])
def test_correction_takes_out_the_lag_of_corruption(limits):
    effect = SteeringLag(tau=0.2, **limits)
    steps, t_s = steered_path()
    reported = effect.recorded(steps, t_s, None, effect.start(np.random.default_rng(0))).steps
    assert np.ptp(np.cumsum(reported[:, 2] - steps[:, 2])) > 0.01
    seen = motion(reported[:, 0] * RATE_HZ, reported[:, 2] * RATE_HZ, seconds=SECONDS)
    f = effect.twist_error(seen, effect.start(np.random.default_rng(0))).f[:, 2]
    assert np.abs(np.cumsum(reported[:, 2] + f / RATE_HZ - steps[:, 2])).max() < 1e-9


@pytest.mark.parametrize(("sigma_m", "sigma_rad"), [(0.0, 0.0), (0.002, 0.003), (0.02, 0.009)])
def test_noise_of_the_path_becomes_no_drift_beside_the_lag(sigma_m, sigma_rad):
    # breaks where noisy curvatures are differentiated: the heading drifted by 8 to 25 times the error of the lag
    rng, hz = np.random.default_rng(1), 10.0 if sigma_m > 0.01 else RATE_HZ
    t_s = np.arange(1, int(SECONDS * hz) + 1) / hz
    v = 0.8 * np.clip(2.0 * np.sin(0.2 * t_s), -0.5, 1.0)  # forth, back, and hardly moving between
    steps = np.stack((v / hz, np.zeros_like(v), 0.6 * np.sin(0.9 * t_s) * v / hz), axis=1)
    shaken = rng.standard_normal((len(v) + 1, 3)) * [sigma_m, sigma_m, sigma_rad]
    effect = SteeringLag(tau=0.15)
    exact, noisy = added(effect, steps, t_s), added(effect, steps + np.diff(shaken, axis=0), t_s)
    assert np.std(noisy - exact) < 2.0 * np.std(exact)


def test_wheels_follow_while_a_car_creeps():
    # breaks where the angle is unknown below 0.05 m/s: wheels were where they were before the car slowed down
    t_s = np.arange(1, int(SECONDS * RATE_HZ) + 1) / RATE_HZ
    v = 0.02 + 0.5 * (np.sin(0.5 * t_s) > 0.0)
    steps = np.stack((v, np.zeros_like(v), 0.4 * np.sin(0.9 * t_s) * v), axis=1) / RATE_HZ
    effect = SteeringLag(tau=0.15)
    reported = effect.recorded(steps, t_s, None, effect.start(None)).steps
    seen = motion(v, reported[:, 2] * RATE_HZ, seconds=SECONDS)
    f = effect.twist_error(seen, effect.start(None)).f[:, 2]
    slow = v < 0.05
    assert np.abs(f[slow]).max() > 0.1 * 0.15 * 0.4 * 0.9 * 0.02
    assert np.abs(np.cumsum(reported[:, 2] + f / RATE_HZ - steps[:, 2])).max() < 1e-9
