"""Wheels, ticks and gyros of a corrupted bag, integrated from another library's reading, give the noisy odometry."""

from __future__ import annotations

import numpy as np
import pytest
from bagged import messages_in
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

import odomcorrupt
from odomcorrupt.cli import run

STORE = get_typestore(Stores.ROS2_HUMBLE)
TICKS = "irobot_create_msgs/msg/WheelTicks"
STORE.register(get_types_from_msg("std_msgs/Header header\nint32 ticks_left\nint32 ticks_right", TICKS))
RADIUS_M, TRACK_M, PER_RAD = 0.05, 0.34, 4000.0
JOINTS = ["left_wheel", "arm", "right_wheel", "scanner"]
NOISE = odomcorrupt.Noise(alpha=(0.1, 0.05, 0.1, 0.02))


def new(name, *fields):
    package, _, kind = name.partition("/")
    return STORE.types[f"{package}/msg/{kind}"](*fields)


def vector(*xyz, kind="Vector3"):
    return new(f"geometry_msgs/{kind}", *map(float, xyz))


def heading(yaw):
    return new("geometry_msgs/Quaternion", 0.0, 0.0, float(np.sin(yaw / 2)), float(np.cos(yaw / 2)))


def drive(turning):
    """Return times (n,), s, speeds (n,) and turn rates (n,) in the interval before each, and poses (n, 3)."""
    t = np.arange(0.0, 60.0, 0.02)
    v = 0.5 + 0.2 * np.sin(0.3 * t)
    w = turning * 0.5 * np.sin(0.2 * t)
    v[0] = w[0] = 0.0
    yaw = np.cumsum(0.02 * w)
    middle = yaw - 0.01 * w
    return t, v, w, np.column_stack((np.cumsum(0.02 * v * np.cos(middle)), np.cumsum(0.02 * v * np.sin(middle)), yaw))


def write(path, turning=1.0):
    """Write odometry at 50 Hz and its sensors at the same stamps: the right wheel is mirrored, the IMU upside down."""
    t, v, w, poses = drive(turning)
    left, right = (np.cumsum(0.02 * (v + sign * w * TRACK_M / 2)) / RADIUS_M for sign in (-1, 1))
    nine, none = np.zeros(9), np.zeros(36)
    types = {"/odom": "nav_msgs/msg/Odometry", "/joint_states": "sensor_msgs/msg/JointState", "/ticks": TICKS,
             "/imu": "sensor_msgs/msg/Imu", "/left_encoder": "std_msgs/msg/Int32"}  # fmt: skip
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections = {topic: writer.add_connection(topic, name, typestore=STORE) for topic, name in types.items()}
        for i, (x, y, yaw) in enumerate(poses):
            stamp = 1_700_000_000 * 10**9 + round(t[i] * 1e9)
            head = lambda frame: new("std_msgs/Header", new("builtin_interfaces/Time", *divmod(stamp, 10**9)), frame)  # noqa: B023, E731
            pose = new("geometry_msgs/Pose", vector(x, y, 0, kind="Point"), heading(yaw))
            twist = new("geometry_msgs/Twist", vector(v[i], 0, 0), vector(0, 0, w[i]))
            odometry = new(
                "nav_msgs/Odometry", head("odom"), "base", new("geometry_msgs/PoseWithCovariance", pose, none),
                new("geometry_msgs/TwistWithCovariance", twist, none),
            )  # fmt: skip
            speeds = (v[i] + np.array([-1, 1]) * w[i] * TRACK_M / 2) / RADIUS_M
            positions = np.array([(left[i] + np.pi) % (2 * np.pi) - np.pi, 0.3, -right[i], 9.0 * t[i]])
            joints = new("sensor_msgs/JointState", head(""), JOINTS, positions,
                         np.array([speeds[0], 0.0, -speeds[1], 9.0]), np.zeros(0))  # fmt: skip
            imu = new("sensor_msgs/Imu", head("imu"), heading(yaw), nine, vector(0, 0, -w[i] + 0.01), nine,
                      vector(0, 0, -9.8), nine)  # fmt: skip
            ticks = new(f"{TICKS.replace('/msg', '')}", head(""), *(int(PER_RAD * a) for a in (left[i], right[i])))
            encoder = new("std_msgs/Int32", int(-PER_RAD * left[i]))
            every = dict(zip(types, (odometry, joints, ticks, imu, encoder), strict=True))
            for topic, message in every.items():
                writer.write(connections[topic], stamp, STORE.serialize_cdr(message, types[topic]))
    return path


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    return write(tmp_path_factory.mktemp("drive") / "in")


def read(path):
    found = {}
    with AnyReader([path], default_typestore=STORE) as reader:
        for connection, _, raw in reader.messages():
            found.setdefault(connection.topic, []).append(STORE.deserialize_cdr(raw, connection.msgtype))
    return found


def integrated(left, right):
    """Return poses (n, 3) from running wheel angles."""
    ds, turn = RADIUS_M * (np.diff(left) + np.diff(right)) / 2, RADIUS_M * (np.diff(right) - np.diff(left)) / TRACK_M
    yaw = np.concatenate(([0.0], np.cumsum(turn)))
    middle = yaw[:-1] + turn / 2
    return np.column_stack((np.cumsum(ds * np.cos(middle)), np.cumsum(ds * np.sin(middle)), yaw[1:]))


def test_whoever_integrates_wheels_or_gyro_gets_the_noisy_odometry(source, tmp_path):
    target = tmp_path / "out"
    done = odomcorrupt.corrupt(source, target, model=NOISE, seed=3, consistent=True)
    assert done.outcome.with_true_motion == []
    before, after = read(source), read(target)
    places = [
        np.array([(m.pose.pose.position.x, m.pose.pose.position.y) for m in bag["/odom"]]) for bag in (before, after)
    ]
    turns = [m.pose.pose.orientation for m in after["/odom"]]
    yaw = np.unwrap([2 * np.arctan2(q.z, q.w) for q in turns])
    drift_m = np.hypot(*(places[1] - places[0]).T).max()
    assert drift_m > 0.5
    noisy = np.column_stack((places[1], yaw))

    joints = after["/joint_states"]
    position, velocity = (np.array([getattr(m, name) for m in joints]) for name in ("position", "velocity"))
    assert np.abs(position[:, 0]).max() <= np.pi
    dt = 0.02
    rows = {
        "positions": (np.unwrap(position[:, 0]), -position[:, 2]),
        "velocities": (np.cumsum(velocity[:, 0]) * dt, -np.cumsum(velocity[:, 2]) * dt),
        "ticks": [
            np.array([getattr(m, f"ticks_{side}") for m in after["/ticks"]]) / PER_RAD for side in ("left", "right")
        ],
    }
    for name, wheels in rows.items():
        off = integrated(*wheels) - (noisy[1:] - np.append(noisy[0, :2], 0.0))
        assert np.hypot(*off[:, :2].T).max() < 0.02 * drift_m, name
        assert np.abs(off[:, 2]).max() < 2e-3, name
    encoder = -np.array([m.data for m in after["/left_encoder"]])
    assert np.abs(encoder - PER_RAD * rows["ticks"][0]).max() <= 3
    rate = np.array([m.angular_velocity.z for m in after["/imu"]])
    assert np.abs(np.cumsum(0.01 - rate[1:]) * dt - yaw[1:]).max() < 1e-3
    facing = np.unwrap([2 * np.arctan2(m.orientation.z, m.orientation.w) for m in after["/imu"]])
    assert np.abs(facing - yaw).max() < 1e-3
    for column in (1, 3):
        assert np.array_equal(position[:, column], [m.position[column] for m in before["/joint_states"]])
    assert {m.linear_acceleration.z for m in after["/imu"]} == {-9.8}


def test_without_the_option_they_stay_and_are_named(source, tmp_path):
    done = odomcorrupt.corrupt(source, tmp_path / "out", model=NOISE, seed=3)
    named = ["/imu", "/joint_states", "/left_encoder", "/ticks"]
    assert done.outcome.with_true_motion == named
    before, after = ([m for m in messages_in(path) if m[0] in named] for path in (source, tmp_path / "out"))
    assert before == after


def test_a_batch_has_the_bytes_of_single_runs(source, tmp_path):
    options = {"model": NOISE, "seed": 3, "consistent": True}
    odomcorrupt.batch([source], tmp_path / "runs", runs=2, to="mcap", **options)
    odomcorrupt.corrupt(source, tmp_path / "one.mcap", run=1, **options)
    (made,) = (tmp_path / "runs").glob("*1.mcap")
    assert made.read_bytes() == (tmp_path / "one.mcap").read_bytes()


@pytest.mark.parametrize(("words", "code", "said"), [
    ([], 1, "the bag does not tell how"), (["--tf", "correction", "--new-odom-frame", "a"], 2, "leave one"),
])  # fmt: skip
def test_what_cannot_be_known_or_contradicts_is_one_line(tmp_path, capsys, words, code, said):
    source = write(tmp_path / "in", turning=0.0)
    assert run([str(source), str(tmp_path / "out"), "--consistent", *words]) == code
    assert said in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
