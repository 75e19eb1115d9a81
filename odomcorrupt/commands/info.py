"""odomcorrupt info: what a bag holds, and what corruption would move."""

from __future__ import annotations

import click

from odomcorrupt.commands._bag import bag_options, report_losses, source_of
from odomcorrupt.commands._progress import Progress
from odomcorrupt.report.json.numbers import finite

__all__ = ["command"]


@click.command("info", short_help="Show a bag's odometry, and what corruption would move.")
@click.argument("input_", metavar="INPUT", type=click.Path(allow_dash=True))
@bag_options
@click.option("--json", "as_json", is_flag=True, help="Print values for scripts: metres, radians, seconds.")
def command(
    input_: str,
    odom_topic: str | None,
    odom_frame: str | None,
    base_frame: str | None,
    recover: bool,  # noqa: FBT001 - click passes flags so
    as_json: bool,  # noqa: FBT001 - as above
) -> int:
    """Show a bag's topics, frames and edges, how its robot moved, what is odd, and which topics tell the truth."""
    import json

    from odomcorrupt.bags.open import open_reader
    from odomcorrupt.info.scan import survey
    from odomcorrupt.info.summary import portrait, portrait_text

    with open_reader(source_of(input_), recover=recover) as reader, Progress() as progress:
        seen = survey(reader, progress)
        losses = list(reader.losses)
    values = portrait(seen, odom_topic=odom_topic, odom_frame=odom_frame, base_frame=base_frame)
    click.echo(json.dumps(finite(values), indent=2, allow_nan=False) if as_json else portrait_text(values))
    return report_losses(losses)
