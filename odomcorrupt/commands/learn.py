"""odomcorrupt learn: the whole loop, from recordings to a robot's model."""

from __future__ import annotations

import json
import shlex
from pathlib import Path
from typing import TYPE_CHECKING

import click

from odomcorrupt.commands._advice import check_drive, write_drive, write_report
from odomcorrupt.commands._output import refuse_existing, write_text
from odomcorrupt.commands._recordings import Reading, recording_options, split_arguments
from odomcorrupt.extras import require

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.study.validate.compare import Comparison

__all__ = ["command"]


@click.command("learn", short_help="Fit, diagnose and add, until nothing is missing.")
@click.argument("recordings", nargs=-1, required=True)
@recording_options
@click.option("-o", "--output", type=click.Path(dir_okay=False, path_type=Path), help="Model file to write.")
@click.option("--judge", type=click.Path(), multiple=True, help="Recording to judge the result on (repeatable).")
@click.option("--plot", type=click.Path(dir_okay=False, path_type=Path), help="Picture of the error falling.")
@click.option(
    "--report",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Write all of it as one page of HTML, pictures too.",
)
@click.option(
    "--drive",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Write the drive that would settle what is open, as /cmd_vel in an MCAP.",
)
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
@click.option("--overwrite", is_flag=True, help="Replace existing outputs.")
def command(
    recordings: tuple[str, ...],
    *,
    reading: Reading,
    output: Path | None,
    judge: tuple[str, ...],
    plot: Path | None,
    report: Path | None,
    drive: Path | None,
    as_json: bool,
    overwrite: bool,
) -> None:
    """Learn which effects a robot has, write its model, and show the error falling.

    Without --judge, the ladder is cross-validated on halves of the recordings themselves.
    """
    require("scipy", "the study needs it", "study")
    from odomcorrupt.model.model_file import format_model
    from odomcorrupt.report.json.comparison import comparison_json
    from odomcorrupt.report.json.diagnosis import learned_json
    from odomcorrupt.report.text.comparison import comparison_text
    from odomcorrupt.report.text.diagnosis import found_text
    from odomcorrupt.report.text.fit import fit_text
    from odomcorrupt.study.design.advise import advise
    from odomcorrupt.study.estimate.calibrate import fit_robot
    from odomcorrupt.study.select.stepwise import learn
    from odomcorrupt.study.validate.compare import compare
    from odomcorrupt.study.validate.held_out import keep_what_holds
    from odomcorrupt.study.validate.model_sequence import ladder_comparison
    from odomcorrupt.study.validate.round_trip import proved

    paths, models = split_arguments(recordings)
    if models:
        raise click.UsageError(f"{models[0]} is a model; `fit --start` and `diagnose` take models")
    for path in (output, plot, report):
        refuse_existing(path, overwrite=overwrite)
    check_drive(drive, overwrite=overwrite)
    runs, held_out = reading.read_with_held_out(paths, [Path(j) for j in judge])
    judges = held_out or runs
    learned, said = keep_what_holds(learn(runs), held_out or ())
    advice = advise(learned)
    random = [gain.effect for gain in learned.noise]
    robot = fit_robot(
        runs,
        (*learned.fit.effects, *random),
        law_name="diffusion",
        clocks=learned.clocks,
        shaped=learned.added,
    )
    proof = proved(robot.model, runs)
    ladder = {"without effects": fit_robot(runs, (), law_name="diffusion", clocks=learned.clocks).model}
    names = [*learned.added, *(one.title for one in learned.laws), *(e.name for e in random)]
    if names:
        ladder["with " + ", ".join(names)] = proof.model
    comparison = compare(judges, ladder)
    steps = ladder_comparison(learned, judges) if as_json or report is not None else None
    if as_json and steps is not None:
        found = learned_json(learned, steps.judgements, advice, judged=comparison.judgements[-1], fit=robot.fit)
        click.echo(json.dumps(found | {"comparison": comparison_json(comparison)}, indent=2, allow_nan=False))
    else:
        told = found_text(learned, advice, judged=comparison.judgements[-1], fit=robot.fit)
        lines = [told, *(one.remark for one in said if one.harm), fit_text(robot, clocks=False), *proof.changes, ""]
        click.echo("\n".join([*lines, comparison_text(comparison)]))
    if output is not None:
        write_text(output, format_model(proof.model))
        click.echo(f"wrote {output}", err=True)
    if drive is not None:
        write_drive(drive, advice)
    if plot is not None:
        _draw(plot, comparison)
    if report is not None and steps is not None:
        words = [*map(str, paths), *reading.words()]
        write_report(report, learned, steps, advice, _following(output, words))


def _draw(path: Path, comparison: Comparison) -> None:
    from odomcorrupt.report.plots.model_sequence import draw_ladder

    draw_ladder(comparison, path)
    click.echo(f"wrote {path}", err=True)


def _following(model: Path | None, words: Sequence[str]) -> str:
    """Return what to type when all is learned: corrupt with the model, or write one first."""
    if model is None:
        return f"odomcorrupt learn {shlex.join(words)} -o robot.toml"
    return f"odomcorrupt sim.bag noisy.bag --model {shlex.quote(str(model))}"
