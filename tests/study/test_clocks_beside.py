"""Clocks of validation recordings are estimated beside the model's effects, and lags are compared with clocks."""

from dataclasses import astuple, replace

import numpy as np
import pytest
from hidden import as_recording

from odomcorrupt.effects import effect_from_values
from odomcorrupt.geometry.increments import Increments, accumulate, increments
from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.model.motion_model import MotionModel
from odomcorrupt.model.presets import preset_named
from odomcorrupt.simulation import simulate
from odomcorrupt.study.estimate.clocks import find_clocks
from odomcorrupt.study.estimate.config import choose_approach
from odomcorrupt.study.estimate.gauss_newton import fit
from odomcorrupt.study.io.clock import Clock
from odomcorrupt.study.select.candidates import library_candidates
from odomcorrupt.study.select.clock_rivals import cancelled_lag, clock_beside_lag, lag_in_place
from odomcorrupt.study.select.decisions import DECISIONS
from odomcorrupt.study.validate.evaluation_clocks import clocks_beside


def test_an_effect_of_the_heading_in_the_world_is_taken_out_of_a_recording_whose_truth_has_none():
    recording = as_recording(simulate(93, "slope", duration_s=60.0))
    xyt = recording.truth.xyt.copy()
    xyt[:, 2] = np.nan
    recording = replace(recording, truth=replace(recording.truth, xyt=xyt))
    slope = effect_from_values("slope", {"creep": 0.01, "direction": 0.5})
    model = MotionModel(preset_named("typical").noise, effects=(slope,))
    clocks = clocks_beside([recording], choose_approach([recording]), model)
    assert abs(clocks.clocks[0].offset_s) < 0.05


@pytest.mark.parametrize("by", ["filter", "delay"])
def test_odometry_that_a_filter_makes_late_is_told_from_odometry_with_a_late_clock(by):
    tau_s = 0.1
    recording = filtered(as_recording(simulate(93, None, duration_s=120.0)), tau_s, by)
    clocked = fit(
        [recording], clocks=(Clock(tau_s),), free_clocks=((True, False),), approach=choose_approach([recording])
    )
    found = lag_in_place(clocked, DECISIONS)
    if by == "delay":
        assert clocked.problem.clocks[0].offset_s == pytest.approx(tau_s, abs=0.003)
        assert found is None or found.more_nats < -DECISIONS.replacement_nats
    else:
        assert found.more_nats > DECISIONS.replacement_nats
        assert found.fit.effects[-1].tau == pytest.approx(tau_s, abs=0.003)


def test_the_clock_of_a_laser_is_free_even_if_slip_pulls_it_to_where_it_increases_the_drift(monkeypatch):
    """Slip while speeding up is late travel; with turns in time and a fixed clock it was a lag of the turns, sure."""
    monkeypatch.setattr("odomcorrupt.study.estimate.clocks._harmless", lambda *_: False)
    recording = as_recording(simulate(93, "accel_slip", duration_s=120.0))
    approach = choose_approach([recording])
    assert find_clocks([recording], approach).free == ((False, False),)
    covariance = np.broadcast_to(np.diag([4e-6, 4e-6, 1e-5]), (len(recording.truth), 3, 3))
    seen = replace(recording, truth=replace(recording.truth, covariance=covariance), truth_scale_error=0.003)
    found = find_clocks([seen], approach)
    assert (found.free, found.clocks[0].offset_s) == (((True, False),), 0.0)


def test_a_late_truth_of_odometry_with_coarse_ticks_is_no_lag_of_the_motors():
    """A first-order lag smooths ticks, and gained 40 nats over the clock of a truth that was 50 ms late."""
    recording = as_recording(simulate(93, None, duration_s=120.0))
    steps, track_m, tick_m = increments(recording.odometry.xyt), recording.track_m, 0.004
    wheels = np.cumsum([steps.ds_m + s * steps.dtheta_rad * track_m / 2.0 for s in (1.0, -1.0)], axis=1)
    right, left = np.diff(np.floor(wheels / tick_m) * tick_m, axis=1, prepend=0.0)
    counted = Increments((right + left) / 2.0, np.zeros_like(right), (right - left) / track_m)
    odometry = replace(recording.odometry, xyt=accumulate(recording.odometry.xyt[0], counted))
    late = replace(recording.truth, stamps_ns=recording.truth.stamps_ns + 50_000_000)
    recording = replace(recording, odometry=odometry, truth=late)
    clocked = fit(
        [recording], clocks=(Clock(-0.05),), free_clocks=((True, False),), approach=choose_approach([recording])
    )
    assert clocked.problem.clocks[0].offset_s == pytest.approx(-0.05, abs=0.005)
    assert lag_in_place(clocked, DECISIONS, first=True) is None


def test_a_filter_of_all_speeds_that_absorbed_a_clock_gets_it_beside_it():
    """Without the clock, a filter of 0.14 s was one of 0.164 s, sure, and doubled the error of another drive."""
    recording = filtered(as_recording(simulate(93, None, duration_s=240.0)), 0.2, "filter")
    late = replace(recording.odometry, stamps_ns=recording.odometry.stamps_ns + 30_000_000)
    lag = effect_from_values("channel_lag", {"tau": 0.23, "channel": "all"})
    alone = fit([replace(recording, odometry=late)], [lag], approach=choose_approach([recording]))
    found = clock_beside_lag(alone, (), DECISIONS)
    assert found.more_nats > DECISIONS.alternative_nats
    (error_s,), ((clock_error_s, _),) = found.fit.standard_errors, found.fit.clock_errors
    assert found.fit.by_name["channel_lag"].tau == pytest.approx(0.2, abs=3.0 * error_s)
    assert found.fit.problem.clocks[0].offset_s == pytest.approx(0.03, abs=3.0 * clock_error_s)
    assert abs(alone.by_name["channel_lag"].tau - 0.2) > 10.0 * alone.standard_errors[0]
    assert clock_beside_lag(alone, {"channel_lag"}, DECISIONS) is None


def filtered(recording, tau_s, by):
    """Return a recording whose odometry has a lag of all speeds."""
    path = recording.odometry
    lag = effect_from_values("channel_lag", {"tau": tau_s, "channel": "all", "by": by})
    late = lag.recorded(np.stack(astuple(increments(path.xyt)), axis=1), recording.odometry_s[1:], None, None).steps
    xyt = accumulate(path.xyt[0], Increments(*np.ascontiguousarray(late.T)))
    return replace(recording, odometry=Trajectory(path.stamps_ns, xyt))


@pytest.mark.parametrize(("tau_s", "offset_s"), [(0.12, -0.04), (0.1, -0.08)])
def test_motors_that_follow_late_beside_an_early_clock_are_both(tau_s, offset_s):
    """Their sum is a clock offset that neither explains alone; its misfit was a dozen of effects, two of them sure."""
    recording = as_recording(simulate(93, None, duration_s=120.0))
    late = replace(recording.truth, xyt=followed(recording.truth, tau_s))
    late = replace(late, stamps_ns=late.stamps_ns - int(offset_s * 1e9))
    recording = replace(recording, truth=late)
    sum_s = offset_s - tau_s
    clocked = fit(
        [recording], clocks=(Clock(sum_s),), free_clocks=((True, False),), approach=choose_approach([recording])
    )
    found = lag_in_place(clocked, DECISIONS, first=True)
    assert found.more_nats > 60.0
    (lag,), (clock,) = found.fit.effects, found.fit.problem.clocks
    assert lag.name == "motor_lag"
    assert lag.tau == pytest.approx(tau_s, abs=0.006)
    assert clock.offset_s == pytest.approx(offset_s, abs=0.006)


def with_late_truth(recording, seconds):
    """Return a recording with later stamps of the truth: odometry with an early clock."""
    stamps_ns = recording.truth.stamps_ns + round(seconds * 1e9)
    return replace(recording, truth=replace(recording.truth, stamps_ns=stamps_ns))


@pytest.mark.parametrize("clocked", [False, True])
@pytest.mark.parametrize(("name", "tau_s"), [("motor_lag", 0.08), ("channel_lag", 0.2)])
def test_a_lag_and_the_clock_that_cancels_it_are_both(name, tau_s, clocked):
    """To first order there is no error, and the second was the wheelbase, sure."""
    recording = as_recording(simulate(93, None, duration_s=120.0))
    if name == "motor_lag":
        late = replace(recording.truth, xyt=followed(recording.truth, tau_s))
        recording, offset_s = with_late_truth(replace(recording, truth=late), -tau_s), tau_s
    else:
        recording, offset_s = with_late_truth(filtered(recording, tau_s, "filter"), tau_s), -tau_s
    approach = choose_approach([recording])
    start = fit([recording], clocks=(Clock(),), free_clocks=((clocked, False),), approach=approach)
    found = cancelled_lag(start, 0.0, DECISIONS)
    (lag,), (clock,) = found.fit.effects, found.fit.problem.clocks
    assert (lag.name, found.candidates[0].name) == (name, name)
    assert lag.tau == pytest.approx(tau_s, abs=0.006)
    assert clock.offset_s == pytest.approx(offset_s, abs=0.006)
    assert cancelled_lag(start, found.more_nats, DECISIONS) is None  # an effect explains as much


@pytest.mark.parametrize("cause", [None, "accel_slip", "backlash", "wheelbase"])
def test_other_causes_are_no_lag_that_a_clock_cancels(cause):
    recording = as_recording(simulate(93, cause, duration_s=120.0))
    approach = choose_approach([recording])
    alone = fit([recording], approach=approach)
    gain = max((one.gain for one in library_candidates(alone, DECISIONS) if not one.refused), default=0.0)
    assert cancelled_lag(alone, gain, DECISIONS) is None


def followed(path, tau_s):
    """Return the poses of a robot whose speeds follow those of a path with a continuous first-order lag."""
    t_s = path.seconds_since(int(path.stamps_ns[0]))
    grid_s = np.arange(0.0, t_s[-1] + 0.002, 0.002)
    there = path.at(grid_s, int(path.stamps_ns[0]))
    steps = increments(there)
    kept, speeds = np.exp(-0.002 / tau_s), np.stack((steps.ds_m, steps.dl_m, steps.dtheta_rad))
    for i in range(1, speeds.shape[1]):
        speeds[:, i] = kept * speeds[:, i - 1] + (1.0 - kept) * speeds[:, i]
    poses = accumulate(there[0], Increments(*speeds))
    return np.stack([np.interp(t_s, grid_s[: len(poses)], column) for column in poses.T], axis=1)
