"""odomcorrupt density: probability density of an end pose."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

import click

from odomcorrupt.commands._model import AlphaCommand, choose_condition, choose_move, map_options, move_options
from odomcorrupt.commands._options import PICTURE, kind_of, pose, setting, usage_errors, valued
from odomcorrupt.commands._standard import Console, overwrite_option, standard_options, typed_words, written
from odomcorrupt.errors import ModelError
from odomcorrupt.result_files import write_file

if TYPE_CHECKING:
    from pathlib import Path


@click.command(
    "density", cls=AlphaCommand, short_help="Evaluate the density of end poses, p(x_t | u_t, x_t-1), and draw samples."
)
@click.option("--plot", "-o", "--output", "output", type=PICTURE, help="Picture: .png, .svg or .pdf.")
@move_options
@valued(
    "--reading", among=["pose", "product", "hypothetical"],
    text="A density over poses; the lecture's p1 p2 p3; or the same as the book prints it, with the variances of the "
    "motion to each pose.",
)  # fmt: skip
@click.option(
    "--at", "poses", type=pose, multiple=True, help="Print the density at this end pose, as in 0.2,0.3,10deg."
)
@map_options
@setting("--seed", type=click.IntRange(0), metavar="N", help="Seed of the samples. [default: drawn, and printed]")
@overwrite_option()
@standard_options
def command(
    output: Path | None,
    *,
    reading: Literal["pose", "product", "hypothetical"],
    poses: tuple[tuple[float, ...], ...],
    console: Console,
    **given: Any,
) -> None:
    """Evaluate the density of end poses of one motion in closed form, and draw samples of it.

    \b
    odomcorrupt density --plot density.png
    odomcorrupt density --example balanced --at 1,0.35,40deg --at 1.1,0.3,40deg
    """  # noqa: D301 - click wants a real backspace
    from odomcorrupt.api.motion import density
    from odomcorrupt.rng import draw_seed

    chosen = choose_move(given)
    count = chosen.pop("count")
    with usage_errors(ModelError):
        found = density(**chosen, poses=poses, reading=reading, within=choose_condition(given, None, ""))

    def draw(path: Path) -> None:
        from odomcorrupt.report.plots.figure import rendered

        seed = draw_seed() if given["seed"] is None else given["seed"]
        write_file(path, rendered(found.draw_beside(count, seed), kind_of(path)))

    following = ["density", *typed_words(), "--plot", "density.png"]
    if output is not None:
        following = ["sample", *typed_words("--at", "--reading")]
    console.show(found.then("odomcorrupt", *following), files=written(output, draw))
