"""Quality of service of ROS 2 and latching of ROS 1 in terms of each other, as `rosbags-convert` has it."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

from rosbags.convert.converter import LATCH
from rosbags.rosbag2.metadata import dump_qos_v8

from odomcorrupt.bags.rosbag2.bounded_yaml import load_plain

_TRANSIENT_LOCAL = (1, "1", "transient_local")
"""As metadata of all versions name it."""


@lru_cache(maxsize=1)
def latched_qos() -> str:
    """Return the profile of a publisher that latches its last message: reliable and transient local."""
    return dump_qos_v8(list(LATCH))


def stays_for_late_subscribers(profiles: str) -> bool:
    """Return whether some publisher's last messages are sent to late subscribers: durability is transient local."""
    try:
        offered: Any = load_plain(profiles) if profiles else []
    except ValueError:
        return False
    if not isinstance(offered, list):
        return False
    return any(isinstance(one, dict) and one.get("durability") in _TRANSIENT_LOCAL for one in offered)
