"""Arguments and options of the study's commands: recordings, how to read them, models, and extra output files."""

from __future__ import annotations

import functools
import sys
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import click
from click.core import ParameterSource

from odomcorrupt.commands._bag import unpack_option
from odomcorrupt.commands._options import PAGE, TRACK, Decorator, OutputFile, added, number, setting, words_of
from odomcorrupt.commands._progress import Stages
from odomcorrupt.commands._standard import printed, written
from odomcorrupt.drive_types import AUTO, DRIVE_TYPES
from odomcorrupt.extras import require

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from odomcorrupt.api.findings import Findings
    from odomcorrupt.api.recordings import Recordings
    from odomcorrupt.commands._standard import Console, Files

WORSE = "{}: not written: it predicts held-out data worse than no effects do; above is what was tried; {}"
"""Why a model file is not written, for its path and a way out."""


class Reading(NamedTuple):
    """Reading options of a command line.

    given : values of the options of `recording_options`, by their names
    words : words of the command line that read the same recordings again
    """

    given: Mapping[str, Any]
    words: tuple[str, ...] = ()

    def stages(self, console: Console) -> Stages:
        """Return the progress display."""
        require("scipy")
        return Stages(quiet=console.quiet)

    def read(
        self, paths: Sequence[Path], console: Console, stages: Stages, *, track: float | None = None,
        held_out: Sequence[Path] = (),
    ) -> tuple[Recordings, Recordings | None]:  # fmt: skip
        """Return recordings, and held-out ones (None without any); several truth bags cover both in order.

        track : that of a model, used if the command line gives none
        """
        from odomcorrupt.api.recordings import describe, read_recordings

        count = len(paths) + len(held_out)
        alike = dict(self.given)
        own_track, truth_bags, relative = (alike.pop(name) for name in ("track", "truth_bags", "relative"))
        for flag, files in (("--truth-bag", truth_bags), ("--relative", relative)):
            if len(files) > 1 and len(files) != count:
                raise click.UsageError(f"{len(files)} {flag} for {count} recordings; name one for all, or one for each")

        def read(own: Sequence[Path], rows: slice) -> Recordings:
            first, part = (rows.start or 0) / count, len(own) / count
            truths, motions = (files[rows] if len(files) > 1 else files for files in (truth_bags, relative))
            runs = read_recordings(
                [_spooled(path) if str(path) == "-" else path for path in own],
                names=["stdin" if str(path) == "-" else "" for path in own],
                track_m=track if own_track is None else own_track,
                truth_bag=truths, relative=motions,
                progress=lambda stage, share: stages.reading(stage, first + part * share), **alike,
            )  # fmt: skip
            for recording in runs:
                console.detail("\n  ".join([describe(recording), *recording.notes]))
            return runs

        first = read(paths, slice(len(paths)))
        return first, read(held_out, slice(len(paths), None)) if held_out else None


_USUAL = (
    setting(
        "--truth", help="Topic of the truth, or edge of TF as /tf:map.base_link. [default: the only candidate]"
    ),
    setting("--track", type=TRACK, help="Nominal distance between the wheels, metres (for two-wheel effects)."),
    setting(
        "--odom", help="Topic of the odometry, or edge of TF as /tf:odom.base_link. [default: the only Odometry]"
    ),
)  # fmt: skip
"""Options of reading that most recordings need."""
_OTHERS = (
    click.option(
        "--truth-bag", "--truth-file", "truth_bags", type=click.Path(path_type=Path), multiple=True,
        help="Bag, TUM or CSV file with the truth, where the recording has none: one for all, or one for each.",
    ),
    setting(
        "--truth-shift", "truth_shift_s", type=number("seconds", -1e10, 1e10), default=0.0, metavar="SECONDS",
        help="Seconds added to the truth's stamps if its clock is far off (the remainder is fitted).",
    ),
    setting(
        "--scan", metavar="TOPIC",
        help="Laser scans (LaserScan, PointCloud2) to learn from if there is no truth; none: no laser. "
        "[default: the only one]",
    ),
    setting(
        "--laser-scale-accuracy", type=number("a share as in 0.3% or 0.003", 0.0, 20.0, share=True), metavar="SHARE",
        default="0.3%",
        help="Standard deviation of the laser's own scale error: no learned scale is more accurate. "
        "[default: 0.3%]",
    ),
    setting(
        "--imu", metavar="TOPIC",
        help="Gyro: shows whether the heading is from wheels or a gyro. (Only `diagnose` can use it without a truth or "
        "a laser.) [default: the only Imu]",
    ),
    setting(
        "--gyro-scale-accuracy", type=number("a share as in 1% or 0.01", 0.0, 20.0, share=True), metavar="SHARE",
        default="1%",
        help="Standard deviation of the gyro's own scale error, if the gyro is the truth. [default: 1%]",
    ),
    click.option(
        "--relative", type=click.Path(exists=True, dir_okay=False, path_type=Path), multiple=True,
        help="CSV of relative motions (t0,t1,dx,dy,dyaw) to learn from, as scan matchers and visual odometry write "
        "them: one for all, or one for each.",
    ),
    setting(
        "--joints", nargs=2, metavar="LEFT RIGHT",
        help="Wheel joints in JointState whose angles replace the odometry. [default: joints named as wheels, for the "
        "track alone]",
    ),
    setting(
        "--drive-type", type=click.Choice((*DRIVE_TYPES, AUTO)), default=AUTO,
        help="Drive type; it decides which effects are tested. [default: auto, from the motion]",
    ),
)  # fmt: skip
_OPTIONS = {option.name: option for option in click.command()(added(*_USUAL, *_OTHERS)(lambda: None)).params}


def recording_options(*own: Decorator) -> Decorator:
    """Return a decorator that adds the options of reading; the command receives them as one argument, `reading`.

    own : options of the command, listed after those of reading that most recordings need
    """

    def add(command: Callable[..., Any]) -> Callable[..., Any]:
        @functools.wraps(command)
        def with_reading(*args: Any, **given: Any) -> Any:
            context = click.get_current_context()
            read = {name: given.pop(name) for name in _OPTIONS}
            typed = (n for n in read if context.get_parameter_source(n) is not ParameterSource.DEFAULT)
            reading = Reading(read, tuple(word for name in typed for word in words_of(_OPTIONS[name], read[name])))
            return command(*args, reading=reading, **given)

        return added(*_USUAL, *own, *_OTHERS, unpack_option)(with_reading)

    return add


def split_arguments(arguments: Sequence[str]) -> tuple[list[Path], list[str]]:
    """Split arguments into recordings (also of folders, patterns and lists) and models: .toml files and presets."""
    from odomcorrupt.api.recordings import recording_paths
    from odomcorrupt.model.presets import PRESETS

    models = [a for a in arguments if a.endswith(".toml") or (a in PRESETS and not Path(a).exists())]
    recordings = recording_paths([a for a in arguments if a not in models])
    if not recordings:
        raise click.UsageError("no recording given; name a bag with odometry and truth")
    return recordings, models


def _spooled(path: Path) -> Path:
    """Return a temporary file with the contents of a pipe, because reading may take two passes; deleted at the end."""
    from odomcorrupt.bags.source import temporary_copy, temporary_folder

    folder = temporary_folder(copies := ExitStack())
    click.get_current_context().call_on_close(copies.close)
    return temporary_copy(sys.stdin.buffer, folder / f"stdin{path.suffix}", "stdin")


advice_options = added(
    click.option(
        "--drive", type=OutputFile("mcap"),
        help="Write the manoeuvre that separates the effects that these data leave undecided, as /cmd_vel in an MCAP.",
    ),
    click.option("--report", type=PAGE, help="Write the full result as one HTML page with pictures."),
)  # fmt: skip


def advice_files(result: Findings, drive: Path | None, report: Path | None) -> Files:
    """Return the writers of the drive (/cmd_vel) and the report; no drive is written if nothing is open."""

    def save(path: Path) -> str:
        said = result.save_next_drive(path, overwrite=True)
        nothing = f"{path} is not written: there is no open question that another drive would answer"
        return f"wrote {path}: {said}" if said else nothing

    return {**written(drive, save), **printed(report, result.report)}
