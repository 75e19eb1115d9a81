"""odomcorrupt batch: many corrupted runs of one bag."""

from __future__ import annotations

import re
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from odomcorrupt.commands._bag import bag_words, container_options, moving_options, threads_option
from odomcorrupt.commands._map import choose_condition_of_run, map_options
from odomcorrupt.commands._model import AlphaCommand, choose_model, model_options
from odomcorrupt.commands._options import FILE, one_of
from odomcorrupt.commands._standard import Console, chosen_output, output_option, standard_options

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.batching.engine import Shard
    from odomcorrupt.batching.estimate import Need
    from odomcorrupt.batching.job import Job
    from odomcorrupt.model.motion_model import MotionModel

_MODEL_WORDS = {"alpha": "--alpha", "law": "--law", "twist_noise": "--twist-noise", "step": "--step",
                "preset": "--preset", "effects": "--effect", "track": "--track"}  # fmt: skip
_MAP_WORDS = {
    "map_": "--map", "radius": "--robot-radius", "check": "--map-check", "unknown": "--unknown", "tries": "--max-tries",
}  # fmt: skip
_SUFFIXES = {"bag": ".bag", "mcap": ".mcap", "db3": ".db3", "directory": ""}
"""Suffixes of the runs' names by output format."""


class _ShardType(click.ParamType):  # type: ignore[type-arg]  # generic since click 8.5 only
    name = "I/N"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return (number, count) of a shard written as 3/16."""
        match = re.fullmatch(r"(\d+)/(\d+)", value) if isinstance(value, str) else None
        if match is None or not 1 <= int(match[1]) <= int(match[2]):
            self.fail(f"{value!r}; write which of how many, counted from 1, as in 3/16", param, ctx)
        return int(match[1]), int(match[2])


@click.command("batch", cls=AlphaCommand, short_help="Make many corrupted bags of one: Monte-Carlo runs.")
@click.argument("paths", metavar="INPUT... DIRECTORY", nargs=-1, required=True, type=click.Path(path_type=Path))
@output_option("DIRECTORY")
@click.option("--runs", type=click.IntRange(1), required=True, metavar="N", help="Make runs 0 to N - 1.")
@model_options
@click.option("--seed", type=click.IntRange(0), metavar="N", help="Seed of all draws. [default: the batch's, or drawn]")
@one_of(
    "--output", among=["full", "overlay", "trajectories"],
    text="Whole bags, only the changed topics, or only paths (TUM, npz).",
)  # fmt: skip
@one_of(
    "--layout", among=["same", "split"],
    text="Chunks as in the input, or changed messages in chunks of their own: faster.",
)  # fmt: skip
@click.option(
    "--to", type=click.Choice([*_SUFFIXES]),
    help="Format of the runs: ROS 1 bag, MCAP, sqlite3, ROS 2 directory. [default: that of the input]",
)  # fmt: skip
@click.option(
    "--robots", type=click.Choice(["stated", "posterior"]), default="stated",
    help='Draw for each run what the model states as "a +- b", or everything with a standard error.',
)  # fmt: skip
@click.option(
    "--fleet", multiple=True, type=FILE, metavar="FILE",
    help="A robot of a fleet (repeat for each): every run draws a robot by their mean and spread.",
)  # fmt: skip
@click.option(
    "--sweep", "sweeps", multiple=True, metavar="NAME=V,V",
    help="As alpha-scale=0.5,1,2, or a range as wheel_scale.e=0..0.02 with --points (repeatable).",
)  # fmt: skip
@click.option("--points", type=click.IntRange(0), default=0, metavar="N", help="Cover all ranges by N Sobol points.")
@click.option("--jobs", type=click.IntRange(1), default=1, metavar="N", help="Processes. [default: 1]")
@click.option("--shard", type=_ShardType(), help="Make the I-th of N parts, as 3/16, counted from 1.")
@click.option("--dask", metavar="ADDRESS", help="Use the workers of a Dask scheduler, as tcp://host:8786.")
@threads_option
@click.option(
    "--verify", is_flag=True, help="Make those runs again whose checksums differ from the manifest: bit rot, edits."
)
@click.option("--dry-run", is_flag=True, help="Print the expected time and disk space, and make nothing.")
@moving_options
@map_options
@container_options
@standard_options
def command(paths: tuple[Path, ...], output_option: str | None, *, console: Console, **given: Any) -> int:
    """Make runs 0 to N - 1 of a seed: the same bytes as `odomcorrupt INPUT OUTPUT --seed S --run K` one by one.

    Called again, it makes the missing runs. DIRECTORY/manifest.jsonl has the command that makes any single run.
    """
    from odomcorrupt.api.batch import Batch
    from odomcorrupt.batching.engine import Shard, require_odometry, run_batch
    from odomcorrupt.batching.estimate import need_of
    from odomcorrupt.commands._progress import Rate

    inputs, target = _paths(paths, output_option)
    jobs = _jobs(inputs, target, given)
    shard = Shard(*(given["shard"] or (1, 1)))
    runs = range(given["runs"])
    if given["dry_run"]:
        need = need_of(jobs, runs, shard)
        said = _dry(need, jobs, given["jobs"])
        console.print(said, said, {"schema": 2, **asdict(need)})
        return 0
    require_odometry(jobs)
    _require_space(jobs, runs, shard)
    with Rate(sum(len(runs) for _ in jobs), quiet=console.quiet) as rate:
        made = run_batch(
            jobs, runs, processes=given["jobs"], shard=shard, verify=given["verify"], dask=given["dask"], audience=rate
        )
    done = Batch(target, tuple(jobs), made.runs, made.failures)
    console.show(done, err=True)
    return 1 if made.failures else 3 if done.losses else 0


def _paths(paths: tuple[Path, ...], option: str | None) -> tuple[tuple[Path, ...], Path]:
    """Return the inputs and the directory, which is the last argument unless -o gives it."""
    inputs, last = (paths, None) if option is not None else (paths[:-1], str(paths[-1]))
    target = Path(chosen_output(last, option, "DIRECTORY"))
    if not inputs:
        raise click.UsageError("Missing argument 'DIRECTORY'.")
    for path in inputs:
        if not path.exists():
            raise click.UsageError(f"Invalid value for 'INPUT...': Path '{path}' does not exist.")
    if target.is_file():
        raise click.UsageError(f"Invalid value for 'DIRECTORY': Directory '{target}' is a file.")
    return inputs, target


def _jobs(inputs: tuple[Path, ...], target: Path, given: dict[str, Any]) -> list[Job]:
    from odomcorrupt.api.bag_options import split_options
    from odomcorrupt.bags.pipeline import default_threads
    from odomcorrupt.batching.job import BatchSpec, plan
    from odomcorrupt.batching.manifest import seed_of

    model = _model(given)
    options, container = split_options(bag_words(given))
    threads = max(1, (given["threads"] or default_threads()) // given["jobs"])  # per process
    container = replace(container, overwrite=False, threads=threads)
    if given["output"] != "full":
        _require_whole_bags(given)
    if given["shard"] and given["dask"]:
        raise click.UsageError("--shard and --dask: both spread the runs; give one of them")
    if given["shard"] and given["seed"] is None:
        raise click.UsageError("--shard: all shards need the same --seed; give one")
    if given["map_"] is not None and len(inputs) > 1:
        raise click.UsageError("--map: is for one drive; make a batch of each input")
    spec = BatchSpec(
        model=model,
        seed=seed_of(target) if given["seed"] is None else given["seed"],
        model_file=given["model"],
        sweeps=given["sweeps"],
        points=given["points"],
        posterior=given["robots"] == "posterior" or bool(given["fleet"]),
        options=options,
        container=container,
        output=given["output"],
        split=given["layout"] == "split",
        condition=choose_condition_of_run(given, inputs[0], options, model),
        suffix=_SUFFIXES.get(given["to"]),
        model_words=None if given["fleet"] else tuple(_words(_MODEL_WORDS, given)),
        map_words=tuple(_map_words(given)),
    )
    return plan(inputs, target, spec)


def _require_whole_bags(given: dict[str, Any]) -> None:
    """Refuse options that need whole bags if only parts of them are written."""
    output = f"--output {given['output']}"
    for flag, name in (("--keep-truth", "keep_truth"), ("--tf correction", "new_odom_frame")):
        if given[name]:
            raise click.UsageError(
                f"{flag}: adds messages, but {output} holds changed messages only; leave one of them out"
            )
    for flag, name in (("--to", "to"), ("--exclude-topic", "exclude"), ("--ros", "ros"), ("--storage", "storage")):
        if given[name]:
            raise click.UsageError(f"{flag}: is for whole bags, not for {output}; leave one of them out")
    if given["layout"] == "split":
        raise click.UsageError(f"--layout split: is for whole bags, not for {output}; leave one of them out")


def _model(given: dict[str, Any]) -> MotionModel:
    """Return the requested model, or that of a fleet."""
    if not given["fleet"]:
        return choose_model(given).motion_model
    from odomcorrupt.batching.parameter_draws import fleet_model
    from odomcorrupt.model.model_file import read_model

    other = [flag for name, flag in (("model", "--model"), *_MODEL_WORDS.items()) if given[name]]
    if other:
        raise click.UsageError(
            f"--fleet and {other[0]}: the files of a fleet are its whole model; leave {other[0]} out"
        )
    if len(set(given["fleet"])) < len(given["fleet"]):
        raise click.UsageError("--fleet: a file is named twice; a robot counts once")
    return fleet_model({str(path): read_model(path) for path in given["fleet"]})


def _map_words(given: dict[str, Any]) -> list[str]:
    if given["map_"] is None:
        return []
    pose = [] if given["map_pose"] is None else ["--map-pose", ",".join(repr(float(v)) for v in given["map_pose"])]
    return [*_words(_MAP_WORDS, given), *pose]


def _words(names: dict[str, str], given: dict[str, Any]) -> list[str]:
    """Return the given options as words of a command line."""
    words = []
    for name, flag in names.items():
        value = given[name]
        if name == "effects":
            words += [word for one in value for word in (flag, one)]
        elif name == "alpha" and value:
            words += [flag, *value.split()]
        elif isinstance(value, tuple):
            words += [flag, *map(str, value)]
        elif value is not None:
            words += [flag, str(value)]
    return words


def _dry(need: Need, jobs: Sequence[Job], processes: int) -> str:
    """Return the resources that a batch needs, in sentences."""
    saved = 1.0 - need.overlay_bytes / need.bytes if need.bytes else 0.0
    text = (
        f"{need.runs} runs to make, about {need.bytes / 1e9:.3g} GB ({need.free_bytes / 1e9:.3g} GB are free) and "
        f"{need.core_seconds / 60.0:.3g} core minutes"
    )
    text += f", {need.core_seconds / 60.0 / processes:.3g} minutes with {processes} processes" * (processes > 1) + "."
    if jobs[0].batch.output == "full":
        text += f" --output overlay would write {need.overlay_bytes / 1e9:.3g} GB, {saved:.0%} less."
    if need.bytes > need.free_bytes:
        text += " The disk cannot hold it."
    return text


def _require_space(jobs: Sequence[Job], runs: range, shard: Shard) -> None:
    """Refuse a batch that the disk cannot hold; sizes are estimated only if space may be short."""
    from odomcorrupt.batching.estimate import free_bytes, need_of, require_space
    from odomcorrupt.batching.manifest import bytes_of

    if 5 * len(runs) * sum(bytes_of(job.source) for job in jobs) > free_bytes(jobs[0].directory):
        require_space(need_of(jobs, runs, shard), jobs[0].shown_directory)
