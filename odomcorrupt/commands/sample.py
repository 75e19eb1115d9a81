"""odomcorrupt sample: where one motion may have ended."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from odomcorrupt.commands._bag import unpack_option
from odomcorrupt.commands._map import choose_condition, map_options
from odomcorrupt.commands._model import AlphaCommand
from odomcorrupt.commands._motion_options import choose_move, move_options
from odomcorrupt.commands._param_types import Number
from odomcorrupt.commands._poses import PICTURES, need_pictures, picture_kind
from odomcorrupt.commands._sample_path import sample_along
from odomcorrupt.commands._standard import overwrite_option, standard_options
from odomcorrupt.files import refuse_existing, write_text

if TYPE_CHECKING:
    from odomcorrupt.commands._standard import Voice

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
@overwrite_option()
@unpack_option
@standard_options
def command(bag: Path | None, output: Path | None, *, overwrite: bool, voice: Voice, **given: Any) -> None:
    """Draw where one motion may have ended, or, with a BAG, where the robot may be along its drive.

    \b
    odomcorrupt sample -o banana.png                             # the article's example
    odomcorrupt sample --law article-code -o listing.png         # its listing, as it is
    odomcorrupt sample --example rotation-heavy -o heavy.svg     # one of the lecture's settings
    odomcorrupt sample --end 1,0.3,20deg --alpha 0.05 0.02 0.05 0.01 -n 5000 -o ends.csv
    odomcorrupt sample drive.mcap -n 500 -o cloud.png            # the cloud spreading along a drive
    odomcorrupt sample drive.mcap --map map.yaml -o cloud.png    # the same within free space
    """  # noqa: D301 - click wants a real backspace
    from odomcorrupt.api.motion import sample
    from odomcorrupt.errors import ModelError
    from odomcorrupt.sampling.text import csv_text, json_text

    refuse_existing(output, overwrite=overwrite)
    kind = None if output is None else picture_kind(output) or output.suffix.lower()
    if kind not in (None, ".csv", ".json", *PICTURES):
        raise click.UsageError(f"{output}: ends in {kind or 'nothing'}; write .png, .svg, .pdf, .csv or .json")
    if kind in PICTURES:
        need_pictures()
    if bag is not None:
        sample_along(bag, output, kind, voice=voice, given=given)
        return
    chosen = choose_move(given)
    condition = choose_condition(given, None, "odom")
    try:
        drawn = sample(
            chosen.start_xyt,
            chosen.end_xyt,
            model=chosen.noise.model,
            count=chosen.count,
            seed=given["seed"],
            within=condition,
            article_code=chosen.noise.article_code,
        )
    except ModelError as error:
        raise click.UsageError(str(error)) from error
    voice.tell(drawn)
    if output is None:
        return
    if kind in PICTURES:
        drawn.plot(output)
    else:
        write_text(output, csv_text(drawn.xyt) if kind == ".csv" else json_text(drawn.drawn))
    voice.note(f"wrote {output}")
