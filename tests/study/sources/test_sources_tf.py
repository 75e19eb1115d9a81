"""TF edges in evo's notation: chains, static edges, inverted edges, and moving edges of different rates."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp
from sourcebags import edges, topic, write
from sourcedrive import START_NS, Rows, odometry, truth

from odomcorrupt.errors import RecordingError, TopicError
from odomcorrupt.study.io import Source, read_runs


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
    """map -> odom (10 Hz) -> base -> mast (static), and tracker -> map turned round; scipy is the oracle."""
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
