"""Events: what is put into a bag at a stated time, is in its manifest, and is nothing that a diagnosis tests."""

import json
from pathlib import Path

import numpy as np
import pytest

from odomcorrupt.cli import run
from odomcorrupt.corruption.path import NoisyPath
from odomcorrupt.effects import effect_from_values, registry
from odomcorrupt.geometry.se2 import Increments, accumulate, between
from odomcorrupt.model.motion_model import MotionModel, Noise
from odomcorrupt.model.noise_laws import Coefficients

OFFICE = Path(__file__).parents[2] / "fixtures" / "office.mcap"
EVENTS = [name for name, kind in registry().items() if kind.kind == "event"]
N = 1001
STAMPS = 10**18 + np.arange(N) * 20_000_000
T_S = np.arange(N) * 0.02


def clean_path():
    return accumulate(
        np.array([1.0, 2.0, 0.5]), Increments(np.full(N - 1, 0.01), np.zeros(N - 1), np.full(N - 1, 0.004))
    )


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
