"""What the loops over messages do to poses: white noise; less than odomcorrupt does, and nothing is kept consistent."""

from __future__ import annotations

import random
from typing import Any

MOVED = frozenset({"nav_msgs/msg/Odometry", "tf2_msgs/msg/TFMessage", "nav_msgs/Odometry", "tf2_msgs/TFMessage"})


def shake(message: Any) -> None:
    """Move every pose in an Odometry or TF message."""
    if hasattr(message, "transforms"):
        places = [one.transform.translation for one in message.transforms]
    else:
        places = [message.pose.pose.position]
    for place in places:
        place.x += random.gauss(0.0, 0.01)
        place.y += random.gauss(0.0, 0.01)
