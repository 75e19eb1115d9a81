"""The drift of one run in closed loop, and covariances of random effects."""

import importlib
import runpy
import sys
import time
from itertools import islice
from types import SimpleNamespace as Names

import numpy as np
import pytest
from bagged import IMU, ODOM, TF, MemoryBag, blocks_of, read, robot, rows_of
from drives import error_in_any_cut, model, office, silent
from mcap.reader import make_reader

import odomcorrupt as oc
from odomcorrupt.corruption.covariance import SUMS, has_random_part, pose_covariance
from odomcorrupt.corruption.path import NoisyPath
from odomcorrupt.corruption.transform import Options, Transform
from odomcorrupt.effects import effect_from_values, registry
from odomcorrupt.model.noise_laws import Coefficients
from recordings import OFFICE, ROOT

PLANAR = np.array([0, 1, 5])


def planar(covariance):
    return covariance.reshape(-1, 6, 6)[:, PLANAR[:, None], PLANAR]


def test_steps_have_the_numbers_of_a_corrupted_bag(tmp_path):
    model = oc.Model(oc.Noise(alpha=(0.05, 0.02, 0.05, 0.01)), effects=["wheelbase:e=2%", "slip_burst"])
    oc.corrupt(OFFICE, tmp_path / "noisy.mcap", model=model, seed=4, run=2)
    clean, noisy, drift = rows_of(OFFICE), rows_of(tmp_path / "noisy.mcap"), oc.Drift(model, 4, 2)
    steps = zip(clean.stamps_ns[:600], clean.xyt, clean.twist[:, PLANAR], strict=False)
    found = [drift.step(int(stamp), pose, twist) for stamp, pose, twist in steps]
    pose, speed, pose_covariance, twist_covariance = (np.array(column) for column in zip(*found, strict=True))
    assert np.abs(noisy.position - clean.position)[:600].max() > 0.05
    np.testing.assert_allclose(pose[:, :2], noisy.position[:600, :2], atol=1e-12)
    np.testing.assert_allclose(np.sin(pose[:, 2] / 2.0), noisy.orientation[:600, 2], atol=1e-12)
    np.testing.assert_allclose(speed, noisy.twist[:600, PLANAR], atol=1e-11)
    np.testing.assert_allclose(pose_covariance, planar(noisy.pose_covariance[:600]), atol=1e-12)
    np.testing.assert_allclose(twist_covariance[1:], planar(noisy.twist_covariance[1:600]), atol=1e-12)


def test_a_step_back_in_time_and_numbers_that_are_none_are_refused():
    drift = oc.Drift("typical", seed=1)
    drift.step(10, (0.0, 0.0, 0.0))
    with pytest.raises(oc.OdomCorruptError, match="stamp 9 after 10"):
        drift.step(9, (0.0, 0.0, 0.0))
    with pytest.raises(oc.OdomCorruptError, match="finite numbers"):
        drift.step(11, (0.0, float("nan"), 0.0))


def message(x, yaw, stamp):
    turned = Names(x=0.0, y=0.0, z=np.sin(yaw / 2), w=np.cos(yaw / 2))
    pose = Names(position=Names(x=x, y=0.0, z=0.2), orientation=turned)
    twist = Names(linear=Names(x=0.5, y=0.0, z=0.0), angular=Names(x=0.0, y=0.0, z=0.1))
    return Names(
        header=Names(stamp=stamp, frame_id="odom"), child_frame_id="base_link",
        pose=Names(pose=pose, covariance=[7.0] * 36), twist=Names(twist=twist, covariance=[7.0] * 36),
    )  # fmt: skip


class Sink:
    """Publisher, broadcaster and transform of the ROS libraries."""

    def __init__(self, *_, **__):
        self.sent = []
        self.transform = Names(translation=Names(), rotation=None)

    def publish(self, what):
        self.sent.append(what)

    sendTransform = publish  # noqa: N815 - the name of ROS


def ros(seen):
    """Return modules of ROS whose publishers and callbacks are collected in `seen`."""

    class Node:
        def __init__(self, _):
            pass

        def declare_parameter(self, name, value):
            return Names(value={"seed": 3, "tf": True}.get(name, value))

        def create_publisher(self, *_):
            seen["ros2"] = Sink()
            return seen["ros2"]

        def create_subscription(self, _, __, callback, ___):
            seen["on2"] = callback

    def subscribed(_, __, callback):
        seen["on1"] = callback

    def published(topic, *_, **__):
        return seen.setdefault(topic, Sink())

    return {
        "rclpy": Names(init=lambda: None, spin=lambda _: None), "rclpy.node": Names(Node=Node),
        "geometry_msgs": Names(), "geometry_msgs.msg": Names(TransformStamped=Sink),
        "nav_msgs": Names(), "nav_msgs.msg": Names(Odometry=object),
        "tf2_ros": Names(TransformBroadcaster=lambda _: seen.setdefault("tf2", Sink())),
        "tf2_msgs": Names(), "tf2_msgs.msg": Names(TFMessage=list),
        "rospy": Names(
            init_node=lambda _: None, spin=lambda: None, Publisher=published, Subscriber=subscribed,
            get_param={"~seed": 3, "~tf": True}.get,
        ),
    }  # fmt: skip


def test_the_nodes_of_the_examples_publish_what_steps_return(monkeypatch):
    seen = {}
    for name, module in ros(seen).items():
        monkeypatch.setitem(sys.modules, name, module)
    for name in ("drift_ros1.py", "drift_ros2.py"):
        runpy.run_path(str(ROOT / "examples" / name), run_name="__main__")
    drift = oc.Drift("typical", 3)
    for k in range(20):
        expected = drift.step(k * 10**8, (0.05 * k, 0.0, 0.01 * k), (0.5, 0.0, 0.1))
        seen["on2"](message(0.05 * k, 0.01 * k, Names(sec=0, nanosec=k * 10**8)))
        seen["on1"](message(0.05 * k, 0.01 * k, Names(to_nsec=lambda k=k: k * 10**8)))
        for sink, edges in ((seen["ros2"], seen["tf2"]), (seen["/odom_drifted"], seen["/tf"])):
            got, edge = sink.sent[-1], edges.sent[-1]
            assert (got.pose.pose.position.x, got.pose.pose.position.y) == pytest.approx(tuple(expected.pose_xyt[:2]))
            assert got.pose.pose.position.z == 0.2
            assert got.twist.twist.angular.z == pytest.approx(expected.twist[2])
            covariance = np.reshape(got.pose.covariance, (6, 6))
            np.testing.assert_allclose(covariance[PLANAR[:, None], PLANAR], expected.pose_covariance)
            assert covariance[2, 3] == 7.0
            edge = edge[0] if isinstance(edge, list) else edge
            assert (edge.transform.translation.x, edge.transform.translation.z) == (got.pose.pose.position.x, 0.2)
    assert abs(expected.pose_xyt[1]) > 1e-4


@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of packages of ROS
def test_the_node_under_rclpy_publishes_the_drift_of_a_corrupted_bag(tmp_path, monkeypatch):
    rclpy = pytest.importorskip("rclpy", exc_type=ImportError)
    kind, read = (importlib.import_module(name) for name in ("nav_msgs.msg", "rclpy.serialization"))
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    with OFFICE.open("rb") as file:
        rows = islice(make_reader(file).iter_messages("/odom"), 200)
        sent = [read.deserialize_message(one.data, kind.Odometry) for *_, one in rows]
    rclpy.init(args=["--ros-args", "-p", "seed:=7"])
    nodes = runpy.run_path(str(ROOT / "examples" / "drift_ros2.py"))["DriftNode"](), rclpy.create_node("probe")
    got, publisher = [], nodes[1].create_publisher(kind.Odometry, "/odom", 10)
    nodes[1].create_subscription(kind.Odometry, "/odom_drifted", got.append, 10)
    until = time.monotonic() + 30.0
    while len(got) < len(sent) and time.monotonic() < until:
        if nodes[0].publisher.get_subscription_count() and publisher.get_subscription_count():
            publisher.publish(sent[len(got)])
        for node in nodes:
            rclpy.spin_once(node, timeout_sec=1.0 if node is nodes[1] else 0.1)
    rclpy.shutdown()
    oc.corrupt(OFFICE, tmp_path / "noisy.mcap", model="typical", seed=7)
    found = [(one.pose.pose.position.x, one.pose.pose.position.y) for one in got]
    np.testing.assert_allclose(found, rows_of(tmp_path / "noisy.mcap").position[:200, :2], atol=1e-12)


WEAK = Coefficients(0.02, 0.01, 0.02, 0.01)
TRACK_M = 0.5
RANDOM = {
    "gain": ("gauss_markov", {"sigma": 0.04, "tau": 3.0}),
    "difference of the wheels": ("gauss_markov", {"sigma": 0.01, "tau": 3.0, "channel": "wheels"}),
    "turning gain": ("gauss_markov", {"sigma": 0.03, "tau": 3.0, "channel": "yaw"}),
    "walk": ("gyro_bias_walk", {"density": 3e-4}),
    "bias that comes back": ("gyro_bias_walk", {"density": 2e-3, "tau": 4.0}),
    "bursts of both wheels": ("slip_burst", {"rate": 0.3, "slip": 0.2, "duration": 0.3}),
    "bursts of a wheel": ("slip_burst", {"rate": 0.1, "slip": 0.1, "duration": 0.3}),
    "losses": ("lost_increments", {"fraction": 0.02}),
    "dead band": ("gyro_dead_band", {"threshold": 0.2, "noise": 0.1}),
}
BOUNDED = {"quantization", "heavy_tails"}
"""The error of the one never grows; the other draws within the law's own variance."""


def chosen(which, coefficients=WEAK):
    name, values = RANDOM[which]
    track = TRACK_M if which == "bursts of a wheel" else None
    return model(coefficients=coefficients, effects=[effect_from_values(name, values)], track_m=track)


@pytest.mark.slow
@pytest.mark.parametrize("which", RANDOM)
def test_covariance_is_calibrated_about_the_mean_of_the_runs(which):
    t, poses = office(10.0, 40.0)
    places, runs = np.array([60, 130, 200, 400]), 250
    errors, P = np.empty((runs, len(places), 3)), np.empty((runs, len(places), 3, 3))
    for number in range(runs):
        samples = NoisyPath(chosen(which), 11, number).feed(t, poses)
        errors[number] = samples.error_xyt[places]
        noisy = (poses[places, :2] + errors[number, :, :2] - samples.origin_xy).T
        P[number] = pose_covariance(samples.sums[:, places], noisy)
        without = pose_covariance(samples.sums[:SUMS, places], noisy)
        assert np.linalg.det(P[number, -1]) > 1.3 * np.linalg.det(without[-1]), "the effect is no small part of it"
    off = errors - errors.mean(axis=0)
    nees = np.einsum("rpi,rpi->rp", off, np.linalg.solve(P, off[..., None])[..., 0]).mean(axis=0) / 3.0
    assert nees == pytest.approx(np.ones(len(places)), abs=0.15)


@pytest.mark.parametrize("which", RANDOM)
def test_any_cut_into_batches_gives_the_same_bits(which):
    error_in_any_cut(chosen(which), *office(10.0, 20.0))


def test_a_new_stretch_begins_with_no_uncertainty_but_a_bias_that_has_wandered():
    t, poses = office(10.0, 20.0)
    path = NoisyPath(chosen("walk"), 5)
    first = path.feed(t, poses).sums
    path.restart()
    second = path.feed(t, poses).sums
    assert not second[:, 0].any()
    assert second[SUMS + 9, -1] > 1.5 * first[SUMS + 9, -1] > 0.0, "the turn's own variance: row 3 of 5, column 3"


def test_every_random_effect_states_its_gains_or_is_bounded():
    random = {name for name, kind in registry().items() if kind.kind == "noise" and name != "user"}
    stating = {
        effect.name
        for name, values in RANDOM.values()
        if has_random_part(effect := effect_from_values(name, values), None)
    }
    assert random == stating | BOUNDED


def test_an_effect_alone_that_draws_is_in_the_messages_covariances():
    t, poses = office(10.0, 20.0)
    only = silent([effect_from_values("gyro_bias_walk", {"density": 1e-3})])

    def covariances(**options):
        bag = MemoryBag(blocks_of(robot(t, poses), 40), {c.id: c for c in (ODOM, TF, IMU)}, True)
        out = list(Transform(only, 3, 0, Options(**options)).blocks(bag, "test.mcap"))
        return read(out, ODOM, "pose_covariance")[1]

    yaw = covariances().reshape(-1, 6, 6)[:, 5, 5]
    assert yaw == pytest.approx(NoisyPath(only, 3).feed(t, poses).sums[SUMS + 9] + 1e-9, rel=1e-9)
    assert yaw[-1] == pytest.approx(1e-6 * 20.0**3 / 3.0, rel=0.05), "a walk's integral: density^2 t^3 / 3"
    before = read(blocks_of(robot(t, poses)), ODOM, "pose_covariance")[1]
    assert np.array_equal(covariances(keep_covariance=True), before)
