"""Checks for poses and frame trees that are unusable for a planar robot."""

from __future__ import annotations

from dataclasses import dataclass, field
from graphlib import CycleError, TopologicalSorter
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.bags.messages import gather, gather_stamps_ns, stamps_or_log_ns
from odomcorrupt.corruption.se2_on_se3 import PLANAR, inverted, planar_poses, poses_in
from odomcorrupt.geometry.se2 import wrap

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from odomcorrupt.bags.block import Block
    from odomcorrupt.bags.messages import Item, Layout
    from odomcorrupt.geometry.se2 import Array

ZERO = "orientations are quaternions of four zeros"

FAR_M = 1e9
"""Where no robot is: a pose so far away is no number of use."""

_STEEP = float(np.sin(np.deg2rad(85.0)))
"""Sine of a pitch at which the body's x axis points up or down, and small roll decides on the heading."""


_MANY, _EACH = 2048, 8  # poses of a block above which one in eight is examined, to save time
_SECTORS, _MIN_SECTORS = 24, 8
"""Sectors of roll, and how many of them a robot that rolls must visit, here 120 deg."""
_MIN_PART, _NEARLY_ALL = 0.002, 0.98  # parts of the poses in a visited sector, and of those about the x axis alone


@dataclass(slots=True, eq=False, repr=False)
class ComponentOrder:
    """Test of quaternions for components in the order w, x, y, z instead of x, y, z, w.

    A planar robot then rolls by the angle that it turns, from 180 deg, and never turns. A constant roll is the mounting
    of a sensor. Positions must be planar, too: where x points up, turning is rolling.
    """

    count: int = 0
    flat: int = 0
    rolls: NDArray[np.int64] = field(default_factory=lambda: np.zeros(_SECTORS, dtype=np.int64))
    low: Array = field(default_factory=lambda: np.full(3, np.inf))
    high: Array = field(default_factory=lambda: np.full(3, -np.inf))

    def take(self, position: Array, quat_xyzw: Array) -> None:
        """Count poses of position (n, 3), metres, and quat_xyzw (n, 4) of any length."""
        if len(position) > _MANY:
            position, quat_xyzw = position[::_EACH], quat_xyzw[::_EACH]
        good = np.asarray(np.isfinite(quat_xyzw).all(axis=1) & (np.abs(position) < FAR_M).all(axis=1))
        if not good.any():
            return
        position, (x, y, z, w) = position[good], quat_xyzw[good].T
        with np.errstate(over="ignore", under="ignore"):
            # (sine of half the tilt)^2 up to which a rotation is about the x axis alone: a tilt of 16 deg
            flat = (y * y + z * z < 0.02 * (x * x + w * w)) & (x * x + w * w > 0.0)
        self.count += len(flat)
        self.flat += _count(flat)
        roll = np.mod(2.0 * np.arctan2(x[flat], w[flat]), 2.0 * np.pi)
        sectors = np.minimum((roll * (_SECTORS / (2.0 * np.pi))).astype(np.int64), _SECTORS - 1)
        self.rolls += np.bincount(sectors, minlength=_SECTORS)
        self.low = np.minimum(self.low, position.min(axis=0))
        self.high = np.maximum(self.high, position.max(axis=0))

    @property
    def w_first(self) -> bool:
        """Whether the components are in the order w, x, y, z."""
        if self.flat < max(_NEARLY_ALL * self.count, 1.0):
            return False
        extent = self.high - self.low
        visited = _count(self.rolls > _MIN_PART * self.flat)
        return visited >= _MIN_SECTORS and bool(extent[2] <= 0.25 * extent[:2].max())


def lacks_w(quat_xyzw: Array) -> int:
    """Return how many quaternions (n, 4) have a w of 0 or 1 and are neither zero nor of unit length: w was not set."""
    with np.errstate(all="ignore"):
        length2, w = np.sum(quat_xyzw**2, axis=1), quat_xyzw[:, 3]
    return _count(((w == 0.0) | (w == 1.0)) & (length2 > 0.0) & (np.abs(length2 - 1.0) > 1e-3))


W_FIRST = (
    "its quaternions roll while they never turn: their components are w, x, y, z in the place of x, y, z, w, or its "
    "attitude turns about x. Write x, y, z, w with the yaw about z, and record again"
)
"""What is wrong with quaternions in the other order, and the way out."""


_STILL, _LEAST_M, _LEAST_RAD = 0.01, 0.5, 1.0
"""Part of the travel by twists below which poses stand still; least travel and turn by twists that are compared."""
_LONGEST_S = 1.0  # longer intervals are gaps
_FAST_MPS = 60.0
PER_METRE = {"feet": 1.0 / 0.3048, "inches": 1.0 / 0.0254, "centimetres": 100.0, "millimetres": 1000.0}
"""Units of length that publishers confuse with metres; yards cannot be distinguished from larger wheels."""
_OF_A_UNIT = 1.06


@dataclass(slots=True, eq=False, repr=False)
class TwistTravel:
    """Travel and turn of an odometry topic by its poses and by its twists, m and rad, in the order of arrival.

    Of blocks of many poses the first eighth counts.

    moving, fast : number of intervals in which the poses move, and move faster than any robot
    """

    by_poses: Array = field(default_factory=lambda: np.zeros(2))
    by_twists: Array = field(default_factory=lambda: np.zeros(2))
    moving: int = 0
    fast: int = 0
    _last: tuple[int, Array] | None = None

    def take(self, stamps_ns: NDArray[np.int64], xyt: Array, twist: Array) -> None:
        """Add poses xyt (n, 3) and twists (n, 3), forwards, to the left and counter-clockwise, at stamps (n,)."""
        if many := len(xyt) > _MANY:
            own = slice(len(xyt) // _EACH)
            stamps_ns, xyt, twist = stamps_ns[own], xyt[own], twist[own]
        good = (np.abs(xyt) < FAR_M).all(axis=1) & (np.abs(twist) < FAR_M).all(axis=1)
        stamps_ns, xyt, twist = stamps_ns[good], xyt[good], twist[good]
        if not len(stamps_ns):
            return
        if self._last is None:
            self._last = int(stamps_ns[0]), xyt[0]
        step = np.diff(np.concatenate((self._last[1][None], xyt)), axis=0)
        dt_s = np.diff(np.concatenate(([self._last[0]], stamps_ns))) * 1e-9
        counted = (dt_s > 0.0) & (dt_s < _LONGEST_S)
        lengths = np.stack((np.hypot(step[:, 0], step[:, 1]), np.abs(wrap(step[:, 2]))))
        speeds = np.stack((np.hypot(twist[:, 0], twist[:, 1]), np.abs(twist[:, 2])))
        self.by_poses += lengths[:, counted].sum(axis=1)
        self.moving += _count(lengths[0, counted] > 0.0)
        self.fast += _count(lengths[0, counted] > _FAST_MPS * dt_s[counted])
        self.by_twists += (speeds * dt_s)[:, counted].sum(axis=1)
        self._last = None if many else (int(stamps_ns[-1]), xyt[-1])

    @property
    def poses_stand_still(self) -> bool:
        """Whether the poses stand still while the twists move."""
        moves = self.by_twists > (_LEAST_M, _LEAST_RAD)
        return bool(moves.any() and (self.by_poses <= _STILL * self.by_twists).all())

    def sentences(self) -> list[str]:
        """Return a warning where poses and twists are of different motions, without a full stop."""
        poses_m, twists_m = self.by_poses[0], self.by_twists[0]
        if self.poses_stand_still:
            return [self.still()]
        if self.fast > self.moving / 2:
            return [f"it usually moves faster than {_FAST_MPS:g} m/s: millimetres for metres? Poses must be in metres"]
        if min(poses_m, twists_m) < _STILL * _LEAST_M or max(poses_m, twists_m) < _LEAST_M:
            return []
        factor = max(poses_m / twists_m, twists_m / poses_m)
        large, small = ("poses", "twists") if poses_m > twists_m else ("twists", "poses")
        return [
            f"the {large} move {factor:.3g} times as far as the {small}: {unit} for metres? Both must be in metres"
            for unit, per_m in PER_METRE.items()
            if 1.0 / _OF_A_UNIT < factor / per_m < _OF_A_UNIT
        ]

    def still(self) -> str:
        """Return what is wrong with poses that stand still, and the way out."""
        return (
            f"the poses stand still while the twists move by {self.by_twists[0]:.3g} m and "
            f"{np.degrees(self.by_twists[1]):.3g} deg: the driver fills twists alone; `odomcorrupt integrate IN OUT` "
            "makes poses of them"
        )


@dataclass(slots=True, eq=False, repr=False)
class Alternation:
    """Test of a path for alternation between two, as of two publishers of one topic or TF edge.

    way_m : length of the path
    returned_m : length of the steps that the next step takes back by more than half
    returns : their number
    """

    way_m: float = 0.0
    returned_m: float = 0.0
    returns: int = 0
    _last: Array = field(default_factory=lambda: np.zeros((0, 2)))

    def take(self, xyt: Array) -> None:
        """Add poses xyt (n, 2 or more) in the order of their stamps."""
        good = (np.abs(xyt[:, :2]) < FAR_M).all(axis=1)
        path = np.concatenate((self._last, xyt[good, :2]))
        x, y = np.diff(path, axis=0).T
        length = np.sqrt(x * x + y * y)
        left = np.sqrt((x[1:] + x[:-1]) ** 2 + (y[1:] + y[:-1]) ** 2)
        least = np.minimum(length[1:], length[:-1])
        # poses of two publishers are this far apart at least: less is the noise of one
        back = (left < least / 2.0) & (least > 0.01)
        new = max(len(self._last) - 1, 0)
        self.way_m += float(length[new:].sum())
        self.returned_m += float(least[back].sum())
        self.returns += _count(back)
        self._last = path[-2:]

    @property
    def alternates(self) -> bool:
        """Whether more than half of the path is taken back at once."""
        return self.returns > 10 and self.returned_m > self.way_m / 2.0

    def sentence(self) -> str:
        """Return what is wrong, without a full stop."""
        apart = self.returned_m / max(self.returns, 1)
        return (
            f"two publishers alternate, {apart:.2g} m apart: the pose goes to and fro {self.returns} times, which no "
            "robot drives"
        )


@dataclass(slots=True, eq=False, repr=False)
class PoseFaults:
    """Reader of the poses of an odometry topic or TF edge, with counts of what is unusable in them.

    zero_stamps : stamps that are zero, replaced by log times
    no_orientation : quaternions that are zero
    no_w : quaternions whose w was never set, see `lacks_w`
    upright : pitches beyond 85 deg
    far : positions beyond `FAR_M`
    order : test of the order of the quaternions' components
    twists : comparison of the poses with the twists
    paths : test for two publishers, of the poses in the order of their stamps
    """

    zero_stamps: int = 0
    no_orientation: int = 0
    no_w: int = 0
    upright: int = 0
    far: int = 0
    order: ComponentOrder = field(default_factory=ComponentOrder)
    twists: TwistTravel = field(default_factory=TwistTravel)
    paths: Alternation = field(default_factory=Alternation)

    def read(
        self, block: Block, layout: Layout, item: Item, *, inverse: bool = False
    ) -> tuple[NDArray[np.int64], Array]:
        """Return stamps (n,) and planar poses (n, 3) of messages, in metres and radians; log times for zero stamps.

        inverse : whether the transforms point the other way
        """
        poses = poses_in(block, layout, item)
        poses = inverted(poses) if inverse else poses
        stamps_ns, xyt = gather_stamps_ns(block, layout, item), planar_poses(poses)
        self.take(poses.position, poses.quat_xyzw)
        if not stamps_ns.all():
            self.zero_stamps += _count(stamps_ns == 0)
            stamps_ns = stamps_or_log_ns(block, layout, item)
        if "twist" in item.fields:
            self.twists.take(stamps_ns, xyt, gather(block, layout, item, "twist")[:, PLANAR])
        return stamps_ns, xyt

    def take(self, position: Array, quat_xyzw: Array) -> None:
        """Count the unusable poses of position (n, 3), metres, and quat_xyzw (n, 4)."""
        self.order.take(position, quat_xyzw)
        self.no_w += lacks_w(quat_xyzw)
        with np.errstate(all="ignore"):
            x, y, z, w = quat_xyzw.T
            length2 = x * x + y * y + z * z + w * w
            sine = np.abs(2.0 * (w * y - z * x))
            self.no_orientation += _count(length2 == 0.0)
            self.upright += _count((length2 > 0.0) & (sine > _STEEP * length2))
            far = (np.abs(position[:, 0]) >= FAR_M) | (np.abs(position[:, 1]) >= FAR_M)
            if far.any():
                self.far += _count(far & np.isfinite(position).all(axis=1))

    def sentences(self) -> list[str]:
        """Return one warning for each kind of fault found, without a full stop."""
        said = [W_FIRST] if self.order.w_first else []
        said += [self.paths.sentence()] if self.paths.alternates else self.twists.sentences()
        if self.no_orientation:
            said.append(f"{self.no_orientation} {ZERO}: not used, and left unchanged")
        if self.no_w:
            said.append(f"{self.no_w} orientations are no unit quaternions, w is 0 or 1: set w = cos(yaw / 2)")
        if self.upright:
            said.append(f"{self.upright} poses pitch beyond 85 deg: their heading is that of the z axis")
        if self.far:
            said.append(f"{self.far} poses are beyond {FAR_M:.0e} m: not used, and left unchanged")
        return said


def _count(which: NDArray[np.bool_] | np.bool_) -> int:
    return int(np.count_nonzero(which))


def frame_faults(edges: Iterable[tuple[str, str]], odom: str | None, base: str | None) -> list[str]:
    """Return warnings on a bag's TF tree (loops, several parents), without a full stop.

    edges : parent and child of every transform
    odom, base : frames of the odometry
    """
    said = []
    if odom is not None and odom == base:
        said.append(f"the odometry is from {odom} to {base}, one and the same frame; it needs two")
    parents: dict[str, set[str]] = {}
    for parent, child in edges:
        parents.setdefault(child, set()).add(parent)
    for child, above in sorted(parents.items()):
        if len(above) > 1 and not any(child in parents.get(one, ()) for one in above):
            said.append(
                f"TF gives {child} {len(above)} parents ({', '.join(sorted(above)[:6])}): a frame can have only one"
            )
    try:
        TopologicalSorter({child: sorted(parents[child]) for child in sorted(parents)}).prepare()
    except CycleError as error:
        said.append(f"TF has a loop: {' -> '.join(error.args[1])}")
    return said
