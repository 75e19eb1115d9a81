"""odomcorrupt density: how likely an end pose is."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from odomcorrupt.commands._map import choose_condition, map_options
from odomcorrupt.commands._model import AlphaCommand
from odomcorrupt.commands._motion_options import choose_move, move_options
from odomcorrupt.commands._output import refuse_existing
from odomcorrupt.commands._poses import POSE, need_pictures, picture_kind, save_picture

if TYPE_CHECKING:
    from collections.abc import Callable

    from odomcorrupt.geometry.se2 import Array

__all__ = ["command"]


@click.command(
    "density", cls=AlphaCommand, short_help="How likely an end pose is, p(x_t | u_t, x_t-1), beside samples."
)
@click.option("-o", "--output", type=click.Path(dir_okay=False, path_type=Path), help="Picture: .png, .svg or .pdf.")
@move_options
@click.option(
    "--reading",
    type=click.Choice(["pose", "product", "hypothetical"]),
    default="pose",
    help="A density over poses; the lecture's p1 p2 p3; or the same as the book prints it, with the variances of the "
    "motion to each pose. [default: pose]",
)
@click.option("--at", "poses", type=POSE, multiple=True, help="Print the density there, as in 0.2,0.3,10deg.")
@map_options
@click.option("--seed", type=click.IntRange(0), metavar="N", help="Of the samples. [default: drawn, and printed]")
@click.option("--overwrite", is_flag=True, help="Replace an existing output.")
def command(
    output: Path | None, *, reading: str, poses: tuple[tuple[float, ...], ...], overwrite: bool, **given: Any
) -> None:
    """Say how likely end poses of one motion are, in closed form, beside samples of it.

    \b
    odomcorrupt density -o density.png
    odomcorrupt density --example balanced --at 1,0.35,40deg --at 1.1,0.3,40deg
    """  # noqa: D301 - click wants a real backspace
    import numpy as np

    from odomcorrupt.errors import ModelError
    from odomcorrupt.rng import draw_seed, stream
    from odomcorrupt.sampling.density import density_on_grid, hypothetical, pose_density, product, within_map
    from odomcorrupt.sampling.samples import move_sampled
    from odomcorrupt.sampling.text import law_words

    refuse_existing(output, overwrite=overwrite)
    if output is not None:
        if picture_kind(output) is None:
            raise click.UsageError(f"{output}: ends in {output.suffix or 'nothing'}; write .png, .svg or .pdf")
        need_pictures()
    chosen = choose_move(given)
    move, variances = chosen.move, chosen.variances
    unit = "1/(m^2 rad)" if reading == "pose" else "1/(m rad^2)"
    click.echo(f"noise: {law_words(chosen.noise.model.noise, article_code=chosen.noise.article_code)}")
    readings: dict[str, Callable[[Array], Array]] = {
        "pose": lambda at: pose_density(at, move, variances),
        "product": lambda at: product(at, move, variances),
        "hypothetical": lambda at: hypothetical(at, move, chosen.noise.model.noise),
    }
    density_of = readings[reading]
    condition = choose_condition(given, None, "")
    try:
        grid = density_on_grid(move, variances, density_of=density_of)
        part, free = 1.0, None
        if condition is not None:
            start = move.start_xyt[:2]
            grid, part = within_map(grid, condition.space, start, condition.check)
            ends = np.array(poses).reshape(-1, 3)[:, :2]
            free = condition.space.allows(np.broadcast_to(start, ends.shape), ends, condition.check)
            click.echo(f"map: {100.0 * part:.4g} % of it is free, by which it is divided")
        if poses:
            values = density_of(np.array(poses)) / part * (1.0 if free is None else free)
            for pose, value in zip(poses, values, strict=True):
                x, y, theta = pose
                click.echo(f"at ({x:g} m, {y:g} m, {np.degrees(theta):g} deg): {value:.6g} {unit}")
    except ModelError as error:
        raise click.UsageError(str(error)) from error
    meaning = "one is a density" if reading == "pose" else "the product is not a density over poses"
    click.echo(f"integral over the grid of end poses: {grid.integral:.6f} ({meaning})")
    if output is None:
        return
    from odomcorrupt.report.plots.density import draw_density

    seed = draw_seed() if given["seed"] is None else given["seed"]
    xyt = move_sampled(move, variances, chosen.count, stream(seed, 0, "sample"))
    if condition is not None:
        start = np.broadcast_to(move.start_xyt[:2], (len(xyt), 2))
        xyt = xyt[condition.space.allows(start, xyt[:, :2], condition.check)]
    name = "Density of end poses" if reading == "pose" else f"p1 p2 p3 ({reading}) at end poses"
    law = "article-code" if chosen.noise.article_code else chosen.noise.model.noise.law_name
    per_area = "density (1/m^2)" if reading == "pose" else "p1 p2 p3, summed (1/(m rad))"
    save_picture(output, draw_density(move, grid, xyt, f"{name}: law {law}, samples of seed {seed}", per_area))
