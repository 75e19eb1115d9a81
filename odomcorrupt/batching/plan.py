"""The jobs of a batch: one for each input and each point of a sweep, a directory each."""

from __future__ import annotations

from typing import TYPE_CHECKING

from odomcorrupt.bags.open import open_reader
from odomcorrupt.batching.job import Job
from odomcorrupt.batching.manifest import BatchError
from odomcorrupt.batching.parameter_draws import spreads_of, stated_spreads
from odomcorrupt.batching.sweep import variants
from odomcorrupt.model.model_file import format_model

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from odomcorrupt.batching.job import Output
    from odomcorrupt.corruption.run import Container
    from odomcorrupt.corruption.transform import Options
    from odomcorrupt.model.motion_model import MotionModel

__all__ = ["plan"]


def plan(
    inputs: Sequence[Path],
    target: Path,
    model: MotionModel,
    *,
    model_file: Path | None,
    sweeps: Sequence[str],
    points: int = 0,
    posterior: bool,
    seed: int,
    options: Options,
    container: Container,
    output: Output,
    split: bool,
    typed: Sequence[str],
    option_words: Sequence[str],
) -> list[Job]:
    """Return the jobs.

    points : how many cover ranges of the sweep
    model_file : where the model was read from, whose "a +- b" are drawn for each run; posterior: all standard errors
    typed : how the model was told on the command line, but for --model
    option_words : how frames and containers were told

    Raises
    ------
    BatchError
        Where inputs would share a directory, or an output cannot be had of them.

    """
    stems = [source.stem for source in inputs]
    if len(set(stems)) < len(stems):
        twice = next(stem for stem in stems if stems.count(stem) > 1)
        raise BatchError(f"inputs: two of them are called {twice}, and would share a directory; rename one")
    if posterior and not model.standard_errors:
        raise BatchError("--robots posterior: the model has no standard errors; give the --model that a fit wrote")
    stated = frozenset[str]() if model_file is None else stated_spreads(model_file)
    jobs = []
    for source in inputs:
        if source.is_dir() and target.resolve().is_relative_to(source.resolve()):
            raise BatchError(f"{target}: lies in the input {source}, which stays as it is; name a directory elsewhere")
        if split and _is_sqlite(source, container):
            raise BatchError(
                f"{source}: sqlite3 has no chunks that --layout split could part, and nothing in it is compressed "
                "again; leave --layout out"
            )
        for variant in variants(model, sweeps, points):
            parts = ([source.stem] if len(inputs) > 1 else []) + ([variant.name] if variant.name else [])
            directory = target.joinpath(*parts)
            shown = str(directory)
            told = tuple(typed)
            text = format_model(variant.model)
            if variant.name:
                told = ("--model", f"{shown}/model.toml")
            elif model_file is not None:
                # the file as it is now: somebody may edit it later
                told = ("--model", f"{shown}/model.toml", *typed)
                text = model_file.read_text(encoding="utf8")
            spreads = spreads_of(variant.model, None if posterior else stated)
            jobs.append(
                Job(
                    source.absolute(), directory.absolute(), variant.model, spreads, seed, options, container, output,
                    split, text, told, tuple(option_words), str(source), shown,
                )
            )  # fmt: skip
    return jobs


def _is_sqlite(source: Path, container: Container) -> bool:
    with open_reader(source, recover=container.recover) as reader:
        return reader.kind == "sqlite3"
