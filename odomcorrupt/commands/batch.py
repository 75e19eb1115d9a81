"""odomcorrupt batch: a thousand corrupted bags of one."""

from __future__ import annotations

import re
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from odomcorrupt.commands._model import AlphaCommand, choose_model, model_options
from odomcorrupt.commands._progress import say

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.batching.engine import Shard
    from odomcorrupt.batching.estimate import Need
    from odomcorrupt.batching.job import Job
    from odomcorrupt.batching.runner import Failure
    from odomcorrupt.model.motion_model import MotionModel

__all__ = ["command"]

_MODEL_WORDS = {
    "alpha": "--alpha", "law": "--law", "twist_noise": "--twist-noise", "step": "--step", "preset": "--preset",
    "effects": "--effect", "track": "--track",
}  # fmt: skip
_OPTION_WORDS = {
    "odom_topic": "--odom-topic", "odom_frame": "--odom-frame", "base_frame": "--base-frame", "twist": "--twist",
    "covariance": "--covariance", "keep_truth": "--keep-truth", "keep_localisation": "--keep-localisation",
    "tf": "--tf", "new_odom_frame": "--new-odom-frame", "compression": "--compression", "level": "--level",
    "recover": "--recover",
}  # fmt: skip


class _ShardType(click.ParamType):  # type: ignore[type-arg]  # generic since click 8.5 only
    name = "I/N"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return (number, count) of a shard written as 3/16."""
        match = re.fullmatch(r"(\d+)/(\d+)", value) if isinstance(value, str) else None
        if match is None or not 1 <= int(match[1]) <= int(match[2]):
            self.fail(f"{value!r}; write which of how many, counted from 1, as in 3/16", param, ctx)
        return int(match[1]), int(match[2])


@click.command("batch", cls=AlphaCommand, short_help="Make many corrupted bags of one: Monte-Carlo runs.")
@click.argument("inputs", metavar="INPUT...", nargs=-1, required=True, type=click.Path(exists=True, path_type=Path))
@click.argument("target", metavar="DIRECTORY", type=click.Path(file_okay=False, path_type=Path))
@click.option("--runs", type=click.IntRange(1), required=True, metavar="N", help="Make runs 0 to N - 1.")
@model_options
@click.option("--seed", type=click.IntRange(0), metavar="N", help="Of all draws. [default: the batch's, or drawn]")
@click.option(
    "--output",
    type=click.Choice(["full", "overlay", "trajectories"]),
    default="full",
    help="Whole bags, only the changed topics, or only paths (TUM, npz). [default: full]",
)
@click.option(
    "--layout",
    type=click.Choice(["same", "split"]),
    default="same",
    help="Chunks as in the input, or changed messages in chunks of their own: faster. [default: same]",
)
@click.option(
    "--robots",
    type=click.Choice(["stated", "posterior"]),
    default="stated",
    help='Draw for each run what the model states as "a +- b", or everything with a standard error.',
)
@click.option(
    "--fleet",
    multiple=True,
    type=click.Path(dir_okay=False, path_type=Path),
    metavar="FILE",
    help="A robot of a fleet (repeat for each): every run draws a robot by their mean and spread.",
)
@click.option(
    "--sweep",
    "sweeps",
    multiple=True,
    metavar="NAME=V,V",
    help="As alpha-scale=0.5,1,2, or a range as wheel_scale.e=0..0.02 with --points (repeatable).",
)
@click.option("--points", type=click.IntRange(0), default=0, metavar="N", help="Cover all ranges by N Sobol points.")
@click.option("--jobs", type=click.IntRange(1), default=1, metavar="N", help="Processes. [default: 1]")
@click.option("--threads", type=click.IntRange(1), metavar="N", help="In all. [default: one a core, at most 4]")
@click.option("--shard", type=_ShardType(), help="Make the I-th of N parts, as 3/16, counted from 1.")
@click.option("--dask", metavar="ADDRESS", help="Use the workers of a Dask scheduler, as tcp://host:8786.")
@click.option("--verify", is_flag=True, help="Make runs again whose bytes are not those noted: bit rot, edits.")
@click.option("--dry-run", is_flag=True, help="Say what it would take, and make nothing.")
@click.option("--odom-topic", "--odom", "odom_topic", metavar="TOPIC", help="Odometry that drives the model.")
@click.option("--odom-frame", metavar="FRAME", help="Frame that drifts. [default: that of the odometry]")
@click.option("--base-frame", metavar="FRAME", help="The robot's frame. [default: the odometry's child frame]")
@click.option("--twist", type=click.Choice(["model", "keep"]), help="Twists: follow the noise, or as they are.")
@click.option("--covariance", type=click.Choice(["model", "keep"]), help="Likewise covariances.")
@click.option("--keep-truth", metavar="TOPIC", help="Keep the clean odometry on this topic, too.")
@click.option("--keep-localisation", is_flag=True, help="Move map -> odom the other way, so that map -> base stays.")
@click.option(
    "--tf",
    type=click.Choice(["odometry", "correction"]),
    help="Move the odometry, or leave it and publish the drift as a transform. [default: odometry]",
)
@click.option("--new-odom-frame", metavar="FRAME", help="Parent of the odom frame for --tf correction.")
@click.option("--compression", metavar="NAME", help="none, lz4, zstd (MCAP), bz2 (ROS 1). [default: as it was]")
@click.option("--level", type=int, metavar="N", help="Of compression. [default: a fast one]")
@click.option(
    "--recover", is_flag=True, help="Read what is whole of a damaged bag; the exit code is 3 if some is lost."
)
def command(inputs: tuple[Path, ...], target: Path, **given: Any) -> int:
    """Make runs 0 to N - 1 of a seed: the same bytes as `odomcorrupt INPUT OUTPUT --seed S --run K` one by one.

    Called again, it makes what is missing. DIRECTORY/manifest.jsonl has the command that makes any single run.
    """
    from odomcorrupt.batching.engine import Shard, missing_runs
    from odomcorrupt.batching.manifest import begin, fingerprint_of, locked, write_manifest

    jobs = _jobs(inputs, target, given)
    shard = Shard(*(given["shard"] or (1, 1)))
    if given["dry_run"]:
        say(_dry(jobs, range(given["runs"]), shard, given["jobs"]))
        return 0
    _require_driver(jobs)
    fingerprints = {source: fingerprint_of(source) for source in {job.source for job in jobs}}
    fresh = [job for job in jobs if not (job.directory / "batch.json").exists()]
    _require_space(jobs, fresh, range(given["runs"]), shard)
    for job in jobs:
        begin(job, fingerprints[job.source])
    with ExitStack() as locks:
        for job in jobs:
            locks.enter_context(locked(job, shared=shard.count > 1))
        todo = [(job, missing_runs(job, range(given["runs"]), shard, verify=given["verify"])) for job in jobs]
        failures = _make(todo, given)
        made = sum(write_manifest(job.directory) for job in jobs)
        for job in jobs:
            _collect(job, given["runs"])
    asked = sum(len(runs) for _, runs in todo)
    lost = _losses(jobs)
    said = f"{asked - len(failures)} runs made now, {made} in {target}, seed {jobs[0].seed}."
    say(said + _told(failures) + "".join(f" Lost: {loss}." for loss in lost))
    return 1 if failures else 3 if lost else 0


def _jobs(inputs: tuple[Path, ...], target: Path, given: dict[str, Any]) -> list[Job]:
    from odomcorrupt.batching.plan import plan
    from odomcorrupt.corruption.run import Container
    from odomcorrupt.corruption.transform import Options

    model = _model(given)
    if given["layout"] == "split" and given["output"] != "full":
        raise click.UsageError(f"--layout split: is for whole bags; --output {given['output']} has no use for it")
    if (given["tf"] == "correction") != (given["new_odom_frame"] is not None):
        raise click.UsageError("--tf correction and --new-odom-frame FRAME go together; give both or neither")
    for flag, asked in (("--keep-truth", given["keep_truth"]), ("--tf correction", given["new_odom_frame"])):
        if asked and given["output"] != "full":
            raise click.UsageError(
                f"{flag}: adds messages, and --output {given['output']} has only what changes; leave one of them out"
            )
    if given["shard"] and given["dask"]:
        raise click.UsageError("--shard and --dask: both spread the runs; give one of them")
    return plan(
        inputs, target, model, model_file=given["model"], sweeps=given["sweeps"], points=given["points"],
        posterior=given["robots"] == "posterior" or bool(given["fleet"]), seed=_seed(target, given),
        options=Options(
            given["odom_topic"], given["odom_frame"], given["base_frame"], given["twist"] == "keep",
            given["covariance"] == "keep", given["keep_truth"], given["keep_localisation"], given["new_odom_frame"],
        ),
        container=Container(
            compression=given["compression"], level=given["level"], recover=given["recover"], threads=_threads(given)
        ),
        output=given["output"],
        split=given["layout"] == "split", typed=_words(_MODEL_WORDS, given), option_words=_words(_OPTION_WORDS, given),
    )  # fmt: skip


def _model(given: dict[str, Any]) -> MotionModel:
    """Return the model that was asked for, or that of a fleet."""
    if not given["fleet"]:
        return choose_model(**{name: given[name] for name in (*_MODEL_WORDS, "model")}).model
    from odomcorrupt.batching.fleet import fleet_model
    from odomcorrupt.model.model_file import read_model

    other = [flag for name, flag in (("model", "--model"), *_MODEL_WORDS.items()) if given[name]]
    if other:
        raise click.UsageError(
            f"--fleet and {other[0]}: the files of a fleet are its whole model; leave {other[0]} out"
        )
    if len(set(given["fleet"])) < len(given["fleet"]):
        raise click.UsageError("--fleet: a file is named twice; a robot counts once")
    return fleet_model({str(path): read_model(path) for path in given["fleet"]})


def _threads(given: dict[str, Any]) -> int:
    """Return how many threads each process has."""
    from odomcorrupt.bags.pipeline import default_threads

    threads: int = (given["threads"] or default_threads()) // given["jobs"]
    return max(1, threads)


def _words(names: dict[str, str], given: dict[str, Any]) -> list[str]:
    """Return options as they are typed, of those that were given."""
    words = []
    for name, flag in names.items():
        value = given[name]
        if name == "effects":
            words += [word for one in value for word in (flag, one)]
        elif name == "alpha" and value:
            words += [flag, *value.split()]
        elif isinstance(value, bool):
            words += [flag] * value
        elif isinstance(value, tuple):
            words += [flag, *map(str, value)]
        elif value is not None:
            words += [flag, str(value)]
    return words


def _seed(target: Path, given: dict[str, Any]) -> int:
    """Return the seed asked for, that of the batch which is there, or a fresh one."""
    from odomcorrupt.batching.manifest import read_beginning
    from odomcorrupt.rng import draw_seed

    if given["seed"] is not None:
        return int(given["seed"])
    if given["shard"]:
        raise click.UsageError("--shard: all shards need the same --seed; give one")
    there = next(iter(sorted(target.rglob("batch.json"))), None)
    return draw_seed() if there is None else int(read_beginning(there.parent)["seed"])


def _require_driver(jobs: Sequence[Job]) -> None:
    """Fail at once where all runs would: no odometry, or a model that is none."""
    from odomcorrupt.bags.open import open_reader
    from odomcorrupt.corruption.transform import Transform

    for job in jobs:
        with open_reader(job.source, recover=job.container.recover) as reader:
            Transform(job.model_of(0), job.seed, 0, job.options).driver.prepare(reader, reader.name)


def _need(jobs: Sequence[Job], runs: range, shard: Shard) -> Need:
    from odomcorrupt.batching.engine import count_missing
    from odomcorrupt.batching.estimate import Need, estimate, free_bytes

    count = size = overlay = 0
    seconds = 0.0
    for job in jobs:
        missing = count_missing(job, runs, shard)
        each = estimate(job)
        count += missing
        size += missing * each.bytes
        overlay += missing * each.overlay_bytes
        seconds += missing * each.seconds
    return Need(count, size, seconds, overlay, free_bytes(jobs[0].directory))


def _dry(jobs: Sequence[Job], runs: range, shard: Shard, processes: int) -> str:
    need = _need(jobs, runs, shard)
    saved = 1.0 - need.overlay_bytes / need.bytes if need.bytes else 0.0
    text = (
        f"{need.runs} runs to make, about {need.bytes / 1e9:.3g} GB ({need.free_bytes / 1e9:.3g} GB are free) and "
        f"{need.core_seconds / 60.0:.3g} core minutes"
    )
    text += (
        f", {need.core_seconds / 60.0 / processes:.3g} minutes with {processes} processes." if processes > 1 else "."
    )
    if jobs[0].output == "full":
        text += f" --output overlay would write {need.overlay_bytes / 1e9:.3g} GB, {saved:.0%} less."
    if need.bytes > need.free_bytes:
        text += " The disk cannot hold it."
    return text


def _require_space(jobs: Sequence[Job], _fresh: Sequence[Job], runs: range, shard: Shard) -> None:
    """Refuse what the disk cannot hold; what is far from that is not measured."""
    from odomcorrupt.batching.estimate import bytes_of, free_bytes, require_space

    if 5 * len(runs) * sum(bytes_of(job.source) for job in jobs) > free_bytes(jobs[0].directory):
        require_space(_need(jobs, runs, shard), jobs[0].shown_directory)


def _make(todo: Sequence[tuple[Job, Sequence[int]]], given: dict[str, Any]) -> list[Failure]:
    from odomcorrupt.batching.engine import run_local, run_on_dask, tasks_of
    from odomcorrupt.commands._eta import Rate

    with Rate(sum(len(runs) for _, runs in todo)) as rate:
        if given["dask"]:
            run_on_dask(todo, given["dask"], rate)
        else:
            tasks = [task for job, runs in todo for task in tasks_of(job, runs, given["jobs"])]
            run_local(tasks, given["jobs"], rate)
    return rate.failures


def _collect(job: Job, runs: int) -> None:
    """Put all paths into one file, when the last of them is there."""
    from odomcorrupt.batching.manifest import read_records
    from odomcorrupt.batching.tum import read_tum, write_npz

    if job.output == "trajectories":
        made = read_records(job.directory)
        if set(range(runs)) <= made.keys():
            files = [job.directory / record["file"] for record in made.values()]
            write_npz(job.directory / "trajectories.npz", read_tum(job.directory / "clean.tum"), list(made), files)


def _losses(jobs: Sequence[Job]) -> list[str]:
    """Return what could not be read of damaged inputs, each once."""
    from odomcorrupt.batching.manifest import read_records

    records = [record for job in jobs if job.container.recover for record in read_records(job.directory).values()]
    return list(dict.fromkeys(loss for record in records for loss in record.get("losses", ())))


def _told(failures: Sequence[Failure]) -> str:
    if not failures:
        return ""
    first, reason = failures[0]
    names = ", ".join(str(run) for run, _ in failures[:8]) + (", ..." if len(failures) > 8 else "")
    return f" Not made, tried twice: {len(failures)} runs ({names}); run {first}: {reason}"
