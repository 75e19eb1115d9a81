"""ROS 2 node for closed loop: /odom in, drifted odometry out on /odom_drifted, and its transform if asked.

    python3 examples/drift_ros2.py --ros-args -p model:=robot.toml -p seed:=7 -p tf:=true

Point controller and localisation at /odom_drifted. The simulator must not publish
odom -> base_link itself if tf is true.
"""

import contextlib

import rclpy
from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node

import odomcorrupt as oc


class DriftNode(Node):
    """Publishes drifted odometry."""

    def __init__(self) -> None:
        super().__init__("odom_drift")
        asked = {name: self.declare_parameter(name, value).value
                 for name, value in (("model", "typical"), ("seed", 0), ("tf", False))}  # fmt: skip
        self.drift = oc.Drift(asked["model"], asked["seed"])
        self.tf = None
        if asked["tf"]:
            from tf2_ros import TransformBroadcaster  # noqa: PLC0415 - not part of rclpy

            self.tf = TransformBroadcaster(self)
        self.publisher = self.create_publisher(Odometry, "/odom_drifted", 10)
        self.create_subscription(Odometry, "/odom", self.on_odometry, 10)

    def on_odometry(self, message: Odometry) -> None:
        """Publish a message with its drift."""
        stamp = message.header.stamp
        self.drift.apply(message, stamp.sec * 10**9 + stamp.nanosec)
        self.publisher.publish(message)
        if self.tf is not None:
            edge = TransformStamped(header=message.header, child_frame_id=message.child_frame_id)
            edge.transform.translation.x = message.pose.pose.position.x
            edge.transform.translation.y = message.pose.pose.position.y
            edge.transform.translation.z = message.pose.pose.position.z
            edge.transform.rotation = message.pose.pose.orientation
            self.tf.sendTransform(edge)


if __name__ == "__main__":
    rclpy.init()
    with contextlib.suppress(KeyboardInterrupt):
        rclpy.spin(DriftNode())
