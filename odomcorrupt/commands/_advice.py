"""What diagnose and learn write besides their result: the drive that would settle what is open, and the report."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from odomcorrupt.commands._poses import need_pictures
from odomcorrupt.files import refuse_existing, write_text

if TYPE_CHECKING:
    from collections.abc import Callable

    from odomcorrupt.api.diagnosis import Findings
    from odomcorrupt.commands._standard import Files

__all__ = ["advice_files", "advice_options", "check_advice"]


def advice_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add --drive and --report."""
    for option in (
        click.option(
            "--report",
            type=click.Path(dir_okay=False, path_type=Path),
            help="Write all of it as one page of HTML, pictures too.",
        ),
        click.option(
            "--drive",
            type=click.Path(dir_okay=False, path_type=Path),
            help="Write the drive that would settle what is open, as /cmd_vel in an MCAP.",
        ),
    ):
        command = option(command)
    return command


def check_advice(drive: Path | None, report: Path | None, *, overwrite: bool) -> None:
    """Refuse names that cannot be written, before any work is done."""
    if drive is not None and drive.suffix != ".mcap":
        raise click.UsageError(f"--drive {drive}: commands are written as MCAP; end the name in .mcap")
    if report is not None:
        need_pictures()
    for path in (drive, report):
        refuse_existing(path, overwrite=overwrite)


def advice_files(result: Findings, drive: Path | None, report: Path | None) -> Files:
    """Return the drive as /cmd_vel and the page as files to write; where nothing is open, there is no drive."""

    def save_drive(path: Path) -> str:
        words = result.save_next_drive(path, overwrite=True)
        nothing = f"{path} is not written: nothing is open that a drive would settle"
        return f"wrote {path}: {words}" if words else nothing

    files: dict[Path, Callable[[], object]] = {}
    if drive is not None:
        files[drive] = partial(save_drive, drive)
    if report is not None:
        files[report] = lambda: write_text(report, result.report())
    return files
