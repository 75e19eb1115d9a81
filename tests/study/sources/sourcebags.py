"""Bags by independent writers, with any message type of odometry and truth."""

from typing import NamedTuple

import numpy as np
import sourcedrive
from sourcedrive import odometry

import rosmessages
from odomcorrupt.study.io import Source, read_runs
from rosmessages import edge, header, new, pose, tree


class Sent(NamedTuple):
    """A message before it is written; `value` makes it in either version of ROS."""

    log_ns: int
    topic: str
    kind: str
    value: object


def topic(name, kind, rows, *, frame="odom", child="base_link", variance=1e-3, log_ns=None, stamps=True, status=0):
    """The messages of a topic; NavSatFix takes latitude, longitude, height for positions."""
    variances = np.broadcast_to(variance, len(rows))
    grades = np.broadcast_to(status, len(rows))
    logs = rows.stamps_ns if log_ns is None else log_ns
    poses = zip(rows.xyz.tolist(), rows.quat.tolist(), variances.tolist(), grades.tolist(), strict=True)
    return [
        Sent(int(log), name, kind, (kind, stamp if stamps else 0, frame, child, *pose))
        for log, stamp, pose in zip(logs, rows.stamps_ns.tolist(), poses, strict=True)
    ]


def edges(rows, parent, child, *, name="/tf", log_ns=None):
    """The messages of an edge of TF, one in each."""
    return topic(name, "TFMessage", rows, frame=parent, child=child, variance=0.0, log_ns=log_ns)


def write(path, *sent):
    """Write a bag of the kind that its name says: .mcap, .bag, or a rosbag2 directory."""
    ros = 1 if path.suffix == ".bag" else 2
    messages = sorted((message for group in sent for message in group), key=lambda message: message.log_ns)
    return rosmessages.write(path, ((one.log_ns, one.topic, make(ros, *one.value)) for one in messages))


def both(path, moved=None, real=None, *, name="/odom", truth="/truth", kind="PoseStamped", odom=None, seen=None):
    """Write a bag of odometry and truth, by default those of `sourcedrive`; odom, seen : options of their topics."""
    first = topic(name, "Odometry", odometry() if moved is None else moved, **(odom or {}))
    return write(path, first, topic(truth, kind, sourcedrive.truth() if real is None else real, **(seen or {})))


def read(folder, moved=None, real=None, *, asked=None, **options):
    """Return the recordings of a bag of odometry and truth; asked : options of `Source`, the others of `both`."""
    return read_runs(Source(both(folder / "run.mcap", moved, real, **options), **(asked or {})))


def make(ros, kind, stamp_ns, frame, child, xyz, quat, variance, grade=0):
    """Make a message object."""
    covariance = np.zeros(36)
    covariance[[0, 7, 35]] = variance / 2, variance / 2, variance
    if kind == "Odometry":
        frames, covariances = (frame, child), (covariance, 0.0 * covariance)
        return rosmessages.odometry(ros, stamp_ns, xyz, quat, frames=frames, covariances=covariances)
    if kind in ("TransformStamped", "TFMessage"):
        transform = edge(ros, stamp_ns, frame, child, xyz, quat)
        return transform if kind == "TransformStamped" else tree(ros, transform)
    if kind == "NavSatFix":
        status = new(ros, "sensor_msgs/NavSatStatus", grade, 1)
        variances = 0.5 * variance * np.eye(3).ravel()
        return new(ros, "sensor_msgs/NavSatFix", header(ros, stamp_ns, frame), status, *xyz, variances, 0)
    place = pose(ros, xyz, quat)
    if kind == "PointStamped":
        place = place.position
    if kind == "PoseWithCovarianceStamped":
        place = new(ros, "geometry_msgs/PoseWithCovariance", place, covariance)
    return new(ros, f"geometry_msgs/{kind}", header(ros, stamp_ns, frame), place)
