"""Sign and size of each effect on a straight line, a circle, a turn on the spot and a stop, worked out by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
from manoeuvres import CIRCLE, RATE_HZ, REVERSE, SPIN, STOP, STRAIGHT, error, motion, total

from odomcorrupt.effects.compensation import error_of
from odomcorrupt.effects.ground import Slope
from odomcorrupt.errors import EffectError

CASES = [
    # effect, values, manoeuvre, seconds, track, what the truth has more than the odometry: m along, m left, rad
    ("wheel_scale", {"e": 0.01}, STRAIGHT, 2.0, None, (0.01, 0.0, 0.0)),
    ("wheel_scale", {"e": 0.01}, SPIN, 2.0, None, (0.0, 0.0, 0.02)),
    ("unequal_wheels", {"curvature": 0.02}, STRAIGHT, 2.0, None, (0.0, 0.0, 0.02)),
    ("unequal_wheels", {"curvature": 0.02}, REVERSE, 2.0, None, (0.0, 0.0, -0.02)),
    ("unequal_wheels", {"curvature": 0.02}, SPIN, 1.0, 0.4, (0.0008, 0.0, 0.0)),
    ("wheelbase", {"e": 0.25}, SPIN, 1.0, None, (0.0, 0.0, -0.2)),
    ("gyro_scale", {"e": 0.2}, SPIN, 1.2, None, (0.0, 0.0, -0.2)),
    ("gyro_scale", {"e": 0.2}, STRAIGHT, 1.0, None, (0.0, 0.0, 0.0)),
    ("lever_arm", {"x": 0.1, "y": 0.05}, SPIN, 1.0, None, (-0.05, 0.1, 0.0)),
    ("icr_shift", {"x": 0.1}, SPIN, 1.0, None, (0.0, 0.1, 0.0)),
    ("icr_shift", {"x": 0.1}, STRAIGHT, 1.0, None, (0.0, 0.0, 0.0)),
    ("mount_yaw", {"yaw": 0.1}, STRAIGHT, 2.0, None, (math.cos(0.1) - 1.0, -math.sin(0.1), 0.0)),
    ("gyro_bias", {"bias": 0.01}, STOP, 3.0, None, (0.0, 0.0, -0.03)),
    ("side_slip", {"k": 0.05}, CIRCLE, 1.0, None, (0.0, -0.02, 0.0)),
    ("side_slip", {"k": 0.05}, SPIN, 1.0, None, (0.0, 0.0, 0.0)),
    ("turn_asymmetry", {"k": 0.01}, SPIN, 1.0, None, (0.0, 0.0, 0.01)),
    ("turn_scrub", {"travel": -0.1}, {"v": 1.0, "omega": -0.5}, 1.0, None, (-0.05, 0.0, 0.0)),
    ("turn_scrub", {"travel": -0.1}, {"v": 0.0, "vy": 1.0, "omega": 0.5}, 1.0, None, (0.0, -0.05, 0.0)),
    ("turn_scrub", {"turn": 0.1}, {"v": 0.0, "omega": -0.5}, 1.0, None, (0.0, 0.0, -0.025)),
    ("off_centre_load", {"x": 0.2}, {"v": 0.5, "omega": 1.0}, 1.0, None, (0.0, 0.0, 0.1)),
    ("off_centre_load", {"y": 0.2}, {"v": 0.0, "vy": -0.5, "omega": 1.0}, 1.0, None, (0.0, 0.0, -0.1)),
    ("turn_asymmetry", {"k": 0.01}, {"v": 0.0, "omega": -1.0}, 1.0, None, (0.0, 0.0, 0.01)),
    ("speed_scale", {"k": 0.02}, STRAIGHT, 2.0, None, (0.01, 0.0, 0.0)),
    ("speed_scale", {"k": 0.02}, REVERSE, 2.0, 0.4, (-0.01, 0.0, 0.0)),
    # rims at +-0.2 m/s: k * 0.2 * 0.2 on each side, apart by the track
    ("speed_scale", {"k": 0.02}, SPIN, 1.0, 0.4, (0.0, 0.0, 0.004)),
    ("accel_slip", {"k": 0.05}, STRAIGHT, 2.0, None, (0.0, 0.0, 0.0)),
    ("slope", {"creep": 0.02, "direction": math.pi / 2}, STRAIGHT, 2.0, None, (0.0, 0.02, 0.0)),
    ("slope", {"creep": 0.02, "direction": 0.0}, REVERSE, 2.0, None, (0.02, 0.0, 0.0)),
    ("slope", {"creep": 0.02, "direction": 0.0}, SPIN, 2.0, None, (0.0, 0.0, 0.0)),
    ("region_slip", {"slip": 0.1, "x": 0.0, "y": 0.0, "radius": 0.5}, STRAIGHT, 2.0, None, (-0.05, 0.0, 0.0)),
    ("region_slip", {"slip": 0.1, "x": 9.0, "y": 0.0, "radius": 0.5}, STRAIGHT, 2.0, None, (0.0, 0.0, 0.0)),
    # edges are crossed within an interval
    ("region_slip", {"slip": 0.1, "x": 0.0, "y": 0.0, "radius": 0.5037}, STRAIGHT, 2.0, None, (-0.05037, 0.0, 0.0)),
    ("region_slip", {"slip": 0.1, "x": -0.5, "y": 0.0, "radius": 0.1237}, REVERSE, 2.0, None, (0.02474, 0.0, 0.0)),
    (
        "region_slip",
        {"slip": 0.1, "x": 0.5, "y": 0.0, "radius": 0.3, "width": 0.2, "angle": math.pi / 6.0},
        STRAIGHT,
        2.0,
        None,
        (-0.1 * 0.6 / math.cos(math.pi / 6.0), 0.0, 0.0),
    ),
    ("region_slip", {"slip": 0.1, "x": 0.1, "y": 0.0, "radius": 0.5}, SPIN, 1.0, None, (0.0, 0.0, -0.1)),
    ("region_slip", {"slip": 0.1, "x": 0.1, "y": 0.0, "radius": 0.05}, SPIN, 1.0, None, (0.0, 0.0, 0.0)),
    ("backlash", {"travel": 0.004}, STRAIGHT, 2.0, 0.4, (0.0, 0.0, 0.0)),
    ("time_offset", {"offset": 0.1}, STRAIGHT, 1.0, None, (0.0, 0.0, 0.0)),
    ("clock_skew", {"rate": 0.01}, SPIN, 1.0, None, (0.0, 0.0, 0.01)),
]


@pytest.mark.parametrize(("name", "values", "drive", "seconds", "track", "expected"), CASES)
def test_truth_minus_odometry_is_what_paper_says(name, values, drive, seconds, track, expected):
    found = total(name, values, motion(**drive, seconds=seconds, track=track))
    assert found == pytest.approx(expected, abs=1e-12)


SYSTEMATIC_AT_REST = ["wheel_scale", "wheelbase", "side_slip", "accel_slip", "speed_scale", "slope", "scale_drift"]


@pytest.mark.parametrize("name", SYSTEMATIC_AT_REST)
def test_at_rest_only_a_gyro_goes_wrong(name):
    amplitude = {"wheel_scale": "e", "wheelbase": "e", "slope": "creep", "scale_drift": "rate"}.get(name, "k")
    assert not error(name, {amplitude: 1e-4}, motion(**STOP)).any()


def test_scale_drift_grows_with_time():
    drive = motion(0.5, 0.2, seconds=100.0)
    f = error("scale_drift", {"rate": 1e-5}, drive)
    assert f[-1] == pytest.approx([5e-4, 0.0, 2e-4])
    assert (f * drive.dt_s[:, None]).sum(axis=0)[0] == pytest.approx(0.5 * 1e-5 * 100.0**2 / 2.0, rel=1e-3)


def test_slip_by_acceleration_falls_behind_at_the_start_and_comes_back_at_the_stop():
    up = np.linspace(0.0, 1.0, 50, endpoint=False)
    drive = motion(np.concatenate((np.zeros(10), up, np.ones(50), up[::-1], np.zeros(10))), 0.0, seconds=170 / RATE_HZ)
    lag = np.cumsum(error("accel_slip", {"k": 0.05}, drive)[:, 0] * drive.dt_s)
    # -k/2 v^2 while it drives, and nothing when it stands again
    assert lag[85] == pytest.approx(-0.05 / 2.0)
    assert lag[-1] == pytest.approx(0.0, abs=1e-15)
    assert lag.max() < 1e-3


def test_slip_by_acceleration_is_behind_in_reverse_too():
    drive = motion(-np.linspace(0.0, 1.0, 50), 0.0)
    assert total("accel_slip", {"k": 0.05}, drive)[0] == pytest.approx(0.05 / 2.0, rel=0.06)


def test_the_slope_is_fixed_in_the_world():
    for heading in np.linspace(-3.0, 3.0, 7):
        along, across, _ = total(
            "slope", {"creep": 0.02, "direction": 1.0}, motion(**STRAIGHT, seconds=2.0, heading=heading)
        )
        east = along * math.cos(heading) - across * math.sin(heading)
        north = along * math.sin(heading) + across * math.cos(heading)
        assert (east, north) == pytest.approx((0.02 * math.cos(1.0), 0.02 * math.sin(1.0)))


@pytest.mark.parametrize("first", [0.5, -0.5])
def test_backlash_loses_its_travel_at_each_reversal_and_not_at_the_first_start(first):
    legs = np.repeat([0.0, first, -first, first, 0.0], 50)
    lost = total("backlash", {"travel": 0.004}, motion(legs, 0.0, seconds=5.0, track=0.4))
    assert lost == pytest.approx([0.0, 0.0, 0.0], abs=1e-12)  # one each way
    once = total("backlash", {"travel": 0.004}, motion(legs[:150], 0.0, seconds=3.0, track=0.4))
    assert once == pytest.approx([math.copysign(0.004, first), 0.0, 0.0], abs=1e-12)


def test_castors_turn_the_robot_after_each_reversal_and_the_next_one_turns_it_back():
    legs = np.concatenate((np.full(100, 0.2), np.full(100, -0.2)))
    kick = {"angle": 0.03, "way": 0.1}
    assert not error("castor_kick", kick, motion(legs[:100], 0.0, seconds=2.0)).any()
    there = error("castor_kick", kick, motion(legs, 0.0, seconds=4.0))
    # within the way on which they swing, and a parked robot's sway
    assert not there[130:].any()
    assert total("castor_kick", kick, motion(legs, 0.0, seconds=4.0)) == pytest.approx([0.0, 0.0, -0.03], abs=1e-12)
    back = motion(np.concatenate((legs, legs)), 0.0, seconds=8.0)
    assert total("castor_kick", kick, back) == pytest.approx([0.0, 0.0, -0.03], abs=1e-12)


def test_a_complementary_filter_takes_the_turn_of_the_wheels_seconds_late():
    drive = motion(0.0, np.repeat([1.0, 0.0], [100, 1900]), seconds=40.0)
    late = error("complementary_filter", {"e": 0.25, "tau": 5.0}, drive)[:, 2] / RATE_HZ
    assert late.sum() == pytest.approx(-0.2 * 2.0, rel=1e-3)
    assert late[:100].sum() == pytest.approx(-0.2 * (2.0 - 4.0 * (1.0 - math.exp(-0.5))), rel=0.01)


def test_backlash_of_one_wheel_turns_the_robot():
    """A turn to the left on the spot after driving on: the left wheel alone reverses."""
    drive = motion(np.repeat([0.5, 0.0], 50), np.repeat([0.0, 1.0], 50), seconds=2.0, track=0.4)
    assert total("backlash", {"travel": 0.004}, drive) == pytest.approx([0.002, 0.0, -0.01], abs=1e-12)


def test_a_parked_robot_that_sways_has_no_backlash():
    rng = np.random.default_rng(3)
    sway = rng.normal(0.0, 5e-6, 200) * RATE_HZ
    drive = motion(np.concatenate((np.full(50, 0.5), sway)), 0.0, seconds=5.0, track=0.4)
    assert not error("backlash", {"travel": 0.004}, drive).any()


@pytest.mark.parametrize("name", ["backlash"])
def test_effects_of_single_wheels_ask_for_the_track(name):
    with pytest.raises(EffectError, match="track"):
        error(name, {"travel": 0.004}, motion(**STRAIGHT))


def test_a_slope_is_reported_as_a_creep_towards_where_it_goes():
    drive = motion(**CIRCLE)
    for creep, direction in ((-0.015, 0.5), (0.01, 4.0)):
        told = (slope := Slope(creep=creep, direction=direction)).plain()
        assert told.creep > 0.0
        assert -np.pi <= told.direction <= np.pi
        assert error_of(told, drive) == pytest.approx(error_of(slope, drive), abs=1e-12)
