"""Drift in a bag's odometry, or in a live robot's; and the correction of the systematic errors in measured odometry."""

from __future__ import annotations

import math
import sys
from collections import Counter
from contextlib import ExitStack
from dataclasses import dataclass
from os import PathLike, fspath
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, Unpack

import numpy as np

from odomcorrupt.api.bag_options import BagOptions, as_condition, bag_path, drive_path, split_options
from odomcorrupt.api.model import Model, ModelLike, as_model
from odomcorrupt.api.result import Result
from odomcorrupt.bags.provenance import ProvenanceWatcher
from odomcorrupt.bags.source import temporary_copy, temporary_folder
from odomcorrupt.corruption.correction import Curve
from odomcorrupt.corruption.covariance import pose_covariance
from odomcorrupt.corruption.patch import Motions, TopicTwist
from odomcorrupt.corruption.path import NoisyPath
from odomcorrupt.corruption.run import Outcome, corrupt_bag
from odomcorrupt.corruption.summary import brief, oddities
from odomcorrupt.errors import OdomCorruptError
from odomcorrupt.geometry.se2 import compose
from odomcorrupt.model.motion_model import NOISE_FREE
from odomcorrupt.report.plain import picked
from odomcorrupt.rng import draw_seed

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from matplotlib.figure import Figure

    from odomcorrupt.bags.block import Block
    from odomcorrupt.correction.run import Corrected
    from odomcorrupt.corruption.path import Drift as Errors
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.mapping.conditioned import MapCondition
    from odomcorrupt.summary import Summary


@dataclass(frozen=True, slots=True, repr=False)
class Corruption(Result):
    """Result of the corruption of a bag.

    source, target : the bags; "-" is a pipe
    model : model of the drift
    outcome : complete result of the run
    map_account : effect of a map on the draws, in a sentence; "" without a map
    earlier : records of earlier corruptions in the input: seed, run, version, model
    """

    source: str
    target: str
    model: Model
    outcome: Outcome
    map_account: str = ""
    earlier: tuple[dict[str, str], ...] = ()

    @property
    def seed(self) -> int:
        """Seed of all random draws."""
        return self.outcome.seed

    @property
    def run(self) -> int:
        """Number of the run under this seed."""
        return self.outcome.run

    @property
    def drift(self) -> Errors:
        """Errors at the end and per 10 m, drawn and expected from the noise; metres and radians."""
        return self.outcome.drift

    @property
    def moved(self) -> dict[str, int]:
        """Number of modified messages per topic, and of modified transforms per TF edge "parent -> child"."""
        changes = (robot.changes for robot in (self.outcome, *self.outcome.others))
        return dict(sum((one.odometry + one.edges + one.noisy for one in changes), Counter[str]()))

    @property
    def losses(self) -> tuple[str, ...]:
        """Unreadable parts of a damaged input, in sentences."""
        return self.outcome.losses

    def summary(self) -> Summary:
        """Return the messages modified, model, seed, the drift at the end, and warnings."""
        again = [
            f"The input was corrupted before (seed {one.get('seed', '?')}, run {one.get('run', '?')}): drifts add up."
            for one in self.earlier
        ]
        return brief(self.outcome, self.model.origin, self.target, [*again, self.map_account])

    def _values(self) -> dict[str, Any]:
        outcome = self.outcome
        return {
            "input": self.source,
            "output": self.target,
            **picked(outcome, "seed", "run"),
            "law": outcome.model.noise.law_name,
            "parameters": self.model.parameters,
            "odometry": outcome.odometry,
            "odom_frame": outcome.frames.odom,
            "base_frame": outcome.frames.base,
            "moved": self.moved,
            "added": outcome.added,
            "drift": outcome.drift._asdict(),
            "remarks": oddities(outcome),
            **picked(outcome, "losses"),
            **picked(self, "earlier"),
        }

    def rows(self) -> list[dict[str, Any]]:
        """Return the drift at the end and per 10 m, drawn and expected."""
        drift, names = self.drift._asdict(), ("drawn_m", "drawn_rad", "expected_m", "expected_rad")
        return [
            {"after": after, **{name: drift[f"{part}_{name}"] or 0.0 for name in names}}
            for after, part in (("end", "end"), ("10 m", "leg"))
            if drift[f"{part}_drawn_m"] is not None
        ]

    def _figure(self) -> Figure:
        from odomcorrupt.report.plots.paths import draw_corruption
        from odomcorrupt.trajectories import read_drive

        clean, noisy = (read_drive(drive_path(bag), self.outcome.odometry) for bag in (self.source, self.target))
        return draw_corruption(clean.xyt, noisy.xyt, f"{Path(self.target).name}: seed {self.seed}, run {self.run}")


def corrupt(
    source: str | PathLike[str],
    target: str | PathLike[str],
    *,
    model: ModelLike | None = None,
    seed: int | None = None,
    run: int = 0,
    within: MapCondition | str | PathLike[str] | None = None,
    also: Sequence[str] = (),
    watch: Callable[[Block], None] = lambda _: None,
    **options: Unpack[BagOptions],
) -> Corruption:
    """Corrupt the odometry of a bag: its poses, twists and covariances, and the TF edges that go with them.

    source, target : bags of any kind; "-" is a pipe. The target is written completely or not at all
    model : model, noise, model file or preset; by default the preset `typical`
    seed : seed of all random draws: the same seed gives the same bytes. By default a random one, stated in the result
    run : number of the run under this seed
    within : map condition or a map's .yaml; draw poses in free space only, as a particle filter does; the odom frame is
        then the map's. See `odomcorrupt.mapping.conditioned.read_condition` for other robots and frames
    also : odometry topics of other robots in the bag, each corrupted with a drift of its own in the same pass
    watch : called with every block written
    **options : see `BagOptions`

    Returns
    -------
    Corruption
        Messages modified, and the drift.

    Raises
    ------
    BagError, TopicError, EffectError, ModelError, MapError
        If a bag cannot be read or written, has no odometry to apply the model to, or the model is invalid.

    Examples
    --------
    >>> import odomcorrupt as oc
    >>> noise = oc.Noise(alpha=(0.05, 0.02, 0.05, 0.01))
    >>> done = oc.corrupt("fixtures/office.mcap", "noisy.mcap", model=noise, seed=7, overwrite=True)
    >>> done.seed, done.moved["/odom"]
    (7, 3000)
    """
    moved, container = split_options(options)
    chosen = as_model(model)
    drawn = draw_seed() if seed is None else seed
    condition = as_condition(within)
    watcher = ProvenanceWatcher(watch)
    with ExitStack() as kept:
        path, bag = None, bag_path(source)
        if condition is not None:  # a path within a map is drawn for the whole drive at once
            from odomcorrupt.forecasting import clean_drive_of

            bag = temporary_copy(sys.stdin.buffer, temporary_folder(kept) / "bag", "stdin") if bag is None else bag
            drive = clean_drive_of(bag, chosen.motion_model, moved, recover=container.recover)
            path = condition.path(chosen.motion_model, drawn, run, drive)
        outcome = corrupt_bag(
            bag, bag_path(target), chosen.motion_model, seed=drawn, run=run, options=moved, container=container,
            watch=watcher, path=path, metadata={} if condition is None else condition.provenance(), also=also,
        )  # fmt: skip
    account = "" if path is None else path.account()
    return Corruption(fspath(source), fspath(target), chosen, outcome, account, watcher.provenance(bag_path(source)))


@dataclass(frozen=True, slots=True, repr=False)
class Correction(Result):
    """Result of a correction of measured odometry.

    source, target : the bags
    outcome : complete result
    """

    source: str
    target: str
    outcome: Corrected

    @property
    def drift(self) -> Errors:
        """Change of the odometry (`drawn`), and remaining error expected from the noise (`expected`)."""
        return self.outcome.run.drift

    @property
    def losses(self) -> tuple[str, ...]:
        """Unreadable parts of a damaged input, in sentences."""
        return self.outcome.run.losses

    def summary(self) -> Summary:
        """Return the effects removed, how far that moved the odometry, and the remaining error."""
        from odomcorrupt.correction.run import brief as brief_correction

        return brief_correction(self.outcome, self.target)

    def _values(self) -> dict[str, Any]:
        effects, run = self.outcome.effects, self.outcome.run
        return {
            "input": self.source,
            "output": self.target,
            "taken_out": [effect.name for effect in effects.undone],
            "left": [effect.name for effect in effects.left],
            "odometry": run.odometry,
            "moved": {**run.changes.odometry, **run.changes.edges},
            "drift": run.drift._asdict(),
            "losses": run.losses,
        }

    def rows(self) -> list[dict[str, Any]]:
        """Return one row per effect, and whether it was removed."""
        undone, left = self.outcome.effects.undone, self.outcome.effects.left
        return [{"effect": e.name, "taken_out": e in undone} for e in (*undone, *left)]

    def _figure(self) -> Figure:
        from odomcorrupt.report.plots.paths import draw_corruption
        from odomcorrupt.trajectories import read_drive

        before, after = (read_drive(drive_path(bag), self.outcome.run.odometry) for bag in (self.source, self.target))
        return draw_corruption(before.xyt, after.xyt, Path(self.target).name, names=("measured", "corrected"))


def correct(
    source: str | PathLike[str],
    target: str | PathLike[str],
    *,
    model: ModelLike | None = None,
    start_xyt: Sequence[float] | Literal["odom"] | None = None,
    watch: Callable[[Block], None] = lambda _: None,
    **options: Unpack[BagOptions],
) -> Correction:
    """Remove the systematic effects of a model from measured odometry.

    source, target : bags; the source is read twice and cannot be a pipe, the target may be "-"
    model : model or model file from `fit` or `learn`; None copies the bag
    start_xyt : (3,) or "odom" start pose of the odometry in the frame of position-dependent effects, metres and
        radians; "odom" if that frame is the odometry's own. Required for a learned model with such effects
    watch : called with every block written
    **options : see `BagOptions`

    Returns
    -------
    Correction
        Effects removed, effects that cannot be, and the change of the odometry.

    Raises
    ------
    BagError, TopicError, EffectError
        If a bag cannot be read or written, has no odometry, or no true motion explains its odometry; if
        position-dependent effects were learned and `start_xyt` is missing.

    Examples
    --------
    >>> import odomcorrupt as oc
    >>> model = oc.Model(effects=["wheelbase:e=2%"], track_m=0.3)
    >>> done = oc.correct("fixtures/office.mcap", "corrected.mcap", model=model, overwrite=True)
    >>> [effect.name for effect in done.outcome.effects.undone]
    ['wheelbase']
    """
    from odomcorrupt.correction.run import correct_bag, require_start

    before, (moved, container) = drive_path(source), split_options(options)
    robot = NOISE_FREE if model is None else as_model(model).motion_model
    if start_xyt is None:
        require_start(robot)
    start = None if start_xyt is None or start_xyt == "odom" else np.array(start_xyt, dtype=np.float64)
    outcome = correct_bag(
        before, bag_path(target), robot, options=moved, container=container, start_xyt=start, watch=watch
    )
    return Correction(fspath(source), fspath(target), outcome)


_PLANAR = [6 * i + j for i in (0, 1, 5) for j in (0, 1, 5)]
"""Places of x, y, yaw in a covariance of 6 x 6 numbers."""


class Drifted(NamedTuple):
    """Odometry with its drift.

    pose_xyt : (3,) metres and radians, in the odom frame
    twist : (3,) forward and leftward m/s, yaw rate rad/s, in the robot's axes
    pose_covariance, twist_covariance : (3, 3) of these; that of the first twist is zero, because nothing has moved yet
    """

    pose_xyt: Array
    twist: Array
    pose_covariance: Array
    twist_covariance: Array


class Drift:
    """The drift of one run, for closed loop: the controller acts on odometry that has drifted.

    The numbers are those of `corrupt` and `batch` with the same model, seed and run.

    Parameters
    ----------
    model : Model, Noise, path of a model file or name of a preset
        By default the preset `typical`.
    seed : int, optional
        Seed of all random draws; by default drawn, see the attribute `seed`.
    run : int
        Number of the run under this seed.

    Examples
    --------
    >>> import odomcorrupt as oc
    >>> drift = oc.Drift("typical", seed=1)
    >>> drift.step(0, (0.0, 0.0, 0.0), (0.5, 0.0, 0.0)).pose_xyt.tolist()
    [0.0, 0.0, 0.0]
    >>> [round(v, 3) for v in drift.step(1_000_000_000, (0.5, 0.0, 0.0), (0.5, 0.0, 0.0)).pose_xyt.tolist()]
    [0.53, 0.003, -0.007]
    """

    def __init__(self, model: ModelLike = "typical", seed: int | None = None, run: int = 0) -> None:
        self.seed = draw_seed() if seed is None else seed
        self._path = NoisyPath(as_model(model).motion_model, self.seed, run)
        self._curve, self._twist = Curve(), TopicTwist()
        self._last_ns: int | None = None

    def step(self, stamp_ns: int, pose_xyt: Sequence[float], twist: Sequence[float] = (0.0, 0.0, 0.0)) -> Drifted:
        """Return the next odometry message with its drift.

        stamp_ns : stamp, nanoseconds, not before the last one
        pose_xyt : (3,) clean pose in the odom frame, metres and radians
        twist : (3,) clean forward and leftward speed, m/s, and yaw rate, rad/s, in the robot's axes

        Returns
        -------
        Drifted
            Pose, twist, and their covariances.

        Raises
        ------
        OdomCorruptError
            If time runs backwards, or a number is not finite.
        """
        stamps_ns, xyt = np.array([stamp_ns], dtype=np.int64), np.array([pose_xyt], dtype=float)
        full, level = np.zeros((1, 6)), np.zeros((1, 4))
        full[0, [0, 1, 5]] = twist
        level[0, 2:] = np.sin(xyt[0, 2] / 2.0), np.cos(xyt[0, 2] / 2.0)
        if not (np.isfinite(xyt).all() and np.isfinite(full).all()):
            raise OdomCorruptError(f"step: pose {tuple(pose_xyt)}, twist {tuple(twist)}; give finite numbers")
        if self._last_ns is not None and stamp_ns < self._last_ns:
            raise OdomCorruptError(
                f"step: stamp {stamp_ns} after {self._last_ns}; make a new Drift where time restarts"
            )
        self._last_ns = stamp_ns
        self._curve.extend(self._path.feed(stamps_ns, xyt), stamps_ns)
        self._curve.forget(stamp_ns)
        at = self._curve.at(stamps_ns, stamps_ns)
        noisy = compose(at.xyt, xyt)[0]
        change = self._twist.change(Motions(stamps_ns, xyt, level, full), at)
        return Drifted(
            noisy, full[0, [0, 1, 5]] + np.where(change.known, change.added, 0.0)[0],
            pose_covariance(at.sums, noisy[:2, None] - at.origin_xy)[0], change.covariance[0],
        )  # fmt: skip

    def apply(self, message: Any, stamp_ns: int) -> None:
        """Give a nav_msgs/Odometry message of ROS 1 or ROS 2 its drift, in place.

        message : message of rospy or rclpy: pose, twist, and their covariances in the plane are changed
        stamp_ns : its stamp, nanoseconds

        Raises
        ------
        OdomCorruptError
            As by `step`.
        """
        p, q, v = message.pose.pose.position, message.pose.pose.orientation, message.twist.twist
        yaw = math.atan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y**2 + q.z**2))
        found = self.step(stamp_ns, (p.x, p.y, yaw), (v.linear.x, v.linear.y, v.angular.z))
        p.x, p.y, turned = found.pose_xyt.tolist()
        q.x, q.y, q.z, q.w = 0.0, 0.0, math.sin(turned / 2.0), math.cos(turned / 2.0)
        v.linear.x, v.linear.y, v.angular.z = found.twist.tolist()
        for one, covariance in ((message.pose, found.pose_covariance), (message.twist, found.twist_covariance)):
            values = np.array(one.covariance, dtype=float)
            values[_PLANAR] = covariance.ravel()
            one.covariance = values.tolist()
