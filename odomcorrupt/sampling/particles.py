"""Particle sets along a drive: poses of many noisy runs at given distances, with mean and covariance."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from odomcorrupt.corruption.inverse import SystematicEffects
from odomcorrupt.corruption.path import NoisyPath
from odomcorrupt.errors import RecordingError
from odomcorrupt.sampling.samples import ellipse, sample_moments
from odomcorrupt.summary import Line, Summary, command_line

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.model.motion_model import MotionModel
    from odomcorrupt.trajectories import Drive


@dataclass(frozen=True, slots=True)
class ParticleSet:
    """Poses of many runs of one drive at k places along it.

    distance_m : (k,) distance travelled by the odometry, metres
    clean_xyt : (k, 3) odometry poses there, metres and radians
    xyt : (runs, k, 3) noisy poses there, metres and radians
    path_xyt : (n, 3) the whole path of the odometry
    """

    distance_m: Array
    clean_xyt: Array
    xyt: Array
    path_xyt: Array
    seed: int


def places_along(drive: Drive, every_m: float) -> NDArray[np.intp]:
    """Return the indices (k,) of one pose of a drive every `every_m` metres, and of the last one."""
    travelled = drive.distance_m
    total = float(travelled[-1])
    if not total > 0.0:
        raise RecordingError(f"{drive.topic}: the robot does not move; particles need a drive with motion")
    marks = np.arange(every_m, total, every_m)
    # drop the last mark if it coincides with the end
    marks = marks[total - marks > 0.3 * every_m]
    return np.append(np.searchsorted(travelled, marks), len(drive) - 1)


def sample_particles(
    drive: Drive, model: MotionModel, places: NDArray[np.intp], *, seed: int, runs: int
) -> ParticleSet:
    """Return the poses of noisy runs of a drive at the pose indices (k,).

    Run k is the path that corruption with `--seed` and `--run k` writes.
    """
    xyt, systematic = np.empty((runs, len(places), 3)), SystematicEffects(model)
    for run in range(runs):
        samples = NoisyPath(model, seed, run, covariance=False, systematic=systematic).feed(drive.stamps_ns, drive.xyt)
        xyt[run] = drive.xyt[places] + samples.error_xyt[places]
    return particles_at(drive, places, xyt, seed)


def particles_at(drive: Drive, places: NDArray[np.intp], xyt: Array, seed: int) -> ParticleSet:
    """Return the particle set of noisy poses (runs, k, 3) at the pose indices (k,) of a drive."""
    return ParticleSet(drive.distance_m[places], drive.xyt[places], xyt, drive.xyt, seed)


def report_text(particles: ParticleSet) -> str:
    """Return the particle set as text: one line per place."""
    lines = [f"{len(particles.xyt)} runs, seed {particles.seed}"]
    lines += [f"after {d:6.2f} m: 1 sigma {_spread(particles, i)}" for i, d in enumerate(particles.distance_m)]
    return "\n".join(lines)


def brief(particles: ParticleSet, model: str, drive: str, following: Sequence[object]) -> Summary:
    """Return a summary of the runs' spread at the end and on the way.

    particles : the particle set
    model, drive : descriptions of noise model and odometry
    following : the command to type next
    """
    runs, places = len(particles.xyt), len(particles.distance_m)
    between = sorted({(places - 1) // 3, 2 * (places - 1) // 3} - {places - 1})
    said = [f"{_spread(particles, i)} (1 sigma) after {particles.distance_m[i]:.4g} m" for i in (places - 1, *between)]
    lines = [Line("SPREAD", said[0], "good"), *(Line("", one) for one in said[1:])]
    lines += [Line("model", model), Line("runs", f"{runs} of seed {particles.seed}, over {drive}")]
    return Summary((*lines, command_line(following)))


def _spread(particles: ParticleSet, place: int) -> str:
    """Return the standard deviations at one place along the drive, in words."""
    moments = sample_moments(particles.xyt[:, place])
    about = ellipse(moments, 1.0)
    heading_deg = np.degrees(np.sqrt(moments.covariance[2, 2]))
    return f"{about.major_m:.3g} m by {about.minor_m:.3g} m, heading {heading_deg:.3g} deg"


def csv_text(particles: ParticleSet) -> str:
    """Return the particle set as CSV: one line per pose and run."""
    lines = ["run,distance_m,x_m,y_m,theta_rad"]
    for run, poses in enumerate(particles.xyt):
        for distance, pose in zip(particles.distance_m, poses, strict=True):
            lines.append(",".join([str(run), repr(float(distance)), *(repr(float(value)) for value in pose)]))
    return "\n".join(lines) + "\n"


def particles_json(particles: ParticleSet) -> dict[str, Any]:
    """Return mean and covariance at every place as plain values."""
    places: list[dict[str, Any]] = []
    for i, distance in enumerate(particles.distance_m):
        moments = sample_moments(particles.xyt[:, i])
        places.append(
            {
                "distance_m": float(distance),
                "odometry_xyt": particles.clean_xyt[i].tolist(),
                "mean_xyt": moments.mean_xyt.tolist(),
                "covariance": moments.covariance.tolist(),
            }
        )
    return {"seed": particles.seed, "runs": len(particles.xyt), "places": places}
