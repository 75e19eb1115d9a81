"""ROS 1 node for closed loop: /odom in, drifted odometry out on /odom_drifted, and its transform if asked.

    rosrun or python3 examples/drift_ros1.py _model:=robot.toml _seed:=7 _tf:=true

Point controller and localisation at /odom_drifted. The simulator must not publish
odom -> base_link itself if tf is true.
"""

import rospy
from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import Odometry
from tf2_msgs.msg import TFMessage

import odomcorrupt as oc


def main() -> None:
    """Publish drifted odometry until ROS stops."""
    rospy.init_node("odom_drift")
    drift = oc.Drift(rospy.get_param("~model", "typical"), rospy.get_param("~seed", 0))
    publisher = rospy.Publisher("/odom_drifted", Odometry, queue_size=10)
    edges = rospy.Publisher("/tf", TFMessage, queue_size=10) if rospy.get_param("~tf", False) else None

    def on_odometry(message: Odometry) -> None:
        drift.apply(message, message.header.stamp.to_nsec())
        publisher.publish(message)
        if edges is not None:
            edge = TransformStamped(header=message.header, child_frame_id=message.child_frame_id)
            edge.transform.translation.x = message.pose.pose.position.x
            edge.transform.translation.y = message.pose.pose.position.y
            edge.transform.translation.z = message.pose.pose.position.z
            edge.transform.rotation = message.pose.pose.orientation
            edges.publish(TFMessage([edge]))

    rospy.Subscriber("/odom", Odometry, on_odometry)
    rospy.spin()


if __name__ == "__main__":
    main()
