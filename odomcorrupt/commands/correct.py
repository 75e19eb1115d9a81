"""odomcorrupt correct: the systematic part of measured odometry taken out."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from odomcorrupt.commands._model import choose_model
from odomcorrupt.commands._poses import POSE
from odomcorrupt.commands._progress import Progress, say

if TYPE_CHECKING:
    from odomcorrupt.model.motion_model import MotionModel

__all__ = ["command"]


@click.command("correct", short_help="Take the systematic part out of measured odometry.")
@click.argument("input_", metavar="INPUT", type=click.Path(allow_dash=True))
@click.argument("output", metavar="OUTPUT", type=click.Path(allow_dash=True))
@click.option(
    "--model", type=click.Path(dir_okay=False, path_type=Path), help="Motion model, as `fit` and `learn` write it."
)
@click.option("--effect", "effects", multiple=True, metavar="NAME:KEY=VALUE,...", help="Systematic error (repeatable).")
@click.option(
    "--track",
    type=float,
    metavar="M",
    help="Distance between the wheels, for effects of single wheels. [default: the model's]",
)
@click.option("--odom-topic", "--odom", "odom_topic", metavar="TOPIC", help="Odometry to correct.")
@click.option("--odom-frame", metavar="FRAME", help="Frame that drifts. [default: that of the odometry]")
@click.option("--base-frame", metavar="FRAME", help="The robot's frame. [default: the odometry's child frame]")
@click.option(
    "--twist",
    type=click.Choice(["model", "keep"]),
    default="model",
    help="Twists: follow the correction, or as they are. [default: model]",
)
@click.option(
    "--covariance",
    type=click.Choice(["model", "keep"]),
    default="model",
    help="Covariances: those of the model's noise, or as they are. [default: model]",
)
@click.option("--start", type=POSE, help="Where the drive began, for effects of places. [default: as odometry has it]")
@click.option("--keep-localisation", is_flag=True, help="Move map -> odom the other way, so that map -> base stays.")
@click.option("--overwrite", is_flag=True, help="Replace an existing output.")
@click.option("--compression", metavar="NAME", help="none, lz4, zstd (MCAP), bz2 (ROS 1). [default: as it was]")
@click.option("--level", type=int, metavar="N", help="Of compression. [default: a fast one]")
@click.option(
    "--recover", is_flag=True, help="Read what is whole of a damaged bag; the exit code is 3 if some is lost."
)
def command(input_: str, output: str, model: Path | None, effects: tuple[str, ...], **given: Any) -> int:
    """Take the effects of a model out of a bag's odometry: its poses, twists and covariances, and its TF edges.

    It takes the whole motion to know what was wrong with it, so INPUT is read twice and cannot be a pipe; OUTPUT can.
    Random effects cannot be undone, but for lost increments; the summary names them.
    """
    import numpy as np

    from odomcorrupt.correction.run import correct_bag
    from odomcorrupt.correction.summary import correction_summary
    from odomcorrupt.corruption.run import Container
    from odomcorrupt.corruption.transform import Options

    if input_ == "-":
        raise click.UsageError(
            "INPUT is a pipe, and correction reads a bag twice: the whole motion first; save it to a file and name that"
        )
    if output == "-" and sys.stdout.isatty():
        raise click.UsageError("OUTPUT is - but stdout is a terminal; redirect it to a file or a pipe")
    with Progress() as progress:
        corrected = correct_bag(
            Path(input_),
            None if output == "-" else Path(output),
            _model(model, effects, given["track"]),
            options=Options(
                odom_topic=given["odom_topic"],
                odom_frame=given["odom_frame"],
                base_frame=given["base_frame"],
                keep_twist=given["twist"] == "keep",
                keep_covariance=given["covariance"] == "keep",
                keep_localisation=given["keep_localisation"],
            ),
            container=Container(given["overwrite"], given["compression"], given["level"], given["recover"]),
            start_xyt=None if given["start"] is None else np.array(given["start"]),
            watch=progress,
        )
    say(correction_summary(corrected))
    return 3 if corrected.losses else 0


def _model(model: Path | None, effects: tuple[str, ...], track: float | None) -> MotionModel:
    """Return the model that the options describe; with none, one that has nothing in it."""
    from odomcorrupt.correction.run import SILENT

    if model is None and not effects:
        return SILENT
    nothing: dict[str, Any] = dict.fromkeys(("alpha", "law", "twist_noise", "step", "preset"))
    return choose_model(**nothing, effects=effects, model=model, track=track).model
