"""Additional outputs of diagnose and learn: the drive that decides between open alternatives, and the report."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from odomcorrupt.commands._options import FILE, added, need_pictures
from odomcorrupt.result_files import refuse_existing, write_text

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from odomcorrupt.api.diagnosis import Findings
    from odomcorrupt.commands._standard import Files

__all__ = ["advice_files", "advice_options", "check_advice"]


advice_options = added(
    click.option("--drive", type=FILE, help="Write the drive that would settle what is open, as /cmd_vel in an MCAP."),
    click.option("--report", type=FILE, help="Write all of it as one page of HTML, pictures too."),
)


def check_advice(drive: Path | None, report: Path | None, *, overwrite: bool) -> None:
    """Refuse output names that cannot be written; called before any work is done."""
    if drive is not None and drive.suffix != ".mcap":
        raise click.UsageError(f"--drive {drive}: commands are written as MCAP; end the name in .mcap")
    if report is not None:
        need_pictures()
    for path in (drive, report):
        refuse_existing(path, overwrite=overwrite)


def advice_files(result: Findings, drive: Path | None, report: Path | None) -> Files:
    """Return the writers of the drive (/cmd_vel) and the report; no drive is written if nothing is open."""
    files: dict[Path, Callable[[], object]] = {}
    if drive is not None:
        files[drive] = lambda: (
            f"wrote {drive}: {said}"
            if (said := result.save_next_drive(drive, overwrite=True))
            else f"{drive} is not written: nothing is open that a drive would settle"
        )
    if report is not None:
        files[report] = lambda: write_text(report, result.report())
    return files
