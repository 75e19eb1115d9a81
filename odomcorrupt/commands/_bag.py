"""Options that say which odometry of a bag is meant, what of it is moved, and how bags are written."""

from __future__ import annotations

import functools
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from odomcorrupt.commands._standard import overwrite_option

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

    from odomcorrupt.api.bag_options import BagOptions

__all__ = [
    "BAG_OPTIONS",
    "bag_options",
    "bag_words",
    "container_options",
    "frame_options",
    "keeping_options",
    "moving_options",
    "report_losses",
    "source_of",
    "threads_option",
    "unpack_option",
]

BAG_OPTIONS = (
    "odom_topic",
    "odom_frame",
    "base_frame",
    "keep_truth",
    "keep_localisation",
    "new_odom_frame",
    "overwrite",
    "compression",
    "level",
    "storage",
    "exclude",
    "recover",
    "threads",
)
"""Options that are called alike here and in the Python interface."""

_RECOVER = click.option(
    "--recover", is_flag=True, help="Read what is whole of a damaged bag; the exit code is 3 if some is lost."
)


def _all(command: Callable[..., Any], options: Iterable[Callable[..., Any]]) -> Callable[..., Any]:
    for option in reversed([*options]):
        command = option(command)
    return command


def frame_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options that say which odometry and which frames are meant."""
    return _all(
        command,
        (
            click.option("--odom-topic", "--odom", "odom_topic", metavar="TOPIC", help="Odometry that is moved."),
            click.option("--odom-frame", metavar="FRAME", help="Frame that drifts. [default: that of the odometry]"),
            click.option("--base-frame", metavar="FRAME", help="Robot's frame. [default: the odometry's child frame]"),
        ),
    )


def keeping_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options that leave twists or covariances as they are."""
    return _all(
        command,
        (
            click.option(
                "--twist",
                type=click.Choice(["model", "keep"]),
                default="model",
                help="Twists: follow the poses, or as they are. [default: model]",
            ),
            click.option(
                "--covariance",
                type=click.Choice(["model", "keep"]),
                default="model",
                help="Likewise covariances. [default: model]",
            ),
        ),
    )


def moving_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options that say what corruption moves and what it adds."""
    return frame_options(
        keeping_options(
            _all(
                command,
                (
                    click.option("--keep-truth", metavar="TOPIC", help="Keep the clean odometry on this topic, too."),
                    click.option(
                        "--keep-localisation",
                        is_flag=True,
                        help="Move map -> odom the other way, so that map -> base stays.",
                    ),
                    click.option(
                        "--tf",
                        type=click.Choice(["odometry", "correction", "subtraction"]),
                        default="odometry",
                        help="Move the odometry, or leave it and publish the drift as a transform: rigid, or noisy "
                        "minus clean as the article's listing has it. [default: odometry]",
                    ),
                    click.option(
                        "--new-odom-frame", metavar="FRAME", help="Parent of the odom frame for --tf correction."
                    ),
                ),
            )
        )
    )


def unpack_option(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the option that lifts the limit of what compressed bags become, while the command runs."""

    @functools.wraps(command)
    def within_limit(*args: Any, max_unpacked: int | None, **given: Any) -> Any:
        from odomcorrupt.bags.budget import limited

        with limited(max_unpacked):
            return command(*args, **given)

    option = click.option(
        "--max-unpacked",
        metavar="SIZE",
        callback=_size,
        help="Let compressed chunks become so large, as in 4GiB. [default: 1GiB each, and what a recording can reach]",
    )
    return option(within_limit)


def _size(_ctx: click.Context, _option: click.Parameter, text: str | None) -> int | None:
    from odomcorrupt.bags.budget import size_of

    try:
        return None if text is None else size_of(str(text))
    except ValueError as error:
        raise click.BadParameter(str(error)) from error


def container_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options that say how bags are read and written."""
    return _all(
        unpack_option(command),
        (
            overwrite_option(),
            click.option(
                "--compression",
                metavar="NAME",
                help="none, lz4, zstd (MCAP), bz2 (ROS 1), file, message (ROS 2 directories). [default: as it was]",
            ),
            click.option("--level", type=int, metavar="N", help="Of compression. [default: a fast one]"),
            click.option(
                "--ros",
                type=click.Choice(["1", "2"]),
                help="ROS of the messages in an .mcap or a pipe. [default: 2 for an .mcap, else as it was]",
            ),
            click.option(
                "--storage",
                type=click.Choice(["mcap", "sqlite3"]),
                help="Of an output without a suffix, a ROS 2 directory. [default: as it was, else mcap]",
            ),
            click.option(
                "--exclude-topic",
                "exclude",
                multiple=True,
                metavar="TOPIC",
                help="Leave a topic out of the output (repeatable).",
            ),
            _RECOVER,
        ),
    )


def threads_option(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the option that says how many threads read, compute and compress side by side."""
    option = click.option(
        "--threads", type=click.IntRange(1), metavar="N", help="For the same bytes. [default: one a core, at most 4]"
    )
    return option(command)


def bag_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options of commands that only read a bag: which odometry, and whether it may be damaged."""
    return frame_options(_RECOVER(unpack_option(command)))


def bag_words(given: Mapping[str, Any], names: Sequence[str]) -> BagOptions:
    """Return options as the Python interface calls them.

    Raises
    ------
    click.UsageError
        Where --tf correction and its frame do not come together.

    """
    if (given.get("tf", "odometry") != "odometry") != (given.get("new_odom_frame") is not None):
        raise click.UsageError("--tf correction and --new-odom-frame FRAME go together; give both or neither")
    options: Any = {name: given[name] for name in names if name in given}
    for name in ("twist", "covariance"):
        if name in given:
            options[f"keep_{name}"] = given[name] == "keep"
    if given.get("tf") == "subtraction":
        options["subtracted"] = True
    if given.get("ros") is not None:
        options["ros"] = int(given["ros"])
    chosen: BagOptions = options
    return chosen


def source_of(input_: str) -> Path | None:
    """Return the path of an input, None for a pipe; a terminal is refused."""
    if input_ != "-":
        return Path(input_)
    if sys.stdin.isatty():
        raise click.UsageError("INPUT is - but stdin is a terminal; feed it a bag")
    return None


def report_losses(losses: Sequence[str]) -> int:
    """Say on stderr what was lost of a damaged bag, and return the exit code."""
    for loss in losses:
        click.echo(f"Lost: {loss}.", err=True)
    return 3 if losses else 0
