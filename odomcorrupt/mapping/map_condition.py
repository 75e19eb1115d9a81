"""Map condition of corruption: a map from a file or a bag, and the path drawn within its free space."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from odomcorrupt.bags.messages import locate
from odomcorrupt.bags.open import open_reader
from odomcorrupt.corruption.odometry_source import ENCODINGS, ODOMETRY, TRANSFORMS, OdometrySource
from odomcorrupt.errors import MapError, TopicError
from odomcorrupt.mapping.conditioned_runs import without_effects
from odomcorrupt.mapping.constrained_path import FreePath, whole_path
from odomcorrupt.mapping.frames import FrameTree
from odomcorrupt.mapping.free_space import Check, Constraint, free_space
from odomcorrupt.mapping.messages import GRID, read_grid
from odomcorrupt.mapping.occupancy_grid import FREE, OCCUPIED, UNKNOWN, Grid, read_map

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.corruption.transform import Options
    from odomcorrupt.forecasting.forecast import CleanDrive
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.model.motion_model import MotionModel

OCCUPIED_PERCENT, FREE_PERCENT = 65, 25
"""Values of an OccupancyGrid from which a cell is occupied, and up to which it is free: map_server's thresholds."""


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
    """Return the pose (3,) of the odom frame in the map from the first transforms of a bag; None if TF has none."""
    tree = FrameTree()
    with open_reader(path, recover=recover) as reader:
        for block in reader.blocks():
            tree.take(block, reader.channels.values())
            pose = tree.pose(map_frame, odom_frame)
            if pose is not None:
                return pose
    return None


def read_odom_frame(path: Path, options: Options, learned_from: str | None = None, *, recover: bool = False) -> str:
    """Return the frame of a bag's odometry, from its first message.

    learned_from : topic of the odometry if the bag has several: the one that the model was learned from

    Raises
    ------
    TopicError
        If the bag has no odometry.
    """
    source = OdometrySource(options.odom_topic, options.odom_frame, options.base_frame, learned_from)
    with open_reader(path, recover=recover) as reader:
        source.prepare(reader, reader.name)
        for block in reader.blocks():
            channels = [reader.channels[int(number)] for number in np.unique(block.table["channel"])]
            wanted = [c for c in channels if c.encoding in ENCODINGS and c.msgtype in (ODOMETRY, *TRANSFORMS)]
            source.read(block, [(c, layout) for c in wanted for layout in locate(block, c)], block.table["log_ns"])
            if source.frames is not None:
                return source.frames.odom
        raise TopicError(f"{reader.name}: {source.name} has no message with a pose{source.elsewhere}")


@dataclass(frozen=True, slots=True)
class MapCondition(Constraint):
    """Constraint on the motions of a corruption by a map, recorded in its output."""

    def path(self, model: MotionModel, seed: int, run: int, drive: CleanDrive | None = None) -> FreePath | None:
        """Return the path of one run within the free space; None if no noise is drawn, and nothing moves.

        drive : odometry, required to draw whole paths; None if unknown
        """
        if without_effects(model).noise.coefficients.noise_free:
            return None
        if drive is None:
            return FreePath(model, self, seed, run)
        return whole_path(drive.stamps_ns, drive.xyt, model, self, seed, run)

    def provenance(self) -> dict[str, str]:
        """Return the map's record for an output: a hash of the blocked cells, without a file name."""
        grid = self.space.grid
        digest = hashlib.sha256(self.space.blocked.tobytes())
        digest.update(repr((self.space.blocked.shape, grid.resolution_m, grid.origin_xyt.tolist())).encode())
        pose = ",".join(repr(float(value)) for value in self.space.map_from_odom)
        words = f"{self.check}, {self.tries} tries, odom at {pose}, blocked cells {digest.hexdigest()[:16]}"
        return {"map": words}


def is_map_file(name: str) -> bool:
    """Tell whether a name is that of a map's .yaml file, instead of a topic."""
    return name.endswith((".yaml", ".yml"))


def read_condition(
    name: str,
    *,
    bag: Path | None = None,
    odom_frame: str = "odom",
    map_pose: Sequence[float] | None = None,
    radius_m: float = 0.2,
    unknown: Literal["blocked", "free"] = "blocked",
    check: Check = "endpoint",
    tries: int = 100,
    recover: bool = False,
) -> MapCondition:
    """Return the condition of a map: its free space for a robot, placed in the odom frame.

    name : a map's .yaml file, or a topic of the bag
    bag : source of the topic, and of the pose of odom in the map
    odom_frame : frame of the odometry
    map_pose : (3,) pose of the odom frame in the map, metres and radians; by default from TF in the bag, or zero
        without a bag
    radius_m : radius of the robot, metres
    unknown : "free" if the robot may be in unknown cells, else "blocked"
    check : whether only the end of a motion must be free, "endpoint", or all of it, "path"
    tries : largest number of draws per motion
    recover : whether to read the undamaged part of a damaged bag

    Raises
    ------
    MapError
        If the map cannot be read, or the pose of odom in it is unknown.
    """
    frame = "map"
    if is_map_file(name):
        grid = read_map(Path(name))
    elif bag is None:
        raise MapError(f"{name}: without a bag a map is a .yaml file; name one")
    else:
        grid, frame = read_recorded_map(bag, name, recover=recover)
    pose = np.zeros(3) if map_pose is None else np.array(map_pose, dtype=np.float64)
    if map_pose is None and bag is not None and frame.lstrip("/") != odom_frame.lstrip("/"):
        found = read_map_from_odom(bag, frame, odom_frame, recover=recover)
        if found is None:
            raise MapError(
                f"{bag}: TF has nothing between {frame!r} and {odom_frame!r}; give the pose of odom in the map with "
                "--map-pose x,y,yaw (0,0,0 where they are the same)"
            )
        pose = found
    return MapCondition(free_space(grid, radius_m, unknown=unknown, map_from_odom=pose), check, tries)
