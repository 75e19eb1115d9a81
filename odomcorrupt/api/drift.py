"""Drift of a live robot or simulator, one odometry message at a time."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from odomcorrupt.api.model import ModelLike, as_model
from odomcorrupt.corruption.correction import Curve
from odomcorrupt.corruption.covariance import pose_covariance
from odomcorrupt.corruption.patch import Motions, TopicTwist
from odomcorrupt.corruption.path import NoisyPath
from odomcorrupt.errors import OdomCorruptError
from odomcorrupt.geometry.se2 import compose
from odomcorrupt.rng import draw_seed

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.geometry.se2 import Array


_PLANAR = [6 * i + j for i in (0, 1, 5) for j in (0, 1, 5)]
"""Places of x, y, yaw in a covariance of 6 x 6 numbers."""


class Drifted(NamedTuple):
    """Odometry with its drift.

    pose_xyt : (3,) metres and radians, in the odom frame
    twist : (3,) forward and leftward m/s, yaw rate rad/s, in the robot's axes
    pose_covariance, twist_covariance : (3, 3) of these; that of the first twist is zero, because nothing has moved yet
    """

    pose_xyt: Array
    twist: Array
    pose_covariance: Array
    twist_covariance: Array


class Drift:
    """The drift of one run, for closed loop: the controller acts on odometry that has drifted.

    The numbers are those of `corrupt` and `batch` with the same model, seed and run.

    Parameters
    ----------
    model : Model, Noise, path of a model file or name of a preset
        By default the preset `typical`.
    seed : int, optional
        Seed of all random draws; by default drawn, see the attribute `seed`.
    run : int
        Number of the run under this seed.

    Examples
    --------
    >>> import odomcorrupt as oc
    >>> drift = oc.Drift("typical", seed=1)
    >>> drift.step(0, (0.0, 0.0, 0.0), (0.5, 0.0, 0.0)).pose_xyt.tolist()
    [0.0, 0.0, 0.0]
    >>> [round(v, 3) for v in drift.step(1_000_000_000, (0.5, 0.0, 0.0), (0.5, 0.0, 0.0)).pose_xyt.tolist()]
    [0.53, 0.003, -0.007]
    """

    def __init__(self, model: ModelLike = "typical", seed: int | None = None, run: int = 0) -> None:
        self.seed = draw_seed() if seed is None else seed
        self._path = NoisyPath(as_model(model).motion_model, self.seed, run)
        self._curve, self._twist = Curve(), TopicTwist()
        self._last_ns: int | None = None

    def step(self, stamp_ns: int, pose_xyt: Sequence[float], twist: Sequence[float] = (0.0, 0.0, 0.0)) -> Drifted:
        """Return the next odometry message with its drift.

        Parameters
        ----------
        stamp_ns : int
            Stamp, nanoseconds, not before the last one.
        pose_xyt : (3,)
            Clean pose in the odom frame, metres and radians.
        twist : (3,)
            Clean forward and leftward speed, m/s, and yaw rate, rad/s, in the robot's axes.

        Returns
        -------
        Drifted
            Pose, twist, and their covariances.

        Raises
        ------
        OdomCorruptError
            If time runs backwards, or a number is not finite.
        """
        stamps_ns, xyt = np.array([stamp_ns], dtype=np.int64), np.array([pose_xyt], dtype=float)
        full, level = np.zeros((1, 6)), np.zeros((1, 4))
        full[0, [0, 1, 5]] = twist
        level[0, 2:] = np.sin(xyt[0, 2] / 2.0), np.cos(xyt[0, 2] / 2.0)
        if not (np.isfinite(xyt).all() and np.isfinite(full).all()):
            raise OdomCorruptError(f"step: pose {tuple(pose_xyt)}, twist {tuple(twist)}; give finite numbers")
        if self._last_ns is not None and stamp_ns < self._last_ns:
            raise OdomCorruptError(
                f"step: stamp {stamp_ns} after {self._last_ns}; make a new Drift where time restarts"
            )
        self._last_ns = stamp_ns
        self._curve.extend(self._path.feed(stamps_ns, xyt), stamps_ns)
        self._curve.forget(stamp_ns)
        at = self._curve.at(stamps_ns, stamps_ns)
        noisy = compose(at.xyt, xyt)[0]
        change = self._twist.change(Motions(stamps_ns, xyt, level, full), at)
        return Drifted(
            noisy, full[0, [0, 1, 5]] + np.where(change.known, change.added, 0.0)[0],
            pose_covariance(at.sums, noisy[:2, None] - at.origin_xy)[0], change.covariance[0],
        )  # fmt: skip

    def apply(self, message: Any, stamp_ns: int) -> None:
        """Give a nav_msgs/Odometry message of ROS 1 or ROS 2 its drift, in place.

        Parameters
        ----------
        message : nav_msgs.msg.Odometry
            Message of rospy or rclpy: pose, twist, and their covariances in the plane are changed.
        stamp_ns : int
            Its stamp, nanoseconds.

        Returns
        -------
        None

        Raises
        ------
        OdomCorruptError
            As by `step`.
        """
        p, q, v = message.pose.pose.position, message.pose.pose.orientation, message.twist.twist
        yaw = math.atan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y**2 + q.z**2))
        found = self.step(stamp_ns, (p.x, p.y, yaw), (v.linear.x, v.linear.y, v.angular.z))
        p.x, p.y, turned = found.pose_xyt.tolist()
        q.x, q.y, q.z, q.w = 0.0, 0.0, math.sin(turned / 2.0), math.cos(turned / 2.0)
        v.linear.x, v.linear.y, v.angular.z = found.twist.tolist()
        for one, covariance in ((message.pose, found.pose_covariance), (message.twist, found.twist_covariance)):
            values = np.array(one.covariance, dtype=float)
            values[_PLANAR] = covariance.ravel()
            one.covariance = values.tolist()
