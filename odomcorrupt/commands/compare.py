"""odomcorrupt compare: models against measurements, and where they fail."""

from __future__ import annotations

import json
from pathlib import Path

import click

from odomcorrupt.commands._output import refuse_existing
from odomcorrupt.commands._recordings import need_study, read_all, recording_options, split_arguments

__all__ = ["REJECTED", "command"]

REJECTED = 4
"""Exit code of --fail-if-rejected."""


@click.command("compare", short_help="Compare models with measurements; see where they fail.")
@click.argument("arguments", nargs=-1, required=True, metavar="RECORDING... MODEL.toml...")
@recording_options
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
@click.option("--plot", type=click.Path(dir_okay=False, path_type=Path), help="Picture of error against distance.")
@click.option("--fail-if-rejected", is_flag=True, help="Exit with 4 where the data reject the last model.")
@click.option("--overwrite", is_flag=True, help="Replace an existing picture.")
def command(
    arguments: tuple[str, ...],
    odom: str | None,
    truth: str | None,
    track: float | None,
    as_json: bool,  # noqa: FBT001 - click passes flags so
    plot: Path | None,
    fail_if_rejected: bool,  # noqa: FBT001 - as above
    overwrite: bool,  # noqa: FBT001 - as above
) -> int:
    """Print the error measured and expected by length of path, and the ladder of the models on these recordings.

    Recordings that a model was fitted on are cut in halves: the model is refitted on one and judged on the other.
    """
    need_study()
    from odomcorrupt.report.comparison import comparison_text
    from odomcorrupt.report.comparison_json import comparison_json
    from odomcorrupt.report.tables import clock_lines
    from odomcorrupt.study.compare import compare

    paths, models = split_arguments(arguments)
    if not models:
        raise click.UsageError("no model given; name one or more .toml files that `odomcorrupt fit` wrote")
    refuse_existing(plot, overwrite=overwrite)
    tracks = [m.track_m for m in models.values() if m.track_m is not None]
    runs = read_all(paths, odom, truth, track if track is not None else (tracks[0] if tracks else None))
    result = compare(runs, models)
    if as_json:
        click.echo(json.dumps(comparison_json(result), indent=2, allow_nan=False))
    else:
        for line in clock_lines([r.name for r in runs], result.clocks):
            click.echo(line)
        click.echo(comparison_text(result))
    if plot is not None:
        from odomcorrupt.report.ladder import draw_ladder

        draw_ladder(result, plot)
        click.echo(f"wrote {plot}", err=True)
    return REJECTED if fail_if_rejected and result.judgements[-1].verdict.rejected else 0
