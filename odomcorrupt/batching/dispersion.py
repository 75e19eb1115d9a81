"""Dispersion of the runs of a batch, compared with the prediction of the linearised model."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from odomcorrupt.batching.job import Spread
from odomcorrupt.batching.manifest import read_beginning, read_records
from odomcorrupt.batching.sinks import read_tum
from odomcorrupt.corruption.covariance import pose_covariance
from odomcorrupt.corruption.inverse import SystematicEffects
from odomcorrupt.corruption.path import NoisyPath
from odomcorrupt.errors import BatchError, EffectError
from odomcorrupt.model.model_file import parse_model, read_model

if TYPE_CHECKING:
    from pathlib import Path

    from odomcorrupt.batching.sinks import TumPath
    from odomcorrupt.corruption.path import PathSamples
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.model.motion_model import MotionModel

SHOWN_RUNS, BAND_POINTS = 60, 120
"""Paths, and points of the predicted band, that a picture shows."""


@dataclass(frozen=True, slots=True)
class SpreadRow:
    """Dispersion after a distance: standard deviations (m, rad) of the runs and predicted, and the mean error."""

    after_m: float
    position_m: float
    position_predicted_m: float
    heading_rad: float
    heading_predicted_rad: float
    mean_m: float
    mean_rad: float


@dataclass(frozen=True, slots=True)
class SpreadReport:
    """Dispersion of a batch.

    random_effects : names of random effects, which the prediction does not include
    clean_xy (n, 2), runs_xy : paths for plots, metres
    band : (m, 3) distance in m, predicted standard deviations of position in m and heading in rad
    errors : (k, j, 3) distance in m, position error in m and heading error in rad of each run at each mark
    concentration : sum of the squared eigenvalues of the predicted position covariance at the end over their squared
        sum: 1 for errors along one axis, 0.5 for equal ones along two
    """

    directory: str
    runs: int
    rows: tuple[SpreadRow, ...]
    random_effects: tuple[str, ...]
    clean_xy: Array
    runs_xy: tuple[Array, ...]
    band: Array
    errors: Array
    concentration: float


def measure(directory: Path) -> SpreadReport:
    """Return the dispersion of the runs of a batch directory, measured and predicted from its clean path.

    Raises
    ------
    BatchError
        If the directory has no batch of at least two runs.
    """
    begun = read_beginning(directory)
    records = list(read_records(directory).values())
    if len(records) < 2:
        raise BatchError(f"{directory}: has {len(records)} runs; a spread needs at least two")
    clean = read_tum(directory / "clean.tum")
    model = parse_model(begun["model"]["text"])
    spreads = tuple(Spread(effect, name, deviation) for effect, name, deviation in begun["robots"])
    errors = np.array([record["errors"] for record in records])
    centre = _quiet(model, clean)
    covariance = _covariance(model, spreads, clean, centre)
    rows = []
    for mark in range(errors.shape[1]):
        at_m = float(errors[0, mark, 0])
        i = min(int(np.searchsorted(centre.travelled_m, at_m - 1e-6)), len(centre) - 1)
        drawn = errors[:, mark, 1:]
        mean = drawn.mean(axis=0)
        spread = drawn.std(axis=0, ddof=1)
        v = np.diagonal(covariance[i])
        rows.append(
            SpreadRow(
                at_m, float(np.hypot(spread[0], spread[1])), float(np.sqrt(v[0] + v[1])), float(spread[2]),
                float(np.sqrt(v[2])), float(np.hypot(mean[0], mean[1])), float(mean[2]),
            )
        )  # fmt: skip
    shown = np.unique(np.linspace(0, len(centre) - 1, BAND_POINTS).astype(int))
    v = np.diagonal(covariance, axis1=1, axis2=2)[shown]
    band = np.column_stack((centre.travelled_m[shown], np.sqrt(v[:, 0] + v[:, 1]), np.sqrt(v[:, 2])))
    distances = np.stack((errors[:, :, 0], np.hypot(errors[:, :, 1], errors[:, :, 2]), np.abs(errors[:, :, 3])), axis=2)
    shared = SystematicEffects(model)
    paths = tuple(_path(model, shared, begun["seed"], record, directory, clean) for record in records[:SHOWN_RUNS])
    planar = covariance[i][:2, :2]
    random = tuple(sorted({effect.name for effect in model.effects if effect.kind == "noise"}))
    return SpreadReport(
        str(directory), len(records), tuple(rows), random, clean.xyt[:, :2], paths, band, distances,
        float(np.trace(planar @ planar) / np.trace(planar) ** 2) if np.trace(planar) > 0.0 else 1.0,
    )  # fmt: skip


def _quiet(model: MotionModel, clean: TumPath) -> PathSamples:
    """Return the path with the effects but zero noise, and the sums of the noise's variances along it."""
    # the same path with zero in place of every random number
    return NoisyPath(model, 0, 0, normals=lambda n: np.zeros((n, 4))).feed(clean.stamps_ns, clean.xyt)


def _covariance(model: MotionModel, spreads: tuple[Spread, ...], clean: TumPath, centre: PathSamples) -> Array:
    """Return error covariances (n, 3, 3): of the noise, and of the parameters drawn for each run."""
    k = model.noise.coefficients
    broad = {s.parameter: float(np.hypot(getattr(k, s.parameter), s.deviation)) for s in spreads if s.effect is None}
    noise = _quiet(replace(model, noise=replace(model.noise, coefficients=replace(k, **broad))), clean)
    noisy = (noise.clean_xyt[:, :2] + noise.error_xyt[:, :2] - noise.origin_xy).T
    covariance = pose_covariance(noise.sums, noisy)
    for spread in spreads:
        if spread.effect is not None:
            slope = _displaced(model, spread, clean, centre)
            covariance += slope[:, :, None] * slope[:, None, :]
    return covariance


def _displaced(model: MotionModel, spread: Spread, clean: TumPath, centre: PathSamples) -> Array:
    """Return the displacement (n, 3) of the path by one standard deviation of a parameter."""
    for part in (1.0, -1.0, 0.1, -0.1):
        effects: list[Any] = list(model.effects)
        i, name = spread.effect or 0, spread.parameter
        effects[i] = replace(effects[i], **{name: getattr(effects[i], name) + part * spread.deviation})
        try:
            moved = _quiet(replace(model, effects=tuple(effects)), clean)
        except EffectError:
            continue
        return (moved.error_xyt - centre.error_xyt) / part
    return np.zeros_like(centre.error_xyt)


def _path(
    model: MotionModel, shared: SystematicEffects, seed: int, record: dict[str, Any], directory: Path, clean: TumPath
) -> Array:
    """Return a run's path (n, 2), drawn again from its seed and its own parameters."""
    if "robot" in record:
        model = read_model(directory / record["robot"])
        shared = SystematicEffects(model)
    path = NoisyPath(model, seed, record["run"], covariance=False, systematic=shared)
    samples = path.feed(clean.stamps_ns, clean.xyt)
    return samples.clean_xyt[:, :2] + samples.error_xyt[:, :2]
