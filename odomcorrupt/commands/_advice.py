"""What diagnose and learn do with what they found: write the drive that settles what is open, and the report."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING

import click

from odomcorrupt.commands._output import refuse_existing, write_bytes, write_text

if TYPE_CHECKING:
    from pathlib import Path

    from odomcorrupt.study.design.advise import Advice
    from odomcorrupt.study.select.stepwise import Learned
    from odomcorrupt.study.validate.compare import Comparison

__all__ = ["check_drive", "write_drive", "write_report"]


def check_drive(path: Path | None, *, overwrite: bool) -> None:
    """Refuse a name that cannot be written, before any work is done."""
    if path is not None and path.suffix != ".mcap":
        raise click.UsageError(f"--drive {path}: commands are written as MCAP; end the name in .mcap")
    refuse_existing(path, overwrite=overwrite)


def write_drive(path: Path, advice: Advice) -> None:
    """Write the advised manoeuvre as /cmd_vel, and say what it is; where nothing is open, say that."""
    import numpy as np

    from odomcorrupt.bags.write_twist import write_twists
    from odomcorrupt.report.text.design import drive_sentence
    from odomcorrupt.study.design.plan import STEP_S

    plan = advice.best
    if plan is None:
        click.echo(f"{path} is not written: nothing is open that a drive would settle", err=True)
        return
    twist = np.stack((plan.v_mps, np.zeros_like(plan.v_mps), plan.omega_radps), axis=1)
    bag = io.BytesIO()
    write_twists(bag, np.arange(len(twist), dtype=np.float64) * STEP_S, twist)
    write_bytes(path, bag.getvalue())
    click.echo(f"wrote {path}: {drive_sentence(plan)}", err=True)


def write_report(path: Path, learned: Learned, ladder: Comparison, advice: Advice, following: str) -> None:
    """Write the page; `following` is the command to type next, or ""."""
    from odomcorrupt import __version__
    from odomcorrupt.report.html.diagnosis import Story, found_html

    write_text(path, found_html(Story(learned, ladder, advice, following), version=__version__))
    click.echo(f"wrote {path}", err=True)
