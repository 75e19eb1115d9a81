"""odomcorrupt INPUT OUTPUT: the default command."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import click

from odomcorrupt.commands._map import choose_condition_of_run, clean_drive, map_options
from odomcorrupt.commands._model import MODEL_OPTIONS, AlphaCommand, choose_model, model_options
from odomcorrupt.commands._progress import Progress, say

__all__ = ["command"]


@click.command("corrupt", cls=AlphaCommand, short_help="Corrupt the odometry of a bag (the default: needs no name).")
@click.argument("input_", metavar="INPUT", type=click.Path(allow_dash=True, readable=False))
@click.argument("output", metavar="OUTPUT", type=click.Path(allow_dash=True))
@model_options
@click.option("--seed", type=click.IntRange(0), metavar="N", help="Of all draws. [default: drawn, and printed]")
@click.option("--run", type=click.IntRange(0), default=0, metavar="N", help="Which run of this seed. [default: 0]")
@click.option("--odom-topic", "--odom", "odom_topic", metavar="TOPIC", help="Odometry that drives the model.")
@click.option("--odom-frame", metavar="FRAME", help="Frame that drifts. [default: that of the odometry]")
@click.option("--base-frame", metavar="FRAME", help="The robot's frame. [default: the odometry's child frame]")
@click.option(
    "--twist",
    type=click.Choice(["model", "keep"]),
    default="model",
    help="Twists: follow the noise, or as they are. [default: model]",
)
@click.option(
    "--covariance", type=click.Choice(["model", "keep"]), default="model", help="Likewise covariances. [default: model]"
)
@click.option("--keep-truth", metavar="TOPIC", help="Keep the clean odometry on this topic, too.")
@click.option("--keep-localisation", is_flag=True, help="Move map -> odom the other way, so that map -> base stays.")
@click.option(
    "--tf",
    type=click.Choice(["odometry", "correction", "subtraction"]),
    default="odometry",
    help="Move the odometry, or leave it and publish the drift as a transform: the rigid motion of the odom frame, or "
    "noisy minus clean as the article's listing has it. [default: odometry]",
)
@click.option("--new-odom-frame", metavar="FRAME", help="Parent of the odom frame for --tf correction.")
@map_options
@click.option("--overwrite", is_flag=True, help="Replace an existing output.")
@click.option("--compression", metavar="NAME", help="none, lz4, zstd (MCAP), bz2 (ROS 1). [default: as it was]")
@click.option("--level", type=int, metavar="N", help="Of compression. [default: a fast one]")
@click.option("--threads", type=click.IntRange(1), metavar="N", help="[default: one a core, at most 4]")
@click.option(
    "--recover", is_flag=True, help="Read what is whole of a damaged bag; the exit code is 3 if some is lost."
)
def command(input_: str, output: str, **given: Any) -> int:
    """Corrupt the odometry of a bag: its poses, twists and covariances, and the TF edges that go with them.

    INPUT and OUTPUT are bags of any kind; - is a pipe. With --map no pose is drawn into a wall: motion as a particle
    has it. Real odometry drifts through walls; leave --map out to imitate that.
    """
    from odomcorrupt.corruption.run import Container, corrupt_bag
    from odomcorrupt.corruption.summary import summary
    from odomcorrupt.corruption.transform import Options
    from odomcorrupt.memory import keep_freed_memory
    from odomcorrupt.rng import draw_seed

    chosen = choose_model(**{name: given[name] for name in MODEL_OPTIONS})
    if output == "-" and sys.stdout.isatty():
        raise click.UsageError("OUTPUT is - but stdout is a terminal; redirect it to a file or a pipe")
    if input_ == "-" and sys.stdin.isatty():
        raise click.UsageError("INPUT is - but stdin is a terminal; feed it a bag")
    if (given["tf"] != "odometry") != (given["new_odom_frame"] is not None):
        raise click.UsageError(
            "--tf correction (or subtraction) and --new-odom-frame FRAME go together; give both or neither"
        )
    source = None if input_ == "-" else Path(input_)
    options = Options(
        odom_topic=given["odom_topic"],
        odom_frame=given["odom_frame"],
        base_frame=given["base_frame"],
        keep_twist=given["twist"] == "keep",
        keep_covariance=given["covariance"] == "keep",
        keep_truth=given["keep_truth"],
        keep_localisation=given["keep_localisation"],
        new_odom_frame=given["new_odom_frame"],
        subtracted=given["tf"] == "subtraction",
    )
    seed = draw_seed() if given["seed"] is None else given["seed"]
    condition = choose_condition_of_run(given, source, options)
    path = None
    if condition is not None:
        drive = None if source is None else clean_drive(source, chosen.model, options, recover=given["recover"])
        path = condition.path(chosen.model, seed, given["run"], drive)
    keep_freed_memory()
    with Progress() as progress:
        outcome = corrupt_bag(
            source,
            None if output == "-" else Path(output),
            chosen.model,
            seed=seed,
            run=given["run"],
            options=options,
            container=Container(
                given["overwrite"], given["compression"], given["level"], given["recover"], given["threads"]
            ),
            watch=progress,
            path=path,
            told={} if condition is None else condition.told(),
        )
    say(" ".join([summary(outcome, chosen.origin), *([] if path is None else [path.account()])]))
    return 3 if outcome.losses else 0
