"""odomcorrupt integrate: wheel odometry from velocities alone."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from odomcorrupt.commands._bag import ODOM_TOPIC, unpack_option
from odomcorrupt.commands._options import PICTURE, one_of, save_picture, usage_errors
from odomcorrupt.commands._standard import Console, chosen_output, output_option, overwrite_option, standard_options
from odomcorrupt.errors import ModelError, OdomCorruptError
from odomcorrupt.result_files import refuse_existing
from odomcorrupt.summary import Line, Summary, command_line

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.geometry.trajectory import Trajectory
    from odomcorrupt.trajectories import Drive

_BAG = click.Path(path_type=Path)


@click.command("integrate", short_help="Integrate a bag's velocities to odometry, with or without noise on them.")
@click.argument("input_", metavar="INPUT", type=_BAG)
@click.argument("output", metavar="[OUTPUT]", type=_BAG, required=False)
@output_option()
@one_of(
    "--integrate", "rule", among=["euler", "midpoint", "exact"], default="exact",
    text="Integration rule: initial heading of an interval, middle heading, or arc.",
)  # fmt: skip
@one_of("--hold", among=["next", "previous"], text="A twist holds until the next stamp, or from the previous one.")
@click.option(
    "--twist-noise", nargs=2, type=float, metavar="V OMEGA", help="White noise on every twist: m/s and rad/s."
)
@click.option("--runs", type=click.IntRange(1, 100_000), default=1, help="How many noisy runs to draw. [default: 1]")
@click.option("--seed", type=click.IntRange(0), metavar="N", help="Seed of the noise. [default: drawn, and printed]")
@click.option(*ODOM_TOPIC, metavar="TOPIC", help="Odometry whose twists are taken.")
@click.option("--truth", metavar="TOPIC", help="Poses to compare with. [default: a topic named like a truth]")
@click.option("--plot", type=PICTURE, help="Picture: .png, .svg or .pdf.")
@overwrite_option("existing outputs", passed=True)
@unpack_option
@standard_options
def command(input_: Path, output: Path | None, output_option: str | None, *, console: Console, **given: Any) -> None:
    """Integrate the velocities of a bag's odometry, and write them as its poses.

    OUTPUT gets run 0, in the Odometry messages and the TF edges that go with them; everything else stays.

    \b
    odomcorrupt integrate in.mcap out.mcap --integrate euler --plot errors.png
    odomcorrupt integrate in.mcap --twist-noise 0.2 0.04 --runs 100 --plot runs.png
    """  # noqa: D301 - click wants a real backspace
    from odomcorrupt.bags.open import form_of, open_reader
    from odomcorrupt.rng import draw_seed
    from odomcorrupt.trajectories import find_truth, integrate, noisy_twists, read_drive, read_poses

    if output is not None or output_option is not None:
        output = Path(chosen_output(None if output is None else str(output), output_option))
    plot, noise, rule = given["plot"], given["twist_noise"], given["rule"]
    if "-" in (str(input_), str(output)):
        raise OdomCorruptError("-: integration reads the whole drive first, which is impossible on a pipe; name files")
    if given["runs"] > 1 and noise is None:
        raise click.UsageError(f"--runs {given['runs']}: without --twist-noise all runs are the same")
    refuse_existing(output, overwrite=given["overwrite"])
    if output is not None:  # refuse a name that is not that of a bag before any work is done
        with open_reader(input_) as reader:
            form_of(output, reader)
    drive = read_drive(input_, given["odom_topic"])
    truth_topic = given["truth"] or find_truth(input_)
    truth = None if truth_topic is None else read_poses(input_, truth_topic)
    said = [_about(drive, rule, given["hold"]), *drive.notes]
    clean = integrate(drive.xyt[0], drive.twist, drive.t_s, rule, hold=given["hold"])
    compared = _compared(drive, clean, truth, truth_topic)
    said += compared
    written, provenance = clean, {"command": "integrate", "rule": rule, "hold": given["hold"]}
    runs, spread = None, []
    if noise is not None:
        seed = draw_seed() if given["seed"] is None else given["seed"]
        with usage_errors(ModelError):
            twists = noisy_twists(drive.twist, *noise, seed=seed, runs=range(given["runs"]))
        runs = integrate(drive.xyt[0], twists, drive.t_s, rule, hold=given["hold"])
        written, provenance = runs[0], provenance | {"seed": str(seed), "twist_noise": f"{noise[0]} {noise[1]}"}
        spread = _spread(runs, clean, noise, seed)
        said += spread
    following = ["info", output] if output is not None else ["integrate", input_, "--plot", "errors.png"]
    brief = _brief(
        drive, f"{rule}, a twist holds {_held(given['hold'])}", {"error": compared, "noise": spread}, following
    )
    files: dict[Path, Callable[[], object]] = {}
    if output is not None:
        files[output] = partial(_rewrite, input_, output, drive, written, provenance, overwrite=given["overwrite"])
    if plot is not None:
        files[plot] = partial(_draw, plot, drive, clean, runs, truth, rule, noise)
    values = {"schema": 2, "rule": rule, "hold": given["hold"], "sentences": said}
    console.print(brief, "\n".join(said), values, files=files)


def _brief(drive: Drive, rule: str, found: Mapping[str, Sequence[str]], following: Sequence[object]) -> Summary:
    """Return the integrated odometry's length and errors, the effect of noise, and the suggested next command."""
    whole = f"{len(drive)} twists of {drive.topic}, {drive.distance_m[-1]:.4g} m in {drive.t_s[-1]:.4g} s"
    lines = [Line("INTEGRATED", whole, "good"), Line("rule", rule)]
    lines += [Line("note", note, "warning") for note in drive.notes]
    lines += [Line("" if i else label, one) for label, said in found.items() for i, one in enumerate(said)]
    return Summary((*lines, command_line(["odomcorrupt", *following])))


def _rewrite(
    source: Path, target: Path, drive: Drive, xyt: Array, provenance: dict[str, str], *, overwrite: bool
) -> str:
    from odomcorrupt.trajectories import rewrite_path

    done = rewrite_path(source, target, drive, xyt, provenance, overwrite=overwrite)
    return f"wrote {target}: {done.messages} odometry messages, {done.transforms} transforms"


def _held(hold: str) -> str:
    return "until the next stamp" if hold == "next" else "since the previous stamp"


def _about(drive: Drive, rule: str, hold: str) -> str:
    hertz = (len(drive) - 1) / float(drive.t_s[-1])
    return (
        f"{drive.topic}: {len(drive)} twists in {drive.t_s[-1]:.4g} s ({hertz:.3g} Hz), {drive.distance_m[-1]:.4g} m; "
        f"rule {rule}, each twist holds {_held(hold)}"
    )


def _compared(drive: Drive, xyt: Array, truth: Trajectory | None, name: str | None) -> list[str]:
    """Return the distance of integrated odometry from the truth, and from the bag's own poses."""
    import numpy as np

    from odomcorrupt.trajectories import path_error

    error = None if truth is None else path_error(drive.stamps_ns, xyt, truth)
    own = path_error(drive.stamps_ns, xyt, drive.trajectory)
    return [
        f"against {against}: at most {one.position_m.max():.4f} m and {np.abs(one.heading_rad).max():.4f} rad"
        for one, against in ((error, name), (own, drive.topic))
        if one is not None
    ]


def _spread(runs: Array, clean: Array, noise: tuple[float, float], seed: int) -> list[str]:
    """Return the distance of noisy runs' ends from the clean path."""
    import numpy as np

    ends = runs[:, -1] - clean[-1]
    position, heading = np.sqrt((ends[:, :2] ** 2).sum(axis=1).mean()), np.sqrt((ends[:, 2] ** 2).mean())
    return [
        f"{len(runs)} runs with white noise of {noise[0]:g} m/s and {noise[1]:g} rad/s on every twist, seed {seed}",
        f"they end {position:.3g} m and {heading:.3g} rad away (RMS), which depends on the message rate",
    ]


def _draw(
    plot: Path,
    drive: Drive,
    clean: Array,
    runs: Array | None,
    truth: Trajectory | None,
    rule: str,
    noise: tuple[float, float] | None,
) -> None:
    from odomcorrupt.report.plots.paths import draw_errors, draw_runs
    from odomcorrupt.trajectories import path_error

    reference = drive.trajectory if truth is None else truth
    error = path_error(drive.stamps_ns, clean, reference)
    if error is None:
        raise click.UsageError("odometry and truth share no time; name another topic with --truth")
    if runs is None or noise is None:
        save_picture(plot, draw_errors(error, f"twists, {rule}", f"Odometry integrated from velocities alone ({rule})"))
        return
    words = f"Velocities with white noise of {noise[0]:g} m/s and {noise[1]:g} rad/s"
    save_picture(plot, draw_runs(runs, error.truth_xyt, "true path" if truth is not None else "bag's own path", words))
