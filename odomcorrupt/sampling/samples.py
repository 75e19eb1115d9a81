"""Samples of one motion, and particles along a drive."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.corruption.inverse import SystematicEffects
from odomcorrupt.corruption.path import NoisyPath, StepGrowth, noise_variances
from odomcorrupt.errors import MapError, ModelError, RecordingError
from odomcorrupt.geometry.se2 import BEARING_MIN_M, Increments, RotTransRot, increments, rot_trans_rot, rotate
from odomcorrupt.model.motion_model import Noise
from odomcorrupt.model.noise_laws import Coefficients, Variances

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.mapping.occupancy_grid import Constraint
    from odomcorrupt.model.motion_model import MotionModel
    from odomcorrupt.trajectories import Drive


@dataclass(frozen=True, slots=True)
class Move:
    """A motion in the plane.

    start_xyt, end_xyt : (3,) odometry before and after, metres and radians
    shift_xy : (2,) from start to end, metres
    along_xy : (2,) unit vector along which noise on the travel acts: the bearing of the motion, or below
        `BEARING_MIN_M`, where it is meaningless, the heading after half the turn
    swing : fraction of rot1's error that rotates the travel: one, or one half if the law distributes it over an arc.
        Then the travel is the arc's chord, shorter than the driven arc by sin(turn / 2) / (turn / 2)
    steps : the motion as one increment
    """

    start_xyt: Array
    end_xyt: Array
    shift_xy: Array
    along_xy: Array
    swing: float
    steps: Increments

    @property
    def turn_rad(self) -> float:
        """The turn, in [-pi, pi)."""
        return float(self.steps.dtheta_rad[0])

    @property
    def arc(self) -> bool:
        """Whether the motion is an arc, as with the velocity law, instead of turn, drive, turn."""
        return self.swing < 1.0

    def chord_per_arc(self, turn_rad: Array) -> Array:
        """Return the ratio of chord to arc length (n,) for given turns (n,); ones if the motion is not an arc."""
        return np.sinc(turn_rad / (2.0 * np.pi)) if self.arc else np.ones_like(turn_rad)

    @property
    def arc_m(self) -> float:
        """Driven length, positive along `along_xy`, metres."""
        return float(self.shift_xy @ self.along_xy) / float(self.chord_per_arc(np.array([self.turn_rad]))[0])

    @property
    def parts(self) -> RotTransRot:
        """The motion as turn, drive, turn."""
        return rot_trans_rot(self.steps)


def move_between(start_xyt: Array, end_xyt: Array, *, arc: bool = False) -> Move:
    """Return the motion between two poses (3,).

    arc : whether the law distributes rot1 over the translation, `Law.arc`
    """
    steps = increments(np.stack((start_xyt, end_xyt)))
    shift = end_xyt[:2] - start_xyt[:2]
    length = float(np.hypot(*shift))
    middle = start_xyt[2] + steps.dtheta_rad[0] / 2.0
    along = shift / length if length >= BEARING_MIN_M else np.array([np.cos(middle), np.sin(middle)])
    return Move(start_xyt, end_xyt, shift, along, 0.5 if arc else 1.0, steps)


def move_variances(noise: Noise, move: Move) -> Variances:
    """Return the variances of the noise on a motion, (1,) each, as used in corruption.

    A motion has no duration: the angle random walk of a gyro, which grows with time, is not included.
    """
    k = noise.coefficients
    if k.white_v or k.white_omega:
        raise ModelError("white noise on twists grows with time, and one motion has none; draw along a bag instead")
    return noise_variances(noise, move.steps, np.zeros(1), StepGrowth()).variances


@dataclass(frozen=True, slots=True)
class Moments:
    """Mean (3,) and covariance (3, 3) of x, y (metres) and heading (radians)."""

    mean_xyt: Array
    covariance: Array


@dataclass(frozen=True, slots=True)
class Ellipse:
    """An ellipse about a mean position: half axes in metres, the longer one first, and the angle of that axis."""

    centre_xy: Array
    major_m: float
    minor_m: float
    angle_rad: float


def move_sampled(move: Move, variances: Variances, count: int, rng: np.random.Generator) -> Array:
    """Return end poses (count, 3) drawn for a motion; headings are not wrapped.

    variances : (1,) each, for this motion, see `move_variances`
    """
    return with_noise(move, rng.standard_normal((count, 4)) * deviations(variances))


def deviations(variances: Variances) -> Array:
    """Return standard deviations (4,) of rot1, trans, across and rot2."""
    v = variances
    return np.sqrt(np.concatenate((v.rot1, v.trans, v.across, v.rot2)))


def with_noise(move: Move, noise: Array) -> Array:
    """Return the end poses (n, 3) of a motion with errors (n, 4) of rot1, trans, across and rot2 added.

    On an arc, rot1 is the error of its turn and trans the error of its length: the arc is integrated exactly
    (Probabilistic Robotics, table 5.3), and rot2 turns at its end.
    """
    rot1, trans, across, rot2 = noise.T
    along = move.along_xy
    left = np.array([-along[1], along[0]])
    travelled = move.shift_xy + trans[:, None] * along + across[:, None] * left
    if move.arc:
        chord = (move.arc_m + trans) * move.chord_per_arc(move.turn_rad + rot1)
        travelled = chord[:, None] * along + across[:, None] * left
    xy = move.start_xyt[:2] + rotate(travelled, move.swing * rot1)
    return np.column_stack((xy, move.start_xyt[2] + move.turn_rad + rot1 + rot2))


def sample_moments(xyt: Array) -> Moments:
    """Return mean and (unbiased) covariance of samples (n, 3) whose headings are not wrapped."""
    return Moments(xyt.mean(axis=0), np.cov(xyt, rowvar=False))


def linearised_moments(move: Move, variances: Variances) -> Moments:
    """Return the prediction of a Kalman filter: the odometry's end, and the covariance to first order in the noise."""
    along, shift = move.along_xy, move.shift_xy
    shorter = float(move.chord_per_arc(np.array([move.turn_rad]))[0])
    # the chord shortens as the arc turns more
    half = move.turn_rad / 2.0
    shrinks = move.arc_m * (np.cos(half) - shorter) / move.turn_rad if move.arc and abs(half) > 1e-6 else 0.0
    jacobian = np.array(
        [
            [-move.swing * shift[1] + shrinks * along[0], shorter * along[0], -along[1], 0.0],
            [move.swing * shift[0] + shrinks * along[1], shorter * along[1], along[0], 0.0],
            [1.0, 0.0, 0.0, 1.0],
        ]
    )
    scaled = jacobian * deviations(variances)
    mean = np.array([*move.end_xyt[:2], move.start_xyt[2] + move.turn_rad])
    return Moments(mean, scaled @ scaled.T)


def ellipse(moments: Moments, sigmas: float) -> Ellipse:
    """Return the ellipse of x and y at a number of standard deviations."""
    values, vectors = np.linalg.eigh(moments.covariance[:2, :2])
    minor, major = np.sqrt(np.maximum(values, 0.0)) * sigmas
    angle = np.arctan2(vectors[1, 1], vectors[0, 1])
    return Ellipse(moments.mean_xyt[:2], float(major), float(minor), float(angle))


DEFAULT_EXAMPLE = "article"
Pose = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Example:
    """A motion with its noise: poses in metres and radians, number of samples, and the source of the values."""

    name: str
    noise: Noise
    start_xyt: Pose
    end_xyt: Pose
    count: int
    source: str


_TURN = (0.0, 0.0, 0.0), (1.0, 0.35, math.radians(40.0))
_OURS = "the lecture's three pictures; motion and values are ours"
EXAMPLES: Mapping[str, Example] = {
    example.name: example
    for example in (
        Example(
            DEFAULT_EXAMPLE,
            Noise("linear", Coefficients(0.05, math.radians(15.0), 0.05, 0.01)),
            (0.0, 0.0, math.radians(30.0)),
            (0.2, 0.35, math.radians(10.0)),
            1000,
            "Adding noise to odometry data published by the Gazebo simulator (2018), its worked example",
        ),
        Example("balanced", Noise("quadratic", Coefficients(0.02, 0.015, 0.006, 0.006)), *_TURN, 500, _OURS),
        Example("translation-heavy", Noise("quadratic", Coefficients(0.002, 0.001, 0.04, 0.01)), *_TURN, 500, _OURS),
        Example("rotation-heavy", Noise("quadratic", Coefficients(0.2, 0.15, 0.0005, 0.0005)), *_TURN, 500, _OURS),
    )
}


def example_named(name: str) -> Example:
    """Return the example with a given name; a ModelError lists the available names."""
    try:
        return EXAMPLES[name]
    except KeyError:
        raise ModelError(f"no example is called {name!r}; there are {', '.join(EXAMPLES)}") from None


@dataclass(frozen=True, slots=True)
class FreeSamples:
    """Samples in the free space of a map.

    xyt : (n, 3) metres, radians
    candidates : number of candidates drawn for them
    lost : number of samples given up because none of their tries was free
    free_at_first : number of first tries that were free
    """

    xyt: Array
    candidates: int
    lost: int
    free_at_first: int
    tries: int

    def account(self) -> str:
        """Return the numbers of tries and failures, in one sentence."""
        asked = len(self.xyt) + self.lost
        said = (
            f"map: {self.free_at_first} of {asked} first draws were free, {self.candidates} draws made "
            f"{len(self.xyt)} free samples"
        )
        return said + (f"; {self.lost} were given up after {self.tries} tries each" if self.lost else "")


def move_sampled_in_map(
    move: Move, variances: Variances, count: int, rng: np.random.Generator, within: Constraint
) -> FreeSamples:
    """Draw end poses of a motion in the free space of a map; see `samples.move_sampled`.

    Raises
    ------
    MapError
        If the motion begins in a wall, or no candidate is free.
    """
    if within.tries < 1:
        raise ModelError(f"tries: {within.tries}; there must be one or more")
    start = move.start_xyt[None, :2]
    if not within.space.free(start)[0]:
        x, y = start[0]
        raise MapError(
            f"the motion begins at ({x:.3f} m, {y:.3f} m), which is not free in the map for this robot; check "
            "--map-pose and --robot-radius"
        )
    out = np.empty((count, 3))
    pending: NDArray[np.intp] = np.arange(count)
    candidates = free_at_first = 0
    for attempt in range(within.tries):
        drawn = move_sampled(move, variances, len(pending), rng)
        candidates += len(drawn)
        good = within.allows(np.broadcast_to(start, (len(drawn), 2)), drawn[:, :2])
        out[pending[good]] = drawn[good]
        pending = pending[~good]
        free_at_first += int(np.count_nonzero(good)) if attempt == 0 else 0
        if not len(pending):
            break
    if len(pending) == count:
        raise MapError(
            f"none of {candidates} candidates is free: the motion ends in a wall, and no noisy end pose leaves it"
        )
    return FreeSamples(np.delete(out, pending, axis=0), candidates, len(pending), free_at_first, within.tries)


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
