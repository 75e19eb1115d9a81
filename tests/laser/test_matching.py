"""Scan matching: poses, their information, and the map, in a room that is known."""

import numpy as np
import pytest

from odomcorrupt.geometry.se2 import between, compose, inverse, rotate
from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.laser.calibrate import calibrate
from odomcorrupt.laser.icp import WEAK, lines_of, match, surface_of
from odomcorrupt.laser.scans import Deskewing, Motion, Sweep, Sweeps
from odomcorrupt.laser.slam import Edges, optimise

ROOM = np.array([(-3.0, -2.0), (4.0, -2.0), (4.0, 3.0), (-3.0, 3.0)])


def seen(pose, noise=0.0, rng=None, walls=ROOM, beams=360):
    """Return the returns of a laser at a pose inside a polygon."""
    bearing = pose[2] + np.linspace(-np.pi, np.pi, beams, endpoint=False)
    way = np.stack((np.cos(bearing), np.sin(bearing)), axis=1)
    a, b = walls, np.roll(walls, -1, axis=0)
    along, to = b - a, a - pose[:2]
    cross = way[:, None, 0] * along[:, 1] - way[:, None, 1] * along[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        far = (to[:, 0] * along[:, 1] - to[:, 1] * along[:, 0]) / cross
        share = (to[:, 0] * way[:, None, 1] - to[:, 1] * way[:, None, 0]) / cross
    far = np.where((far > 0) & (share >= 0) & (share <= 1), far, np.inf).min(axis=1)
    far = far + (noise * rng.normal(size=beams) if rng is not None else 0.0)
    good = far < 15.0
    return rotate(far[good, None] * way[good], np.full(int(good.sum()), -pose[2]))


def test_a_match_finds_the_pose_within_what_it_says_of_its_error():
    rng = np.random.default_rng(3)
    first, second = np.array([0.2, 0.1, 0.3]), np.array([0.5, -0.1, 0.5])
    surface = surface_of(*lines_of(seen(first, 0.01, rng)))
    found = match(seen(second, 0.01, rng), surface, between(first, second) + np.array([0.1, -0.08, 0.06]))
    miss = found.pose - between(first, second)
    deviation = np.sqrt(np.diag(np.linalg.inv(found.information)))
    assert np.all(np.abs(miss) < 8.0 * deviation)
    assert np.all(np.abs(miss) < [0.006, 0.006, 0.003])
    assert found.ratio > WEAK


def test_along_a_plain_corridor_nothing_is_known_and_the_guess_stays():
    walls = np.array([(-40.0, -1.0), (40.0, -1.0), (40.0, 1.0), (-40.0, 1.0)])
    first, second = np.zeros(3), np.array([0.3, 0.05, 0.02])
    surface = surface_of(*lines_of(seen(first, walls=walls)))
    found = match(seen(second, walls=walls), surface, second + np.array([0.2, 0.03, 0.01]))
    assert found.ratio < WEAK
    assert abs(found.weak_axis[0]) > 0.99
    assert found.pose[0] == pytest.approx(0.5, abs=0.02)
    assert found.pose[1:] == pytest.approx(second[1:], abs=3e-3)


def test_a_pose_graph_closes_a_loop_and_leaves_a_wrong_closure_aside():
    rng = np.random.default_rng(1)
    count = 40
    heading = np.linspace(0.0, 2.0 * np.pi, count, endpoint=False)
    truth = np.column_stack((5.0 * np.cos(heading), 5.0 * np.sin(heading), heading + np.pi / 2))
    pairs = [(i, i + 1, False) for i in range(count - 1)] + [(i, i + 2, False) for i in range(count - 2)]
    pairs += [(count - 1, 0, True), (3, 20, True)]
    i, j, robust = (np.array(part) for part in zip(*pairs, strict=True))
    pose = between(truth[i], truth[j]) + rng.normal(size=(len(i), 3)) * [0.01, 0.01, 0.002]
    pose[-1, :2] += 1.5  # a wrong closure
    information = np.broadcast_to(np.diag([1e4, 1e4, 2.5e5]), (len(i), 3, 3))
    start = np.zeros_like(truth)
    start[0] = truth[0]
    for k in range(1, count):
        start[k] = compose(start[k - 1], pose[k - 1])
    found, weight = optimise(start, Edges(i, j, pose, information, robust), rounds=30)
    assert weight[-1] < 0.1
    assert weight[-2] > 0.5
    last = between(found[-1], found[0])
    assert last[:2] == pytest.approx(between(truth[-1], truth[0])[:2], abs=0.03)


def test_returns_of_noisy_walls_have_less_noisy_feet():
    rng = np.random.default_rng(5)
    x = np.linspace(-2.0, 2.0, 200)
    lines = lines_of(np.column_stack((x, 1.0 + 0.02 * rng.normal(size=200))))
    assert np.std(lines.feet[:, 1]) < 0.01
    assert np.abs(lines.normals[:, 1]).mean() > 0.98


def test_inverse_mounting_brings_the_laser_back_to_the_robot():
    mount, robot = np.array([0.2, 0.05, 1.0]), np.array([[1.0, 2.0, 0.4]])
    assert compose(compose(robot, mount), inverse(mount)) == pytest.approx(robot)


@pytest.mark.parametrize("ratio", [1.0, 0.9])
def test_a_turn_that_accelerates_within_a_sweep_is_taken_out_whole(ratio):
    # what is left is an error of the heading at starts and stops, and looks like slip there
    t_s = np.linspace(-0.5, 0.5, 1001)
    accelerates = 10.0
    poses = np.column_stack((np.zeros((1001, 2)), 0.5 * accelerates / ratio * t_s**2))
    motion = Motion(Trajectory(np.round(t_s * 1e9).astype(np.int64), poses), 0, 0.0, np.zeros(3), ratio)
    after_s = np.linspace(-0.1, 0.1, 401)
    bearing = np.linspace(-np.pi, np.pi, 401) - 0.5 * accelerates * after_s**2
    xy = 5.0 * np.stack((np.cos(bearing), np.sin(bearing)), axis=1)
    sweep = Sweep(0, xy.astype(np.float32), after_s.astype(np.float32))
    sweeps = Sweeps("run: /scan", "/scan", "laser", (sweep,), 2.0 * np.pi, np.zeros(1, dtype=np.int64), None)
    fixed = 5.0 * np.stack([f(np.linspace(-np.pi, np.pi, 401)) for f in (np.cos, np.sin)], axis=1)
    found = Deskewing(sweeps, motion, mirrored=False)[0]
    off_rad = np.mean(found[:, 1] * fixed[:, 0] - found[:, 0] * fixed[:, 1]) / 25.0
    assert abs(off_rad) < 2e-4


def test_the_turns_of_sweeps_are_taken_where_the_odometry_turns_too_far():
    rng = np.random.default_rng(5)
    t_s = np.arange(0.0, 30.0, 0.02)
    yaw = 1.5 * np.sin(0.5 * t_s)
    xy = np.stack((np.sin(0.3 * t_s), np.cos(0.4 * t_s)), axis=1)
    odometry = Trajectory(np.round(t_s * 1e9).astype(np.int64), np.column_stack((xy, 1.06 * yaw)))
    after_s = np.linspace(-0.05, 0.05, 180, endpoint=False)
    sweeps = []
    for k in range(20, len(t_s) - 20, 18):
        turned = np.interp(t_s[k] + after_s, t_s, yaw) - yaw[k]
        clean = seen(np.array([*xy[k], yaw[k]]), 0.005, rng, beams=180)
        # each return is measured at the robot's heading at that time
        c, s = np.cos(-turned), np.sin(-turned)
        moved = np.stack((c * clean[:, 0] - s * clean[:, 1], s * clean[:, 0] + c * clean[:, 1]), axis=1)
        sweeps.append(Sweep(round(t_s[k] * 1e9), moved.astype(np.float32), after_s.astype(np.float32)))
    log_ns = np.array([sweep.stamp_ns for sweep in sweeps])
    whole = Sweeps("run: /scan", "/scan", "laser", tuple(sweeps), 2.0 * np.pi, log_ns, None)
    assert calibrate(whole, odometry, 0).motion.turn_ratio == pytest.approx(1.0 / 1.06, abs=0.003)
