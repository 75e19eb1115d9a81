"""Options shared by all functions that read and write bags."""

from __future__ import annotations

from dataclasses import fields
from os import PathLike, fspath
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypedDict

from odomcorrupt.corruption.run import Container
from odomcorrupt.corruption.transform import Options
from odomcorrupt.errors import OdomCorruptError
from odomcorrupt.sensors import read_imu

if TYPE_CHECKING:
    from odomcorrupt.bags.convert.message_types import Generation
    from odomcorrupt.mapping.conditioned import MapCondition


class BagOptions(TypedDict, total=False):
    """Which messages of a bag are modified, and how the output is written.

    odom_topic : odometry topic that the model is applied to; by default the only one
    odom_frame, base_frame : frames, if those of the odometry messages differ from those of TF
    keep_twist, keep_covariance : leave twists or covariances as they are
    keep_truth : topic to which the clean odometry is copied
    keep_localisation : modify map -> odom inversely, so that map -> base remains true
    new_odom_frame : leave all messages unchanged and publish the drift as the transform from this frame to odom
    subtracted : with `new_odom_frame`: publish noisy minus clean poses, as in the article's listing, which is not rigid
    consistent : rewrite wheels, ticks, twists and gyros of known types to the noisy motion, too
    scan_noise, scan_keep : noise of the ranges of laser scans, metres, and part of their beams that is kept, 0 to 1
    scan_every : keep every N-th laser scan of a publisher, beginning with the first, and leave the others out
    imu : file with the noise of IMUs, as Kalibr has it
    overwrite : replace an existing output
    compression, level : of the output: none, lz4, zstd (MCAP), bz2 (ROS 1), file, message (ROS 2 directories);
        by default those of the input
    ros : ROS generation, 1 or 2, of the output's messages, if its name allows both
    storage : mcap or sqlite3, for an output directory
    exclude : topics left out of the output, or edges of TF, as in "/tf:map.odom"
    rename : "OLD=NEW" for topics that get another name in the output
    recover : read the undamaged parts of a damaged input
    threads : number of threads that read, compute and compress; by default one per core, at most four
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
    consistent: bool
    scan_noise: float
    scan_keep: float
    scan_every: int
    imu: str | PathLike[str] | None
    overwrite: bool
    compression: str | None
    level: int | None
    ros: Generation | None
    storage: str | None
    exclude: tuple[str, ...]
    rename: tuple[str, ...]
    recover: bool
    threads: int | None


def split_options(options: BagOptions) -> tuple[Options, Container]:
    """Return the options of the modification, and those of reading and writing."""
    moved = set(Options._fields)
    known = moved | {field.name for field in fields(Container)}
    for name in options:
        if name not in known:
            raise TypeError(f"{name}: no such option; there are {', '.join(sorted(known))}")
    values: dict[str, Any] = dict(options)
    if values.get("imu") is not None:
        values["imu"] = read_imu(Path(fspath(values["imu"])))
    own = {name: values.pop(name) for name in moved & values.keys()}
    return Options(**own), Container(**values)


def bag_path(path: str | PathLike[str]) -> Path | None:
    """Return a path, or None for "-" (a pipe)."""
    return None if fspath(path) == "-" else Path(fspath(path))


def drive_path(bag: str | PathLike[str]) -> Path:
    """Return the path of a bag that is read before anything is written; raise OdomCorruptError for "-" (a pipe)."""
    if fspath(bag) == "-":
        raise OdomCorruptError("-: the whole drive is read first, which is impossible on a pipe; name a file")
    return Path(fspath(bag))


def as_condition(within: MapCondition | str | PathLike[str] | None) -> MapCondition | None:
    """Return a map condition unchanged, or read it from the path of a map; None without a map."""
    if isinstance(within, str | PathLike):
        from odomcorrupt.mapping.conditioned import read_condition

        return read_condition(fspath(within))
    return within
