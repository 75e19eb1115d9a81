"""odomcorrupt diagnose: which physical effect is missing in a model."""

from __future__ import annotations

import json
import shlex
from pathlib import Path

import click

from odomcorrupt.commands._advice import check_drive, write_drive, write_report
from odomcorrupt.commands._output import refuse_existing
from odomcorrupt.commands._recordings import Reading, recording_options, split_arguments
from odomcorrupt.extras import require

__all__ = ["command"]


@click.command("diagnose", short_help="Name the physical effect that a model misses.")
@click.argument("arguments", nargs=-1, required=True, metavar="RECORDING... [MODEL.toml]")
@recording_options
@click.option(
    "--drive",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Write the drive that would settle what is open, as /cmd_vel in an MCAP.",
)
@click.option(
    "--report",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Write all of it as one page of HTML, pictures too.",
)
@click.option("--overwrite", is_flag=True, help="Replace existing outputs.")
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
def command(
    arguments: tuple[str, ...],
    *,
    reading: Reading,
    drive: Path | None,
    report: Path | None,
    overwrite: bool,
    as_json: bool,
) -> None:
    """Rank the effects by evidence, with what each would gain on held-out stretches, and say what to type next."""
    require("scipy", "the study needs it", "study")
    from odomcorrupt.model.model_file import read_model
    from odomcorrupt.report.json.diagnosis import learned_json
    from odomcorrupt.report.text.diagnosis import found_text, shares_text
    from odomcorrupt.report.text.tables import candidates_table
    from odomcorrupt.study.design.advise import advise
    from odomcorrupt.study.select.stepwise import learn
    from odomcorrupt.study.validate.model_sequence import ladder_comparison

    paths, names = split_arguments(arguments)
    models = {name: read_model(Path(name)) for name in names}
    if len(models) > 1:
        raise click.UsageError(f"{len(models)} models given; diagnose one at a time")
    refuse_existing(report, overwrite=overwrite)
    check_drive(drive, overwrite=overwrite)
    name, model = next(iter(models.items()), (None, None))
    # the set-up belongs to the recordings: what a model knows of it is no reason not to look for it here
    effects = model.effects if model is not None else ()
    known = {effect.name for effect in model.setup.effects} if model is not None else set()
    law = model.noise.law_name if model is not None else "diffusion"
    runs = reading.read(paths, track=model.track_m if model else None)
    learned = learn(runs, effects, law_name=law)
    advice = advise(learned)
    if drive is not None:
        write_drive(drive, advice)
    words = [*(str(p) for p in paths), *reading.words()]
    words += ["--start", name] if name else []
    added = [effect for effect in learned.added if effect not in known]
    words += [w for effect in added for w in ("--add", effect)]
    following = f"odomcorrupt fit {shlex.join(words)} -o robot.toml" if added else ""
    if learned.laws:
        # what is added holds beside a law only, and `learn` alone writes laws
        words = [*(str(p) for p in paths), *reading.words()]
        following = f"odomcorrupt learn {shlex.join(words)} -o robot.toml"
    begin = Path(name).name if name else "without effects"
    ladder = ladder_comparison(learned, runs, begin)
    # a ladder knows nothing of noise: what it rejects may be what was named
    judged = ladder.judgements[-1] if not learned.noise else None
    if as_json:
        told = learned_json(learned, ladder.judgements, advice, judged=judged)
        click.echo(json.dumps(told, indent=2, allow_nan=False))
    else:
        said = found_text(learned, advice, judged=judged)
        click.echo(f"{candidates_table(learned.rounds[0])}\n\n{said}")
        if learned.added:
            click.echo(f"\n{shares_text(ladder.judgements)}")
        if following:
            click.echo(f"\nnext: {following}")
    if report is not None:
        write_report(report, learned, ladder, advice, following)
