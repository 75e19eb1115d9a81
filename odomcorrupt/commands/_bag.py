"""Options that select a bag's odometry, the messages to modify, and how bags are read and written."""

from __future__ import annotations

import functools
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from odomcorrupt.commands._options import FILE, Setting, added, number, setting, valued
from odomcorrupt.commands._standard import overwrite_option

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from odomcorrupt.api.bag_options import BagOptions

_RECOVER = click.option(
    "--recover", is_flag=True, help="Read the intact part of a damaged bag; the exit code is 3 if data are lost."
)

ODOM_TOPIC = ("--odom-topic", "--odom", "odom_topic")
"""Names of the option that selects the odometry."""

frame_options = added(
    setting(*ODOM_TOPIC, metavar="TOPIC",
            help="Odometry topic to modify; in a ROS 1 bag TOPIC@NODE for one publisher of it."),
    setting("--odom-frame", metavar="FRAME", help="Odom frame. [default: that of the odometry]"),
    setting("--base-frame", metavar="FRAME", help="Robot's frame. [default: the odometry's child frame]"),
)  # fmt: skip
"""Adds the options that select odometry and frames."""

keeping_options = added(
    valued("--twist", among=["model", "keep"], text="Twists: recomputed with the poses, or unchanged."),
    valued("--covariance", among=["model", "keep"], text="Covariances: recomputed, or unchanged."),
)
"""Adds the options that leave twists or covariances unchanged."""

keep_localisation_option = click.option(
    "--keep-localisation", is_flag=True, help="Invert the change in map -> odom, so that map -> base is unchanged."
)
moving_options = added(
    frame_options,
    keeping_options,
    click.option(
        "--also", multiple=True, metavar="TOPIC",
        help="Odometry of another robot in the bag, corrupted with a drift of its own (repeatable).",
    ),
    click.option("--keep-truth", metavar="TOPIC", help="Keep the clean odometry on this additional topic."),
    keep_localisation_option,
    click.option("--consistent", is_flag=True, help="Rewrite wheels, ticks, twists, gyros to the noisy motion, too."),
    valued("--scan-noise", kind=number("metres", 0.0, 100.0), default=0.0, metavar="M", cls=Setting,
           text="Standard deviation of noise on the ranges of laser scans, metres."),
    valued("--scan-keep", kind=number("a part of 1", 0.0, 1.0), default=1.0, metavar="PART", cls=Setting,
           text="Part of the beams of laser scans that is kept; the others become NaN."),
    setting("--scan-every", type=click.IntRange(1), default=1, metavar="N",
            help="Keep every N-th laser scan of a topic, and leave the others out."),
    click.option("--imu", type=FILE, help="Add the noise in an IMU file of Kalibr to all Imu messages."),
    valued(
        "--tf", among=["odometry", "correction", "subtraction"],
        text="Move the odometry, or leave it and publish the drift as a transform: a rigid transform (correction), or "
        "noisy minus clean poses, which is not rigid (subtraction; Gazebo article, docs/laws.md).",
    ),
    click.option("--new-odom-frame", metavar="FRAME",
                 help="Parent of the odom frame, for --tf correction or subtraction."),
)  # fmt: skip
"""Adds the options of the messages that corruption modifies and adds."""


def unpack_option(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the option that raises the size limit of decompressed bags while the command runs."""

    @functools.wraps(command)
    def within_limit(*args: Any, max_unpacked: int | None, **given: Any) -> Any:
        from odomcorrupt.bags.source import limited

        with limited(max_unpacked):
            return command(*args, **given)

    option = click.option(
        "--max-unpacked",
        metavar="SIZE",
        callback=_size,
        help="Limit of decompressed chunks, as in 4GiB. [default: 1GiB each, and a plausible total]",
    )
    return option(within_limit)


def _size(_ctx: click.Context, _option: click.Parameter, text: str | None) -> int | None:
    from odomcorrupt.bags.source import size_of

    try:
        return None if text is None else size_of(str(text))
    except ValueError as error:
        raise click.BadParameter(str(error)) from error


container_options = added(
    overwrite_option(passed=True),
    click.option(
        "--compression", metavar="NAME",
        help="none, lz4, zstd (MCAP), bz2 (ROS 1), file, message (ROS 2 directories). [default: as in the input]",
    ),
    click.option("--level", type=int, metavar="N", help="Compression level. [default: a fast one]"),
    click.option(
        "--ros", type=click.Choice(["1", "2"]),
        help="ROS generation of the messages in an .mcap or a pipe. [default: 2 for an .mcap, else as in the input]",
    ),
    click.option(
        "--storage", type=click.Choice(["mcap", "sqlite3"]),
        help="Storage of an output without a suffix, a ROS 2 directory. [default: as in the input, else mcap]",
    ),
    click.option(
        "--exclude-topic", "exclude", multiple=True, metavar="TOPIC",
        help="Leave a topic, or an edge of TF as in /tf:map.odom, out of the output (repeatable).",
    ),
    click.option(
        "--rename", multiple=True, metavar="OLD=NEW",
        help="Name of a topic in the output (repeatable). [default: as in the input, or as ROS 2 allows]",
    ),
    _RECOVER,
    unpack_option,
)  # fmt: skip
"""Adds the options for reading and writing bags."""

threads_option = click.option(
    "--threads", type=click.IntRange(1), metavar="N",
    help="Number of threads; the output does not depend on it. [default: one per core, at most 4]",
)  # fmt: skip
"""Sets the number of threads that read, compute and compress."""

bag_options = added(frame_options, _RECOVER, unpack_option)
"""Adds the options of commands that only read a bag: its odometry, and reading of damaged bags."""


def bag_words(given: Mapping[str, Any]) -> BagOptions:
    """Return options under their names in the Python interface.

    Raises
    ------
    click.UsageError
        If only one of --tf correction and its frame is given.
    """
    from odomcorrupt.api.bag_options import BagOptions

    tf = given.get("tf", "odometry")
    if (tf != "odometry") != (given.get("new_odom_frame") is not None):
        word = "correction" if tf == "odometry" else tf
        raise click.UsageError(f"--tf {word} and --new-odom-frame FRAME go together; give both or neither")
    if given.get("consistent") and tf != "odometry":
        raise click.UsageError(f"--consistent and --tf {tf}: the odometry keeps the true motion; leave one out")
    options: Any = {name: given[name] for name in BagOptions.__annotations__ if name in given}
    for name in ("twist", "covariance"):
        if name in given:
            options[f"keep_{name}"] = given[name] == "keep"
    if given.get("tf") == "subtraction":
        options["subtracted"] = True
    if given.get("ros") is not None:
        options["ros"] = int(given["ros"])
    return options


def source_of(input_: str) -> Path | None:
    """Return the path of an input, None for a pipe; a terminal is refused."""
    if input_ != "-":
        return Path(input_)
    if sys.stdin.isatty():
        raise click.UsageError("INPUT is - but stdin is a terminal; redirect a bag to it")
    return None


further_inputs = click.argument("further", nargs=-1, type=click.Path(), metavar="")
"""Takes the files that a shell makes of run_*.bag; not in the usage line."""


def one_input(files: Sequence[str]) -> str:
    """Return an input, or the pattern of several that are the parts of one recording.

    Raises
    ------
    click.UsageError
        If several inputs are not that.
    """
    if len(files) == 1:
        return files[0]
    if missing := [file for file in files if not Path(file).exists()]:
        raise click.UsageError(f"Got unexpected extra argument: {missing[0]} does not exist; write INPUT OUTPUT")
    from odomcorrupt.bags.parts import bags_in, pattern_of

    paths = [Path(file) for file in files]
    if (pattern := pattern_of(paths)) is None:
        raise click.UsageError(
            f"{len(files)} inputs ({files[0]}, {files[1]}, ...) are not evidently the parts of one recording, such as "
            "run_0.bag and run_1.bag; run the command for each of them, or `odomcorrupt batch` for all"
        )
    if more := [one.name for one in bags_in(pattern) if one not in paths]:
        raise click.UsageError(f"{', '.join(more)}: part of the same recording; name it, too, or write '{pattern}'")
    return str(pattern)


def report_losses(losses: Sequence[str]) -> int:
    """Print the losses of a damaged bag on stderr, and return the exit code."""
    for loss in losses:
        click.echo(f"Lost: {loss}.", err=True)
    return 3 if losses else 0
