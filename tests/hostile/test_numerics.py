"""Far from the origin, for a day, a thousand times a second, at the end of the 32-bit clock: no precision is lost."""

import struct
import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.append(str(Path(__file__).parents[1] / "corruption"))

from bagged import ODOM, MemoryBag, blocks_of, odometry, quaternion, read, robot, twists

from odomcorrupt.bags.block import Channel
from odomcorrupt.corruption.path import NoisyPath
from odomcorrupt.corruption.transform import Transform
from odomcorrupt.effects import effect_from_values
from odomcorrupt.model.motion_model import MotionModel, Noise
from odomcorrupt.model.noise_laws import Coefficients

NOISE = Noise("diffusion", Coefficients(0.05, 0.02, 0.05, 0.01))
MODEL = MotionModel(NOISE)
START_NS = 1_700_000_000 * 10**9
LAST_SECOND_OF_2038 = 2_177_452_799
"""Behind January 2038 a signed 32-bit stamp, that of ROS 2, is over; ROS 1 counts on."""
ODOM1 = Channel(1, "/odom", "nav_msgs/msg/Odometry", "ros1")


def arc(n, step_s, origin=(0.0, 0.0)):
    """A robot on a circle of 4 m at 0.5 m/s: stamps in nanoseconds from 0, poses."""
    t = np.arange(n) * step_s
    heading = 0.125 * t
    xy = np.column_stack((4 * np.sin(heading), 4 * (1 - np.cos(heading)))) + origin
    return np.rint(t * 1e9).astype(np.int64), np.column_stack((xy, heading))


def corrupted(messages, channels=None, size=40):
    bag = MemoryBag(blocks_of(messages, size), **({} if channels is None else {"channels": channels}))
    return list(Transform(MODEL, 7).blocks(bag, "test"))


def test_a_million_metres_away_the_same_error_is_made():
    far = np.array([1e6, -1e6])
    t, near_poses = arc(400, 0.02)
    near = corrupted(robot(START_NS + t, near_poses))
    away = corrupted(robot(START_NS + t, arc(400, 0.02, far)[1]))
    here, there = read(near, ODOM, "position")[1][:, :2], read(away, ODOM, "position")[1][:, :2]
    assert np.abs(here - near_poses[:, :2]).max() > 0.05
    # a number near 1e6 has steps of 1.2e-10, and a turned origin is a sum of some of them
    np.testing.assert_allclose(there - far, here, rtol=0, atol=3e-9)
    np.testing.assert_allclose(read(away, ODOM, "twist")[1], read(near, ODOM, "twist")[1], rtol=0, atol=2e-7)
    covariance = read(near, ODOM, "pose_covariance")[1]
    np.testing.assert_allclose(read(away, ODOM, "pose_covariance")[1], covariance, rtol=0, atol=1e-8)


def test_a_day_of_driving_adds_up_to_the_last_digits():
    n, step_m = 1_000_000, 0.05
    stamps = START_NS + np.arange(n, dtype=np.int64) * 100_000_000
    assert (stamps[-1] - stamps[0]) * 1e-9 > 0.99e5
    still = Noise("diffusion", Coefficients(0.0, 0.0, 0.0, 0.0))
    path = NoisyPath(MotionModel(still, (effect_from_values("wheel_scale", {"e": 0.01}),)), 7)
    xyt = np.column_stack((np.arange(n) * step_m, np.zeros(n), np.zeros(n)))
    for begin in range(0, n, 65_536):
        samples = path.feed(stamps[begin : begin + 65_536], xyt[begin : begin + 65_536])
    driven = xyt[-1, 0]
    # the truth is 1 % more than what the wheels tell, so the wheels tell this
    np.testing.assert_allclose(samples.error_xyt[-1, 0], driven / 1.01 - driven, rtol=1e-11)
    np.testing.assert_allclose(samples.travelled_m[-1], driven, rtol=1e-11)


def test_a_thousand_times_a_second_twists_are_the_steps_of_the_poses():
    t, poses = arc(3000, 0.001)
    out = corrupted(
        [
            (ODOM, int(s) + 10**6, odometry(s, p, v))
            for s, p, v in zip(START_NS + t, poses, twists(t, poses), strict=True)
        ]
    )
    position, quat = read(out, ODOM, "position")[1], read(out, ODOM, "orientation")[1]
    heading = np.unwrap(2 * np.arctan2(quat[:, 2], quat[:, 3]))
    noisy = np.column_stack((position[:, :2], heading))
    assert np.abs(noisy - poses).max() > 1e-3
    told = read(out, ODOM, "twist")[1][1:, [0, 1, 5]]
    # a pose of some metres has steps of 1e-15, and a step of it is divided by a thousandth of a second
    np.testing.assert_allclose(told, twists(t, noisy)[1:], rtol=0, atol=1e-9)


def ros1_odometry(stamp_ns, xyt):
    text = struct.pack("<I4sI9s", 4, b"odom", 9, b"base_link")
    numbers = [xyt[0], xyt[1], 0.0, *quaternion(xyt[2]), *np.zeros(36), *np.zeros(42)]
    return struct.pack("<III", 0, *divmod(int(stamp_ns), 10**9)) + text + np.array(numbers, dtype="<f8").tobytes()


@pytest.mark.parametrize("first_s", [LAST_SECOND_OF_2038 - 7, 2**32 - 20, 2**31 - 4])
def test_at_the_end_of_2038_and_of_the_clock_all_is_as_ever(first_s):
    t, poses = arc(400, 0.02)
    outs = []
    for start_ns in (START_NS, first_s * 10**9):
        messages = [(ODOM1, int(s) + 10**6, ros1_odometry(s, p)) for s, p in zip(start_ns + t, poses, strict=True)]
        out = corrupted(messages, {1: ODOM1})
        stamps, position = read(out, ODOM1, "position")
        np.testing.assert_array_equal(stamps, start_ns + t)
        outs.append(position)
    assert np.abs(outs[0][:, :2] - poses[:, :2]).max() > 0.05
    np.testing.assert_array_equal(outs[0], outs[1])


def test_ros_2_counts_to_january_2038():
    t, poses = arc(300, 0.02)
    start_ns = (2**31 - 1) * 10**9 - int(t[-1])
    out = corrupted([(ODOM, int(s) + 10**6, odometry(s, p)) for s, p in zip(start_ns + t, poses, strict=True)])
    np.testing.assert_array_equal(read(out, ODOM, "position")[0], start_ns + t)
