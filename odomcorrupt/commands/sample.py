"""odomcorrupt sample: where one motion may have ended."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from odomcorrupt.commands._map import choose_condition, map_options
from odomcorrupt.commands._model import AlphaCommand
from odomcorrupt.commands._motion_options import choose_move, move_options
from odomcorrupt.commands._output import refuse_existing, write_text
from odomcorrupt.commands._param_types import Number
from odomcorrupt.commands._poses import PICTURES, need_pictures, picture_kind, save_picture
from odomcorrupt.commands._sample_path import sample_along

if TYPE_CHECKING:
    from odomcorrupt.commands._map import Condition
    from odomcorrupt.sampling.text import Drawn

__all__ = ["command"]


@click.command("sample", cls=AlphaCommand, short_help="Draw where one motion may have ended: the banana.")
@click.argument("bag", metavar="[BAG]", type=click.Path(path_type=Path), required=False)
@click.option(
    "-o", "--output", type=click.Path(dir_okay=False, path_type=Path), help="Result: .png, .svg, .pdf, .csv or .json."
)
@move_options
@map_options
@click.option("--every", type=Number("metres", 0.0, 1e6, above=True), metavar="M", help="Along a bag: a cloud per M m.")
@click.option("--odom-topic", "--odom", "odom_topic", metavar="TOPIC", help="Along a bag: which odometry.")
@click.option("--seed", type=click.IntRange(0), metavar="N", help="Of all draws. [default: drawn, and printed]")
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
@click.option("--overwrite", is_flag=True, help="Replace an existing output.")
def command(bag: Path | None, output: Path | None, *, as_json: bool, overwrite: bool, **given: Any) -> None:
    """Draw where one motion may have ended, or, with a BAG, where the robot may be along its drive.

    \b
    odomcorrupt sample -o banana.png                             # the article's example
    odomcorrupt sample --law article-code -o listing.png         # its listing, as it is
    odomcorrupt sample --example rotation-heavy -o heavy.svg     # one of the lecture's settings
    odomcorrupt sample --end 1,0.3,20deg --alpha 0.05 0.02 0.05 0.01 -n 5000 -o ends.csv
    odomcorrupt sample drive.mcap -n 500 -o cloud.png            # the cloud spreading along a drive
    odomcorrupt sample drive.mcap --map map.yaml -o cloud.png    # the same within free space
    """  # noqa: D301 - click wants a real backspace
    from odomcorrupt.mapping.conditioned import move_sampled_in_map
    from odomcorrupt.rng import draw_seed, stream
    from odomcorrupt.sampling.samples import move_sampled
    from odomcorrupt.sampling.text import Drawn, csv_text, json_text, report_text

    refuse_existing(output, overwrite=overwrite)
    kind = None if output is None else picture_kind(output) or output.suffix.lower()
    if kind not in (None, ".csv", ".json", *PICTURES):
        raise click.UsageError(f"{output}: ends in {kind or 'nothing'}; write .png, .svg, .pdf, .csv or .json")
    if kind in PICTURES:
        need_pictures()
    if bag is not None:
        sample_along(bag, output, kind, as_json=as_json, given=given)
        return
    chosen = choose_move(given)
    seed = draw_seed() if given["seed"] is None else given["seed"]
    rng = stream(seed, 0, "sample")
    condition = choose_condition(given, None, "odom")
    notes: tuple[str, ...] = ()
    if condition is None:
        xyt = move_sampled(chosen.move, chosen.variances, chosen.count, rng)
    else:
        free = move_sampled_in_map(
            chosen.move, chosen.variances, chosen.count, rng, condition.space, check=condition.check,
            tries=condition.tries,
        )  # fmt: skip
        xyt, notes = free.xyt, (free.account(),)
    drawn = Drawn(
        chosen.move, chosen.noise.model.noise, chosen.variances, xyt, seed, chosen.noise.origin,
        chosen.noise.article_code, notes,
    )  # fmt: skip
    click.echo(json_text(drawn) if as_json else report_text(drawn), nl=not as_json)
    if output is None:
        return
    if kind in PICTURES:
        _draw(output, drawn, condition)
        return
    write_text(output, csv_text(xyt) if kind == ".csv" else json_text(drawn))
    click.echo(f"wrote {output}", err=True)


def _draw(output: Path, drawn: Drawn, condition: Condition | None) -> None:
    from odomcorrupt.report.plots.samples import draw_banana
    from odomcorrupt.sampling.text import title

    space = None if condition is None else condition.space
    save_picture(output, draw_banana(drawn.move, drawn.variances, drawn.xyt, title(drawn), space))
