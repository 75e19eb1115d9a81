"""The second judge is judged: without a cause its odometry is good to 0.03 %, with one it is off as the cause says."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.append(str(Path(__file__).parents[1] / "benchmarks"))
pytest.importorskip("mujoco", reason="mujoco is not installed; pip install mujoco to let it judge the odometry")

from mujocosim import CAUSES, simulate_body
from mujocosim.body import RADIUS_M, TRACK_M

from odomcorrupt.simulation import Rig, Segment, SimulatedRun, Tracker

RIG = Rig(sampling_jitter_s=0.0, stamp_jitter_s=0.0, ticks_per_turn=None, motor_ripple=0.0, creep=0.0)
TRACKER = Tracker(sampling_jitter_s=0.0, noise_m=0.0, noise_rad=0.0, dropouts_per_min=0.0)
REST = Segment(0.0, 0.0, 1.0, 1.0)
STRAIGHT = (REST, Segment(0.5, 0.0, 9.0), Segment(0.0, 0.0, 3.0))
CIRCLE = (REST, Segment(0.6, 0.5, 20.0))
WINDOW = 25
"""Half a second of odometry."""


def driven(cause, route, parameters=None, duration_s=15.0, seed=1):
    return simulate_body(seed, cause, parameters=parameters, route=route, duration_s=duration_s, rig=RIG, truth=TRACKER)


def steps(run):
    """Ways along, to the left (m), and turns (rad) of odometry and truth over half seconds; shape (n, 3) each."""
    at_ns = run.odom_stamps_ns[run.odom_stamps_ns > run.truth_stamps_ns[0]][:-WINDOW:WINDOW]
    pairs = ((run.odom_stamps_ns, run.odom_xyt), (run.truth_stamps_ns, run.truth_xyt))
    both = []
    for stamps, xyt in pairs:
        x, y, heading = (np.interp(at_ns, stamps, c) for c in (*xyt.T[:2], np.unwrap(xyt[:, 2])))
        moved = np.diff(x + 1j * y) * np.exp(-0.5j * (heading[1:] + heading[:-1]))
        both.append(np.column_stack((moved.real, moved.imag, np.diff(heading))))
    return both


def gains(run):
    """Scale - 1, yaw gain - 1 and curvature (rad/m) of truth over odometry, by least squares."""
    odom, truth = steps(run)
    error = truth - odom
    scale = odom[:, 0] @ error[:, 0] / (odom[:, 0] @ odom[:, 0])
    curvature, yaw_gain = np.linalg.lstsq(odom[:, [0, 2]], error[:, 2], rcond=None)[0]
    return scale, yaw_gain, curvature


def test_without_a_cause_scale_and_yaw_are_right_to_three_parts_in_ten_thousand():
    run = driven(None, "office", duration_s=60.0)
    assert isinstance(run, SimulatedRun)
    scale, yaw_gain, curvature = gains(run)
    assert max(abs(scale), abs(yaw_gain)) < 3e-4
    assert abs(curvature) < 1e-4
    odom, truth = steps(run)
    assert np.abs(odom - truth).max() < 2e-3
    assert run.answer["cause"] is None
    assert run.answer["rolling_m"] == pytest.approx([RADIUS_M, RADIUS_M], abs=1e-8)


def test_larger_right_wheel_bends_the_path_to_the_left():
    run = driven("larger_right_wheel", "office", {"e": 0.005}, 60.0)
    scale, yaw_gain, curvature = gains(run)
    assert curvature == pytest.approx(0.005 / TRACK_M, rel=0.02)
    assert run.answer["causes"]["unequal_wheels"]["curvature"] == pytest.approx(0.005 / TRACK_M, rel=1e-3)
    assert (scale, yaw_gain) == pytest.approx((0.0025, 0.0025), abs=3e-4)


def test_larger_wheels_go_and_turn_farther():
    run = driven("larger_wheels", "office", {"e": 0.01}, 60.0)
    scale, yaw_gain, curvature = gains(run)
    assert (scale, yaw_gain) == pytest.approx((0.01, 0.01), abs=3e-4)
    assert abs(curvature) < 1e-4
    assert run.answer["causes"] == {"wheel_scale": {"e": pytest.approx(0.01, abs=1e-6)}}


def test_wider_axle_turns_less():
    run = driven("wider_axle", "office", {"e": 0.03}, 60.0)
    scale, yaw_gain, _ = gains(run)
    assert yaw_gain == pytest.approx(1 / 1.03 - 1, abs=3e-4)
    assert abs(scale) < 5e-4
    assert run.answer["causes"] == {"wheelbase": {"e": 0.03}}


def test_one_sided_load_squeezes_the_tyre_under_it():
    run = driven("one_sided_load", STRAIGHT, {"mass": 6.0, "y": 0.12})
    without = driven("soft_tyres", STRAIGHT)
    curvature = run.answer["causes"]["unequal_wheels"]["curvature"]
    assert curvature > 0.002
    odom, truth = (part[6:18] for part in steps(run))
    assert (truth - odom)[:, 2].sum() / odom[:, 0].sum() == pytest.approx(curvature, rel=0.05)
    odom, truth = (part[6:18] for part in steps(without))
    assert abs((truth - odom)[:, 2].sum() / odom[:, 0].sum()) < 1e-5


def test_soft_tyres_slip_out_of_turns_as_the_wheel_level_says():
    run = driven("soft_tyres", CIRCLE, duration_s=20.0)
    odom, truth = (part[-10:] for part in steps(run))
    assert (truth - odom)[:, 1].mean() / 0.5 == pytest.approx(-run.answer["causes"]["side_slip"]["k"] * 0.3, rel=0.05)


def test_patch_lets_wheels_spin_where_it_is_and_nowhere_else():
    where = {"x": 0.0, "y": 0.0, "radius": 1.0, "friction": 0.02}
    inside = driven("slippery_patch", STRAIGHT, where)
    odom, truth = steps(inside)
    assert (odom - truth)[:, 0].sum() > 0.05
    outside = driven("slippery_patch", STRAIGHT, where | {"x": 50.0})
    odom, truth = steps(outside)
    assert np.abs(odom - truth).max() < 2e-3


def test_tilted_floor_creeps_downhill_even_at_rest_but_next_to_nothing():
    run = driven("tilted_floor", (REST,), {"angle": np.radians(5.0), "direction": 0.5 * np.pi})
    down_m = run.truth_xyt[-1, 1] - run.truth_xyt[500, 1]
    assert 0.0 < down_m < 2e-3


@pytest.mark.parametrize("cause", [None, *CAUSES])
def test_same_seed_same_bits(cause):
    one, two = (simulate_body(3, cause, duration_s=5.0) for _ in range(2))
    assert np.array_equal(one.odom_xyt, two.odom_xyt)
    assert np.array_equal(one.truth_xyt, two.truth_xyt)
    assert one.answer == two.answer
