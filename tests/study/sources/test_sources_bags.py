"""Reading odometry and truth from bags: every format, every message type, one bag or two."""

import numpy as np
import pytest
from sourcebags import topic, write
from sourcedrive import START_NS, odometry, truth

from odomcorrupt.study.io import Source, read_runs


def same(trajectory, rows, tolerance=1e-12):
    assert np.array_equal(trajectory.stamps_ns, rows.stamps_ns)
    np.testing.assert_allclose(trajectory.xyt, rows.xyt, atol=tolerance)


@pytest.mark.parametrize("name", ["run.mcap", "run.bag", "run"])
def test_any_format_gives_the_poses_to_the_bit_of_their_stamps(tmp_path, name):
    moved, real = odometry(), truth()
    bag = write(tmp_path / name, topic("/odom", "Odometry", moved), topic("/truth", "PoseStamped", real))
    (recording,) = read_runs(Source(bag, track_m=0.3))
    same(recording.odometry, moved)
    same(recording.truth, real)
    assert recording.origin_ns == START_NS
    assert (recording.name, recording.track_m) == (name, 0.3)
    assert recording.notes == ("odometry /odom in frame odom, truth /truth in frame odom",)


@pytest.mark.parametrize("kind", ["Odometry", "PoseStamped", "PoseWithCovarianceStamped", "TransformStamped"])
@pytest.mark.parametrize("suffix", [".mcap", ".bag"])
def test_every_type_with_a_heading_can_be_the_truth(tmp_path, kind, suffix):
    real = truth()
    bag = write(tmp_path / f"run{suffix}", topic("/odom", "Odometry", odometry()), topic("/mocap/robot", kind, real))
    (recording,) = read_runs(Source(bag))
    same(recording.truth, real)


def test_points_are_positions_without_headings(tmp_path):
    real = truth()
    bag = write(tmp_path / "run.mcap", topic("/odom", "Odometry", odometry()), topic("/prism", "PointStamped", real))
    (recording,) = read_runs(Source(bag))
    np.testing.assert_allclose(recording.truth.xyt[:, :2], real.xyz[:, :2])
    assert np.isnan(recording.truth.xyt[:, 2]).all()
    assert "/prism in frame odom (positions without headings)" in recording.notes[0]


def test_satellite_fixes_become_metres_east_and_north(tmp_path):
    real = truth()
    # small steps on WGS 84 at 45 degrees: one degree is 111 131.75 m north and 78 846.81 m east
    degrees = np.column_stack(
        (45.0 + real.xyz[:, 1] / 111_131.745, 7.0 + real.xyz[:, 0] / 78_846.805, np.full(len(real), np.nan))
    )
    degrees[5] = np.nan
    bag = write(
        tmp_path / "run.bag",
        topic("/odom", "Odometry", odometry()),
        topic("/fix", "NavSatFix", real.having(xyz=degrees)),
    )
    (recording,) = read_runs(Source(bag))
    wanted = np.delete(real.xyz[:, :2] - real.xyz[0, :2], 5, axis=0)
    np.testing.assert_allclose(recording.truth.xyt[:, :2], wanted, atol=1e-3)
    assert "/fix: 1 messages without a fix left out" in recording.notes


def test_the_truth_may_lie_in_a_bag_of_its_own_of_another_format(tmp_path):
    moved, real = odometry(), truth()
    first = write(tmp_path / "robot.bag", topic("/odom", "Odometry", moved), topic("/x", "PoseStamped", moved))
    second = write(tmp_path / "lab.mcap", topic("/vrpn/robot/pose", "PoseStamped", real))
    (recording,) = read_runs(Source(first, truth_path=second))
    same(recording.odometry, moved)
    same(recording.truth, real)


def test_of_several_candidates_the_one_that_says_truth_is_meant(tmp_path):
    moved, real = odometry(), truth()
    bag = write(
        tmp_path / "run.mcap",
        topic("/base/pose", "Odometry", moved),
        topic("/ground_truth/state", "Odometry", real),
        topic("/goal", "PoseStamped", real.only(slice(5))),
    )
    (recording,) = read_runs(Source(bag))
    same(recording.odometry, moved)
    same(recording.truth, real)


def test_a_topic_of_two_publishers_is_read_whole(tmp_path):
    """A driver that was started again has a second connection of the same topic in a ROS 1 bag."""
    from rosbags.rosbag1 import Writer
    from sourcebags import SHORT, STORES, make

    moved = odometry()
    sent = topic("/odom", "Odometry", moved) + topic("/truth", "PoseStamped", truth())
    with Writer(tmp_path / "run.bag") as writer:
        connections = {
            (name, who): writer.add_connection(name, SHORT[kind], typestore=STORES[1], callerid=who)
            for name, kind in (("/odom", "Odometry"), ("/truth", "PoseStamped"))
            for who in ("/one", "/other")
        }
        for i, message in enumerate(sent):
            data = STORES[1].serialize_ros1(make(1, *message.value), SHORT[message.kind])
            who = "/other" if message.topic == "/odom" and i >= 350 else "/one"
            writer.write(connections[message.topic, who], message.log_ns, data)
    (recording,) = read_runs(Source(tmp_path / "run.bag"))
    same(recording.odometry, moved)


def test_poses_can_be_odometry_where_they_are_named(tmp_path):
    moved = odometry()
    bag = write(tmp_path / "run.mcap", topic("/pose", "PoseStamped", moved), topic("/truth", "PoseStamped", truth()))
    (recording,) = read_runs(Source(bag, odom="pose"))
    same(recording.odometry, moved)
