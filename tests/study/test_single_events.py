"""A push or a lift is reported with its time, place and size; noise and a truth that jumps are not."""

from dataclasses import replace

import numpy as np
import pytest
from wandering import noisy_path, recording, wander

from odomcorrupt.geometry.se2 import Increments, accumulate
from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.model.noise_laws import Coefficients
from odomcorrupt.study.estimate.config import choose_approach
from odomcorrupt.study.estimate.gauss_newton import fit
from odomcorrupt.study.estimate.outliers import during, single_events, slip_bursts
from odomcorrupt.study.estimate.tails import heavy_tails


def pushed(seed, *, yaw_deg=0.0, begin_s=100.0, lasts_s=3.0):
    """Return a recording in which somebody turned the robot by so much, of which its odometry knows nothing."""
    steps = wander(seed, 240.0)
    run = recording(steps, noisy_path(steps, Coefficients(0.01, 0.01, 0.003, 0.001), seed), seed=seed)
    during = (np.arange(len(steps)) >= 50 * begin_s) & (np.arange(len(steps)) < 50 * (begin_s + lasts_s))
    turn = steps.dtheta_rad + during * np.radians(yaw_deg) / during.sum()
    true = accumulate(np.zeros(3), Increments(steps.ds_m, steps.dl_m, turn))
    noise = np.random.default_rng(seed).normal(0.0, [0.002, 0.002, 0.003], true.shape)
    return replace(run, truth=Trajectory(run.odometry.stamps_ns, true + noise))


def events_of(run):
    return single_events(fit([run], approach=choose_approach([run])))


def test_a_push_is_reported_with_its_time_place_and_size():
    run = pushed(3, yaw_deg=16.0)
    events = events_of(run)
    assert sum(np.degrees(event.yaw_rad) for event in events) == pytest.approx(-16.0, abs=3.0)
    for event in events:
        assert 99.0 < event.start_s < event.end_s < 104.0
        at = run.truth.at(np.array([event.start_s]), run.origin_ns)[0]
        assert event.place_xy == pytest.approx((at[0], at[1]), abs=0.02)


@pytest.mark.parametrize("seed", range(5))
def test_noise_holds_no_event(seed):
    assert events_of(pushed(seed)) == []


def test_a_truth_that_jumps_and_comes_back_is_no_event():
    run = pushed(3)
    truth = run.truth.xyt.copy()
    truth[5000:5400, :2] += 0.3
    assert events_of(replace(run, truth=Trajectory(run.truth.stamps_ns, truth))) == []


def hidden_from_the_truth(run, begin_s=99.0, end_s=104.0):
    """Return a recording whose truth saw nothing of a stretch."""
    t_s = run.truth.seconds_since(run.origin_ns)
    seen = (t_s < begin_s) | (t_s > end_s)
    return replace(run, truth=Trajectory(run.truth.stamps_ns[seen], run.truth.xyt[seen]))


def test_a_push_while_the_truth_saw_nothing_is_reported_by_the_gap():
    (event,) = events_of(hidden_from_the_truth(pushed(3, yaw_deg=16.0)))
    assert 98.0 < event.start_s < 99.1
    assert 103.9 < event.end_s < 105.0
    assert np.degrees(event.yaw_rad) == pytest.approx(-16.0, abs=3.0)


@pytest.mark.parametrize("seed", range(3))
def test_a_gap_of_the_truth_by_itself_is_no_event(seed):
    assert events_of(hidden_from_the_truth(pushed(seed))) == []


def test_a_push_is_one_event_and_no_evidence_for_noise():
    run = pushed(3, yaw_deg=40.0, lasts_s=1.0)
    fitted = fit([run], approach=choose_approach([run]))
    (event,) = single_events(fitted)
    own = during(fitted, [event])
    assert own.any()
    assert slip_bursts(fitted) is None
    assert heavy_tails(fitted) is None


def test_what_a_gap_hides_and_what_is_seen_beside_it_are_one_event():
    run = hidden_from_the_truth(pushed(3, yaw_deg=40.0, lasts_s=3.0), 101.0, 104.0)
    (event,) = events_of(run)
    assert event.start_s < 101.0
    assert event.end_s >= 104.0
    assert np.degrees(event.yaw_rad) == pytest.approx(-40.0, abs=4.0)
