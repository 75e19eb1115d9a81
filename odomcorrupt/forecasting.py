"""Forecast of the drift that a model causes in the odometry of a bag."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.bags.open import open_reader
from odomcorrupt.correction.run import MeasuredPath
from odomcorrupt.corruption.path import MARKS_M, NoisyPath

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable
    from pathlib import Path

    from numpy.typing import NDArray

    from odomcorrupt.bags.block import BagReader, Block
    from odomcorrupt.corruption.path import PathSource
    from odomcorrupt.corruption.transform import Options
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.model.motion_model import MotionModel


DRAWN_POINTS, DRAWN_RUNS = 600, 100
"""Largest numbers of points per path, and of runs, kept for a figure."""


@dataclass(frozen=True, slots=True)
class CleanDrive:
    """Longest stretch of a bag's odometry: its name, stamps_ns (n,), xyt (n, 3) in metres and radians."""

    name: str
    stamps_ns: NDArray[np.int64]
    xyt: Array


@dataclass(frozen=True, slots=True)
class Row:
    """Drift over many runs after a distance, metres and radians.

    rms : root mean square; 90 : 90 % quantile; mean : size of the mean error, the systematic part
    """

    after_m: float
    position_rms_m: float
    position_90_m: float
    position_mean_m: float
    heading_rms_rad: float
    heading_mean_rad: float


@dataclass(frozen=True, slots=True)
class Forecast:
    """Forecast of a model's drift on a drive.

    distance_m, sideways_m : length of the clean drive, and its lateral part
    half_rate_position, half_rate_heading : factor on the final noise at half the message rate; 1 for a law that does
        not depend on the rate
    clean_xy : (m, 2), noisy_xy : (k, m, 2) first paths, for plots, metres
    """

    name: str
    distance_m: float
    duration_s: float
    rate_hz: float | None
    sideways_m: float
    first_run: int
    runs: int
    rows: tuple[Row, ...]
    half_rate_position: float
    half_rate_heading: float
    clean_xy: Array
    noisy_xy: Array


def read_clean_drive(
    reader: BagReader, model: MotionModel, options: Options, watch: Callable[[Block], None] = lambda _: None
) -> CleanDrive:
    """Return the longest stretch of a bag's odometry; `watch` is called with every block.

    Raises
    ------
    TopicError
        If there is no odometry source.
    """
    measured = MeasuredPath.of(reader, model, options, watch)
    longest = max((parts for parts in measured.parts if parts), key=lambda parts: float(parts[-1].travelled_m[-1]))
    return CleanDrive(
        measured.name,
        np.concatenate([samples.stamps_ns for samples in longest]),
        np.concatenate([samples.clean_xyt for samples in longest]),
    )


def clean_drive_of(source: Path, model: MotionModel, options: Options, *, recover: bool) -> CleanDrive:
    """Return the clean path of the odometry of a bag, see `read_clean_drive`; `recover` reads a damaged one."""
    with open_reader(source, recover=recover) as reader:
        return read_clean_drive(reader, model, options)


def forecast(drive: CleanDrive, model: MotionModel, paths: Iterable[PathSource], *, first_run: int = 0) -> Forecast:
    """Return the drift statistics of runs of a model over a drive.

    paths : one unused path source per run, with the draws of the corruption
    first_run : number of the first run
    """
    first = NoisyPath(model, 0).feed(drive.stamps_ns, drive.xyt)
    distance_m = float(first.travelled_m[-1])
    marks = [mark for mark in MARKS_M if mark < distance_m]
    places = np.append(np.searchsorted(first.travelled_m, marks), len(first) - 1)
    shown = np.unique(np.linspace(0, len(first) - 1, DRAWN_POINTS).astype(int))
    ends: list[Array] = []
    noisy: list[Array] = []
    for path in paths:
        error_xyt = path.feed(drive.stamps_ns, drive.xyt).error_xyt
        ends.append(error_xyt[places])
        if len(noisy) < DRAWN_RUNS:
            noisy.append(drive.xyt[shown, :2] + error_xyt[shown, :2])
    errors = np.array(ends)
    duration_s = float(drive.stamps_ns[-1] - drive.stamps_ns[0]) * 1e-9
    half = NoisyPath(model, 0).feed(drive.stamps_ns[::2], drive.xyt[::2])
    return Forecast(
        drive.name, distance_m, duration_s, (len(first) - 1) / duration_s if duration_s > 0.0 else None,
        first.sideways_m, first_run, len(errors),
        tuple(_row(after, errors[:, i]) for i, after in enumerate([*marks, distance_m])),
        _growth(half.sums[6, -1] + half.sums[8, -1], first.sums[6, -1] + first.sums[8, -1]),
        _growth(half.sums[0, -1], first.sums[0, -1]),
        drive.xyt[shown, :2], np.array(noisy),
    )  # fmt: skip


def _growth(variance: float, reference: float) -> float:
    return float(np.sqrt(variance / reference)) if reference > 0.0 else 1.0


def _row(after_m: float, errors: Array) -> Row:
    distance, mean = np.hypot(errors[:, 0], errors[:, 1]), errors.mean(axis=0)
    position, heading = (float(np.sqrt(np.mean(x**2))) for x in (distance, errors[:, 2]))
    far, drift = float(np.quantile(distance, 0.9)), float(np.hypot(mean[0], mean[1]))
    return Row(after_m, position, far, drift, heading, float(mean[2]))
