"""odomcorrupt batch: many corrupted runs of one bag."""

from __future__ import annotations

import functools
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from odomcorrupt.commands._bag import bag_words, container_options, moving_options, threads_option
from odomcorrupt.commands._model import AlphaCommand, choose_condition_of_run, choose_model, map_options, model_options
from odomcorrupt.commands._options import EFFECTS, FILE, setting, usage_errors, valued, words_of
from odomcorrupt.commands._standard import Console, chosen_output, output_option, standard_options
from odomcorrupt.errors import BatchError, BatchOptionError

if TYPE_CHECKING:
    from collections.abc import Sequence

_OF_MODEL = ("alpha", "law", "twist_noise", "step", "preset", "effects", "track")
_OF_MAP = ("map_", "radius", "check", "unknown", "tries", "map_pose")


def _shard(value: Any) -> Any:
    """Return (number, count) of a shard written as 3/16."""
    match = re.fullmatch(r"(\d+)/(\d+)", value) if isinstance(value, str) else None
    if match is None or not 1 <= int(match[1]) <= int(match[2]):
        raise click.BadParameter(f"{value!r}; write which of how many, counted from 1, as in 3/16")
    return int(match[1]), int(match[2])


_shard.__name__ = "I/N"


@click.command("batch", cls=AlphaCommand, short_help="Make many corrupted bags of one: Monte-Carlo runs.")
@click.argument("paths", metavar="INPUT... DIRECTORY", nargs=-1, required=True, type=click.Path(path_type=Path))
@output_option("DIRECTORY")
@click.option("--runs", type=click.IntRange(1), required=True, metavar="N", help="Make runs 0 to N - 1.")
@model_options
@setting("--seed", type=click.IntRange(0), metavar="N", help="Seed of all draws. [default: the batch's, or drawn]")
@valued(
    "--output", among=["full", "overlay", "trajectories"],
    text="Whole bags, only the changed topics, or only paths (TUM, npz).",
)  # fmt: skip
@valued(
    "--layout", among=["same", "split"],
    text="Chunks as in the input, or changed messages in chunks of their own: faster.",
)  # fmt: skip
@click.option(
    "--to", type=click.Choice(["bag", "mcap", "db3", "directory"]),
    help="Format of the runs: ROS 1 bag, MCAP, sqlite3, ROS 2 directory. [default: that of the input]",
)  # fmt: skip
@click.option(
    "--robots", type=click.Choice(["stated", "posterior"]), default="stated",
    help='Parameters drawn for each run: those written "a +- b" in the model file (stated), or all with a standard '
    "error (posterior). [default: stated]",
)  # fmt: skip
@click.option(
    "--fleet", multiple=True, type=FILE, metavar="FILE",
    help="A robot of a fleet (repeat for each): every run draws a robot by their mean and spread.",
)  # fmt: skip
@click.option(
    "--sweep", "sweeps", multiple=True, metavar="NAME=V,V", shell_complete=EFFECTS,
    help="As alpha-scale=0.5,1,2, or a range as wheel_scale.e=0..0.02 with --points (repeatable).",
)  # fmt: skip
@click.option("--points", type=click.IntRange(0), default=0, metavar="N", help="Cover all ranges by N Sobol points.")
@valued("--jobs", kind=click.IntRange(1), default=1, metavar="N", text="Processes.")
@click.option("--shard", type=_shard, help="Make the I-th of N parts, as 3/16, counted from 1.")
@click.option("--dask", metavar="ADDRESS", help="Use the workers of a Dask scheduler, as tcp://host:8786.")
@threads_option
@click.option("--verify", is_flag=True, help="Make runs again whose checksums are not the manifest's: bit rot, edits.")
@click.option("--dry-run", is_flag=True, help="Print the expected time and disk space, and make nothing.")
@moving_options
@map_options
@container_options
@standard_options
def command(paths: tuple[Path, ...], output_option: str | None, *, console: Console, **given: Any) -> int:
    """Make runs 0 to N - 1 of a seed: the same bytes as `odomcorrupt INPUT OUTPUT --seed S --run K` one by one.

    Called again, it makes the missing runs. DIRECTORY/manifest.jsonl has the command that makes any single run.
    """
    from odomcorrupt.api.batch import batch, estimate_batch
    from odomcorrupt.batching.manifest import BEGINNING, read_records
    from odomcorrupt.commands._progress import Rate

    inputs, target = _paths(paths, output_option, console)
    options = _options(inputs, given)
    with usage_errors(BatchOptionError):
        if given["dry_run"]:
            del options["verify"], options["dask"]
            cost = estimate_batch(inputs, target, **options)
            console.show(cost)
            return 0
        try:
            done = batch(inputs, target, **options, progress=functools.partial(Rate, quiet=console.quiet))
        except KeyboardInterrupt:
            kept = sum(len(read_records(path.parent)) for path in target.rglob(BEGINNING))
            said = f"{kept} runs are complete in {target}; the same command makes the others"
            raise KeyboardInterrupt(said) from None
    console.show(done, bag=str(target))
    if done.failures and console.quiet:
        run, reason = done.failures[0]
        raise BatchError(f"{len(done.failures)} runs failed, tried twice; run {run}: {reason}")
    return 1 if done.failures else 3 if done.losses else 0


def _paths(paths: tuple[Path, ...], option: str | None, console: Console) -> tuple[tuple[Path, ...], Path]:
    """Return the inputs and the directory, which is the last argument unless -o gives it."""
    from odomcorrupt.bags.open import is_pattern
    from odomcorrupt.bags.parts import bags_in, pattern_of

    inputs, last = (paths, None) if option is not None else (paths[:-1], str(paths[-1]))
    target = Path(chosen_output(last, option, "DIRECTORY"))
    if not inputs:
        raise click.UsageError("Missing argument 'DIRECTORY'.")
    for path in inputs:
        if not path.exists() and not is_pattern(path):
            raise click.UsageError(f"Invalid value for 'INPUT...': Path '{path}' does not exist.")
    if target.is_file():
        raise click.UsageError(f"Invalid value for 'DIRECTORY': Directory '{target}' is a file.")
    pattern = pattern_of(inputs) if len(inputs) > 1 else None
    # rosbag record --split counts from 0
    if pattern and len(bags_in(pattern)) == len(inputs) and any(re.search(r"\D0+\.bag", one.name) for one in inputs):
        console.note(f"{len(inputs)} inputs are the parts of one recording, {pattern}; for batches of each, name one")
        inputs = (pattern,)
    return inputs, target


def _options(inputs: tuple[Path, ...], given: dict[str, Any]) -> dict[str, Any]:
    """Return model, map and all other options under their names in the Python interface."""
    from odomcorrupt.api.model import Model

    words = bag_words(given)
    passed = ("runs", "seed", "output", "layout", "to", "also", "robots", "fleet", "sweeps", "points")
    options = {**words, **{name: given[name] for name in (*passed, "jobs", "shard", "verify", "dask")}}
    if given["fleet"]:
        if other := _words(["model", *_OF_MODEL], given)[:1]:
            raise click.UsageError(
                f"--fleet and {other[0]}: the files of a fleet are its whole model; leave {other[0]} out"
            )
        model = Model.load(given["fleet"][0])  # for the odometry's topic
    else:
        model = choose_model(given)
        options |= {"model": model, "model_file": given["model"]}
        options["model_words"] = tuple(_words(_OF_MODEL, given))
    condition = choose_condition_of_run(given, inputs[0], words, model)
    mapped = () if given["map_"] is None else _words(_OF_MAP, given)
    return {**options, "within": condition, "map_words": tuple(mapped)}


def _words(names: Sequence[str], given: dict[str, Any]) -> list[str]:
    """Return the given options as words of a command line."""
    options = {option.name: option for option in click.get_current_context().command.params}
    # the coefficients are one value and several words
    alphas = {"alpha": (given["alpha"] or "").split()}
    words = ((name, word) for name in names for word in words_of(options[name], given[name]))
    return [part for name, word in words for part in (alphas.get(name, [word]) if word[:2] != "--" else [word])]
