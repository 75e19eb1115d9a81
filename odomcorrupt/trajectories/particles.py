"""The cloud of places where a robot may be, spreading while it drives: the lecture's corridor."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from odomcorrupt.corruption.path import NoisyPath
from odomcorrupt.errors import RecordingError
from odomcorrupt.sampling.samples import ellipse, sample_moments

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.model.motion_model import MotionModel
    from odomcorrupt.trajectories.reader import Drive

__all__ = ["Cloud", "cloud_along", "cloud_of", "csv_text", "json_text", "places_along", "report_text"]


@dataclass(frozen=True, slots=True)
class Cloud:
    """Poses of many runs of one drive, at a few places along it.

    distance_m : (k,) travelled at each place, by the odometry
    clean_xyt : (k, 3) the odometry there
    xyt : (runs, k, 3) the noisy runs there, metres and radians
    path_xyt : (n, 3) the odometry's whole path
    """

    distance_m: Array
    clean_xyt: Array
    xyt: Array
    path_xyt: Array
    seed: int


def places_along(drive: Drive, every_m: float) -> NDArray[np.intp]:
    """Return which poses of a drive to look at: one per so many metres, and the last one."""
    travelled = drive.distance_m
    total = float(travelled[-1])
    if not total > 0.0:
        raise RecordingError(f"{drive.topic}: the robot does not move; a cloud takes a drive")
    marks = np.arange(every_m, total, every_m)
    # the last mark gives way to the end where the two would lie on each other
    marks = marks[total - marks > 0.3 * every_m]
    return np.append(np.searchsorted(travelled, marks), len(drive) - 1)


def cloud_along(drive: Drive, model: MotionModel, *, seed: int, runs: int, every_m: float) -> Cloud:
    """Draw runs of a drive and look at them once per so many metres, and at the end.

    Run k is the path that corruption writes for `--seed` and `--run k`.
    """
    places = places_along(drive, every_m)
    xyt = np.empty((runs, len(places), 3))
    for run in range(runs):
        knots = NoisyPath(model, seed, run).feed(drive.stamps_ns, drive.xyt)
        xyt[run] = drive.xyt[places] + knots.error_xyt[places]
    return cloud_of(drive, places, xyt, seed)


def cloud_of(drive: Drive, places: NDArray[np.intp], xyt: Array, seed: int) -> Cloud:
    """Return the cloud of runs (runs, k, 3) at places (k,) of a drive."""
    return Cloud(drive.distance_m[places], drive.xyt[places], xyt, drive.xyt, seed)


def report_text(cloud: Cloud) -> str:
    """Return one line per place."""
    lines = [f"{len(cloud.xyt)} runs, seed {cloud.seed}"]
    for i, distance in enumerate(cloud.distance_m):
        moments = sample_moments(cloud.xyt[:, i])
        about = ellipse(moments, 1.0)
        lines.append(
            f"after {distance:6.2f} m: 1 sigma {about.major_m:.3g} m by {about.minor_m:.3g} m, "
            f"heading {np.degrees(np.sqrt(moments.covariance[2, 2])):.3g} deg"
        )
    return "\n".join(lines)


def csv_text(cloud: Cloud) -> str:
    """Return every pose of every run as a line."""
    lines = ["run,distance_m,x_m,y_m,theta_rad"]
    for run, poses in enumerate(cloud.xyt):
        for distance, pose in zip(cloud.distance_m, poses, strict=True):
            lines.append(",".join([str(run), repr(float(distance)), *(repr(float(value)) for value in pose)]))
    return "\n".join(lines) + "\n"


def json_text(cloud: Cloud) -> str:
    """Return mean and covariance at every place as JSON."""
    places: list[dict[str, Any]] = []
    for i, distance in enumerate(cloud.distance_m):
        moments = sample_moments(cloud.xyt[:, i])
        places.append(
            {
                "distance_m": float(distance),
                "odometry_xyt": cloud.clean_xyt[i].tolist(),
                "mean_xyt": moments.mean_xyt.tolist(),
                "covariance": moments.covariance.tolist(),
            }
        )
    return json.dumps({"seed": cloud.seed, "runs": len(cloud.xyt), "places": places}, indent=1) + "\n"
