"""A filtered channel: what corruption makes of a step of speed, and how correction takes it back."""

from dataclasses import replace

import numpy as np
import pytest

from odomcorrupt.corruption.path import NoisyPath
from odomcorrupt.effects import effect_from_values
from odomcorrupt.effects.compensation import corrected_increments
from odomcorrupt.geometry.motion import motion_of
from odomcorrupt.geometry.se2 import Increments, accumulate
from odomcorrupt.model.motion_model import MotionModel, Noise
from odomcorrupt.model.noise_laws import Coefficients

SILENT = Noise("diffusion", Coefficients(0.0, 0.0, 0.0, 0.0))


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
    motion = motion_of(
        np.concatenate(([0.0], np.cumsum(dt))), accumulate(np.zeros(3), Increments(dt, 0.0 * dt, turned))
    )
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
