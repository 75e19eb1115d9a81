"""odomcorrupt compare: models against measurements, and where they fail."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from odomcorrupt.commands._output import refuse_existing, write_bytes, write_text
from odomcorrupt.commands._recordings import Reading, recording_options, split_arguments
from odomcorrupt.extras import require

if TYPE_CHECKING:
    from collections.abc import Iterable

    from odomcorrupt.model.motion_model import MotionModel

__all__ = ["REJECTED", "command"]

REJECTED = 4
"""Exit code of --fail-if-rejected."""
_NAMES = ("error", "path", "nees", "residuals", "map", "pit")
_KINDS = ("png", "svg", "pdf")


@click.command("compare", short_help="Compare models with measurements; see where they fail.")
@click.argument("arguments", nargs=-1, required=True, metavar="RECORDING... MODEL.toml...")
@recording_options
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
@click.option(
    "--report",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Write all of it as one page of HTML, pictures too.",
)
@click.option(
    "--plot",
    multiple=True,
    metavar="[NAME=]FILE",
    help=f"Write one picture as .png, .svg or .pdf (repeatable): {', '.join(_NAMES)}. [default name: error]",
)
@click.option("--fail-if-rejected", is_flag=True, help="Exit with 4 where the data reject the last model.")
@click.option("--overwrite", is_flag=True, help="Replace existing outputs.")
def command(
    arguments: tuple[str, ...],
    *,
    reading: Reading,
    as_json: bool,
    report: Path | None,
    plot: tuple[str, ...],
    fail_if_rejected: bool,
    overwrite: bool,
) -> int:
    """Print the error measured and expected by length of path, whether each model is rejected, and where it fails.

    Recordings that a model was fitted on are cut in halves: the model is refitted on one and judged on the other.
    """
    require("scipy", "the study needs it", "study")
    from odomcorrupt import __version__
    from odomcorrupt.model.model_file import read_model
    from odomcorrupt.report.json.comparison import comparison_json
    from odomcorrupt.report.text.comparison import comparison_text
    from odomcorrupt.report.text.tables import clock_lines
    from odomcorrupt.study.validate.compare import compare

    paths, names = split_arguments(arguments)
    models = {name: read_model(Path(name)) for name in names}
    if not models:
        raise click.UsageError("no model given; name one or more .toml files that `odomcorrupt fit` wrote")
    plots = _plots(plot)
    for output in (report, *plots):
        refuse_existing(output, overwrite=overwrite)
    tracks = [m.track_m for m in models.values() if m.track_m is not None]
    runs = reading.read(paths, track=tracks[0] if tracks else None)
    result = compare(runs, _short_names(models))
    if as_json:
        click.echo(json.dumps(comparison_json(result), indent=2, allow_nan=False))
    else:
        for line in clock_lines([r.name for r in runs], result.clocks):
            click.echo(line)
        click.echo(comparison_text(result))
    if plots:
        from odomcorrupt.report.plots.comparison import PICTURES
        from odomcorrupt.report.plots.figure import rendered

        for path, name in plots.items():
            write_bytes(path, rendered(PICTURES[name].draw(result), path.suffix[1:].lower()))
            click.echo(f"wrote {path}", err=True)
    if report is not None:
        from odomcorrupt.report.html.comparison import report_html

        write_text(report, report_html(result, version=__version__))
        click.echo(f"wrote {report}", err=True)
    return REJECTED if fail_if_rejected and result.judgements[-1].verdict.rejected else 0


def _plots(texts: Iterable[str]) -> dict[Path, str]:
    """Return the picture wanted in each file."""
    found: dict[Path, str] = {}
    for text in texts:
        name, equals, file = text.partition("=")
        if not equals:
            name, file = "error", text
        path = Path(file)
        if name not in _NAMES:
            raise click.UsageError(f"--plot {text}: no picture is called {name!r}; there are {', '.join(_NAMES)}")
        if path.suffix[1:].lower() not in _KINDS:
            raise click.UsageError(f"--plot {text}: {file!r} says no kind of picture; end it in .png, .svg or .pdf")
        if path in found:
            raise click.UsageError(f"--plot {text}: {file} is the file of another picture already; choose another name")
        found[path] = name
    return found


def _short_names(models: dict[str, MotionModel]) -> dict[str, MotionModel]:
    """Return models by file name alone where that tells them apart."""
    short = [Path(name).name for name in models]
    return dict(zip(short, models.values(), strict=True)) if len(set(short)) == len(models) else models
