"""Options that say which map a motion must respect."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from odomcorrupt.commands._param_types import Number
from odomcorrupt.commands._poses import POSE

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from odomcorrupt.corruption.transform import Options
    from odomcorrupt.mapping.constrained_path import FreePath
    from odomcorrupt.mapping.free_space import Check, FreeSpace
    from odomcorrupt.model.motion_model import MotionModel
    from odomcorrupt.preview.forecast import CleanDrive

__all__ = ["Condition", "choose_condition", "choose_condition_of_run", "clean_drive", "map_options"]


@dataclass(frozen=True, slots=True)
class Condition:
    """Free space, how a motion is held against it, and how often it is drawn."""

    space: FreeSpace
    check: Check
    tries: int

    def path(self, model: MotionModel, seed: int, run: int, drive: CleanDrive | None = None) -> FreePath | None:
        """Return where one run of corruption goes within it; None where no noise is drawn, and nothing moves.

        drive : the odometry; None where it can be read only once, as of a pipe
        """
        from odomcorrupt.mapping.constrained_increments import without_effects
        from odomcorrupt.mapping.constrained_path import FreePath
        from odomcorrupt.mapping.whole_path import whole_path

        if without_effects(model).noise.coefficients.silent:
            return None
        if drive is None:
            return FreePath(model, self.space, seed=seed, run=run, check=self.check, tries=self.tries)
        return whole_path(
            drive.stamps_ns, drive.xyt, model, self.space, seed=seed, run=run, check=self.check, tries=self.tries
        )

    def told(self) -> dict[str, str]:
        """Return what an output notes of it: a hash stands for the map, no file is named."""
        import hashlib

        grid = self.space.grid
        digest = hashlib.sha256(self.space.blocked.tobytes())
        digest.update(repr((self.space.blocked.shape, grid.resolution_m, grid.origin_xyt.tolist())).encode())
        pose = ",".join(repr(float(value)) for value in self.space.map_from_odom)
        words = f"{self.check}, {self.tries} tries, odom at {pose}, blocked cells {digest.hexdigest()[:16]}"
        return {"map": words}


def map_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options of `choose_condition`."""
    for option in (
        click.option(
            "--max-tries", "tries", type=click.IntRange(1, 1_000_000), default=100, help="Per motion. [default: 100]"
        ),
        click.option(
            "--unknown",
            type=click.Choice(["blocked", "free"]),
            default="blocked",
            help="Whether the robot may be where the map knows nothing. [default: blocked]",
        ),
        click.option(
            "--map-check",
            "check",
            type=click.Choice(["endpoint", "path"]),
            default="endpoint",
            help="Where a motion ends must be free, or all its way. [default: endpoint]",
        ),
        click.option(
            "--robot-radius", "radius", type=Number("metres", 0.0, 100.0), default=0.2, help="Metres. [default: 0.2]"
        ),
        click.option(
            "--map-pose", type=POSE, help="Odom frame in the map. [default: TF of the bag; without one 0,0,0]"
        ),
        click.option(
            "--map", "map_", metavar="MAP", help="Draw free poses only: a map's .yaml, or a topic of the bag."
        ),
    ):
        command = option(command)
    return command


def choose_condition(
    given: Mapping[str, Any], bag: Path | None, odom_frame: str, *, recover: bool = False
) -> Condition | None:
    """Return what the options ask for, None where they name no map."""
    import numpy as np

    from odomcorrupt.errors import MapError
    from odomcorrupt.mapping.free_space import free_space
    from odomcorrupt.mapping.mapfile import read_map
    from odomcorrupt.mapping.recorded import read_map_from_odom, read_recorded_map

    name = given["map_"]
    if name is None:
        _refuse_alone(given)
        return None
    frame = "map"
    if _is_file(name):
        grid = read_map(Path(name))
    elif bag is None:
        raise click.UsageError(f"--map {name}: without a bag a map is a .yaml file")
    else:
        grid, frame = read_recorded_map(bag, name, recover=recover)
    pose = np.zeros(3) if given["map_pose"] is None else np.array(given["map_pose"])
    if given["map_pose"] is None and bag is not None and frame.lstrip("/") != odom_frame.lstrip("/"):
        found = read_map_from_odom(bag, frame, odom_frame, recover=recover)
        if found is None:
            raise MapError(
                f"{bag}: TF has nothing between {frame!r} and {odom_frame!r}; say where odom is in the map with "
                "--map-pose x,y,yaw (0,0,0 where they are the same)"
            )
        pose = found
    space = free_space(grid, given["radius"], unknown=given["unknown"], map_from_odom=pose)
    return Condition(space, given["check"], given["tries"])


def choose_condition_of_run(given: Mapping[str, Any], source: Path | None, options: Options) -> Condition | None:
    """Return what the options ask of the corruption of a bag, None where they name no map; a source of None is a pipe.

    Raises
    ------
    click.UsageError
        Where a pipe would have to be read twice, or the map has nothing to hold.
    MapError
        Where the map cannot be read, or nothing says where odom is in it.

    """
    name = given["map_"]
    if name is None:
        _refuse_alone(given)
        return None
    from odomcorrupt.mapping.recorded import read_odom_frame

    if options.keep_localisation:
        raise click.UsageError(
            "--map and --keep-localisation: with map -> base kept true nothing in the map is drawn; leave out one"
        )
    if source is None and (given["map_pose"] is None or not _is_file(name)):
        raise click.UsageError(
            f"--map {name}: INPUT is a pipe and read once; name a map's .yaml, and say with --map-pose where odom is "
            "in it"
        )
    frame = ""
    if source is not None and given["map_pose"] is None:
        frame = read_odom_frame(source, options, recover=given["recover"])
    return choose_condition(given, source, frame, recover=given["recover"])


def _is_file(name: str) -> bool:
    return name.endswith((".yaml", ".yml"))


def _refuse_alone(given: Mapping[str, Any]) -> None:
    """Refuse options that say more of a map, where none is named."""
    context = click.get_current_context()
    for option in context.command.params:
        of_map = option.name in ("map_pose", "radius", "check", "unknown", "tries") and option.name in given
        if of_map and context.get_parameter_source(option.name or "") is ParameterSource.COMMANDLINE:
            raise click.UsageError(f"{option.opts[0]}: says more of a map; name the map with --map")


def clean_drive(source: Path, model: MotionModel, options: Options, *, recover: bool) -> CleanDrive:
    """Return the odometry of a bag, read for itself before the bag is corrupted."""
    from odomcorrupt.bags.open import open_reader
    from odomcorrupt.preview.forecast import read_clean_drive

    with open_reader(source, recover=recover) as reader:
        return read_clean_drive(reader, model, options)
