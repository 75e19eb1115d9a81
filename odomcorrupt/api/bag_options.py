"""Options of everything that reads and writes bags."""

from __future__ import annotations

from dataclasses import fields
from os import PathLike, fspath
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypedDict

if TYPE_CHECKING:
    from odomcorrupt.bags.convert.message_types import Generation
    from odomcorrupt.corruption.run import Container
    from odomcorrupt.corruption.transform import Options
    from odomcorrupt.mapping.map_condition import MapCondition

__all__ = ["BagOptions", "as_condition", "bag_path", "options_of", "split_options"]


class BagOptions(TypedDict, total=False):
    """What of a bag is moved, and how it is written.

    odom_topic : the odometry that drives the model; by default the only one
    odom_frame, base_frame : frames, where the odometry's own are not those of TF
    keep_twist, keep_covariance : leave twists or covariances as they are
    keep_truth : a topic on which the clean odometry stays
    keep_localisation : move map -> odom the other way, so that map -> base stays true
    new_odom_frame : leave everything alone and publish the drift as the transform from this frame to odom
    subtracted : publish noisy minus clean there, component by component, as the article's listing does
    overwrite : replace an existing output
    compression, level : of the output: none, lz4, zstd (MCAP), bz2 (ROS 1), file, message (directories of ROS 2);
        by default those of the input
    ros : 1 or 2, the generation of ROS of the output's messages, where its name leaves a choice
    storage : mcap or sqlite3, of an output that is a directory
    exclude : topics left out of the output
    recover : read what is whole of a damaged input
    threads : that read, compute and compress side by side; by default one a core, at most four
    """

    odom_topic: str | None
    odom_frame: str | None
    base_frame: str | None
    keep_twist: bool
    keep_covariance: bool
    keep_truth: str | None
    keep_localisation: bool
    new_odom_frame: str | None
    subtracted: bool
    overwrite: bool
    compression: str | None
    level: int | None
    ros: Generation | None
    storage: str | None
    exclude: tuple[str, ...]
    recover: bool
    threads: int | None


def split_options(options: BagOptions) -> tuple[Options, Container]:
    """Return what is moved, and how bags are read and written."""
    from odomcorrupt.corruption.run import Container
    from odomcorrupt.corruption.transform import Options

    moved = {field.name for field in fields(Options)}
    known = moved | {field.name for field in fields(Container)}
    for name in options:
        if name not in known:
            raise TypeError(f"{name}: no such option; there are {', '.join(sorted(known))}")
    values: dict[str, Any] = dict(options)
    return (
        Options(**{name: value for name, value in values.items() if name in moved}),
        Container(**{name: value for name, value in values.items() if name not in moved}),
    )


def options_of(options: BagOptions) -> Options:
    """Return what is moved, without how bags are written."""
    return split_options(options)[0]


def bag_path(path: str | PathLike[str]) -> Path | None:
    """Return a path; None for "-", a pipe."""
    return None if fspath(path) == "-" else Path(fspath(path))


def as_condition(within: MapCondition | str | PathLike[str] | None) -> MapCondition | None:
    """Return a map's condition as it is, or read from the path of a map; None without a map."""
    if isinstance(within, str | PathLike):
        from odomcorrupt.mapping.map_condition import read_condition

        return read_condition(fspath(within))
    return within
