"""odomcorrupt fit: a robot's motion model from recordings of odometry and truth."""

from __future__ import annotations

from pathlib import Path

import click

from odomcorrupt.commands._output import refuse_existing, write_text
from odomcorrupt.commands._recordings import Reading, recording_options, split_arguments
from odomcorrupt.extras import require

__all__ = ["command"]


@click.command("fit", short_help="Fit a robot's motion model to odometry and truth.")
@click.argument("recordings", nargs=-1, required=True)
@recording_options
@click.option("-o", "--output", type=click.Path(dir_okay=False, path_type=Path), help="Model file to write.")
@click.option("--start", type=click.Path(dir_okay=False, path_type=Path), help="Model file whose effects to refit.")
@click.option("--add", multiple=True, metavar="EFFECT", help="Effect to add to the start model (repeatable).")
@click.option("--law", help="Noise law, or all: the likeliest. [default: that of the start model, or diffusion]")
@click.option("--overwrite", is_flag=True, help="Replace an existing output.")
def command(
    recordings: tuple[str, ...],
    *,
    reading: Reading,
    output: Path | None,
    start: Path | None,
    add: tuple[str, ...],
    law: str | None,
    overwrite: bool,
) -> None:
    """Fit the noise coefficients, the truth's own noise, clocks and set-up, and the effects asked for.

    Of the set-up, a lever arm and a mounting yaw of the truth are fitted where the data show them. Several recordings
    are runs of one robot, each with a clock of its own.
    """
    require("scipy", "the study needs it", "study")
    from odomcorrupt.model.model_file import format_model, read_model
    from odomcorrupt.report.text.fit import fit_text, laws_table
    from odomcorrupt.study.estimate.calibrate import effects_to_fit, fit_every_law, fit_robot
    from odomcorrupt.study.validate.round_trip import proved

    paths, models = split_arguments(recordings)
    if models:
        raise click.UsageError(f"{models[0]} is a model; pass it with --start")
    refuse_existing(output, overwrite=overwrite)
    begin = read_model(start) if start is not None else None
    effects = effects_to_fit(begin, add)
    law_name = law or (begin.noise.law_name if begin is not None else "diffusion")
    runs = reading.read(paths, track=begin.track_m if begin else None)
    if law_name == "all":
        results = fit_every_law(runs, effects, start=begin)
        click.echo(laws_table(results) + "\n")
        result = next(iter(results.values()))
    else:
        result = fit_robot(runs, effects, law_name=law_name, start=begin)
    proof = proved(result.model, runs)
    click.echo("\n".join([fit_text(result), *proof.changes]))
    if output is not None:
        write_text(output, format_model(proof.model))
        click.echo(f"wrote {output}", err=True)
