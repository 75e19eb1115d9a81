"""odomcorrupt compare: models against measurements, and their lack of fit."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click

from odomcorrupt.commands._options import MODELS, PAGE, PICTURE
from odomcorrupt.commands._recordings import Reading, recording_options, split_arguments
from odomcorrupt.commands._standard import Console, overwrite_option, printed, standard_options

if TYPE_CHECKING:
    from collections.abc import Iterable

    from odomcorrupt.commands._standard import Files


REJECTED = 4
"""Exit code of --fail-if-rejected."""
_NAMES = ("error", "path", "nees", "residuals", "map", "pit")


@click.command("compare", short_help="Compare models with measurements; see where they fail.")
@click.argument("arguments", nargs=-1, required=True, metavar="RECORDING... MODEL.toml...", shell_complete=MODELS)
@recording_options(
    click.option(
        "--plot", multiple=True, metavar="[NAME=]FILE",
        help=f"Write one picture as .png, .svg or .pdf (repeatable): {', '.join(_NAMES)}. [default name: error]",
    ),
    click.option("--report", type=PAGE, help="Write the full result as one HTML page with pictures."),
    click.option("--fail-if-rejected", is_flag=True, help="Exit with 4 where the last model is REJECTED."),
)  # fmt: skip
@overwrite_option("existing outputs", passed=True)
@standard_options
def command(
    arguments: tuple[str, ...], *, reading: Reading, report: Path | None, plot: tuple[str, ...], fail_if_rejected: bool,
    overwrite: bool, console: Console,
) -> int:  # fmt: skip
    """Print the error measured and expected by length of path, whether each model is rejected, and where it fails.

    Recordings that a model was fitted on, under any name, cross-validate it: the model is refitted without each of
    them, or each half of the only one, and evaluated on it.
    """
    from odomcorrupt.api.findings import compare, named_models

    paths, names = split_arguments(arguments)
    if not names:
        raise click.UsageError("no model given; name one or more .toml files that `odomcorrupt fit` wrote, or a preset")
    plots = _plots(plot)
    for picture in plots:
        PICTURE.require_writable(picture, overwrite=overwrite)
    models = named_models(list(dict.fromkeys(names)))
    track = next((m.motion_model.track_m for m in models.values() if m.motion_model.track_m is not None), None)
    with reading.stages(console) as stages:
        runs, _ = reading.read(paths, console, stages, track=track)
        stages("comparison", 0.0)
        result = compare(runs, models)
    drawn = {p: partial(result.plot, p, picture=name) for p, name in plots.items()}
    following = ["sim.bag", "noisy.bag", "--model" if names[-1].endswith(".toml") else "--preset", names[-1]]
    if result.fails:
        following = ["diagnose", *map(str, paths), *reading.words, names[-1]]
    files: Files = {**drawn, **printed(report, result.report)}
    console.show(result.then("odomcorrupt", *following), files=files)
    return REJECTED if fail_if_rejected and result.fails else 0


def _plots(texts: Iterable[str]) -> dict[Path, str]:
    """Return the figure requested for each file."""
    found: dict[Path, str] = {}
    for text in texts:
        name, equals, file = text.partition("=")
        if not equals:
            name, file = "error", text
        path = Path(file)
        if name not in _NAMES:
            raise click.UsageError(f"--plot {text}: no picture is called {name!r}; there are {', '.join(_NAMES)}")
        if path in found:
            raise click.UsageError(f"--plot {text}: {file} is the file of another picture already; choose another name")
        found[path] = name
    return found
