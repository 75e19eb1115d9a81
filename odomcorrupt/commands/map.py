"""odomcorrupt map: laser maps from clean and from noisy odometry."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from odomcorrupt.commands._bag import ODOM_TOPIC, unpack_option
from odomcorrupt.commands._model import AlphaCommand, choose_model, model_options
from odomcorrupt.commands._options import FILE, PAGE, PICTURE, number, pose, run_options, setting, usage_errors, valued
from odomcorrupt.commands._progress import Stages
from odomcorrupt.commands._standard import Console, overwrite_option, standard_options, typed_words, written
from odomcorrupt.errors import MapError

_ASKED = ("seed", "run", "scan", "odom_topic", "truth", "laser_pose", "max_yaw_rate", "resolution")
"""Options that are arguments of `draw_maps`."""


@click.command("map", cls=AlphaCommand, short_help="Draw laser maps with clean and with noisy odometry.")
@click.argument("bag", type=click.Path(path_type=Path))
@click.option(
    "-o", "--output", "--plot", "output", type=FILE,
    help="Picture: .png, .svg or .pdf; the maps are written beside it as .pgm and .yaml.",
)  # fmt: skip
@model_options
@run_options
@setting("--scan", metavar="TOPIC", help="Laser scans. [default: the only such topic]")
@setting(*ODOM_TOPIC, metavar="TOPIC", help="Odometry that places the scans.")
@setting("--truth", metavar="TOPIC", help="Draw the map through these poses as well.")
@setting("--laser-pose", type=pose, help="Pose of the laser on the robot, if TF does not contain it.")
@setting(
    "--max-yaw-rate", type=number("rad/s", 0.0, 1e3), metavar="W",
    help="Leave out rays shot while turning faster, rad/s; not with --method laser.",
)  # fmt: skip
@valued(
    "--resolution", kind=number("metres", 0.0, 1e3, above=True), default=0.05, text="Cell size of the maps, metres."
)
@valued(
    "--method", among=["odometry", "laser"],
    text="Place scans by odometry, or by matching them: then -o map.yaml also gets map.tum and map.png, and noisy "
    "odometry is drawn if noise, an effect or a model is given.",
)  # fmt: skip
@overwrite_option("existing outputs", passed=True)
@unpack_option
@standard_options
def command(bag: Path, output: Path | None, *, console: Console, **given: Any) -> None:
    """Draw the laser map with scans placed by a bag's odometry, and by the same odometry with noise.

    Reports the wall thickness of both, and its growth along the drive.

    \b
    odomcorrupt map drive.mcap -o map.png
    odomcorrupt map drive.mcap --alpha 0.1 0.05 0.05 0.01 --seed 3 -o map.png
    """  # noqa: D301 - click wants a real backspace
    from odomcorrupt.api.maps import draw_maps, require_method

    overwrite, method = given["overwrite"], given["method"]
    with usage_errors(MapError):
        require_method(method, *(given[name] for name in ("truth", "laser_pose", "max_yaw_rate")))
    maps, picture = _files(output, method, overwrite=overwrite)
    asked = method == "odometry" or any(given[name] for name in ("alpha", "twist_noise", "preset", "effects", "model"))
    model = choose_model(given) if asked else None
    with Stages(quiet=console.quiet) as stages:
        result = draw_maps(bag, model, method=method, watch=stages, **{name: given[name] for name in _ASKED})
    if maps is None:
        name = "map.png" if method == "odometry" else "map.yaml"
        result = result.then("odomcorrupt", "map", *typed_words("--output"), "-o", name)
    elif method == "laser":
        result = result.then("odomcorrupt", "learn", bag, "--truth-file", maps.with_suffix(".tum"))

    def save(path: Path) -> str:
        return "\n".join(f"wrote {one}" for one in result.save(path, overwrite=overwrite) if one.suffix != ".pgm")

    console.show(result, files={**written(maps, save), **written(picture, result.plot)})


def _files(output: Path | None, method: str, *, overwrite: bool) -> tuple[Path, Path] | tuple[None, None]:
    """Return the names of the map and the picture; raise if a file cannot be written."""
    from odomcorrupt.api.maps import map_files

    if output is None:
        return None, None
    if (method == "laser") != (output.suffix == ".yaml"):
        raise click.UsageError(f"{output}: --method laser writes a map for nav2; name it .yaml, pictures .png")
    if method == "odometry":
        PICTURE.require_writable(output, overwrite=overwrite)
    picture = output.with_suffix(".png") if method == "laser" else output
    for path in (*map_files(output, method), picture):
        PAGE.require_writable(path, overwrite=overwrite)
    return output.with_suffix(".yaml"), picture
