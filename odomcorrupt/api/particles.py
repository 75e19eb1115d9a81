"""Poses of a robot along a whole drive, as its odometry drifts."""

from __future__ import annotations

import math
from dataclasses import dataclass
from os import PathLike, fspath
from pathlib import Path
from typing import TYPE_CHECKING, Any

from odomcorrupt.api.bag_options import as_condition
from odomcorrupt.api.model import Model, ModelLike, as_model
from odomcorrupt.api.result import Result
from odomcorrupt.corruption.summary import model_brief
from odomcorrupt.errors import OdomCorruptError
from odomcorrupt.mapping.conditioned import free_paths
from odomcorrupt.report.json.numbers import finite
from odomcorrupt.rng import draw_seed
from odomcorrupt.sampling.samples import (
    brief,
    csv_text,
    particles_at,
    particles_json,
    places_along,
    report_text,
    sample_particles,
)
from odomcorrupt.trajectories import read_drive

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from odomcorrupt.mapping.conditioned import MapCondition
    from odomcorrupt.mapping.occupancy_grid import FreeSpace
    from odomcorrupt.sampling.samples import ParticleSet
    from odomcorrupt.summary import Summary


@dataclass(frozen=True, slots=True, repr=False)
class Particles(Result):
    """Poses of many noisy runs of a drive at given distances along it.

    result : complete numerical result: distances, clean poses (k, 3) and noisy ones (runs, k, 3), metres and radians
    model, odometry : model of the noise, and the odometry in words
    space, notes : free space that constrains the poses, None without a map, and the map's effect in sentences
    following : words of the suggested next command
    """

    result: ParticleSet
    model: Model
    odometry: str
    space: FreeSpace | None = None
    notes: tuple[str, ...] = ()
    following: tuple[object, ...] = ()

    def summary(self) -> Summary:
        """Return the spread at the end and on the way, and the model."""
        words = model_brief(self.model.motion_model, self.model.origin.partition(":")[0])
        return brief(self.result, words, self.odometry, self.following)

    def details(self) -> str:
        """Return the noise, and the spread at each distance."""
        origin = f" ({self.model.origin})" if self.model.origin else ""
        return f"noise: {self.model.motion_model.noise.words}{origin}\n{report_text(self.result)}"

    def to_dict(self) -> dict[str, Any]:
        """Return seed, number of runs, and mean and covariance at every place."""
        return finite({"schema": 2, **particles_json(self.result)})

    def rows(self) -> list[dict[str, Any]]:
        """Return one row per run and place: distance and pose."""
        names, cloud = ("x_m", "y_m", "theta_rad"), self.result
        return [
            {"run": run, "distance_m": float(distance), **dict(zip(names, map(float, pose), strict=True))}
            for run, poses in enumerate(cloud.xyt)
            for distance, pose in zip(cloud.distance_m, poses, strict=True)
        ]

    def csv(self) -> str:
        """Return the poses as lines of run, distance, x, y, theta that parse to the same bits."""
        return csv_text(self.result)

    def _figure(self) -> Figure:
        """Return a figure of the odometry's path, with the poses at each distance and their ellipse."""
        from odomcorrupt.report.plots.samples import draw_cloud

        within = "" if self.space is None else " within the map"
        law = self.model.motion_model.noise.law_name
        title = f"Where the robot may be{within}: law {law}, seed {self.result.seed}"
        return draw_cloud(self.result, title, self.space)


def sample_along(
    bag: str | PathLike[str],
    model: ModelLike = "typical",
    *,
    runs: int = 300,
    seed: int | None = None,
    every_m: float | None = None,
    odom_topic: str | None = None,
    within: MapCondition | str | PathLike[str] | None = None,
) -> Particles:
    """Return poses of many noisy runs of a bag's drive, at distances along it and at its end.

    Parameters
    ----------
    bag : path
        Bag of any kind; not a pipe.
    model : Model, Noise, path of a model file or name of a preset
        By default the preset `typical`.
    runs : int
        Number of runs; run k is the one that `corrupt` draws with this seed and `run=k`.
    seed : int, optional
        Seed of the random draws; by default a random one, stated in the result.
    every_m : float, optional
        Distance between the places, metres; by default a round one, about a sixth of the drive.
    odom_topic : str, optional
        Odometry topic; by default the only one.
    within : MapCondition or path of a map's .yaml, optional
        As in `corrupt`.

    Returns
    -------
    Particles
        `result.xyt` has shape (runs, k, 3).

    Raises
    ------
    BagError, TopicError, RecordingError, ModelError, MapError
        If the bag cannot be read, has no odometry that moves, or model or map are invalid.

    Examples
    --------
    >>> import odomcorrupt as oc
    >>> oc.sample_along("fixtures/office.mcap", runs=20, seed=1).result.xyt.shape
    (20, 5, 3)
    """
    if fspath(bag) == "-":
        raise OdomCorruptError("-: the whole drive is read first, which is impossible on a pipe; name a file")
    if runs < 1:
        raise OdomCorruptError(f"runs: {runs}; draw one or more")
    chosen = as_model(model)
    drive = read_drive(Path(fspath(bag)), odom_topic)
    places = places_along(drive, every_m or _rounded_up(float(drive.distance_m[-1]) / 6.0))
    seed, condition = draw_seed() if seed is None else seed, as_condition(within)
    odometry, robot = f"{drive.topic} of {fspath(bag)}", chosen.motion_model
    if condition is None:
        return Particles(sample_particles(drive, robot, places, seed=seed, runs=runs), chosen, odometry)
    free = free_paths(drive.stamps_ns, drive.xyt, robot, condition, seed=seed, runs=range(runs), places=places)
    cloud = particles_at(drive, places, free.xyt, seed)
    return Particles(cloud, chosen, odometry, condition.space, (free.account(),))


def _rounded_up(value: float) -> float:
    """Return the smallest of 1, 2 or 5 times a power of ten that is not below a value."""
    power = 10.0 ** math.floor(math.log10(max(value, 1e-6)))
    return next(step * power for step in (1.0, 2.0, 5.0, 10.0) if step * power >= 0.999 * value)
