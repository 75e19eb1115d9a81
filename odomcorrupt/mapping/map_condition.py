"""The map that a corrupted path must respect: where it comes from, and the path drawn within it."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal, TypedDict

import numpy as np

from odomcorrupt.errors import MapError
from odomcorrupt.mapping.constrained_increments import without_effects
from odomcorrupt.mapping.constrained_path import FreePath
from odomcorrupt.mapping.free_space import free_space
from odomcorrupt.mapping.mapfile import read_map
from odomcorrupt.mapping.recorded import read_map_from_odom, read_recorded_map
from odomcorrupt.mapping.whole_path import whole_path

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.mapping.free_space import Check, FreeSpace
    from odomcorrupt.model.motion_model import MotionModel
    from odomcorrupt.preview.forecast import CleanDrive

__all__ = ["MapCondition", "is_map_file", "read_condition"]


class _Given(TypedDict):
    seed: int
    run: int
    check: Check
    tries: int


@dataclass(frozen=True, slots=True)
class MapCondition:
    """Free space, how a motion is held against it, and how often one motion is drawn at most."""

    space: FreeSpace
    check: Check = "endpoint"
    tries: int = 100

    def path(self, model: MotionModel, seed: int, run: int, drive: CleanDrive | None = None) -> FreePath | None:
        """Return the path of one run within the free space; None where no noise is drawn, and nothing moves.

        drive : the odometry, of which whole paths can be drawn; None where it is not known
        """
        if without_effects(model).noise.coefficients.silent:
            return None
        given: _Given = {"seed": seed, "run": run, "check": self.check, "tries": self.tries}
        if drive is None:
            return FreePath(model, self.space, **given)
        return whole_path(drive.stamps_ns, drive.xyt, model, self.space, **given)

    def provenance(self) -> dict[str, str]:
        """Return what an output says of its map: a hash of the blocked cells stands for it, no file is named."""
        grid = self.space.grid
        digest = hashlib.sha256(self.space.blocked.tobytes())
        digest.update(repr((self.space.blocked.shape, grid.resolution_m, grid.origin_xyt.tolist())).encode())
        pose = ",".join(repr(float(value)) for value in self.space.map_from_odom)
        words = f"{self.check}, {self.tries} tries, odom at {pose}, blocked cells {digest.hexdigest()[:16]}"
        return {"map": words}


def is_map_file(name: str) -> bool:
    """Tell whether a map is named by its .yaml file, and not by a topic."""
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

    Parameters
    ----------
    name : str
        A map's .yaml file, or a topic of the bag.
    bag : Path, optional
        Where the topic and the place of odom in the map are read.
    odom_frame : str
        Frame of the odometry.
    map_pose : (3,), optional
        Odom frame in the map, metres and radians; by default what TF in the bag says, without a bag zero.
    radius_m : float
        Radius of the robot, metres.
    unknown : {"blocked", "free"}
        Whether the robot may be where the map knows nothing.
    check : {"endpoint", "path"}
        Whether the end of a motion must be free, or all of it.
    tries : int
        How often one motion is drawn at most.
    recover : bool
        Whether a damaged bag is read as far as it is whole.

    Raises
    ------
    MapError
        Where the map cannot be read, or nothing says where odom is in it.

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
                f"{bag}: TF has nothing between {frame!r} and {odom_frame!r}; say where odom is in the map with "
                "--map-pose x,y,yaw (0,0,0 where they are the same)"
            )
        pose = found
    return MapCondition(free_space(grid, radius_m, unknown=unknown, map_from_odom=pose), check, tries)
