"""What the commands of the study share: telling recordings from models, and reading them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from odomcorrupt.errors import OdomCorruptError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from odomcorrupt.model import MotionModel
    from odomcorrupt.study.trajectory import Recording

__all__ = ["describe", "need_study", "read_all", "recording_options", "split_arguments"]


def recording_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options that say where odometry and truth are."""
    for option in (
        click.option(
            "--track", type=float, help="Nominal distance between the wheels, metres (for two-wheel effects)."
        ),
        click.option("--truth", help="Topic of the truth. [default: the only one it can be]"),
        click.option("--odom", help="Topic of the odometry. [default: the only Odometry]"),
    ):
        command = option(command)
    return command


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
    from odomcorrupt.modelfile import read_model

    models = {a: read_model(Path(a)) for a in arguments if a.endswith(".toml")}
    recordings = [Path(a) for a in arguments if not a.endswith(".toml")]
    if not recordings:
        raise click.UsageError("no recording given; name a bag with odometry and truth")
    return recordings, models


def read_all(paths: Sequence[Path], odom: str | None, truth: str | None, track: float | None) -> list[Recording]:
    """Return the recordings, and say on stderr what reading them left out."""
    from odomcorrupt.study.sources import read_recording

    recordings = [read_recording(path, odom, truth, track_m=track) for path in paths]
    for recording in recordings:
        click.echo(describe(recording), err=True)
        for note in recording.notes:
            click.echo(f"  {note}", err=True)
    return recordings


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
