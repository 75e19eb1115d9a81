"""Maps in a bag, and where its odometry begins in them."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from odomcorrupt.bags.messages import locate
from odomcorrupt.bags.open import open_reader
from odomcorrupt.corruption.odometry_source import OdometrySource
from odomcorrupt.corruption.targets import ENCODINGS, ODOMETRY, TRANSFORMS
from odomcorrupt.errors import MapError, TopicError
from odomcorrupt.mapping.frames import FrameTree
from odomcorrupt.mapping.grid import FREE, OCCUPIED, UNKNOWN, Grid
from odomcorrupt.mapping.messages import GRID, read_grid

if TYPE_CHECKING:
    from pathlib import Path

    from odomcorrupt.corruption.transform import Options
    from odomcorrupt.geometry.se2 import Array

__all__ = ["RecordedMap", "read_map_from_odom", "read_odom_frame", "read_recorded_map"]

OCCUPIED_PERCENT, FREE_PERCENT = 65, 25
"""What counts as a wall and as free in an OccupancyGrid, as map_server's thresholds say."""


class RecordedMap(NamedTuple):
    """A map and the frame it is in."""

    grid: Grid
    frame_id: str


def read_recorded_map(path: Path, topic: str, *, recover: bool = False) -> RecordedMap:
    """Read the last nav_msgs/OccupancyGrid of a topic."""
    latest: tuple[bytes, str, str] | None = None
    with open_reader(path, recover=recover) as reader:
        channels = [c for c in reader.channels.values() if c.topic.lstrip("/") == topic.lstrip("/")]
        if not channels or channels[0].msgtype != GRID:
            found = ", ".join(sorted({c.topic for c in reader.channels.values() if c.msgtype == GRID})) or "none"
            raise TopicError(
                f"{reader.name}: no nav_msgs/OccupancyGrid on {topic} (found {found}); name another, or a map's .yaml"
            )
        for block in reader.blocks():
            for channel in channels:
                rows = block.table[block.table["channel"] == channel.id]
                if len(rows):
                    start, size = rows[-1]["offset"], rows[-1]["length"]
                    latest = block.data[start : start + size].tobytes(), channel.topic, channel.encoding
        name = reader.name
    if latest is None:
        raise MapError(f"{name}: {topic} holds no map; name a map's .yaml instead")
    message = read_grid(*latest)
    cells = np.full(message.cells.shape, UNKNOWN, dtype=np.uint8)
    cells[(message.cells >= 0) & (message.cells <= FREE_PERCENT)] = FREE
    cells[message.cells >= OCCUPIED_PERCENT] = OCCUPIED
    return RecordedMap(Grid(cells, message.resolution_m, message.origin_xyt), message.frame_id)


def read_map_from_odom(path: Path, map_frame: str, odom_frame: str, *, recover: bool = False) -> Array | None:
    """Return the pose (3,) of the odom frame in the map by the first transforms of a bag; None where TF has none."""
    tree = FrameTree()
    with open_reader(path, recover=recover) as reader:
        for block in reader.blocks():
            tree.take(block, reader.channels.values())
            pose = tree.pose(map_frame, odom_frame)
            if pose is not None:
                return pose
    return None


def read_odom_frame(path: Path, options: Options, *, recover: bool = False) -> str:
    """Return the frame that the odometry of a bag is in, by its first message.

    Raises
    ------
    TopicError
        Where no odometry is there.

    """
    source = OdometrySource(options.odom_topic, options.odom_frame, options.base_frame)
    with open_reader(path, recover=recover) as reader:
        source.prepare(reader, reader.name)
        for block in reader.blocks():
            channels = [reader.channels[int(number)] for number in np.unique(block.table["channel"])]
            wanted = [c for c in channels if c.encoding in ENCODINGS and c.msgtype in (ODOMETRY, *TRANSFORMS)]
            source.read(block, [(c, layout) for c in wanted for layout in locate(block, c)], block.table["log_ns"])
            if source.frames is not None:
                return source.frames.odom
        raise TopicError(f"{reader.name}: {source.name} has no message with a pose{source.elsewhere}")
