"""The bag that a command only looks at: where it comes from, what drives, whether it may be damaged."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

__all__ = ["bag_options", "report_losses", "source_of"]


def bag_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options that say how a bag is read, and what in it drives the model."""
    for option in (
        click.option(
            "--recover", is_flag=True, help="Read what is whole of a damaged bag; the exit code is 3 if some is lost."
        ),
        click.option("--base-frame", metavar="FRAME", help="The robot's frame. [default: the odometry's child frame]"),
        click.option("--odom-frame", metavar="FRAME", help="Frame that drifts. [default: that of the odometry]"),
        click.option("--odom-topic", "--odom", "odom_topic", metavar="TOPIC", help="Odometry that drives the model."),
    ):
        command = option(command)
    return command


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
