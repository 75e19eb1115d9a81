"""odomcorrupt info: contents of a bag, and the messages that corruption would modify."""

from __future__ import annotations

import click

from odomcorrupt.commands._bag import bag_options, report_losses, source_of
from odomcorrupt.commands._progress import Progress
from odomcorrupt.commands._standard import Console, standard_options


@click.command("info", short_help="Show a bag's odometry, and what corruption would change.")
@click.argument("input_", metavar="INPUT", type=click.Path(allow_dash=True))
@bag_options
@standard_options
def command(
    input_: str,
    *,
    odom_topic: str | None,
    odom_frame: str | None,
    base_frame: str | None,
    recover: bool,
    console: Console,
) -> int:
    """Show a bag's topics, frames and edges, its motion, anomalies, and topics that still hold the true motion."""
    from odomcorrupt.bags.open import open_reader
    from odomcorrupt.bags.provenance import ProvenanceWatcher
    from odomcorrupt.inspection.scan import scan_bag
    from odomcorrupt.inspection.summary import brief, summarise, summary_text

    source = source_of(input_)
    with open_reader(source, recover=recover) as reader, Progress(quiet=console.quiet) as progress:
        watcher = ProvenanceWatcher(progress)
        seen = scan_bag(reader, watcher)
        losses = list(reader.losses)
    values = summarise(seen, odom_topic=odom_topic, odom_frame=odom_frame, base_frame=base_frame)
    values["provenance"] = [*watcher.provenance(source)]
    console.print(brief(values, input_), summary_text(values), values)
    return report_losses(losses)
