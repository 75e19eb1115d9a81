"""Odometry and truth from bags: every format, message type, edges of TF in evo's notation, and public recordings."""

from dataclasses import replace

import numpy as np
import pytest
from rosbags.rosbag1 import Writer
from scipy.spatial.transform import Rotation, Slerp
from sourcebags import both, edges, make, topic, write
from sourcedrive import START_NS, Rows, odometry, truth

from odomcorrupt.errors import OdomCorruptError, RecordingError, TopicError
from odomcorrupt.study.io import Source, read_runs, reader
from recordings import RECORDINGS
from rosmessages import STORES, serialised


def same(trajectory, rows, tolerance=1e-12):
    assert np.array_equal(trajectory.stamps_ns, rows.stamps_ns)
    np.testing.assert_allclose(trajectory.xyt, rows.xyt, atol=tolerance)


@pytest.mark.parametrize("name", ["run.mcap", "run.bag", "run"])
def test_any_format_gives_the_poses_to_the_bit_of_their_stamps(tmp_path, name):
    moved, real = odometry(), truth()
    (recording,) = read_runs(Source(both(tmp_path / name), track_m=0.3))
    same(recording.odometry, moved)
    same(recording.truth, real)
    assert recording.origin_ns == START_NS
    assert (recording.name, recording.track_m) == (name, 0.3)
    assert recording.notes == ("odometry /odom in frame odom, truth /truth in frame odom",)


@pytest.mark.parametrize("kind", ["Odometry", "PoseStamped", "PoseWithCovarianceStamped", "TransformStamped"])
@pytest.mark.parametrize("suffix", [".mcap", ".bag"])
def test_every_type_with_a_heading_can_be_the_truth(tmp_path, kind, suffix):
    (recording,) = read_runs(Source(both(tmp_path / f"run{suffix}", truth="/mocap/robot", kind=kind)))
    same(recording.truth, truth())


def test_points_are_positions_without_headings(read):
    (recording,) = read(truth="/prism", kind="PointStamped")
    np.testing.assert_allclose(recording.truth.xyt[:, :2], truth().xyz[:, :2])
    assert np.isnan(recording.truth.xyt[:, 2]).all()
    assert "/prism in frame odom (positions without headings)" in recording.notes[0]


def test_satellite_fixes_become_metres_east_and_north(read):
    real = truth()
    # small steps on WGS 84 at 45 degrees: one degree is 111 131.75 m north and 78 846.81 m east
    degrees = np.column_stack(
        (45.0 + real.xyz[:, 1] / 111_131.745, 7.0 + real.xyz[:, 0] / 78_846.805, np.full(len(real), np.nan))
    )
    degrees[5] = np.nan
    (recording,) = read(real=real.having(xyz=degrees), truth="/fix", kind="NavSatFix")
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

    moved = odometry()
    sent = topic("/odom", "Odometry", moved) + topic("/truth", "PoseStamped", truth())
    with Writer(tmp_path / "run.bag") as writer:
        connections = {
            (name, who): writer.add_connection(name, kind, typestore=STORES[1], callerid=who)
            for name, kind in (("/odom", "nav_msgs/msg/Odometry"), ("/truth", "geometry_msgs/msg/PoseStamped"))
            for who in ("/one", "/other")
        }
        for i, message in enumerate(sent):
            data = serialised(1, make(1, *message.value))
            who = "/other" if message.topic == "/odom" and i >= 350 else "/one"
            writer.write(connections[message.topic, who], message.log_ns, data)
    (recording,) = read_runs(Source(tmp_path / "run.bag"))
    same(recording.odometry, moved)


def test_poses_can_be_odometry_where_they_are_named(tmp_path):
    moved = odometry()
    bag = write(tmp_path / "run.mcap", topic("/pose", "PoseStamped", moved), topic("/truth", "PoseStamped", truth()))
    (recording,) = read_runs(Source(bag, odom="pose"))
    same(recording.odometry, moved)


def still(xyz, quat_yaw, stamp_ns=START_NS):
    return Rows(np.array([stamp_ns]), np.array([xyz], dtype=float), np.array([quat_yaw]))


def matrix(xyz, quat):
    out = np.tile(np.eye(4), (len(xyz), 1, 1))
    out[:, :3, :3] = Rotation.from_quat(quat).as_matrix()
    out[:, :3, 3] = xyz
    return out


def planar(matrices):
    return np.column_stack((matrices[:, :2, 3], np.unwrap(np.arctan2(matrices[:, 1, 0], matrices[:, 0, 0]))))


def test_a_chain_over_moving_and_static_edges_is_the_product_of_its_matrices(tmp_path):
    moved, real = odometry(), truth()
    slow = moved.only(slice(0, None, 2))
    shift = Rows(slow.stamps_ns, 0.1 * slow.xyz[::-1] + [0.0, 0.0, 0.2], 0.2 * np.sin(0.3 * slow.yaw))
    tracker = still([1.0, -2.0, 0.5], 2.0)
    mast = still([0.2, 0.1, 0.9], 0.4)
    bag = write(
        tmp_path / "run.bag",
        topic("/odom", "Odometry", moved),
        edges(shift, "/map", "odom"),
        edges(real, "odom", "base_link"),
        edges(tracker, "map", "tracker", name="/tf_static"),
        edges(mast, "base_link", "mast", name="/tf_static"),
        edges(truth(), "base_link", "wheel"),
    )
    (recording,) = read_runs(Source(bag, truth="/tf:tracker.mast"))
    at = recording.truth.stamps_ns
    inside = (real.stamps_ns >= shift.stamps_ns[0]) & (real.stamps_ns <= shift.stamps_ns[-1])
    assert np.array_equal(at, real.stamps_ns[inside])
    own, t = (shift.stamps_ns - START_NS) * 1e-9, (at - START_NS) * 1e-9
    middle = np.stack([np.interp(t, own, shift.xyz[:, i]) for i in range(3)], axis=1)
    turned = Slerp(own, Rotation.from_quat(shift.quat))(t).as_quat()
    wanted = planar(
        np.linalg.inv(matrix(tracker.xyz, tracker.quat))
        @ matrix(middle, turned)
        @ matrix(real.xyz[inside], real.quat[inside])
        @ matrix(mast.xyz, mast.quat)
    )
    turns = np.array([0.0, 0.0, 2 * np.pi * np.round((recording.truth.xyt - wanted)[0, 2] / (2 * np.pi))])
    np.testing.assert_allclose(recording.truth.xyt - turns, wanted, atol=1e-9)
    composed = "/tf:tracker.mast: composed of map.tracker, map.odom, odom.base_link, base_link.mast"
    assert composed in recording.notes


def test_an_edge_can_be_the_odometry_and_frames_may_have_dots(tmp_path):
    moved = odometry()
    bag = write(
        tmp_path / "run.mcap",
        edges(moved, "robot.odom", "robot.base", name="/robot/tf"),
        topic("/truth", "PoseStamped", truth()),
    )
    (recording,) = read_runs(Source(bag, odom="/robot/tf:robot.odom.robot.base"))
    np.testing.assert_allclose(recording.odometry.xyt, moved.xyt, atol=1e-12)


def test_a_topic_with_the_transforms_of_several_bodies_asks_for_one(tmp_path):
    moved, real = odometry(), truth()
    bag = write(
        tmp_path / "run.mcap",
        topic("/odom", "Odometry", moved),
        topic("/vicon", "TransformStamped", real, frame="world", child="robot"),
        topic("/vicon", "TransformStamped", real.having(xyz=real.xyz + 3.0), frame="world", child="wand"),
    )
    with pytest.raises(TopicError, match=r"2 frames; name one of /vicon:world.robot, /vicon:world.wand"):
        read_runs(Source(bag))
    (recording,) = read_runs(Source(bag, truth="/vicon:world.robot"))
    np.testing.assert_allclose(recording.truth.xyt, real.xyt, atol=1e-12)


@pytest.mark.parametrize(
    ("address", "error", "words"),
    [
        ("/tf:map.base_lnk", TopicError, r"no frame base_lnk on /tf \(did you mean base_link\?"),
        ("/tf:map", TopicError, "names no two frames"),
        ("/tf:map.island", TopicError, "two separate trees"),
        ("/tf:map.map", TopicError, "twice"),
        ("/tf:base_link.mast", RecordingError, "no edge on the way .* moves"),
        ("/tf", TopicError, r"is TF; name one of its edges, as in truth /tf:map.base_link"),
        ("/tf:map.base_link:/fixed", TopicError, "no topic /fixed with transforms"),
        ("/odom:map.base_link", TopicError, "/odom is a nav_msgs/msg/Odometry"),
    ],
)
def test_an_address_that_leads_nowhere_says_why(tmp_path, address, error, words):
    real = truth(12.0)
    bag = write(
        tmp_path / "run.mcap",
        topic("/odom", "Odometry", odometry(12.0)),
        edges(real, "map", "base_link"),
        edges(real, "sea", "island"),
        edges(still([0.2, 0.1, 0.9], 0.4), "base_link", "mast", name="/tf_static"),
    )
    with pytest.raises(error, match=words):
        read_runs(Source(bag, truth=address))


HALL = RECORDINGS / "real" / "tuc_lecture_hall.mcap"  # its truth jumps every half minute
REAL = sorted(set((RECORDINGS / "real").glob("*.mcap")) - {HALL})


@pytest.mark.recordings
@pytest.mark.parametrize("path", REAL, ids=lambda path: path.stem)
def test_every_real_recording_is_one_run_with_nothing_cut_and_says_so_when_its_truth_is_mirrored(path, monkeypatch):
    odometry, truth = reader._read(Source(path))

    def runs(seen):
        monkeypatch.setattr(reader, "_read", lambda _: (odometry, seen))
        return read_runs(Source(path))

    (recording,) = runs(truth)
    assert not recording.mistakes
    assert np.isnan(recording.truth.xyt[:, 2]).all() == path.stem.startswith("plaza")
    said = " ".join(recording.notes)
    assert not any(word in said for word in ("outlier", "reset", "jump", "filter", "set back", "headings turn exactly"))
    assert ("a simulation without noise" in said) == path.stem.startswith("rob521")
    (mirrored, *_) = runs(replace(truth, frame="", xyz=truth.xyz * [1.0, -1.0, 1.0], yaw_rad=-truth.yaw_rad))
    assert [one.name for one in mirrored.mistakes] == ["left and right exchanged"]


@pytest.mark.recordings
def test_a_truth_that_jumps_is_cut_into_stretches_and_every_jump_is_said():
    recordings = read_runs(Source(HALL))
    said = " ".join(recordings[0].notes)
    assert "50 jumps that last" in said
    assert f"{len(recordings)} independent stretches used" in said
    starts, ends = zip(*((r.truth.stamps_ns[0], r.truth.stamps_ns[-1]) for r in recordings), strict=True)
    assert all(start > end for start, end in zip(starts[1:], ends[:-1], strict=True))


@pytest.mark.recordings
@pytest.mark.parametrize(
    ("name", "asked", "said"),
    [
        ("evo/nav2_turtlebot.mcap", {"truth": "/tf:map.base_link"}, "the truth is taken at its 133 corrections alone"),
        ("evo/nav2_turtlebot.mcap", {}, "/amcl_pose: it is a localisation by its name"),
        ("evo/nav2_turtlebot.mcap", {}, "/odom: a gap of 1.8 s"),
        ("robot_localization/test1.bag", {}, "/fix: metres east and north of its first fix"),
    ],
)
def test_bags_as_found_say_what_is_odd_about_them(name, asked, said):
    (recording,) = read_runs(Source(RECORDINGS / "bags" / name, **asked))
    assert any(said in note for note in recording.notes)


@pytest.mark.recordings
@pytest.mark.parametrize(
    ("name", "asked", "words"),
    [
        ("olin_tb4/macfirst_floor_take_2", {"truth": "/tf:odom.base_footprint"}, "it is the same odometry"),
        ("evo/tf_example.bag", {"odom": "/tf:odom.base_link", "truth": "/tf:odom.base_footprint"}, "the same odometry"),
        ("evo/tf_example", {"odom": "/tf:odom.base_link", "truth": "/tf:odom.base_footprint"}, "the same odometry"),
        ("polimi/bag1.bag", {}, r"no topic that could be odometry \(found /robot/pose"),
        ("malformed/unindexed.bag", {}, "not indexed"),
    ],
)
def test_bags_that_hold_no_run_say_why(name, asked, words):
    with pytest.raises(OdomCorruptError, match=words):
        read_runs(Source(RECORDINGS / "bags" / name, **asked))


@pytest.mark.recordings
def test_a_bag_of_three_compressions_gives_one_trajectory():
    """Foxglove's turtles: the old tf/tfMessage type; one turtle's way as seen from the other."""
    ways = []
    for name in ("example", "example-lz4", "example-bz2"):
        from odomcorrupt.study.io.bag import read_bag

        path = RECORDINGS / "bags" / "foxglove_turtlesim" / f"{name}.bag"
        ways.append(read_bag(path, name, {"truth": "/tf:turtle1.turtle2"})["truth"])
    assert len(ways[0]) > 500
    for way in ways[1:]:
        assert np.array_equal(way.stamps_ns, ways[0].stamps_ns)
        assert np.array_equal(way.xyz, ways[0].xyz)
