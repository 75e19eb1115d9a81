"""Samples and density of one motion, and particles along a drive."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from odomcorrupt.api.bag_options import as_condition, drive_path
from odomcorrupt.api.model import Model, ModelLike, as_model
from odomcorrupt.api.result import Result
from odomcorrupt.corruption.summary import model_brief
from odomcorrupt.errors import ModelError, OdomCorruptError
from odomcorrupt.mapping.conditioned import free_paths
from odomcorrupt.report.plain import picked
from odomcorrupt.rng import draw_seed, stream
from odomcorrupt.sampling import samples
from odomcorrupt.sampling.density import density_on_grid, hypothetical, pose_density, product, within_map
from odomcorrupt.summary import Line, Summary
from odomcorrupt.trajectories import read_drive

if TYPE_CHECKING:
    from collections.abc import Sequence
    from os import PathLike

    from matplotlib.figure import Figure
    from numpy.typing import ArrayLike, NDArray

    from odomcorrupt.mapping.conditioned import MapCondition
    from odomcorrupt.mapping.occupancy_grid import FreeSpace
    from odomcorrupt.model.motion_model import Noise
    from odomcorrupt.model.noise_laws import Variances
    from odomcorrupt.sampling.density import DensityGrid
    from odomcorrupt.sampling.samples import Move, ParticleSet


_ARTICLE_CODE = (
    "article-code: the listing passes sd*sd where a standard deviation is expected, so what is drawn has deviation "
    "sd^2 (in numbers, whatever the unit), not sd"
)


@dataclass(frozen=True, slots=True, repr=False, kw_only=True)
class Samples(Result):
    """End poses drawn for one motion.

    move, noise, variances : the motion, its noise, and the variances of its noise
    xyt : end poses, shape (count, 3), metres and radians; headings are not wrapped
    seed, origin : seed of the random draws, and source of the noise in words
    space : free space that constrains the samples, None without a map
    notes : effect of a map on the draws, in sentences
    """

    move: Move
    noise: Noise
    variances: Variances
    xyt: NDArray[Any]
    seed: int
    origin: str
    space: FreeSpace | None = None
    notes: tuple[str, ...] = ()

    def summary(self) -> Summary:
        """Return mean and spread of the samples beside those of the linearised model."""
        own = samples.sample_moments(self.xyt)
        lines = [Line("SAMPLES", f"{len(self.xyt)} of seed {self.seed}, mean {_pose(own.mean_xyt)}", "good")]
        for name, moments in (("spread", own), ("linearised", samples.linearised_moments(self.move, self.variances))):
            about = samples.ellipse(moments, 1.0)
            heading = math.degrees(math.sqrt(moments.covariance[2, 2]))
            axes = f"{about.major_m:.3g} m by {about.minor_m:.3g} m at {math.degrees(about.angle_rad) % 180.0:.3g} deg"
            lines.append(Line(name, f"{axes}, heading {heading:.3g} deg (1 sigma)"))
        lines.append(Line("motion", f"{_pose(self.move.start_xyt)} to {_pose(self.move.end_xyt)}"))
        lines.append(Line("noise", self.noise.words, full=self.noise.words + (f" ({self.origin})" * bool(self.origin))))
        squared = (_ARTICLE_CODE,) * (self.noise.law_name == "article-code")
        lines += [Line("note", note, "warning") for note in (*squared, *self.notes)]
        return Summary(tuple(lines))

    def _tables(self) -> str:
        """Return the parts of the motion with their deviations, and both covariances."""
        move, v, parts, degrees = self.move, self.variances, self.move.parts, math.degrees
        rot1, rot2, trans = (float(values[0]) for values in (parts.rot1_rad, parts.rot2_rad, parts.trans_m))
        deviation = [math.sqrt(float(values[0])) for values in (v.rot1, v.trans, v.rot2)]
        lines = [
            f"motion: turn {degrees(rot1):.4g} deg, drive {trans:.4g} m, turn {degrees(rot2):.4g} deg",
            f"with deviations {degrees(deviation[0]):.4g} deg, {deviation[1]:.4g} m, {degrees(deviation[2]):.4g} deg",
        ]
        sets = [("linearised", samples.linearised_moments(move, v))]
        if len(self.xyt) > 1:
            sets.insert(0, ("samples", samples.sample_moments(self.xyt)))
        for name, moments in sets:
            lines += [
                f"{name}: mean {_pose(moments.mean_xyt)}",
                "  covariance of x, y (m), theta (rad):",
                *("    " + "  ".join(f"{value: .4e}" for value in row) for row in moments.covariance),
            ]
        return "\n".join(lines)

    def _values(self) -> dict[str, Any]:
        noise, linear = self.noise, samples.linearised_moments(self.move, self.variances)
        parts = picked(self.move.parts, "rot1_rad", "trans_m", "rot2_rad")
        deviations = picked(self.variances, "rot1", "trans", "across", "rot2")
        return {
            "law": noise.law_name,
            "step": noise.step and str(noise.step),
            "coefficients": asdict(noise.coefficients),
            **picked(self, "seed", "notes", "xyt", source="origin"),
            **picked(self.move, "start_xyt", odometry_end_xyt="end_xyt"),
            **{name: own[0] for name, own in parts.items()},
            "standard_deviations": {name: math.sqrt(own[0]) for name, own in deviations.items()},
            "samples": asdict(samples.sample_moments(self.xyt)) if len(self.xyt) > 1 else None,
            "linearised": asdict(linear),
            "linearised_ellipse_1_sigma": asdict(samples.ellipse(linear, 1.0)),
        }

    def rows(self) -> list[dict[str, Any]]:
        """Return one row per sample."""
        return [_named(row) for row in self.xyt]

    def csv(self) -> str:
        """Return the samples as lines of x, y, theta that parse to the same bits."""
        return _csv(self.rows())

    def _figure(self) -> Figure:
        from odomcorrupt.report.plots.samples import draw_banana

        numbers = "  ".join(f"{name} {value:.3g}" for name, value in self.noise.numbers)
        name = self.noise.law_name + " (sd passed squared)" * (self.noise.law_name == "article-code")
        step = f" per {self.noise.step}" if self.noise.step is not None else ""
        title = f"Where one motion may end: law {name}{step}, {len(self.xyt)} samples, seed {self.seed}\n{numbers}"
        return draw_banana(self.move, self.variances, self.xyt, title, self.space)


def _pose(xyt: NDArray[Any]) -> str:
    return f"({xyt[0]:.4g} m, {xyt[1]:.4g} m, {math.degrees(xyt[2]):.4g} deg)"


def _named(xyt: NDArray[Any]) -> dict[str, float]:
    return dict(zip(("x_m", "y_m", "theta_rad"), map(float, xyt), strict=True))


def _csv(rows: list[dict[str, Any]]) -> str:
    return "\n".join([",".join(rows[0]), *(",".join(map(repr, row.values())) for row in rows)]) + "\n"


def sample(
    start_xyt: Sequence[float],
    end_xyt: Sequence[float],
    *,
    model: ModelLike | None = None,
    count: int = 1000,
    seed: int | None = None,
    within: MapCondition | str | PathLike[str] | None = None,
) -> Samples:
    """Draw samples of the end pose of one motion.

    start_xyt, end_xyt : (3,) odometry before and after the motion, metres and radians
    model : model, noise, model file or preset; by default the preset `typical`. Effects act along a whole drive
        and are refused
    count : number of samples
    seed : seed of the random draws; by default a random one, stated in the result
    within : map condition or a map's .yaml; free space in which samples must end

    Returns
    -------
    Samples
        `xyt` has shape (count, 3).

    Raises
    ------
    ModelError
        If the model has effects, or noise that depends on time.

    Examples
    --------
    >>> import odomcorrupt as oc
    >>> oc.sample((0, 0, 0), (1, 0.35, 0.7), count=500, seed=1).xyt.shape
    (500, 3)
    """
    chosen = as_model(model)
    move, variances = _motion(start_xyt, end_xyt, chosen.motion_model)
    seed = draw_seed() if seed is None else seed
    rng, condition = stream(seed, 0, "sample"), as_condition(within)
    space: FreeSpace | None = None
    notes: tuple[str, ...] = ()
    if condition is None:
        xyt = samples.move_sampled(move, variances, count, rng)
    else:
        free = samples.move_sampled_in_map(move, variances, count, rng, condition)
        xyt, space, notes = free.xyt, condition.space, (free.account(),)
    return Samples(
        move=move, noise=chosen.motion_model.noise, variances=variances, xyt=xyt, seed=seed, origin=chosen.origin,
        space=space, notes=notes,
    )  # fmt: skip


def _motion(start_xyt: Sequence[float], end_xyt: Sequence[float], model: Any) -> tuple[Move, Variances]:
    if model.effects:
        raise ModelError(
            "effects act over time, and a single motion has no duration: corrupt a path, or leave them out"
        )
    start, end = (np.asarray(pose, dtype=np.float64) for pose in (start_xyt, end_xyt))
    if start.shape != (3,) or end.shape != (3,):
        raise ModelError(f"poses of shapes {start.shape} and {end.shape}; give x, y and heading of each")
    move = samples.move_between(start, end, arc=model.noise.law.arc)
    return move, samples.move_variances(model.noise, move)


@dataclass(frozen=True, slots=True, repr=False)
class Density(Result):
    """Density of the end pose of one motion, in closed form.

    poses : (n, 3) evaluation poses, metres and radians
    values : (n,) density at `poses`; 1/(m^2 rad) for a density of poses, 1/(m rad^2) for the product
    reading : "pose", "product" or "hypothetical"
    grid : density over x and y, marginalised over the heading
    within, free_part : map condition, and the fraction of the unconstrained density that is in free space
    """

    poses: NDArray[Any]
    values: NDArray[Any]
    reading: str
    grid: DensityGrid
    move: Move
    variances: Variances
    law: str
    free_part: float = 1.0
    within: MapCondition | None = None

    @property
    def unit(self) -> str:
        """Unit of the values."""
        return "1/(m^2 rad)" if self.reading == "pose" else "1/(m rad^2)"

    def summary(self) -> Summary:
        """Return the density at each pose, and its integral over all poses."""
        meaning = "one is a density" if self.reading == "pose" else "the product is not a density over poses"
        integral = f"integral over the grid of end poses: {self.grid.integral:.6f} ({meaning})"
        said = [
            f"at ({x:g} m, {y:g} m, {math.degrees(t):g} deg): {value:.6g} {self.unit}"
            for (x, y, t), value in zip(self.poses.tolist(), self.values.tolist(), strict=True)
        ]
        if self.within is not None:
            said.append(
                f"{100.0 * self.free_part:.4g} % of the distribution is free in the map; densities are divided by that"
            )
        return Summary((Line("DENSITY", integral, "good"), *(Line("", one) for one in said), Line("noise", self.law)))

    def _values(self) -> dict[str, Any]:
        return {**picked(self, "reading", "unit", "law", integral="grid.integral"), "at": self.rows()}

    def rows(self) -> list[dict[str, Any]]:
        """Return one row per pose."""
        pairs = zip(self.poses, self.values, strict=True)
        return [_named(pose) | {"density": float(value)} for pose, value in pairs]

    def _figure(self) -> Figure:
        return self.draw_beside(1000, 0)

    def draw_beside(self, count: int, seed: int) -> Figure:
        """Return a figure of the density beside samples of the same motion.

        count : number of samples
        seed : seed of the random draws
        """
        from odomcorrupt.report.plots.samples import draw_density

        xyt = samples.move_sampled(self.move, self.variances, count, stream(seed, 0, "sample"))
        if self.within is not None:
            starts = self.move.start_xyt[:2] + 0.0 * xyt[:, :2]
            xyt = xyt[self.within.allows(starts, xyt[:, :2])]
        name = "Density of end poses" if self.reading == "pose" else f"p1 p2 p3 ({self.reading}) at end poses"
        per_area = "density (1/m^2)" if self.reading == "pose" else "p1 p2 p3, summed (1/(m rad))"
        title = f"{name}: {self.law.partition(' (')[0]}, samples of seed {seed}"
        return draw_density(self.move, self.grid, xyt, title, per_area)


def density(
    start_xyt: Sequence[float],
    end_xyt: Sequence[float],
    poses: ArrayLike = (),
    *,
    model: ModelLike | None = None,
    reading: Literal["pose", "product", "hypothetical"] = "pose",
    within: MapCondition | None = None,
) -> Density:
    """Return the density of the end pose of one motion: p(x_t | u_t, x_t-1), or p(x_t | u_t, x_t-1, m) with a map.

    start_xyt, end_xyt : (3,) odometry before and after the motion, metres and radians
    poses : (n, 3) poses at which to evaluate it
    model : model, noise, model file or preset; by default the preset `typical`
    reading : "pose": density over poses. "product": the lecture's product of the
        densities of rot1, trans and rot2. "hypothetical": that product with the variances of the motion to each pose,
        as in table 5.5 of the book
    within : map; the density is zero outside its free space, and normalised over it

    Returns
    -------
    Density
        `values` at the poses, and a grid with its integral.

    Raises
    ------
    ModelError
        If the noise has no density, e.g. no noise of the translation, or an array does not hold poses.

    Examples
    --------
    >>> import odomcorrupt as oc
    >>> round(oc.density((0, 0, 0), (1, 0, 0), [(1, 0, 0)], model="typical").grid.integral, 3)
    1.0
    """
    chosen = as_model(model).motion_model
    move, variances = _motion(start_xyt, end_xyt, chosen)

    def density_of(xyt: NDArray[Any]) -> NDArray[Any]:
        if reading == "hypothetical":
            return hypothetical(xyt, move, chosen.noise)
        return (pose_density if reading == "pose" else product)(xyt, move, variances)

    at = np.asarray(poses, dtype=np.float64)
    if at.size and at.shape[-1] != 3:
        raise ModelError(f"poses: an array of shape {at.shape}; give x, y and heading of each, shape (n, 3)")
    at = at.reshape(-1, 3)
    values = density_of(at)
    grid = density_on_grid(move, variances, density_of=density_of)
    part = 1.0
    if within is not None:
        start_xy = move.start_xyt[:2]
        grid, part = within_map(grid, within, start_xy)
        free = within.allows(np.broadcast_to(start_xy, (len(at), 2)), at[:, :2])
        values = np.where(free, values / part, 0.0)
    return Density(at, values, reading, grid, move, variances, chosen.noise.words, part, within)


@dataclass(frozen=True, slots=True, repr=False)
class Particles(Result):
    """Poses of many noisy runs of a drive at given distances along it.

    result : complete numerical result: distances, clean poses (k, 3) and noisy ones (runs, k, 3), metres and radians
    model, odometry : model of the noise, and the odometry in words
    space, notes : free space that constrains the poses, None without a map, and the map's effect in sentences
    """

    result: ParticleSet
    model: Model
    odometry: str
    space: FreeSpace | None = None
    notes: tuple[str, ...] = ()

    def summary(self) -> Summary:
        """Return the spread at the end and on the way, and the model."""
        cloud, last = self.result, len(self.result.distance_m) - 1
        said = [f"{self._spread(i)} (1 sigma) after {d:.4g} m" for i, d in enumerate(cloud.distance_m)]
        shown = {last // 3, 2 * last // 3}
        lines = [Line("SPREAD", said[last], "good")]
        lines += [Line("", said[i] if i in shown else "", full=said[i]) for i in range(last)]
        model = model_brief(self.model.motion_model, self.model.origin.partition(":")[0])
        origin = f" ({self.model.origin})" if self.model.origin else ""
        lines.append(Line("model", model, full=f"{self.model.motion_model.noise.words}{origin}"))
        return Summary((*lines, Line("runs", f"{len(cloud.xyt)} of seed {cloud.seed}, over {self.odometry}")))

    def _spread(self, place: int) -> str:
        """Return the standard deviations at one place along the drive, in words."""
        moments = samples.sample_moments(self.result.xyt[:, place])
        about, heading = samples.ellipse(moments, 1.0), math.degrees(math.sqrt(moments.covariance[2, 2]))
        return f"{about.major_m:.3g} m by {about.minor_m:.3g} m, heading {heading:.3g} deg"

    def _values(self) -> dict[str, Any]:
        cloud = self.result
        places = zip(cloud.distance_m, cloud.clean_xyt, cloud.xyt.swapaxes(0, 1), strict=True)
        return {
            "seed": cloud.seed,
            "runs": len(cloud.xyt),
            "places": [
                {"distance_m": distance, "odometry_xyt": clean, **asdict(samples.sample_moments(xyt))}
                for distance, clean, xyt in places
            ],
        }

    def rows(self) -> list[dict[str, Any]]:
        """Return one row per run and place: distance and pose."""
        cloud = self.result
        return [
            {"run": run, "distance_m": float(distance), **_named(pose)}
            for run, poses in enumerate(cloud.xyt)
            for distance, pose in zip(cloud.distance_m, poses, strict=True)
        ]

    def csv(self) -> str:
        """Return the poses as lines of run, distance, x, y, theta that parse to the same bits."""
        return _csv(self.rows())

    def _figure(self) -> Figure:
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

    bag : bag of any kind; not a pipe
    model : model, noise, model file or preset; by default the preset `typical`
    runs : number of runs; run k is the one that `corrupt` draws with this seed and `run=k`
    seed : seed of the random draws; by default a random one, stated in the result
    every_m : distance between the places, metres; by default a round one, about a sixth of the drive
    odom_topic : odometry topic; by default the only one
    within : map condition or a map's .yaml; as in `corrupt`

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
    path = drive_path(bag)
    if runs < 1:
        raise OdomCorruptError(f"runs: {runs}; draw one or more")
    chosen = as_model(model)
    drive = read_drive(path, odom_topic)
    places = samples.places_along(drive, every_m or _rounded_up(float(drive.distance_m[-1]) / 6.0))
    seed, condition = draw_seed() if seed is None else seed, as_condition(within)
    odometry, robot = f"{drive.topic} of {path}", chosen.motion_model
    if condition is None:
        return Particles(samples.sample_particles(drive, robot, places, seed=seed, runs=runs), chosen, odometry)
    free = free_paths(drive.stamps_ns, drive.xyt, robot, condition, seed=seed, runs=range(runs), places=places)
    cloud = samples.particles_at(drive, places, free.xyt, seed)
    return Particles(cloud, chosen, odometry, condition.space, (free.account(),))


def _rounded_up(value: float) -> float:
    """Return the smallest of 1, 2 or 5 times a power of ten that is not below a value."""
    power = 10.0 ** math.floor(math.log10(max(value, 1e-6)))
    return next(step * power for step in (1.0, 2.0, 5.0, 10.0) if step * power >= 0.999 * value)
