"""What the tests of this folder read of a bag, message by message."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from odomcorrupt.bags.messages import gather, gather_stamps_ns, locate
from odomcorrupt.bags.open import open_reader
from odomcorrupt.geometry.se2 import yaw_from_quaternion


@dataclass
class Rows:
    """Messages of one topic or edge: stamps (n,), poses (n, 3), and what only Odometry has."""

    stamps_ns: np.ndarray
    xyt: np.ndarray
    twist: np.ndarray
    pose_covariance: np.ndarray
    twist_covariance: np.ndarray


def rows_of(path, topic, edge=None):
    """Read a topic of a bag; `edge` (parent, child) picks transforms."""
    kept = {name: [] for name in ("stamps", "xyt", "twist", "pose_covariance", "twist_covariance")}
    with open_reader(path) as reader:
        channels = [channel for channel in reader.channels.values() if channel.topic == topic]
        for block in reader.blocks():
            for channel in channels:
                for layout in locate(block, channel):
                    for item in layout.items:
                        if edge is not None and (item.frame_id, item.child_frame_id) != edge:
                            continue
                        position = gather(block, layout, item, "position")
                        yaw = yaw_from_quaternion(gather(block, layout, item, "orientation"))
                        kept["stamps"].append(gather_stamps_ns(block, layout, item))
                        kept["xyt"].append(np.column_stack((position[:, :2], yaw)))
                        for name in ("twist", "pose_covariance", "twist_covariance"):
                            if name in item.fields:
                                kept[name].append(gather(block, layout, item, name))
    whole = [np.concatenate(parts) if parts else np.zeros(0) for parts in kept.values()]
    order = np.argsort(whole[0], kind="stable")
    return Rows(*(part[order] if len(part) else part for part in whole))
