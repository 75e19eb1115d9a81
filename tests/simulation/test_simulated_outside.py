"""Causes that no library names do what their names say, too; and several causes add up."""

import numpy as np
import pytest
from simulated_manoeuvres import CIRCLE_LEFT, REST, SPIN_LEFT, STRAIGHT, both, silent, way_m

from odomcorrupt.errors import EffectError
from odomcorrupt.simulation import OUTSIDE, Segment, simulate, simulate_without
from odomcorrupt.simulation.faults import draw_causes
from odomcorrupt.simulation.robot import build_robot, stream

CRUISE = slice(500, 900)


def start_heading(seed=5):
    return silent(None, None, (REST,), duration_s=10.0, seed=seed).truth_xyt[0, 2]


def test_axle_out_of_centre_wags_the_robot_once_per_turn_of_the_wheel():
    robot = build_robot(stream(5, "robot"))
    odom, truth = both(silent("eccentric_wheel", {"e": 0.05, "phase": 0.0}, STRAIGHT))
    expected = 0.05 * robot.nominal_radius_m / robot.nominal_track_m * np.sin(odom[:, 0] / robot.nominal_radius_m)
    assert np.abs(truth[:, 2] - expected).max() < 1e-3


def test_iron_turns_the_compass_by_the_heading():
    heading = start_heading()
    odom, truth = both(silent("magnetic_heading", {"amplitude": 0.05, "direction": 0.3}, SPIN_LEFT))
    facing = truth[:, 2] + heading - 0.3
    assert np.abs(odom[:, 2] - truth[:, 2] - 0.05 * (np.sin(facing) - np.sin(heading - 0.3))).max() < 1e-4


def test_carpet_pulls_towards_its_ribs_whichever_way_one_goes():
    parameters = {"creep": 0.02, "direction": start_heading() + 0.25 * np.pi}
    odom, truth = both(silent("floor_grain", parameters, STRAIGHT))
    assert truth[-1, 1] == pytest.approx(0.02 * odom[-1, 0], rel=1e-3)


@pytest.mark.parametrize(("threshold_mps", "ratio"), [(0.4, 0.95), (0.6, 1.0)])
def test_floor_lets_go_of_wheels_that_are_too_fast(threshold_mps, ratio):
    odom, truth = both(silent("overspeed_slip", {"slip": 0.05, "speed": threshold_mps}, STRAIGHT))
    assert way_m(truth[CRUISE]) / way_m(odom[CRUISE]) == pytest.approx(ratio, abs=1e-6)


def test_braking_wheels_are_dragged():
    odom, truth = both(silent("braking_drag", {"slip": 0.2, "deceleration": 0.3}, STRAIGHT))
    assert truth[900, 0] == pytest.approx(odom[900, 0], abs=1e-6)
    assert 0.02 < truth[-1, 0] - odom[-1, 0] < 0.06


def test_load_that_slides_bends_the_path_from_then_on():
    run = silent("load_shift", {"squeeze": 0.01, "time": 12.0}, STRAIGHT)
    odom, truth = both(run)
    assert np.abs(truth[:590, 2]).max() < 1e-9
    bent = (truth[900, 2] - truth[700, 2]) / (odom[900, 0] - odom[700, 0])
    assert bent == pytest.approx(-0.02 / run.track_m, rel=1e-3)


def test_scrub_takes_more_the_faster_one_turns():
    odom, truth = both(silent("turn_scrub", {"k": 0.05}, SPIN_LEFT))
    gain = (truth[800, 2] - truth[600, 2]) / (odom[800, 2] - odom[600, 2])
    assert gain == pytest.approx(1 / (1 + 0.05 * 0.8), rel=1e-6)


def test_strip_takes_its_part_across_its_width():
    x, y, heading = silent(None, None, (REST,), duration_s=10.0).truth_xyt[0]
    middle = x + 1j * y + 4.0 * np.exp(1j * heading)
    parameters = {"x": middle.real, "y": middle.imag, "direction": heading + 0.5 * np.pi, "width": 2.0, "slip": 0.1}
    odom, truth = both(silent("wet_strip", parameters, STRAIGHT))
    assert odom[-1, 0] - truth[-1, 0] == pytest.approx(0.2 / 0.9, abs=0.003)


def test_patch_under_the_left_wheel_alone_turns_to_the_left():
    x, y, heading = silent(None, None, (REST,), duration_s=10.0).truth_xyt[0]
    centre = x + 1j * y + (4.0 + 0.65j) * np.exp(1j * heading)
    patch = {"slip": 0.1, "x": centre.real, "y": centre.imag, "radius": 0.6}
    odom, truth = both(silent("wet_patch", patch, STRAIGHT))
    assert truth[-1, 2] > 0.05
    assert abs(odom[-1, 2]) < 1e-9


def test_each_says_what_its_error_depends_on():
    assert all(flaw.depends_on for flaw in OUTSIDE.values())


def test_two_flaws_are_both_there():
    parameters = {"wheel_scale": {"e": 0.01}, "wheelbase": {"e": 0.02}}
    odom, truth = both(silent(("wheel_scale", "wheelbase"), parameters, STRAIGHT))
    assert truth[-1, 0] / odom[-1, 0] == pytest.approx(1.01, abs=1e-6)
    run = silent(("wheel_scale", "wheelbase"), parameters, SPIN_LEFT)
    odom, truth = both(run)
    assert truth[-1, 2] / odom[-1, 2] == pytest.approx(1.01 / 1.02, abs=1e-6)
    assert run.answer["causes"] == parameters
    assert run.answer["cause"] == "wheel_scale+wheelbase"


def test_drawn_flaws_of_a_mixture_are_those_of_its_parts():
    both_at_once = simulate(4, ("side_slip", "slope"), duration_s=10.0).answer["causes"]
    alone = {name: simulate(4, name, duration_s=10.0).answer["parameters"] for name in both_at_once}
    assert both_at_once == alone


@pytest.mark.parametrize(
    "causes", ["wheel_skale", ("slope", "slope"), ("gyro_bias", "wheelbase"), ("gyro_scale", "eccentric_wheel")]
)
def test_impossible_causes_are_refused(causes):
    with pytest.raises(EffectError):
        simulate(1, causes, duration_s=10.0)


@pytest.mark.parametrize("cause", ["region_slip", "wet_patch", "wet_strip"])
def test_place_stays_where_it_is_for_other_drives_of_the_robot(cause):
    here = simulate(4, cause, duration_s=30.0)
    there = simulate(5, cause, duration_s=60.0, robot_seed=4)
    assert here.answer == there.answer
    assert np.abs(here.truth_xyt[0, :2] - there.truth_xyt[0, :2]).max() < 0.05
    without = simulate_without(5, cause, duration_s=60.0, robot_seed=4)
    assert np.array_equal(without.truth_xyt[:100], there.truth_xyt[:100])


@pytest.mark.slow
@pytest.mark.parametrize("route", ["office", "loops", "slalom", "shuttle", "yard", "umbmark"])
def test_patch_is_met_on_every_route(route):
    lost = []
    for seed in range(4):
        options = {"route": route, "duration_s": 300.0, "robot_seed": 40 + seed}
        with_patch, without = simulate(seed, "region_slip", **options), simulate_without(seed, "region_slip", **options)
        lost.append(np.abs(with_patch.truth_xyt[-1] - without.truth_xyt[-1]).max() > 0.0)
    assert sum(lost) >= 3


def test_skid_steer_is_wide_and_scrubs():
    differential, skid = (build_robot(stream(5, "robot"), kind) for kind in ("differential", "skid"))
    assert skid.nominal_track_m > 1.25 * differential.nominal_track_m
    odom, truth = both(silent(None, None, None, duration_s=100.0, drive_type="skid"))
    assert np.abs(odom - truth).max() < 1e-3
    _, truth = both(silent("side_slip", {"k": 0.03}, CIRCLE_LEFT, duration_s=40.0, drive_type="skid"))
    assert np.isfinite(truth).all()


def test_hidden_draws_all_kinds_and_what_shows():
    drawn = [draw_causes(seed) for seed in range(400)]
    kinds = [len(h.causes) for h in drawn]
    assert min(kinds.count(0), kinds.count(2), kinds.count(1)) > 30
    assert any(h.causes and h.causes[0] in OUTSIDE for h in drawn)
    assert 0.35 < np.mean([h.yaw_from == "gyro" for h in drawn]) < 0.65
    assert all(h.yaw_from == "gyro" for h in map(draw_causes, range(20), ["gyro"] * 20))
    for h in drawn[:100]:
        simulate(1, h.causes, yaw_from=h.yaw_from, duration_s=6.0)


def test_negative_sizes_of_what_has_none_are_refused():
    with pytest.raises(EffectError, match="must not be negative"):
        silent("backlash", {"travel": -0.01}, (REST, Segment(0.1, 0.0, 1.0)))
