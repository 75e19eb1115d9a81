"""Routes do what their names say, and a bag of commands is followed."""

import numpy as np
import pytest
from mcap.writer import Writer
from simulated_manoeuvres import FLAWLESS_RIG, FLAWLESS_TRACKER, both, way_m

from odomcorrupt.errors import BagError, TopicError
from odomcorrupt.simulation import ROUTES, Commands, read_commands, simulate
from odomcorrupt.simulation.run import STORE


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
    types = STORE.types
    typename = f"geometry_msgs/msg/{kind}"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start("ros2", "test")
        text, _ = STORE.generate_msgdef(typename, ros_version=2)
        schema = writer.register_schema(typename, "ros2msg", text.encode())
        channel = writer.register_channel(topic, "cdr", schema)
        vector = types["geometry_msgs/msg/Vector3"]
        for t, v, omega in rows:
            message = types["geometry_msgs/msg/Twist"](
                linear=vector(x=v, y=0.0, z=0.0), angular=vector(x=0.0, y=0.0, z=omega)
            )
            if kind == "TwistStamped":
                stamp = types["builtin_interfaces/msg/Time"](sec=0, nanosec=0)
                header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="")
                message = types[typename](header=header, twist=message)
            stamp_ns = round(1e9 * t) + 10**18
            writer.add_message(channel, stamp_ns, bytes(STORE.serialize_cdr(message, typename)), stamp_ns)
        writer.finish()


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
    write_commands(tmp_path / "other.mcap", [], topic="/other")
    with pytest.raises(TopicError, match="other"):
        read_commands(tmp_path / "other.mcap")
    write_commands(tmp_path / "two.mcap", [(0.0, 0.1, 0.0)], topic="/joy_vel")
    assert read_commands(tmp_path / "two.mcap").v_mps.tolist() == [0.1]
    (tmp_path / "no.mcap").write_bytes(b"no bag")
    with pytest.raises(BagError):
        read_commands(tmp_path / "no.mcap")
