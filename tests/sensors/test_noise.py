"""Noise of scans and IMUs: another library reads the errors that were asked for, and nothing else changed."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from rosbags.rosbag1 import Writer as Ros1LibraryWriter
from rosbags.typesys import Stores, get_typestore

import odomcorrupt
from odomcorrupt.cli import run
from odomcorrupt.errors import TopicError
from recordings import FIXTURES

STILL = odomcorrupt.Noise(alpha=(0.0, 0.0, 0.0, 0.0))
KALIBR = """# of a laboratory
gyroscope_noise_density: {0}  #Noise density (continuous-time)
gyroscope_random_walk: {1}
accelerometer_noise_density: {2}
accelerometer_random_walk: {3}
rostopic: /imu0
update_rate: 200.0
"""
STD_M, KEEP = 0.02, 0.7


def read(path):
    """Return the messages by topic, with log times and bytes."""
    found = {}
    with AnyReader([Path(path)], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        for connection, log_ns, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype) if connection.topic in ("/scan", "/imu") else None
            found.setdefault(connection.topic, []).append((log_ns, bytes(raw), message))
    return found


def corrupted(target, name="office.mcap", model=STILL, **options):
    return read(odomcorrupt.corrupt(FIXTURES / name, target, model=model, seed=5, overwrite=True, **options).target)


@pytest.mark.parametrize("name", ["office.mcap", "office.bag"])
def test_ranges_have_the_noise_that_was_asked_for_and_the_rest_of_the_bag_its_bytes(name, tmp_path):
    before, after = read(FIXTURES / name), corrupted(tmp_path / name, name, scan_noise=STD_M, scan_keep=KEEP)
    for topic in before.keys() - {"/scan"}:
        assert [one[:2] for one in after[topic]] == [one[:2] for one in before[topic]]
    errors, gone, count = [], 0, 0
    for (_, raw, was), (_, new, now) in zip(before["/scan"], after["/scan"], strict=True):
        begin = raw.index(was.ranges.tobytes())
        assert (raw[:begin], raw[begin + was.ranges.nbytes :]) == (new[:begin], new[begin + was.ranges.nbytes :])
        measured = (was.ranges >= was.range_min) & (was.ranges <= was.range_max)
        np.testing.assert_array_equal(now.ranges[~measured], was.ranges[~measured])
        missing, far = np.isnan(now.ranges[measured]), np.isinf(now.ranges[measured])
        assert np.all(np.abs(was.ranges[measured][far] - was.range_max) < 6.0 * STD_M)
        kept = np.flatnonzero(measured)[~missing & ~far]
        errors.append(now.ranges[kept] - was.ranges[kept])
        gone, count = gone + missing.sum(), count + measured.sum()
    assert np.concatenate(errors).std() == pytest.approx(STD_M, rel=0.03)
    assert gone / count == pytest.approx(1.0 - KEEP, abs=0.01)


def test_a_range_that_leaves_the_limits_is_infinite(tmp_path):
    scans = corrupted(tmp_path / "out.mcap", scan_noise=100.0)["/scan"]
    every = np.concatenate([now.ranges for _, _, now in scans])
    assert np.isneginf(every).sum() > 100
    assert np.isposinf(every).sum() > 100
    assert not np.isnan(every).any()


@pytest.mark.parametrize(("densities", "field"), [
    ((0.01, 0.0, 0.0, 0.0), "angular_velocity"), ((0.0, 0.0, 0.05, 0.0), "linear_acceleration"),
    ((0.0, 0.02, 0.0, 0.0), "angular_velocity"), ((0.0, 0.0, 0.0, 0.3), "linear_acceleration"),
])  # fmt: skip
def test_an_imu_has_the_noise_of_its_file_and_nothing_else_changes(densities, field, tmp_path):
    (tmp_path / "imu.yaml").write_text(KALIBR.format(*densities))
    before, after = read(FIXTURES / "office.mcap"), corrupted(tmp_path / "out.mcap", imu=tmp_path / "imu.yaml")
    assert [rows[1] for rows in after["/scan"]] == [rows[1] for rows in before["/scan"]]
    vector = lambda one, name: [getattr(getattr(one, name), axis) for axis in "xyz"]  # noqa: E731
    both = ("angular_velocity", "linear_acceleration")
    was, now = ({key: np.array([vector(m, key) for _, _, m in bag["/imu"]]) for key in both} for bag in (before, after))
    error = now[field] - was[field]
    times_s = np.array([m.header.stamp.sec + m.header.stamp.nanosec * 1e-9 for _, _, m in before["/imu"]])
    white, walk = densities[::2], densities[1::2]
    if any(white):
        assert error.std(axis=0) == pytest.approx(max(white) * np.sqrt(200.0), rel=0.06)
    else:
        assert np.all(error[0] == 0.0)
        usual = max(walk) * np.sqrt(np.diff(times_s).mean())
        assert np.diff(error, axis=0).std(axis=0) == pytest.approx(usual, rel=0.06)
    for (_, _, one), (_, _, other), numbers in zip(before["/imu"], after["/imu"], error, strict=True):
        for axis, number in zip("xyz", numbers, strict=True):
            setattr(getattr(other, field), axis, getattr(getattr(other, field), axis) - number)
        assert repr(one.orientation) == repr(other.orientation)
        assert one.angular_velocity_covariance.tolist() == other.angular_velocity_covariance.tolist()
    (unchanged,) = {*both} - {field}
    assert np.array_equal(was[unchanged], now[unchanged])


def test_the_noise_depends_on_the_seed_alone(tmp_path):
    (tmp_path / "imu.yaml").write_text(KALIBR.format(0.01, 0.001, 0.05, 0.01))
    options = {"scan_noise": STD_M, "scan_keep": KEEP, "imu": tmp_path / "imu.yaml"}
    one = corrupted(tmp_path / "one.mcap", threads=1, **options)
    for more in ({"threads": 3}, {"exclude": ("/door",)}, {"model": "typical"}):
        other = corrupted(tmp_path / "other.mcap", **(options | more))
        assert [rows[1] for rows in other["/scan"] + other["/imu"]] == [rows[1] for rows in one["/scan"] + one["/imu"]]
    for to in ("full", "overlay"):
        odomcorrupt.batch([FIXTURES / "office.mcap"], tmp_path / to, runs=2, seed=5, model=STILL, output=to, **options)
        first, second = (read(tmp_path / to / f"run_00000{n}.mcap") for n in (0, 1))
        assert [rows[1] for rows in first["/scan"]] == [rows[1] for rows in one["/scan"]]
        assert all(a[1] != b[1] for a, b in zip(first["/imu"], second["/imu"], strict=True))
    assert (tmp_path / "full" / "run_000000.mcap").read_bytes() == (tmp_path / "one.mcap").read_bytes()


@pytest.mark.parametrize(("source", "name", "recover"), [
    ("office.mcap", "o.mcap", False), ("office.mcap", "o.bag", True), ("office.bag", "o.bag", False),
    ("office.bag", "o", True), ("office_ros2", "o", False), ("office_ros2", "o.db3", True),
    ("office_ros2", "o.mcap", False),
])  # fmt: skip
def test_every_third_scan_is_kept_and_has_the_errors_that_it_has_among_all(source, name, recover, tmp_path):
    every = corrupted(tmp_path / f"all_{name}", source, scan_noise=STD_M, scan_keep=KEEP)
    odomcorrupt.corrupt(FIXTURES / source, tmp_path / name, model=STILL, seed=5, scan_noise=STD_M, scan_keep=KEEP,
                        scan_every=3, recover=recover)  # fmt: skip
    thinned = read(tmp_path / name)
    assert {topic: [m[:2] for m in rows] for topic, rows in thinned.items()} == {
        topic: [m[:2] for m in rows[:: 3 if topic == "/scan" else 1]] for topic, rows in every.items()
    }
    with AnyReader([tmp_path / name], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:  # by its indexes
        assert {c.topic: c.msgcount for c in reader.connections} == {t: len(rows) for t, rows in thinned.items()}
    if name.endswith(".mcap") and source.endswith(".mcap"):
        bags = (FIXTURES / source).read_bytes(), (tmp_path / name).read_bytes()
        was, now = (list(make_reader(io.BytesIO(bag)).iter_messages()) for bag in bags)
        times = [(c.topic, m.sequence, m.publish_time) for _, c, m in was if c.topic != "/scan"]
        assert [(c.topic, m.sequence, m.publish_time) for _, c, m in now if c.topic != "/scan"] == times


def test_a_batch_and_a_pipe_keep_the_same_scans(tmp_path, monkeypatch, invoke):
    words = ["--seed", "5", "--odom", "/odom", "--scan-every", "4"]
    assert "/scan 75 scans kept" in invoke([FIXTURES / "office.mcap", tmp_path / "one.mcap", *words]).err
    assert run(["batch", str(FIXTURES / "office.mcap"), str(tmp_path / "runs"), "--runs", "1", *words]) == 0
    assert (tmp_path / "runs" / "run_000000.mcap").read_bytes() == (tmp_path / "one.mcap").read_bytes()
    with (FIXTURES / "office.mcap").open("rb") as stream:
        monkeypatch.setattr("sys.stdin", io.TextIOWrapper(stream))
        assert run(["-", str(tmp_path / "piped.mcap"), *words]) == 0
    assert (tmp_path / "piped.mcap").read_bytes() == (tmp_path / "one.mcap").read_bytes()


@pytest.mark.parametrize(("words", "code", "said"), [
    (["--scan-every", "2", "--exclude-topic", "/scan"], 1, "has no sensor_msgs/msg/LaserScan"),
    (["--scan-every", "0"], 2, "x>=1"),
    (["--scan-noise", "-0.1"], 2, "write metres"), (["--scan-keep", "1.2"], 2, "at most 1"),
    (["--scan-keep", "0.5", "--exclude-topic", "/scan"], 1, "no sensor_msgs/msg/LaserScan"),
    (["--imu", "none.yaml"], 1, "No such file"), (["--imu", "a: ["], 1, "is no YAML"),
    (["--imu", "update_rate: 200"], 1, "gyroscope_noise_density is missing"),
    (["--imu", KALIBR.format(0.1, -1, 0, 0)], 1, "gyroscope_random_walk is -1"),
    (["--imu", KALIBR.format(0, 0, 0, 0).replace("200.0", "0")], 1, "update_rate is 0"),
])  # fmt: skip
def test_what_is_no_noise_is_one_line(words, code, said, tmp_path, monkeypatch, invoke):
    monkeypatch.chdir(tmp_path)
    if words[0] == "--imu" and words[1] != "none.yaml":
        (tmp_path / "imu.yaml").write_text(words[1])
        words = ["--imu", "imu.yaml"]
    text = invoke([FIXTURES / "office.mcap", "out.mcap", *words], code).err
    assert said in " ".join(text.split())
    assert text.count("\n") <= 2
    assert not Path("out.mcap").exists()


def test_of_two_publishers_of_a_topic_one_is_chosen_by_its_node(tmp_path):
    def write(path, nodes):
        with Ros1LibraryWriter(path) as writer, AnyReader([FIXTURES / "office.bag"]) as reader:
            (odom,) = (c for c in reader.connections if c.topic == "/odom")
            own = [
                writer.add_connection("/odom", odom.msgtype, msgdef=odom.msgdef.data, md5sum=odom.digest, callerid=node)
                for node in nodes
            ]
            for number, (_, log_ns, raw) in enumerate(reader.messages([odom])):
                data = bytearray(raw)
                for shift, connection in enumerate(own):
                    at = len(data) - 8 * (7 + 36 + 6 + 36)
                    data[at : at + 8] = (np.frombuffer(raw, "<f8", 1, at) + 3.0 * shift * (number > 0)).tobytes()
                    writer.write(connection, log_ns + shift, bytes(data))
        return path

    both, alone = write(tmp_path / "both.bag", ["/wheels", "/filter"]), write(tmp_path / "alone.bag", ["/wheels"])
    with pytest.raises(TopicError, match="/odom@/filter or /odom@/wheels"):
        odomcorrupt.corrupt(both, tmp_path / "out.bag", seed=1)
    with pytest.raises(TopicError, match="has no publisher /nobody"):
        odomcorrupt.corrupt(both, tmp_path / "out.bag", seed=1, odom_topic="/odom@/nobody")
    odomcorrupt.corrupt(both, tmp_path / "out.bag", seed=1, odom_topic="/odom@/wheels")
    odomcorrupt.corrupt(alone, tmp_path / "right.bag", seed=1)
    chosen = [raw for (log_ns, raw, _) in read(tmp_path / "out.bag")["/odom"][::2]]
    assert chosen == [raw for (_, raw, _) in read(tmp_path / "right.bag")["/odom"]]
