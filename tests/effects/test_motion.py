"""Effects of acceleration, and of iron near a compass."""

import numpy as np
import pytest
from drives import error_in_any_cut
from manoeuvres import motion
from scipy.integrate import solve_ivp

from odomcorrupt.corruption.path import NoisyPath
from odomcorrupt.effects import effect_from_values
from odomcorrupt.effects.compensation import corrected_increments, error_of
from odomcorrupt.effects.expression import user_effect
from odomcorrupt.effects.heading_sensors import HardIron
from odomcorrupt.errors import EffectError
from odomcorrupt.geometry.motion import TRAIL_S, accelerations, motion_of
from odomcorrupt.geometry.se2 import Increments, accumulate
from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.model.motion_model import MotionModel, Noise
from odomcorrupt.model.noise_laws import Coefficients
from odomcorrupt.study.estimate.problem import undo
from odomcorrupt.study.io.recording import Recording

SILENT = Noise("diffusion", Coefficients(0, 0, 0, 0))


def ramp(rate_hz, jitter=0.0):
    """Return stamps and poses of a robot that speeds up at 1 m/s^2 for a second, from rest."""
    t = np.arange(round(3.0 * rate_hz)) / rate_hz
    t = t + jitter / rate_hz * np.random.default_rng(1).uniform(-1.0, 1.0, len(t))
    moving = np.clip(t - 1.0, 0.0, 1.0)
    x = 0.5 * moving**2 + np.maximum(t - 2.0, 0.0)
    return t, np.column_stack((x, np.zeros_like(x), np.zeros_like(x)))


@pytest.mark.parametrize("rate_hz", [20.0, 50.0, 200.0, 1000.0])
def test_acceleration_is_that_of_a_ramp_half_a_trail_late(rate_hz):
    t, poses = ramp(rate_hz)
    motion = motion_of(t, poses)
    inside = (motion.t_s > 1.0 + 2.0 * TRAIL_S) & (motion.t_s < 2.0)
    assert motion.a[inside] == pytest.approx(np.full(inside.sum(), 1.0), abs=1e-6)
    begin = motion.t_s[np.argmax(motion.a > 0.5)]
    assert begin == pytest.approx(1.0 + TRAIL_S / 2.0, abs=2.0 / rate_hz)


@pytest.mark.parametrize("jitter", [0.0, 0.3, 0.49])
def test_over_a_run_it_adds_up_to_the_change_of_speed(jitter):
    t, poses = ramp(100.0, jitter)
    motion = motion_of(t, poses)
    assert np.sum(motion.a * motion.dt_s) == pytest.approx(1.0, abs=1e-9)


def test_bunched_stamps_do_not_make_it_huge():
    """Two messages a microsecond apart: the speed between them means nothing, its change over a trail does."""
    t, poses = ramp(100.0)
    t[120] = t[119] + 1e-6
    motion = motion_of(t, poses)
    assert np.abs(np.cumsum(motion.a * motion.dt_s)).max() < 1.3


def test_any_cut_gives_the_same_bits():
    rng = np.random.default_rng(4)
    twist, dt = rng.normal(size=(500, 3)), rng.uniform(0.0, 0.04, 500)
    dt[[0, 1, 90, 300]] = 0.0
    whole = accelerations(twist, dt)
    for size in (1, 3, 64):
        memory, parts = None, []
        for i in range(0, 500, size):
            part = accelerations(twist[i : i + size], dt[i : i + size], memory)
            memory = part.memory
            parts.append(part)
        assert np.array_equal(np.concatenate([p.rate for p in parts]), whole.rate)
        assert np.array_equal(np.concatenate([p.trail for p in parts]), whole.trail)
        assert np.array_equal(np.concatenate([p.before for p in parts]), whole.before)
    assert accelerations(twist[:0], dt[:0]).rate.shape == (0, 3)


def brisk(rate_hz=50.0):
    t = np.arange(round(40 * rate_hz)) / rate_hz
    v = np.interp(t % 8.0, [0, 1, 1.5, 3, 3.4, 4, 4.5, 6, 7, 8], [0, 0, 2, 2, 0, 0, -1.5, -1.5, 0, 0])
    omega = 0.8 * np.sin(0.7 * t)
    dt = 1.0 / rate_hz
    poses = accumulate(np.zeros(3), Increments(v[:-1] * dt, 0.0 * v[:-1], omega[:-1] * dt))
    return 10**11 + np.round(t * 1e9).astype(np.int64), poses


def there_and_back(effects, drive):
    stamps, poses = drive
    odometry = poses + NoisyPath(MotionModel(SILENT, effects, 0.4), 1).feed(stamps, poses).error_xyt
    motion = motion_of((stamps - stamps[0]) * 1e-9, odometry, track_m=0.4)
    return odometry, accumulate(odometry[0], corrected_increments(effects, motion))


@pytest.mark.slow
@pytest.mark.parametrize("rate_hz", [10.0, 50.0, 400.0])
@pytest.mark.parametrize("k", [0.02, 0.1])
def test_slip_of_any_strength_and_rate_is_put_in_and_taken_out(k, rate_hz):
    drive = brisk(rate_hz)
    odometry, back = there_and_back((effect_from_values("accel_slip", {"k": k}),), drive)
    assert np.abs(odometry - drive[1]).max() > 0.5 * k
    assert back == pytest.approx(drive[1], abs=1e-6)


LAWS = {
    "slides when braking": ("wheels += v * (k * max(-a * sign(v), 0))", 0.1),
    "slips backwards": ("along += k * a * abs(v)", 0.01),
    "switches itself off": ("yaw += omega * (k * where(alpha * sign(omega) > -0.03, 1, 0))", -0.1),
    "switches itself on": ("yaw += omega * (k * where(alpha * sign(omega) > -0.03, 1, 0))", 0.1),
    "has a sign": ("yaw += k * sign(alpha); along += k * v * (a > 0)", -0.05),
}


def rough(rate_hz):
    """Return a drive whose odometry trembles, so that accelerations cross their thresholds all the time."""
    stamps, poses = brisk(rate_hz)
    trembling = np.cumsum(np.random.default_rng(3).normal(size=poses.shape), axis=0)
    return stamps, poses + 1e-3 * np.sqrt(1.0 / rate_hz) * trembling


@pytest.mark.slow
@pytest.mark.parametrize("rate_hz", [10.0, 50.0, 200.0])
@pytest.mark.parametrize("law", LAWS)
def test_laws_of_acceleration_are_put_in_and_taken_out_and_the_other_way_round(law, rate_hz):
    text, k = LAWS[law]
    effects = (user_effect("law", text, {"k": k}),)
    stamps, poses = drive = rough(rate_hz)
    odometry, back = there_and_back(effects, drive)
    assert np.abs(odometry - poses).max() > 0.01
    assert back == pytest.approx(poses, abs=1e-9)
    motion = motion_of((stamps - stamps[0]) * 1e-9, poses, track_m=0.4)
    corrected = accumulate(poses[0], corrected_increments(effects, motion))
    again = corrected + NoisyPath(MotionModel(SILENT, effects, 0.4), 1).feed(stamps, corrected).error_xyt
    assert again == pytest.approx(poses, abs=1e-9)


@pytest.mark.parametrize("law", LAWS)
def test_laws_of_acceleration_do_not_depend_on_cuts(law):
    text, k = LAWS[law]
    model = MotionModel(SILENT, (user_effect("law", text, {"k": k}),), 0.4)
    stamps, poses = rough(50.0)
    error_in_any_cut(model, stamps, poses, 37)


def test_a_law_of_acceleration_is_taken_out_alike_by_a_correction_and_by_the_study():
    """The study takes accelerations from smooth motion, a correction from the steps themselves, a little late."""
    stamps, poses = brisk()
    effects = (user_effect("law", "wheels += v * (k * max(-a * sign(v), 0))", {"k": 0.05}),)
    odometry, back = there_and_back(effects, (stamps, poses))
    recording = Recording("drive", Trajectory(stamps, odometry), Trajectory(stamps, poses), int(stamps[0]), track_m=0.4)
    moved = np.abs(odometry - poses).max()
    assert np.abs(undo(recording, effects).odometry.xyt - back).max() < 0.06 * moved


def test_everything_at_once_is_put_in_and_taken_out():
    names = {
        "accel_slip": {"k": 0.06}, "backlash": {"travel": 0.01}, "slope": {"creep": 0.05, "direction": 2.0},
        "region_slip": {"slip": 0.1, "x": 3.0, "radius": 2.0}, "wheelbase": {"e": 0.1}, "speed_scale": {"k": 0.03},
        "scale_drift": {"rate": 1e-4}, "turn_asymmetry": {"k": 0.05}, "side_slip": {"k": 0.1},
        "unequal_wheels": {"curvature": 0.05}, "gyro_bias": {"bias": 0.02},
    }  # fmt: skip
    effects = tuple(effect_from_values(name, values) for name, values in names.items())
    drive = brisk()
    odometry, back = there_and_back(effects, drive)
    assert np.abs(odometry - drive[1]).max() > 0.5
    assert back == pytest.approx(drive[1], abs=1e-6)
    mixed, _ = there_and_back(effects[::-1], drive)
    assert np.array_equal(mixed, odometry)


def test_true_poses_may_be_given_to_a_correction():
    stamps, poses = brisk()
    slope = effect_from_values("slope", {"creep": 0.05, "direction": 2.0})
    odometry, _ = there_and_back((slope,), (stamps, poses))
    turned = odometry + np.array([5.0, -3.0, 0.0])
    motion = motion_of((stamps - stamps[0]) * 1e-9, turned)
    back = accumulate(turned[0], corrected_increments([slope], motion, place_xyt=poses[:-1]))
    assert back - np.array([5.0, -3.0, 0.0]) == pytest.approx(poses, abs=1e-9)


def test_an_effect_that_acts_against_its_acceleration_cannot_be_taken_out():
    stamps, poses = brisk()
    runaway = user_effect("runaway", "along += k * a", {"k": 0.5})
    motion = motion_of((stamps - stamps[0]) * 1e-9, poses)
    with pytest.raises(EffectError, match=r"cannot be taken out.*weaker"):
        corrected_increments([runaway], motion)


K, M, RATE_HZ = 0.1, -0.06, 50.0


def deflected(effect, omega):
    """Return the time (n,) at the end of each interval, and the heading's error there, of a robot that turns so."""
    drive = motion(0.0 * omega, omega, seconds=len(omega) / RATE_HZ)
    return np.cumsum(drive.dt_s), -np.cumsum(error_of(effect, drive)[:, 2] * drive.dt_s)


@pytest.mark.parametrize("tau", [0.5, 3.0])
def test_the_error_solves_the_equation_of_a_low_pass_filter(tau):
    omega = np.where(np.arange(1500) < 500, 0.7, np.where(np.arange(1500) < 800, 0.0, -1.1))
    t_s, error = deflected(HardIron(k=K, m=M, time_constant=tau), omega)
    begins_s, theta = np.append(0.0, t_s), np.append(0.0, np.cumsum(omega)) / RATE_HZ

    def change(t, d):
        heading = np.interp(t, begins_s, theta)
        return (K * np.cos(heading) + M * np.sin(heading) - d) / tau

    exact = solve_ivp(change, (0.0, t_s[-1]), [K], t_eval=t_s, max_step=0.02, rtol=1e-8, atol=1e-10).y[0]
    # the headings are those at the begin of an interval
    assert error == pytest.approx(exact - K, abs=0.13 / RATE_HZ / tau)


def test_without_a_filter_the_error_is_a_wave_over_the_heading():
    omega = np.append(np.full(500, 0.5), 0.0)
    _, error = deflected(HardIron(k=K, m=M), omega)
    assert error[-1] == pytest.approx(K * (np.cos(5.0) - 1.0) + M * np.sin(5.0), abs=1e-9)
