"""Systematic effects against textbook formulas: gains, lags, events and steering."""

import json
from dataclasses import replace

import numpy as np
import pytest
from drives import error_in_any_cut
from manoeuvres import motion
from scipy.integrate import solve_ivp

from odomcorrupt.cli import run
from odomcorrupt.corruption.path import NoisyPath
from odomcorrupt.effects import effect_from_values, registry
from odomcorrupt.effects.compensation import corrected_increments, error_of
from odomcorrupt.effects.expression import user_effect
from odomcorrupt.effects.heading_sensors import HardIron
from odomcorrupt.effects.steering import SteeringLag, SteeringPlay
from odomcorrupt.errors import EffectError
from odomcorrupt.geometry.motion import TRAIL_S, accelerations, motion_of
from odomcorrupt.geometry.se2 import Increments, accumulate, between
from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.model.motion_model import MotionModel, Noise
from odomcorrupt.model.noise_laws import Coefficients
from odomcorrupt.study.estimate.problem import undo
from odomcorrupt.study.io.recording import Recording
from recordings import OFFICE

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


def lagging(tau, omega, rate_hz, by="filter", channel="yaw"):
    """Return times, the clean poses of a robot that turns so, and those that its lagging odometry reports."""
    n = len(omega)
    clean = accumulate(np.zeros(3), Increments(np.full(n, 0.5 / rate_hz), np.zeros(n), omega / rate_hz))
    stamps = 10**12 + np.round(np.arange(n + 1) * 1e9 / rate_hz).astype(np.int64)
    effect = effect_from_values("channel_lag", {"tau": tau, "by": by, "channel": channel})
    reported = clean + NoisyPath(MotionModel(SILENT, (effect,)), 1).feed(stamps, clean).error_xyt
    return (stamps - stamps[0]) * 1e-9, clean, reported, effect


@pytest.mark.parametrize("rate_hz", [10.0, 50.0, 200.0])
def test_a_step_of_the_yaw_rate_is_reported_late_by_tau(rate_hz):
    """The heading that a first-order lag owes after a step is tau times the step: the textbook's ramp error."""
    omega = np.where(np.arange(int(10 * rate_hz)) < 2 * rate_hz, 0.0, 0.8)
    _, clean, reported, _ = lagging(0.2, omega, rate_hz)
    assert (clean - reported)[-1, 2] == pytest.approx(0.2 * 0.8, rel=1e-3)
    after = int(2.2 * rate_hz) + 1
    # one time constant after the step 1 - 1/e of it is reported, within the window that speeds are averaged over
    rate = np.diff(reported[:, 2])[after - 1] * rate_hz
    assert rate == pytest.approx(0.8 * (1.0 - np.exp(-1.0)), abs=0.12)


@pytest.mark.parametrize("channel", ["yaw", "all"])
def test_any_lag_is_stable_to_put_in_and_taken_out_again(channel):
    omega = np.sin(np.arange(2000) * 0.01) + np.where(np.arange(2000) % 300 < 150, 0.5, -0.5)
    for tau in (0.02, 0.3, 1.0):
        t_s, clean, reported, effect = lagging(tau, omega, 50.0, channel=channel)
        back = accumulate(reported[0], corrected_increments([effect], motion_of(t_s, reported)))
        assert back == pytest.approx(clean, abs=1e-9)


@pytest.mark.parametrize("of_increments", [True, False])
def test_a_filter_updated_once_per_message_is_taken_out_at_jittered_stamps(of_increments):
    """Whether it acts on increments at an even rate or on speeds: y = y' + (x - y') / (1 + tau / dt)."""
    rng, n, tau, usual = np.random.default_rng(1), 3000, 0.2, 0.02
    dt = usual * (1.0 + 0.02 * rng.standard_normal(n))
    dt += usual - np.median(dt)
    shown = np.sin(np.cumsum(dt)) * (np.ones(n) if of_increments else dt / usual)  # increments, in usual intervals
    per = np.full(n, usual) if of_increments else dt
    filtered = [shown[0] * usual / per[0]]
    for x, d in zip(shown[1:] * usual / per[1:], per[1:], strict=True):
        filtered.append(filtered[-1] + (x - filtered[-1]) * d / (d + tau))
    turned = np.array(filtered) * per
    xyt = accumulate(np.zeros(3), Increments(dt, 0.0 * dt, turned))
    motion = motion_of(np.concatenate(([0.0], np.cumsum(dt))), xyt)
    lag = effect_from_values("channel_lag", {"tau": tau, "channel": "yaw"})
    assert np.cumsum(lag.restored(motion).omega * dt) == pytest.approx(np.cumsum(shown * usual), abs=1e-9)


@pytest.mark.parametrize("rate_hz", [20.0, 50.0, 97.0])
def test_a_delay_reports_the_very_same_turns_later(rate_hz):
    delay_s, n = 0.13, int(20 * rate_hz)
    t_s = np.arange(n) / rate_hz
    omega = np.where(t_s < 2.0, 0.3, 0.3 + np.sin(t_s - 2.0))
    at_s, clean, reported, effect = lagging(delay_s, omega, rate_hz, by="delay")
    turned = np.interp(at_s - delay_s, at_s, np.cumsum(np.append(0.0, omega / rate_hz)), left=-0.3 * delay_s)
    late = at_s > delay_s
    assert reported[late, 2] == pytest.approx(turned[late] + 0.3 * delay_s, abs=1e-8)
    back = accumulate(reported[0], corrected_increments([effect], motion_of(at_s, reported)))
    seen = at_s < at_s[-1] - delay_s
    assert back[seen] == pytest.approx(clean[seen], abs=0.5 / rate_hz**2)


def test_a_delay_is_taken_out_where_a_filter_is_not():
    omega = np.where(np.arange(3000) % 100 < 50, 0.9, -0.9)
    t_s, clean, reported, delay = lagging(0.1, omega, 50.0, by="delay")
    motion = motion_of(t_s, reported)
    off = {
        effect.by: np.abs(accumulate(reported[0], corrected_increments([effect], motion)) - clean)[:-6].max()
        for effect in (delay, replace(delay, by="filter"))
    }
    assert off["delay"] < 1e-9
    assert off["filter"] > 0.01


EVENTS = [name for name, kind in registry().items() if kind.kind == "event"]
N = 1001
STAMPS = 10**18 + np.arange(N) * 20_000_000
T_S = np.arange(N) * 0.02


def clean_path():
    return accumulate(np.array([1.0, 2.0, 0.5]), Increments(*(np.full(N - 1, each) for each in (0.01, 0.0, 0.004))))


def corrupted(name, values, track=0.4):
    model = MotionModel(Noise("diffusion", Coefficients(0, 0, 0, 0)), (effect_from_values(name, values),), track)
    return clean_path() + NoisyPath(model, 1).feed(STAMPS, clean_path()).error_xyt


def at(t_s):
    return int(np.searchsorted(T_S, t_s - 1e-9))


def test_there_are_four():
    assert EVENTS == ["latency", "odometry_stop", "push", "slip_event"]


@pytest.mark.parametrize(("name", "size"), [("push", "along"), ("slip_event", "slip"), ("odometry_stop", "duration")])
def test_nothing_happens_before_it_and_the_motion_is_right_after_it(name, size):
    values = {size: 0.3, "time": 4.0}
    begin, end = effect_from_values(name, values).window_s
    own = corrupted(name, values)
    assert np.array_equal(own[: at(begin)], clean_path()[: at(begin)])
    clean, after = clean_path()[at(end) + 1 :], own[at(end) + 1 :]
    assert between(after[0], after[-1]) == pytest.approx(between(clean[0], clean[-1]), abs=1e-9)
    assert np.abs(own[-1, :2] - clean_path()[-1, :2]).max() > 0.01


def test_odometry_misses_a_push():
    own, clean = corrupted("push", {"yaw": 0.2, "time": 4.0, "duration": 0.5}), clean_path()
    missed = (own - clean)[-1, 2]
    assert missed == pytest.approx(-0.2, abs=1e-9)
    own = corrupted("push", {"along": 0.3, "time": 4.0, "duration": 0.5})
    assert np.hypot(*(own - clean)[-1, :2]) == pytest.approx(0.3, rel=1e-3)


def test_wheels_that_slip_overcount_for_as_long_as_they_slip():
    own = corrupted("slip_event", {"slip": 0.5, "time": 4.0, "duration": 2.0})
    length = np.linalg.norm(np.diff(own[:, :2], axis=0), axis=1).sum()
    assert length == pytest.approx(0.01 * (N - 1) + 0.5 * 2.0, rel=1e-3)


def test_a_wheel_alone_turns_the_odometry_and_needs_the_track():
    right, left = (corrupted("slip_event", {"slip": 0.5, "side": side})[-1, 2] for side in ("right", "left"))
    assert right > clean_path()[-1, 2] + 0.5
    assert left < clean_path()[-1, 2] - 0.5
    with pytest.raises(Exception, match="track"):
        corrupted("slip_event", {"slip": 0.5, "side": "left"}, track=None)


def test_a_stop_loses_its_way_or_catches_it_up():
    lost, later = (corrupted("odometry_stop", {"duration": 2.0, "time": 4.0, "then": w}) for w in ("lost", "caught_up"))
    for own in (lost, later):
        still = own[at(4.0) : at(6.0)]
        assert np.ptp(still, axis=0).max() < 1e-12
    length = np.linalg.norm(np.diff(lost[:, :2], axis=0), axis=1).sum()
    assert length == pytest.approx(0.01 * (N - 1) - 0.01 * 100, rel=1e-6)
    assert later[at(6.0) + 2 :] == pytest.approx(clean_path()[at(6.0) + 2 :], abs=1e-9)


def test_stuck_messages_come_in_a_burst_with_growing_stamps():
    effect = effect_from_values("latency", {"delay": 0.5, "time": 4.0})
    stamps = T_S + effect.stamp_shift_s(T_S)
    stuck = (T_S >= 4.0 - 1e-9) & (T_S < 4.5 - 1e-9)
    assert np.all(np.diff(stamps) > 0.0)
    assert np.array_equal(stamps[~stuck], T_S[~stuck])
    assert stamps[stuck].min() >= 4.4995 - 1e-9
    assert stamps[stuck].max() < 4.5


def test_the_manifest_tells_of_events(tmp_path):
    words = ["batch", str(OFFICE), str(tmp_path / "runs"), "--runs", "2", "--alpha", "0", "0", "0", "0", "--seed", "1"]
    assert run([*words, "--effect", "push:along=0.3,time=20", "--output", "trajectories"]) == 0
    for line in (tmp_path / "runs" / "manifest.jsonl").read_text().splitlines():
        assert json.loads(line)["events"] == [{"effect": "push", "from_s": 20.0, "to_s": 20.5}]


STEERED_HZ, SECONDS, SPEED_MPS = 50.0, 60.0, 2.0
PLAY, AXLES_M = 0.02, 1.65


def steered_path(rad_per_root_m=0.0, top=0.2):
    """Return increments (n, 3) and ends (n,), s, of a path that steers to both sides, with noise of its heading."""
    t_s = np.arange(1, int(SECONDS * STEERED_HZ) + 1) / STEERED_HZ
    way = np.full(len(t_s), SPEED_MPS / STEERED_HZ)
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
    seen = motion(reported[:, 0] * STEERED_HZ, reported[:, 2] * STEERED_HZ, seconds=SECONDS)
    f = effect.twist_error(seen, effect.start(np.random.default_rng(0))).f[:, 2]
    left = np.cumsum(reported[:, 2] + f / STEERED_HZ - steps[:, 2])
    assert np.ptp(left[int(STEERED_HZ) * 10 :]) < 1e-9


@pytest.mark.parametrize("phase", range(0, 20, 4))
def test_a_reversal_between_two_samples_crosses_the_play(phase):
    # breaks where the angle at the reversal is what a sample shows: the linkage stayed in its play on a long straight
    fine = int(1000.0 / STEERED_HZ)
    t_s = (np.arange(int(SECONDS) * 1000) - phase) / 1000.0
    wheels = np.interp(t_s, [0.0, 1.0, 5.0, 5.5, 5.55], [0.0, -0.2, -0.2, 0.001, 0.0])
    sensor = wheels + 0.5 * PLAY * np.where((t_s > 5.0) & (t_s < 5.5), 1.0, -1.0)
    curvature = sensor.reshape(-1, fine).mean(axis=1)
    v = np.full(len(curvature), SPEED_MPS)
    f = SteeringPlay(play=PLAY).twist_error(motion(v, v * curvature, seconds=SECONDS), SteeringPlay().start(None)).f
    assert np.abs(curvature + f[:, 2] / v)[int(10.0 * STEERED_HZ) :].max() < 0.1 * PLAY


@pytest.mark.parametrize(
    ("limits", "largest_rate", "largest_lag"), [({"rate": 0.05}, 0.05, np.inf), ({"stop": 0.012}, np.inf, 0.012)]
)
def test_wheels_turn_no_faster_than_their_rate_and_lag_no_further_than_their_stop(limits, largest_rate, largest_lag):
    steps, _ = steered_path()
    seen = motion(steps[:, 0] * STEERED_HZ, steps[:, 2] * STEERED_HZ, seconds=SECONDS)
    for effect in (SteeringLag(tau=0.2), SteeringLag(tau=0.2, **limits)):
        f = effect.twist_error(seen, effect.start(np.random.default_rng(0))).f[:, 2]
        wheels, lag = (seen.omega + f) / seen.v, np.abs(f / seen.v)
        rate = np.abs(np.diff(wheels)) * STEERED_HZ
        within = rate.max() <= largest_rate + 1e-9 and lag.max() <= largest_lag + 1e-9
        assert within == (effect.rate + effect.stop > 0.0)


def test_limits_of_large_angles_are_those_of_the_angle_and_not_of_its_tangent():
    # breaks where the curvature is limited: at 30 degrees it changes by a third more than the angle
    steps, _ = steered_path(top=0.35)
    seen = motion(steps[:, 0] * STEERED_HZ, steps[:, 2] * STEERED_HZ, seconds=SECONDS)
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
    seen = motion(reported[:, 0] * STEERED_HZ, reported[:, 2] * STEERED_HZ, seconds=SECONDS)
    f = effect.twist_error(seen, effect.start(np.random.default_rng(0))).f[:, 2]
    assert np.abs(np.cumsum(reported[:, 2] + f / STEERED_HZ - steps[:, 2])).max() < 1e-9


@pytest.mark.parametrize(("sigma_m", "sigma_rad"), [(0.0, 0.0), (0.002, 0.003), (0.02, 0.009)])
def test_noise_of_the_path_becomes_no_drift_beside_the_lag(sigma_m, sigma_rad):
    # breaks where noisy curvatures are differentiated: the heading drifted by 8 to 25 times the error of the lag
    rng, hz = np.random.default_rng(1), 10.0 if sigma_m > 0.01 else STEERED_HZ
    t_s = np.arange(1, int(SECONDS * hz) + 1) / hz
    v = 0.8 * np.clip(2.0 * np.sin(0.2 * t_s), -0.5, 1.0)  # forth, back, and hardly moving between
    steps = np.stack((v / hz, np.zeros_like(v), 0.6 * np.sin(0.9 * t_s) * v / hz), axis=1)
    shaken = rng.standard_normal((len(v) + 1, 3)) * [sigma_m, sigma_m, sigma_rad]
    effect = SteeringLag(tau=0.15)
    exact, noisy = added(effect, steps, t_s), added(effect, steps + np.diff(shaken, axis=0), t_s)
    assert np.std(noisy - exact) < 2.0 * np.std(exact)


def test_wheels_follow_while_a_car_creeps():
    # breaks where the angle is unknown below 0.05 m/s: wheels were where they were before the car slowed down
    t_s = np.arange(1, int(SECONDS * STEERED_HZ) + 1) / STEERED_HZ
    v = 0.02 + 0.5 * (np.sin(0.5 * t_s) > 0.0)
    steps = np.stack((v, np.zeros_like(v), 0.4 * np.sin(0.9 * t_s) * v), axis=1) / STEERED_HZ
    effect = SteeringLag(tau=0.15)
    reported = effect.recorded(steps, t_s, None, effect.start(None)).steps
    seen = motion(v, reported[:, 2] * STEERED_HZ, seconds=SECONDS)
    f = effect.twist_error(seen, effect.start(None)).f[:, 2]
    slow = v < 0.05
    assert np.abs(f[slow]).max() > 0.1 * 0.15 * 0.4 * 0.9 * 0.02
    assert np.abs(np.cumsum(reported[:, 2] + f / STEERED_HZ - steps[:, 2])).max() < 1e-9
