"""odomcorrupt diagnose: which physical effect is missing in a model."""

from __future__ import annotations

import json
import shlex

import click

from odomcorrupt.commands._recordings import need_study, read_all, recording_options, source_words, split_arguments

__all__ = ["command"]


@click.command("diagnose", short_help="Name the physical effect that a model misses.")
@click.argument("arguments", nargs=-1, required=True, metavar="RECORDING... [MODEL.toml]")
@recording_options
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
def command(
    arguments: tuple[str, ...],
    odom: str | None,
    truth: str | None,
    track: float | None,
    as_json: bool,  # noqa: FBT001 - click passes flags so
) -> None:
    """Rank the effects by evidence, with what each would gain on held-out stretches, and say what to type next."""
    need_study()
    from odomcorrupt.report.found import found_text
    from odomcorrupt.report.json import learned_json
    from odomcorrupt.report.tables import candidates_table, clock_lines
    from odomcorrupt.study.judge.ladder import held_out_ladder
    from odomcorrupt.study.search.learn import learn

    paths, models = split_arguments(arguments)
    if len(models) > 1:
        raise click.UsageError(f"{len(models)} models given; diagnose one at a time")
    name, model = next(iter(models.items()), (None, None))
    effects = (*model.effects, *model.setup.effects) if model is not None else ()
    law = model.noise.law_name if model is not None else "diffusion"
    runs = read_all(paths, odom, truth, track if track is not None else (model.track_m if model else None))
    learned = learn(runs, effects, law_name=law)
    if as_json:
        ladder = held_out_ladder(learned, runs)
        click.echo(json.dumps(learned_json(learned, ladder), indent=2, allow_nan=False))
        return
    for line in clock_lines([r.name for r in runs], learned.clocks):
        click.echo(line)
    click.echo(f"{candidates_table(learned.rounds[0])}\n\n{found_text(learned)}")
    if not learned.added:
        return
    words = [*(str(p) for p in paths), *source_words(odom, truth, track)]
    words += ["--start", name] if name else []
    words += [w for effect in learned.added for w in ("--add", effect)]
    click.echo(f"\nnext: odomcorrupt fit {shlex.join(words)} -o robot.toml")
