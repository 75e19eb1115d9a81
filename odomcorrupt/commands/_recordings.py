"""What the commands of the study share: telling recordings from models, and reading them."""

from __future__ import annotations

import shutil
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from odomcorrupt.commands._param_types import TRACK, Number, Share
from odomcorrupt.commands._progress import part_done
from odomcorrupt.errors import OdomCorruptError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from odomcorrupt.model.motion_model import MotionModel
    from odomcorrupt.study.io.recording import Recording

__all__ = ["describe", "need_study", "read_all", "recording_options", "source_words", "split_arguments"]

_TRUTH_BAGS, _TRUTH_SHIFT, _USED, _SCAN, _RULER = (
    f"odomcorrupt.{name}" for name in ("truth_bags", "truth_shift", "truth_bags_used", "scan", "laser_scale_accuracy")
)


def recording_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options that say where odometry and truth are.

    --truth-bag and --truth-shift concern reading alone: they are kept for `read_all` and not passed to the command.
    """
    for option in (
        click.option(
            "--track", type=TRACK, help="Nominal distance between the wheels, metres (for two-wheel effects)."
        ),
        click.option(
            "--truth-shift",
            type=Number("seconds", -1e10, 1e10),
            default=0.0,
            metavar="SECONDS",
            expose_value=False,
            callback=_remember(_TRUTH_SHIFT),
            help="Added to the truth's stamps, where its clock is far off (seconds are enough; the rest is fitted).",
        ),
        click.option(
            "--truth-bag",
            "--truth-file",
            type=click.Path(path_type=Path),
            multiple=True,
            expose_value=False,
            callback=_remember(_TRUTH_BAGS),
            help="Bag, TUM or CSV file with the truth, where the recording has none: one for all, or one for each.",
        ),
        click.option(
            "--truth", help="Topic of the truth, or edge of TF as /tf:map.base_link. [default: the only one it can be]"
        ),
        click.option(
            "--scan",
            metavar="TOPIC",
            expose_value=False,
            callback=_remember(_SCAN),
            help="Laser scans (LaserScan, PointCloud2) to learn from where there is no truth. [default: the only one]",
        ),
        click.option(
            "--laser-scale-accuracy",
            type=Share("a share as in 0.3% or 0.003", 0.0, 20.0),
            metavar="SHARE",
            default="0.3%",
            expose_value=False,
            callback=_remember(_RULER),
            help="How far the laser's own scale may be off (one standard deviation): no scale is known better. [default: 0.3%]",
        ),
        click.option(
            "--odom", help="Topic of the odometry, or edge of TF as /tf:odom.base_link. [default: the only Odometry]"
        ),
    ):
        command = option(command)
    return command


def _remember(key: str) -> Callable[[click.Context, click.Parameter, Any], None]:
    def callback(ctx: click.Context, _: click.Parameter, value: Any) -> None:
        ctx.meta[key] = value

    return callback


def need_study() -> None:
    """Explain what to install where the study's libraries are missing."""
    try:
        import scipy  # noqa: F401
    except ImportError as error:
        raise OdomCorruptError(
            'scipy is not installed; the study needs it: pip install "odomcorrupt[study]"'
        ) from error


def split_arguments(arguments: Sequence[str]) -> tuple[list[Path], dict[str, MotionModel]]:
    """Return recordings and models: arguments that end in .toml are models."""
    from odomcorrupt.model.model_file import read_model

    models = {a: read_model(Path(a)) for a in arguments if a.endswith(".toml")}
    recordings = [Path(a) for a in arguments if not a.endswith(".toml")]
    if not recordings:
        raise click.UsageError("no recording given; name a bag with odometry and truth")
    return recordings, models


def read_all(paths: Sequence[Path], odom: str | None, truth: str | None, track: float | None) -> list[Recording]:
    """Return the recordings, several for a path with resets, and say on stderr what reading them left out."""
    from odomcorrupt.study.io import Source, read_runs

    meta = click.get_current_context().meta
    recordings = []
    for path, truth_path in zip(paths, _truth_bags(len(paths)), strict=True):
        source = Source(
            path=_spooled(path) if str(path) == "-" else path,
            odom=odom,
            truth=truth,
            truth_path=truth_path,
            truth_shift_s=meta.get(_TRUTH_SHIFT, 0.0),
            scan=meta.get(_SCAN),
            truth_scale_error=meta.get(_RULER, 0.003),
            track_m=track,
            name="stdin" if str(path) == "-" else "",
        )
        for recording in read_runs(source, part_done):
            click.echo(describe(recording), err=True)
            for note in recording.notes:
                click.echo(f"  {note}", err=True)
            recordings.append(recording)
    return recordings


def source_words(odom: str | None, truth: str | None, track: float | None) -> list[str]:
    """Return the words of a command line that read the same recordings again."""
    meta = click.get_current_context().meta
    words = [w for flag, value in (("--odom", odom), ("--truth", truth)) if value for w in (flag, value)]
    words += ["--scan", meta[_SCAN]] if meta.get(_SCAN) else []
    words += [w for path in meta.get(_TRUTH_BAGS, ()) for w in ("--truth-bag", str(path))]
    if shift := meta.get(_TRUTH_SHIFT, 0.0):
        words += ["--truth-shift", repr(shift)]
    return words + (["--track", f"{track:g}"] if track is not None else [])


def describe(recording: Recording) -> str:
    """Return one line about a recording."""
    import numpy as np

    odometry, truth = recording.odometry, recording.truth
    spans = [(t.stamps_ns[-1] - t.stamps_ns[0]) * 1e-9 for t in (odometry, truth)]
    travelled = np.linalg.norm(np.diff(odometry.xyt[:, :2], axis=0), axis=1).sum()
    return (
        f"{recording.name}: odometry {len(odometry)} poses in {spans[0]:.1f} s ({travelled:.1f} m), "
        f"truth {len(truth)} poses in {spans[1]:.1f} s"
    )


def _truth_bags(count: int) -> list[Path | None]:
    """Return the truth's file of each of the next recordings: a command may read twice (learn and its judges)."""
    ctx = click.get_current_context()
    given: tuple[Path, ...] = ctx.meta.get(_TRUTH_BAGS, ())
    if len(given) < 2:
        return [given[0] if given else None] * count
    used = ctx.meta.get(_USED, 0)
    total = count + len(ctx.params.get("judge") or ()) if not used else len(given)
    if total != len(given):
        raise click.UsageError(f"{len(given)} --truth-bag for {total} recordings; name one for all, or one for each")
    ctx.meta[_USED] = used + count
    return list(given[used : used + count])


def _spooled(path: Path) -> Path:
    """Return a file with what comes through the pipe, gone when the command ends: reading may take two passes."""
    folder = Path(tempfile.mkdtemp(prefix="odomcorrupt-"))
    click.get_current_context().call_on_close(lambda: shutil.rmtree(folder, ignore_errors=True))
    target = folder / f"stdin{path.suffix}"
    with target.open("wb") as stream:
        shutil.copyfileobj(sys.stdin.buffer, stream)
    return target
