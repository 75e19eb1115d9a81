"""odomcorrupt info: what a bag holds, and what corruption would move."""

from __future__ import annotations

from pathlib import Path

import click

__all__ = ["command"]


@click.command("info", short_help="Show a bag's odometry, and what corruption would move.")
@click.argument("input_", metavar="INPUT", type=click.Path(allow_dash=True))
@click.option("--odom-topic", "--odom", "odom_topic", metavar="TOPIC", help="Odometry that drives the model.")
@click.option("--odom-frame", metavar="FRAME", help="Frame that drifts. [default: that of the odometry]")
@click.option("--base-frame", metavar="FRAME", help="The robot's frame. [default: the odometry's child frame]")
@click.option("--json", "as_json", is_flag=True, help="Print values for scripts: metres, radians, seconds.")
def command(
    input_: str,
    odom_topic: str | None,
    odom_frame: str | None,
    base_frame: str | None,
    as_json: bool,  # noqa: FBT001 - click passes flags so
) -> None:
    """Show a bag's topics, frames and edges, how its robot moved, what is odd, and which topics tell the truth."""
    import json

    from odomcorrupt.bags.open import open_reader
    from odomcorrupt.info.portrait import portrait, portrait_text
    from odomcorrupt.info.survey import survey

    with open_reader(None if input_ == "-" else Path(input_)) as reader:
        seen = survey(reader)
    values = portrait(seen, odom_topic=odom_topic, odom_frame=odom_frame, base_frame=base_frame)
    click.echo(json.dumps(values, indent=2) if as_json else portrait_text(values))
