"""The simulator of wheels, the errors that its causes make, and the command that hides and answers what is wrong."""

import dataclasses
import tomllib
from hashlib import sha256

import numpy as np
import pytest
from mcap.reader import make_reader

import rosmessages
from odomcorrupt.cli import run
from odomcorrupt.errors import BagError, TopicError
from odomcorrupt.simulation import (
    OUTSIDE,
    ROUTES,
    TRACKERS,
    Commands,
    Rig,
    Segment,
    Tracker,
    read_commands,
    simulate,
    simulate_without,
    write_mcap,
)
from odomcorrupt.simulation.faults import EVERY, draw_causes, draw_parameters
from odomcorrupt.simulation.robot import build_robot, stream
from odomcorrupt.simulation.run import STORE

FLAWLESS_RIG = Rig(
    sampling_jitter_s=0.0,
    stamp_jitter_s=0.0,
    ticks_per_turn=None,
    gyro_noise_rad_per_sqrt_s=0.0,
    motor_ripple=0.0,
    creep=0.0,
)
FLAWLESS_TRACKER = Tracker(sampling_jitter_s=0.0, noise_m=0.0, noise_rad=0.0, dropouts_per_min=0.0)
REST = Segment(0.0, 0.0, 1.0, 1.0)
STRAIGHT = (REST, Segment(0.5, 0.0, 19.0), Segment(0.0, 0.0, 5.0))
SPIN_LEFT = (REST, Segment(0.0, 0.8, 19.0), Segment(0.0, 0.0, 5.0))
CIRCLE_LEFT = (REST, Segment(0.6, 0.5, 40.0))
CIRCLE_RIGHT = (REST, Segment(0.6, -0.5, 40.0))


def silent(cause, parameters, route, duration_s=28.0, seed=5, **options):
    return simulate(
        seed, cause, parameters=parameters, route=route, duration_s=duration_s, rig=FLAWLESS_RIG,
        truth=FLAWLESS_TRACKER, **options,
    )  # fmt: skip


def from_start(stamps_ns, xyt, at_ns):
    """Poses at other stamps, headings unwrapped, as seen from the first of them."""
    seen = [np.interp(at_ns, stamps_ns, column) for column in (xyt[:, 0], xyt[:, 1], np.unwrap(xyt[:, 2]))]
    place = (seen[0] - seen[0][0] + 1j * (seen[1] - seen[1][0])) * np.exp(-1j * seen[2][0])
    return np.column_stack((place.real, place.imag, seen[2] - seen[2][0]))


def both(run):
    """Odometry and truth at the odometry's stamps, each from its own start."""
    at_ns = run.odom_stamps_ns[(run.odom_stamps_ns > run.truth_stamps_ns[0])]
    at_ns = at_ns[at_ns < run.truth_stamps_ns[-1]]
    return from_start(run.odom_stamps_ns, run.odom_xyt, at_ns), from_start(run.truth_stamps_ns, run.truth_xyt, at_ns)


def way_m(xyt):
    return np.hypot(*np.diff(xyt[:, :2], axis=0).T).sum()


def same(one, other):
    return all(np.array_equal(getattr(one, f.name), getattr(other, f.name)) for f in dataclasses.fields(one))


OF_THE_SENSORS = {"gyro_bias", "gyro_bias_walk", "gyro_scale", "magnetic_heading", "quantization", "lost_increments"}
OF_ONE_SIGN = {name for name, flaw in EVERY.items() if flaw.one_signed}
OF_ONE_SIGN |= {"region_slip", "wet_patch", "wet_strip", "slope", "overspeed_slip", "braking_drag"}
SOON = {
    "region_slip": {"radius": 100.0},
    "wet_patch": {"radius": 100.0},
    "wet_strip": {"width": 100.0},
    "slip_burst": {"rate": 1.0},
    "load_shift": {"time": 5.0},
    "overspeed_slip": {"speed": 0.1},
}
"""Parameters with which a flaw shows in half a minute."""


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_flawless_robot_reckons_the_truth(seed):
    odom, truth = both(silent(None, None, None, duration_s=280.0, seed=seed))
    assert way_m(truth) > 95.0
    assert np.abs(odom - truth).max() < 1e-3


def test_ticks_alone_cost_little():
    rig = dataclasses.replace(FLAWLESS_RIG, ticks_per_turn=4096)
    odom, truth = both(simulate(3, None, duration_s=280.0, rig=rig, truth=FLAWLESS_TRACKER))
    assert 1e-5 < np.abs(odom - truth).max() < 2e-2


def test_gyro_without_noise_reckons_the_truth():
    run = simulate(4, None, duration_s=280.0, rig=FLAWLESS_RIG, truth=FLAWLESS_TRACKER, yaw_from="gyro")
    odom, truth = both(run)
    assert np.abs(odom - truth).max() < 1e-3


def test_larger_right_wheel_bends_a_straight_to_the_left():
    odom, truth = both(silent("unequal_wheels", {"curvature": 0.01}, STRAIGHT))
    assert abs(odom[-1, 2]) < 1e-9
    assert truth[-1, 2] / odom[-1, 0] == pytest.approx(0.01, rel=1e-6)
    assert truth[-1, 1] > 0


def test_unequal_wheels_have_the_ratio_of_the_definition():
    run = silent("unequal_wheels", {"curvature": 0.01}, SPIN_LEFT)
    odom, truth = both(run)
    mean_travel_per_rad = (0.5 * run.track_m) * (0.5 * 0.01 * run.track_m)
    assert way_m(truth) / odom[-1, 2] == pytest.approx(mean_travel_per_rad, rel=1e-3)


def test_positive_gyro_bias_turns_the_odometry_left_at_standstill():
    run = silent("gyro_bias", {"bias": 0.005}, (REST,))
    odom, truth = both(run)
    elapsed_s = (run.odom_stamps_ns[-1] - run.odom_stamps_ns[0]) * 1e-9
    assert odom[-1, 2] == pytest.approx(0.005 * elapsed_s, rel=1e-3)
    assert np.abs(truth).max() < 1e-12


@pytest.mark.parametrize(("route", "omega_radps"), [(CIRCLE_LEFT, 0.5), (CIRCLE_RIGHT, -0.5)])
def test_yielding_tyres_move_the_robot_out_of_the_turn(route, omega_radps):
    run = silent("side_slip", {"k": 0.03}, route, duration_s=40.0)
    _, truth = both(run)
    late = truth[-500:]
    midway_rad = 0.5 * (late[1:, 2] + late[:-1, 2])
    step = np.diff(late[:, 0] + 1j * late[:, 1]) * np.exp(-1j * midway_rad)
    assert np.median(step.imag) * 50.0 == pytest.approx(-0.03 * 0.6 * omega_radps, rel=1e-2)


def test_yielding_tyres_do_nothing_on_a_straight():
    _, truth = both(silent("side_slip", {"k": 0.03}, STRAIGHT))
    assert np.abs(truth[:, 1:]).max() < 1e-9


def test_positive_time_offset_stamps_the_odometry_late():
    run = silent("time_offset", {"offset": 0.08}, STRAIGHT)
    half_m = 0.5 * both(run)[1][-1, 0]
    truth = from_start(run.truth_stamps_ns, run.truth_xyt, run.truth_stamps_ns)
    odom_ns = np.interp(half_m, run.odom_xyt[:, 0], run.odom_stamps_ns - run.truth_stamps_ns[0])
    truth_ns = np.interp(half_m, truth[:, 0], run.truth_stamps_ns - run.truth_stamps_ns[0])
    assert (odom_ns - truth_ns) * 1e-9 == pytest.approx(0.08, abs=1e-4)


def test_marker_circles_at_its_lever_arm():
    run = silent("lever_arm", {"x": 0.06, "y": -0.03}, SPIN_LEFT)
    odom, truth = both(run)
    arm = 0.06 - 0.03j
    expected = arm * (np.exp(1j * odom[:, 2]) - 1)
    assert np.abs(truth[:, 0] + 1j * truth[:, 1] - expected).max() < 1e-4


def test_yawed_marker_looks_left_of_the_way_it_goes():
    run = silent("mount_yaw", {"yaw": 0.05}, STRAIGHT)
    odom, truth = both(run)
    assert np.arctan2(truth[-1, 1], truth[-1, 0]) == pytest.approx(-0.05, abs=1e-6)
    assert np.abs(truth[:, 2] - odom[:, 2]).max() < 1e-9


@pytest.mark.parametrize("cause", [None, *EVERY])
def test_same_seed_same_bits(cause):
    assert same(simulate(7, cause, duration_s=20.0), simulate(7, cause, duration_s=20.0))


@pytest.mark.parametrize("cause", EVERY)
def test_flaw_of_no_size_is_the_run_without(cause):
    drawn = simulate(8, cause, duration_s=5.0).answer["parameters"]
    sizes = ("x", "y") if cause == "lever_arm" else (next(iter(drawn)),)
    nothing = simulate(8, cause, duration_s=30.0, parameters=dict.fromkeys(sizes, 0.0))
    without = simulate_without(8, cause, duration_s=30.0)
    assert np.array_equal(nothing.odom_xyt, without.odom_xyt)
    assert np.abs(nothing.truth_xyt - without.truth_xyt).max() < 1e-12
    assert without.answer["cause"] is None


@pytest.mark.parametrize("cause", EVERY)
def test_flaw_leaves_the_draws_of_other_layers_alone(cause):
    run = simulate(9, cause, route="yard", duration_s=40.0, parameters=SOON.get(cause))
    without = simulate_without(9, cause, route="yard", duration_s=40.0)
    assert np.array_equal(run.truth_stamps_ns, without.truth_stamps_ns)
    assert len(run.odom_xyt) == len(without.odom_xyt)
    clock, sensor = cause in {"time_offset", "clock_skew"}, cause in OF_THE_SENSORS
    assert np.array_equal(run.truth_xyt, without.truth_xyt) == (clock or sensor)
    assert np.array_equal(run.odom_xyt, without.odom_xyt) == (not sensor)
    assert np.array_equal(run.odom_stamps_ns, without.odom_stamps_ns) == (not clock)


@pytest.mark.parametrize("cause", EVERY)
def test_draws_stay_in_their_range_and_take_both_signs_where_there_are_two(cause):
    drawn = [list(draw_parameters(cause, 1.0, np.random.default_rng(seed)).values()) for seed in range(30)]
    magnitudes = [np.hypot(*values) if cause == "lever_arm" else abs(values[0]) for values in drawn]
    assert min(magnitudes) >= EVERY[cause].low * (1 - 1e-12)
    assert max(magnitudes) <= EVERY[cause].high * (1 + 1e-12)
    signs = {np.sign(values[0]) for values in drawn}
    assert signs == ({1.0} if cause in OF_ONE_SIGN else {-1.0, 1.0})


def test_robot_of_one_seed_drives_other_routes():
    here = simulate(10, "wheelbase", duration_s=30.0)
    there = simulate(11, "wheelbase", duration_s=30.0, robot_seed=10)
    assert here.answer == there.answer
    assert not np.array_equal(here.odom_xyt[:100], there.odom_xyt[:100]) or here.odom_xyt.shape != there.odom_xyt.shape


def test_drive_is_varied_and_stays_in_the_room():
    run = simulate(12, None)
    v_mps, omega_radps = run.odom_twist[:, 0], run.odom_twist[:, 2]
    standing = np.abs(v_mps) + np.abs(omega_radps) < 1e-3
    assert 0.02 < standing.mean() < 0.3
    assert v_mps.max() > 0.8
    assert v_mps.min() < -0.1
    assert ((np.abs(v_mps) < 0.01) & (np.abs(omega_radps) > 0.2)).mean() > 0.01
    assert min((omega_radps > 0.1).mean(), (omega_radps < -0.1).mean()) > 0.1
    assert np.abs(run.odom_xyt[:, :2]).max() < 30.0


def test_wheels_wander_with_the_root_of_the_way():
    rig = dataclasses.replace(FLAWLESS_RIG, creep=1.0)
    ends = []
    for seed in range(40):
        route = (REST, Segment(0.5, 0.0, 19.0), Segment(0.0, 0.0, 5.0))
        run = simulate(seed, None, robot_seed=0, route=route, duration_s=28.0, rig=rig, truth=FLAWLESS_TRACKER)
        odom, truth = both(run)
        ends.append(truth[-1, 2] / np.sqrt(2 * odom[-1, 0]) * run.track_m)
    assert 0.0007 < np.std(ends) < 0.004


@pytest.mark.parametrize(("kind", "rate_hz"), [("mocap", 100.0), ("rtk", 10.0)])
def test_truth_has_its_rate_noise_and_dropouts(kind, rate_hz):
    run = simulate(13, None, route=(REST,), truth=kind)
    gaps_s = np.diff(run.truth_stamps_ns) * 1e-9
    assert np.median(gaps_s) == pytest.approx(1 / rate_hz, rel=1e-2)
    assert gaps_s.max() > 2 / rate_hz
    assert np.std(np.diff(run.truth_xyt[:, 0])) / np.sqrt(2) == pytest.approx(TRACKERS[kind].noise_m, rel=0.1)
    assert np.std(np.unwrap(run.truth_xyt[:, 2])) == pytest.approx(TRACKERS[kind].noise_rad, rel=0.1)


@pytest.mark.parametrize("cause", ["time_offset", None])
def test_stamps_increase(cause):
    run = simulate(14, cause, duration_s=60.0)
    assert run.odom_stamps_ns.dtype == run.truth_stamps_ns.dtype == np.int64
    assert (np.diff(run.odom_stamps_ns) > 0).all()
    assert (np.diff(run.truth_stamps_ns) > 0).all()


def test_mcap_says_what_the_run_says(tmp_path):
    run = simulate(15, "wheelbase", duration_s=10.0)
    write_mcap(run, tmp_path / "run.mcap")
    found = {"/odom": [], "/tf": [], "/ground_truth": []}
    with (tmp_path / "run.mcap").open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            found[channel.topic].append((message.log_time, STORE.deserialize_cdr(message.data, schema.name)))
    assert [log_ns for log_ns, _ in found["/odom"]] == run.odom_stamps_ns.tolist()
    assert [log_ns for log_ns, _ in found["/ground_truth"]] == run.truth_stamps_ns.tolist()
    for (_, odom), (_, tf), xyt, twist in zip(found["/odom"], found["/tf"], run.odom_xyt, run.odom_twist, strict=True):
        pose, link = odom.pose.pose, tf.transforms[0].transform
        assert (pose.position.x, pose.position.y) == (link.translation.x, link.translation.y) == tuple(xyt[:2])
        assert pose.orientation == link.rotation
        assert 2 * np.arctan2(pose.orientation.z, pose.orientation.w) == pytest.approx(xyt[2])
        assert (odom.twist.twist.linear.x, odom.twist.twist.angular.z) == (twist[0], twist[2])
    first = found["/ground_truth"][0][1]
    assert (first.header.frame_id, first.pose.position.x) == ("world", run.truth_xyt[0, 0])


def driven(route, seed=6, duration_s=300.0):
    run = simulate(seed, None, route=route, duration_s=duration_s, rig=FLAWLESS_RIG, truth=FLAWLESS_TRACKER)
    return both(run)[1], run.odom_twist


@pytest.mark.parametrize("route", ROUTES)
def test_route_begins_and_ends_at_rest_and_stays_near(route):
    truth, twist = driven(route)
    assert np.abs(twist[:30]).max() < 1e-6
    assert np.abs(twist[-30:]).max() < 1e-3
    assert np.abs(truth[:, :2]).max() < 20.0
    assert way_m(truth) > 30.0


@pytest.mark.parametrize("route", ROUTES)
def test_other_seed_other_drive(route):
    assert not np.array_equal(driven(route, 6, 60.0)[1], driven(route, 7, 60.0)[1])


@pytest.mark.parametrize("route", ["loops", "slalom", "yard", "office", "umbmark"])
def test_turns_both_ways(route):
    turn = driven(route, duration_s=600.0)[1][:, 2]
    left, right = turn.clip(min=0.0).sum(), -turn.clip(max=0.0).sum()
    assert 0.25 < left / right < 4.0


def test_shuttle_never_turns_and_reverses():
    truth, twist = driven("shuttle")
    assert np.abs(truth[:, 2]).max() < 1e-6
    assert twist[:, 0].min() < -0.15


def test_slalom_has_several_speeds():
    speeds = driven("slalom", duration_s=600.0)[1][:, 0]
    assert all((np.abs(speeds - v) < 0.02).mean() > 0.03 for v in (0.3, 0.6, 0.9))


def test_umbmark_closes_its_squares_and_turns_round_after_five():
    truth, _ = driven("umbmark", duration_s=600.0)
    assert np.ptp(truth[:, 0]) == pytest.approx(4.0, abs=0.3)
    assert 4.0 < np.ptp(truth[:, 1]) < 8.5
    turned = np.unwrap(truth[:, 2])
    assert turned.min() == pytest.approx(-10 * np.pi, abs=0.2)


def write_commands(path, rows, kind="Twist", topic="/cmd_vel"):
    messages = []
    for t, v, omega in rows:
        message = rosmessages.twist(2, (v, 0.0, 0.0, 0.0, 0.0, omega))
        if kind == "TwistStamped":
            message = rosmessages.new(2, "geometry_msgs/TwistStamped", rosmessages.header(2, 0, ""), message)
        messages.append((round(1e9 * t) + 10**18, topic, message))
    rosmessages.write(path, messages)


@pytest.mark.parametrize("kind", ["Twist", "TwistStamped"])
def test_bag_of_commands_is_followed(tmp_path, kind):
    times = np.arange(0.0, 12.0, 0.1)
    rows = [(t, 0.5 if t < 8.0 else 0.0, 0.0 if t < 8.0 else 0.4) for t in times]
    write_commands(tmp_path / "next.mcap", rows, kind)
    commands = read_commands(tmp_path / "next.mcap")
    assert commands.duration_s == pytest.approx(15.9)
    truth, _ = driven(commands, duration_s=commands.duration_s)
    assert np.abs(truth[:, 0]).max() == pytest.approx(4.0, abs=0.02)
    assert truth[-1, 2] == pytest.approx(0.4 * 4.0, abs=0.02)


def test_base_obeys_no_faster_than_it_can():
    sudden = Commands(np.array([0.0, 5.0]), np.array([1.0, 0.0]), np.zeros(2))
    _, twist = driven(sudden, duration_s=9.0)
    assert np.abs(np.diff(twist[:, 0])).max() < 2.6 * 0.021


def test_bag_without_commands_says_what_it_has(tmp_path):
    rosmessages.write(tmp_path / "no.mcap", [(1, "/other", rosmessages.new(2, "std_msgs/String", "go"))])
    with pytest.raises(TopicError, match="found /other"):
        read_commands(tmp_path / "no.mcap")
    write_commands(tmp_path / "two.mcap", [(0.0, 0.1, 0.0)], topic="/joy_vel")
    assert read_commands(tmp_path / "two.mcap").v_mps.tolist() == [0.1]
    (tmp_path / "no.mcap").write_bytes(b"no bag")
    with pytest.raises(BagError):
        read_commands(tmp_path / "no.mcap")


SPIN_RIGHT = (REST, Segment(0.0, -0.8, 19.0), Segment(0.0, 0.0, 5.0))
FASTER = (REST, Segment(1.0, 0.0, 19.0), Segment(0.0, 0.0, 5.0))
BACK = (REST, Segment(-0.5, 0.0, 19.0), Segment(0.0, 0.0, 5.0))
CRUISE = slice(500, 900)


GAINS = [
    ("wheel_scale", {"e": 0.01}, STRAIGHT, 1.01),
    ("wheelbase", {"e": 0.02}, SPIN_LEFT, 1 / 1.02),
    ("gyro_scale", {"e": 0.02}, SPIN_LEFT, 1 / 1.02),
    ("turn_asymmetry", {"k": 0.02}, SPIN_LEFT, 1.02),
    ("turn_asymmetry", {"k": 0.02}, SPIN_RIGHT, 0.98),
    ("turn_scrub", {"k": 0.05}, SPIN_LEFT, 1 / (1 + 0.05 * 0.8)),
    *(("speed_scale", {"k": 0.02}, route, 1 + 0.02 * v) for route, v in ((STRAIGHT, 0.5), (FASTER, 1.0), (BACK, 0.5))),
    *(("overspeed_slip", {"slip": 0.05, "speed": v}, STRAIGHT, ratio) for v, ratio in ((0.4, 0.95), (0.6, 1.0))),
    # tyres that warm up, 14 s after the start on the average
    ("scale_drift", {"rate": 1e-3}, STRAIGHT, pytest.approx(1 + 1e-3 * 14.0, abs=3e-4)),
]


@pytest.mark.parametrize(("cause", "parameters", "route", "gain"), GAINS)
def test_the_truth_goes_or_turns_more_than_the_odometry_by_a_gain(cause, parameters, route, gain):
    odom, truth = (xyt[CRUISE] for xyt in both(silent(cause, parameters, route)))
    along = way_m(odom) > 0.1
    ratio = way_m(truth) / way_m(odom) if along else np.ptp(truth[:, 2]) / np.ptp(odom[:, 2])
    assert ratio == (pytest.approx(gain, abs=1e-6) if isinstance(gain, float) else gain)


def start(seed=5):
    """Where a drive of this seed begins in the truth frame: place as x + iy, and heading."""
    x, y, heading = silent(None, None, (REST,), duration_s=10.0, seed=seed).truth_xyt[0]
    return x + 1j * y, heading


def test_rotation_centre_behind_swings_the_base_as_a_lever_arm_would():
    odom, truth = both(silent("icr_shift", {"x": 0.05}, SPIN_LEFT))
    assert np.abs(truth[:, 0] + 1j * truth[:, 1] - 0.05 * (np.exp(1j * odom[:, 2]) - 1)).max() < 1e-4


def test_gyro_bias_walks_with_the_root_of_time_even_at_rest():
    ends = []
    for seed in range(40):
        run = silent("gyro_bias_walk", {"density": 1e-3}, (REST,), seed=seed, duration_s=20.0)
        rate = np.diff(np.unwrap(run.odom_xyt[:, 2])) / np.diff(run.odom_stamps_ns) * 1e9
        ends.append(rate[-1])
        assert np.ptp(run.truth_xyt[:, 2]) < 1e-12
    assert np.std(ends) == pytest.approx(1e-3 * np.sqrt(20.0), rel=0.3)


@pytest.mark.parametrize(("route", "sign"), [(STRAIGHT, 1), (BACK, -1)])
def test_traction_loses_way_while_speeding_up_and_gives_it_back_while_braking(route, sign):
    odom, truth = both(silent("accel_slip", {"k": 0.04}, route))
    behind = sign * (odom[:, 0] - truth[:, 0])
    assert behind[700] == pytest.approx(0.04 * 0.5 * 0.5**2, rel=0.05)
    assert abs(behind[-1]) < 0.06 * behind[700]  # what is left is of second order


def test_patch_takes_its_part_of_the_way_rolled_in_it():
    place, heading = start()
    centre = place + 4.0 * np.exp(1j * heading)
    patch = {"slip": 0.1, "x": centre.real, "y": centre.imag, "radius": 1.5}
    odom, truth = both(silent("region_slip", patch, STRAIGHT))
    assert odom[-1, 0] - truth[-1, 0] == pytest.approx(0.1 / 0.9 * 3.0, abs=0.002)
    assert abs(truth[-1, 2]) < 1e-9


@pytest.mark.parametrize(("route", "side"), [(STRAIGHT, 1), (BACK, 1)])
def test_slope_pulls_downhill_per_metre_driven_either_way(route, side):
    _, heading = start()
    odom, truth = both(silent("slope", {"creep": 0.02, "direction": heading + 0.5 * np.pi}, route))
    assert truth[-1, 1] == pytest.approx(side * 0.02 * way_m(odom), rel=1e-3)
    assert truth[-1, 0] == pytest.approx(odom[-1, 0], abs=1e-3)


def test_gear_play_is_lost_at_each_reversal():
    there, back = (Segment(v, 0.0, 5.0) for v in (0.4, -0.4))
    rest = Segment(0.0, 0.0, 2.0)
    odom, truth = both(silent("backlash", {"travel": 0.01}, (REST, there, rest, back, rest), 25.0))
    assert truth[-1, 0] - odom[-1, 0] == pytest.approx(0.01, abs=1e-6)
    odom, truth = both(silent("backlash", {"travel": 0.01}, (REST, there, rest, back, rest, there, rest), 30.0))
    assert abs(truth[-1, 0] - odom[-1, 0]) < 1e-6
    odom, truth = both(silent("backlash", {"travel": 0.01}, STRAIGHT))
    assert np.abs(truth - odom).max() < 1e-5


def test_bursts_take_their_mean_part_of_the_way_and_sometimes_turn_the_robot():
    parts, turns = [], []
    for seed in range(40):
        run = silent("slip_burst", {"rate": 0.2, "slip": 0.5, "duration": 0.3}, STRAIGHT, seed=seed)
        odom, truth = both(run)
        parts.append(1 - way_m(truth) / way_m(odom))
        turns.append(truth[-1, 2])
    assert np.mean(parts) == pytest.approx(0.2 * 0.3 * 0.5, rel=0.25)
    assert np.std(turns) > 0.02


@pytest.mark.parametrize(("channel", "route"), [("along", STRAIGHT), ("yaw", SPIN_LEFT)])
def test_gain_wanders_with_its_deviation_in_its_channel_only(channel, route):
    gains = []
    for seed in range(40):
        run = silent("gauss_markov", {"sigma": 0.03, "tau": 20.0, "channel": channel}, route, seed=seed)
        odom, truth = (xyt[600:625] for xyt in both(run))
        column = 0 if channel == "along" else 2
        gains.append((truth[-1, column] - truth[0, column]) / (odom[-1, column] - odom[0, column]) - 1)
        assert np.abs(truth[:, 2 - column] - odom[:, 2 - column]).max() < 1e-3
    assert np.std(gains) == pytest.approx(0.03, rel=0.3)


def test_the_difference_of_the_wheels_wanders_by_the_way_driven_and_not_at_rest():
    bends = []
    for seed in range(40):
        run = silent("gauss_markov", {"sigma": 0.03, "tau": 20.0, "channel": "wheels"}, STRAIGHT, seed=seed)
        odom, truth = (xyt[600:625] for xyt in both(run))
        bends.append((truth[-1, 2] - truth[0, 2] - odom[-1, 2] + odom[0, 2]) / way_m(odom))
    assert np.std(bends) == pytest.approx(0.03, rel=0.3)
    odom, truth = both(silent("gauss_markov", {"sigma": 0.03, "tau": 20.0, "channel": "wheels"}, SPIN_LEFT, seed=1))
    assert np.abs(truth[:, 2] - odom[:, 2]).max() < 1e-3


def test_heavy_tails_are_heavy():
    rig, route = dataclasses.replace(FLAWLESS_RIG, creep=1.0), (REST, Segment(0.5, 0.0, 900.0))
    options = {"rig": rig, "truth": FLAWLESS_TRACKER, "route": route, "duration_s": 600.0}
    kurtosis = []
    for parameters in ({"inverse_dof": 0.0}, {"inverse_dof": 0.3}):
        odom, truth = both(simulate(3, "heavy_tails", parameters=parameters, **options))
        turns = np.diff((truth - odom)[500::25, 2])
        kurtosis.append(np.mean(turns**4) / np.mean(turns**2) ** 2)
    assert kurtosis[0] == pytest.approx(3.0, abs=0.4)
    assert kurtosis[1] > 4.5


def test_coarse_ticks_leave_a_lattice():
    run = silent("quantization", {"step": 0.004}, STRAIGHT)
    steps = np.hypot(*np.diff(run.odom_xyt[:, :2], axis=0).T)[np.abs(run.odom_twist[1:, 2]) < 1e-9] / 0.004
    assert np.abs(steps - np.rint(steps)).max() < 1e-6
    assert 3 <= len(set(np.rint(steps))) <= 5
    assert run.odom_xyt[-1, 0] == pytest.approx(both(run)[1][-1, 0], abs=0.01)


def test_lost_cycles_stand_still_between_moving_neighbours():
    run = silent("lost_increments", {"fraction": 0.1}, FASTER)
    odom, truth = both(run)
    still = np.diff(odom[CRUISE, 0]) == 0.0
    assert np.mean(still) == pytest.approx(0.1, abs=0.04)
    assert odom[-1, 0] / truth[-1, 0] == pytest.approx(0.9, abs=0.02)


def test_fast_clock_counts_more_seconds():
    run, without = (silent("clock_skew", {"rate": rate}, STRAIGHT) for rate in (1e-3, 0.0))
    elapsed_s, true_s = ((r.odom_stamps_ns[-1] - r.odom_stamps_ns[0]) * 1e-9 for r in (run, without))
    assert elapsed_s / true_s == pytest.approx(1.001, abs=1e-9)


def test_tracker_may_have_the_wrong_clock():
    late = dataclasses.replace(FLAWLESS_TRACKER, clock_offset_s=0.5, clock_rate=1e-3)
    assert isinstance(late, Tracker)
    run = simulate(5, None, route=STRAIGHT, duration_s=28.0, truth=late, rig=FLAWLESS_RIG)
    right = silent(None, None, STRAIGHT)
    shift_ns = run.truth_stamps_ns - right.truth_stamps_ns
    assert shift_ns[0] * 1e-9 == pytest.approx(0.5, abs=1e-3)
    assert shift_ns[-1] * 1e-9 == pytest.approx(0.528, abs=1e-3)


def test_satellites_wander_slowly():
    run = simulate(13, None, route=(REST,), truth="rtk", duration_s=600.0)
    far_m = run.truth_xyt[3000:, :2] - run.truth_xyt[:-3000, :2]
    assert np.std(far_m) / np.sqrt(2) == pytest.approx(np.hypot(0.012, 0.01), rel=0.3)
    slow = np.convolve(run.truth_xyt[:, 0], np.ones(50) / 50, "valid")
    assert np.std(slow) > 0.004


def test_axle_out_of_centre_wags_the_robot_once_per_turn_of_the_wheel():
    robot = build_robot(stream(5, "robot"))
    odom, truth = both(silent("eccentric_wheel", {"e": 0.05, "phase": 0.0}, STRAIGHT))
    expected = 0.05 * robot.nominal_radius_m / robot.nominal_track_m * np.sin(odom[:, 0] / robot.nominal_radius_m)
    assert np.abs(truth[:, 2] - expected).max() < 1e-3


def test_iron_turns_the_compass_by_the_heading():
    heading = start()[1]
    odom, truth = both(silent("magnetic_heading", {"amplitude": 0.05, "direction": 0.3}, SPIN_LEFT))
    facing = truth[:, 2] + heading - 0.3
    assert np.abs(odom[:, 2] - truth[:, 2] - 0.05 * (np.sin(facing) - np.sin(heading - 0.3))).max() < 1e-4


def test_carpet_pulls_towards_its_ribs_whichever_way_one_goes():
    parameters = {"creep": 0.02, "direction": start()[1] + 0.25 * np.pi}
    odom, truth = both(silent("floor_grain", parameters, STRAIGHT))
    assert truth[-1, 1] == pytest.approx(0.02 * odom[-1, 0], rel=1e-3)


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


def test_strip_takes_its_part_across_its_width():
    place, heading = start()
    middle = place + 4.0 * np.exp(1j * heading)
    parameters = {"x": middle.real, "y": middle.imag, "direction": heading + 0.5 * np.pi, "width": 2.0, "slip": 0.1}
    odom, truth = both(silent("wet_strip", parameters, STRAIGHT))
    assert odom[-1, 0] - truth[-1, 0] == pytest.approx(0.2 / 0.9, abs=0.003)


def test_patch_under_the_left_wheel_alone_turns_to_the_left():
    place, heading = start()
    centre = place + (4.0 + 0.65j) * np.exp(1j * heading)
    patch = {"slip": 0.1, "x": centre.real, "y": centre.imag, "radius": 0.6}
    odom, truth = both(silent("wet_patch", patch, STRAIGHT))
    assert truth[-1, 2] > 0.05
    assert abs(odom[-1, 2]) < 1e-9


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
    for h in drawn[:30]:
        simulate(1, h.causes, yaw_from=h.yaw_from, duration_s=6.0)


def simulated(folder, *options, name="out"):
    code = run(["simulate", str(folder / f"{name}.mcap"), "--duration", "15", *options])
    assert code == 0
    return folder / f"{name}.mcap", folder / f"{name}.answer.toml"


def metadata(bag):
    with bag.open("rb") as file:
        return {record.name: record.metadata for record in make_reader(file).iter_metadata()}


def answered(file):
    return tomllib.loads(file.read_text())


@pytest.mark.parametrize("effect", ["hidden", "none", "region_slip", "gyro_bias", "eccentric_wheel"])
def test_answer_is_beside_the_bag_and_only_its_hash_in_it(tmp_path, effect):
    bag, secret = simulated(tmp_path, "--effect", effect, "--seed", "6")
    assert metadata(bag) == {"simulate": {"answer_sha256": sha256(secret.read_bytes()).hexdigest()}}
    with bag.open("rb") as file:
        said = b" ".join(message.data for _, _, message in make_reader(file).iter_messages())
    with bag.open("rb") as file:
        reader = make_reader(file)
        assert not list(reader.iter_attachments())
        assert reader.get_header().library == "wheelsim"
    assert not any(name.encode() in said + bag.read_bytes() for name in (*EVERY, "salt", "seed"))


def test_hidden_is_the_default_and_the_same_seed_makes_the_same_files(tmp_path):
    one, secret = simulated(tmp_path, "--seed", "9")
    two, again = simulated(tmp_path, "--effect", "hidden", "--seed", "9", name="two")
    assert one.read_bytes() == two.read_bytes()
    assert secret.read_bytes() == again.read_bytes()
    other, _ = simulated(tmp_path, "--seed", "10", name="three")
    assert one.read_bytes() != other.read_bytes()


def test_hidden_robot_is_met_again_in_another_drive(tmp_path):
    _, first = simulated(tmp_path, "--seed", "9")
    write_commands(tmp_path / "next.mcap", [(0.1 * i, 0.5, 0.0) for i in range(100)])
    _, second = simulated(tmp_path, "--seed", "11", "--robot", "9", "--drive", str(tmp_path / "next.mcap"), name="b")
    assert answered(first)["causes"] == answered(second)["causes"]
    assert answered(first)["heading"] == answered(second)["heading"]


def test_mixture_with_some_parameters_given(tmp_path):
    options = ("--effect", "mount_yaw:yaw=2deg", "--effect", "gauss_markov:channel=yaw,tau=5", "--size", "strong")
    _, secret = simulated(tmp_path, *options, "--truth", "rtk", "--drive-type", "skid", "--route", "yard")
    answer = answered(secret)
    yawed, wandering = answer["causes"]
    assert (yawed["name"], yawed["in_library"]) == ("mount_yaw", True)
    assert yawed["parameters"]["yaw"] == pytest.approx(0.0349, abs=1e-4)
    assert (wandering["parameters"]["channel"], wandering["parameters"]["tau"]) == ("yaw", 5.0)
    assert wandering["parameters"]["sigma"] >= 0.02
    assert (answer["drive_type"], answer["truth"], answer["route"]) == ("skid", "rtk", "yard")


def test_cause_of_no_library_says_what_it_depends_on(tmp_path):
    _, secret = simulated(tmp_path, "--effect", "floor_grain")
    assert answered(secret)["causes"][0] | {"parameters": 0} == {
        "name": "floor_grain",
        "in_library": False,
        "depends_on": "heading",
        "parameters": 0,
    }


def test_control_has_no_causes(tmp_path):
    _, secret = simulated(tmp_path, "--effect", "none", "--heading", "gyro")
    assert answered(secret)["causes"] == []


@pytest.mark.parametrize(
    ("options", "code", "says"),
    [
        (["--effect", "wheel_skale"], 2, "is not a cause"),
        (["--effect", "slope", "--effect", "slope"], 2, "once"),
        (["--effect", "gyro_bias", "--heading", "wheels"], 2, "has no effect"),
        (["--effect", "gyro_bias", "--effect", "wheelbase"], 2, "different sources"),
        (["--effect", "slope:crep=0.1"], 2, "it has creep, direction"),
        (["--effect", "side_slip:k=-0.1"], 2, "must not be negative"),
        (["--effect", "slope:creep=much"], 2, "is not a number"),
        (["--effect", "gauss_markov:channel=up"], 2, "along, yaw or wheels"),
    ],
)
def test_what_makes_no_sense_is_said(tmp_path, invoke, options, code, says):
    assert says in invoke(["simulate", tmp_path / "out.mcap", *options], code).err
    assert not list(tmp_path.iterdir())


def test_nothing_is_overwritten_unasked(tmp_path, invoke):
    simulated(tmp_path)
    assert "exists already" in invoke(["simulate", tmp_path / "out.mcap"], 1).err
    (tmp_path / "out.mcap").unlink()
    assert run(["simulate", str(tmp_path / "out.mcap")]) == 1
    simulated(tmp_path, "--overwrite")


def test_pipe_needs_a_place_for_the_answer(tmp_path, capfdbinary):
    assert run(["simulate", "-", "--duration", "15"]) == 2
    assert run(["simulate", "-", "--duration", "15", "--seed", "0", "--answer", str(tmp_path / "a.toml")]) == 0
    said = capfdbinary.readouterr().out
    bag, _ = simulated(tmp_path, "--seed", "0")
    assert said == bag.read_bytes()
