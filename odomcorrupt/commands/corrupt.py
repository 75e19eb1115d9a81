"""odomcorrupt INPUT OUTPUT: the default command."""

from __future__ import annotations

import ctypes
import sys
from typing import Any

import click

from odomcorrupt.commands._bag import (
    bag_words,
    container_options,
    further_inputs,
    moving_options,
    one_input,
    source_of,
    threads_option,
)
from odomcorrupt.commands._model import AlphaCommand, choose_condition_of_run, choose_model, map_options, model_options
from odomcorrupt.commands._options import run_options
from odomcorrupt.commands._progress import Progress
from odomcorrupt.commands._standard import Console, chosen_output, output_option, standard_options

_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3
"""Names of parameters in glibc's malloc.h."""
_KEPT_BYTES = 32 << 20


def keep_freed_memory() -> None:
    """Keep freed memory in the process instead of returning it to the kernel, with glibc.

    Codecs allocate memory for each chunk, and getting it from the kernel takes longer than decompressing into it.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None) if sys.platform == "linux" else None
    if mallopt is not None:
        mallopt(_MMAP_THRESHOLD, _KEPT_BYTES)
        mallopt(_TRIM_THRESHOLD, _KEPT_BYTES)


@click.command("corrupt", cls=AlphaCommand, short_help="Corrupt the odometry of a bag (the default: needs no name).")
@click.argument("input_", metavar="INPUT", type=click.Path(allow_dash=True, readable=False))
@click.argument("output", metavar="OUTPUT", type=click.Path(allow_dash=True), required=False)
@further_inputs
@output_option()
@model_options
@run_options
@moving_options
@map_options
@container_options
@threads_option
@standard_options
def command(
    input_: str, output: str | None, further: tuple[str, ...], output_option: str | None, *, console: Console,
    **given: Any,
) -> int:  # fmt: skip
    """Corrupt the odometry of a bag: its poses, twists and covariances, and the TF edges that go with them.

    INPUT and OUTPUT are bags of any kind; - is a pipe; the parts of a split recording are one INPUT, by their folder or
    as run_*.bag. With --map every drawn pose is in free space, as in the motion model of a particle filter; real
    odometry drifts through walls, so leave --map out to imitate it.
    """
    from odomcorrupt.api.corruption import corrupt

    if further:
        inputs = [input_, str(output), *further]
        output = inputs.pop() if output_option is None else None
        input_ = one_input(inputs)
    target = chosen_output(output, output_option)
    model = choose_model(given)
    if target == "-" and sys.stdout.isatty():
        raise click.UsageError("OUTPUT is - but stdout is a terminal; redirect it to a file or a pipe")
    source = source_of(input_)
    options = bag_words(given)
    condition = choose_condition_of_run(given, source, options, model)
    keep_freed_memory()
    with Progress(quiet=console.quiet) as progress:
        asked = {name: given[name] for name in ("seed", "run", "also")} | {"within": condition, "watch": progress}
        done = corrupt(input_, target, model=model, **asked, **options)
    console.show(done, bag=target)
    return 3 if done.losses else 0
