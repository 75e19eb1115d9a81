"""In-place replacement of poses, twists, covariances and stamps in serialised messages."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from odomcorrupt.bags.messages import gather, gather_stamps_ns, scatter, scatter_columns, scatter_stamps_ns
from odomcorrupt.corruption.correction import Correction
from odomcorrupt.corruption.covariance import BODY_SUMS, has_random_part, pose_covariance, twist_covariance
from odomcorrupt.corruption.inverse import acts
from odomcorrupt.corruption.odometry_source import ODOMETRY, plain
from odomcorrupt.corruption.se2_on_se3 import SpatialPoses, finite_rows, from_left, from_right
from odomcorrupt.geometry.se2 import rotated, wrap, yaw_from_quaternion

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from odomcorrupt.bags.block import Block, Channel
    from odomcorrupt.bags.messages import Item, Layout
    from odomcorrupt.corruption.correction import Curve
    from odomcorrupt.corruption.odometry_source import Side
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.model.motion_model import MotionModel

_LOSS = 0.3
"""Smallest motion that counts as a restored loss, as a fraction of the pose's: of both wheels, the pose stands; of one,
it moves as much as is lost."""


class TwistChange(NamedTuple):
    """Changes of n twists.

    known : (n,) whether the message has a predecessor at another stamp; others are not changed
    added : (n, 3) noisy minus clean, forward and leftward m/s, yaw rad/s, in the body at mid heading
    covariance : (n, 3, 3) of these
    clean : (n, 3) rates of the clean poses themselves since the message before, likewise
    """

    known: NDArray[np.bool_]
    added: Array
    covariance: Array
    clean: Array


class TopicTwist:
    """Twist changes of one topic, from messages in the order of arrival.

    A message that arrives after a later stamp gets the rates of the interval that contains its own.
    """

    def __init__(self) -> None:
        self._stretch = -1

    def _begin(self, stretch: int) -> None:
        self._stretch = stretch
        self._stamps_ns: NDArray[np.int64] = np.zeros(0, dtype=np.int64)
        self._clean, self._correction, self._sums = np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 0))
        self._known, self._added, self._covariance = False, np.zeros(3), np.zeros((3, 3))
        self._rate = np.zeros(3)

    def change(self, stamps_ns: NDArray[np.int64], clean_xyt: Array, at: Correction) -> TwistChange:
        """Return the changes of the twists of the next n messages.

        stamps_ns : (n,) header stamps
        clean_xyt : (n, 3) their clean poses, metres and radians
        at : the correction at these stamps
        """
        n = len(stamps_ns)
        edges = np.flatnonzero(np.diff(at.stretch)) + 1
        if n and not len(edges):
            if at.stretch[0] != self._stretch:
                self._begin(int(at.stretch[0]))
            return self._within_stretch(stamps_ns, clean_xyt, at.xyt, at.sums)
        out = TwistChange(np.zeros(n, dtype=bool), np.zeros((n, 3)), np.zeros((n, 3, 3)), np.zeros((n, 3)))
        for start, stop in zip([0, *edges], [*edges, n], strict=True):
            if start == stop:
                continue
            if at.stretch[start] != self._stretch:
                self._begin(int(at.stretch[start]))
            rows = slice(int(start), int(stop))
            part = self._within_stretch(stamps_ns[rows], clean_xyt[rows], at.xyt[rows], at.sums[:, rows])
            out.known[rows], out.added[rows], out.covariance[rows] = part.known, part.added, part.covariance
            out.clean[rows] = part.clean
        return out

    def _within_stretch(
        self, stamps_ns: NDArray[np.int64], clean_xyt: Array, correction_xyt: Array, sums: Array
    ) -> TwistChange:
        sums = sums[BODY_SUMS]
        if not len(self._stamps_ns):
            self._sums = sums[:, :0]
        floor = self._stamps_ns[-1] if len(self._stamps_ns) else np.iinfo(np.int64).min
        reach = np.maximum.accumulate(np.concatenate(([floor], stamps_ns)))
        beyond = stamps_ns > reach[:-1]
        # nearly always all of them are, and need not be picked out
        ahead = slice(None) if beyond.all() else np.flatnonzero(beyond)
        at_ns = np.concatenate((self._stamps_ns, stamps_ns[ahead]))
        clean = np.concatenate((self._clean, clean_xyt[ahead]))
        correction = np.concatenate((self._correction, correction_xyt[ahead]))
        every_sum = np.concatenate((self._sums, sums[:, ahead]), axis=1)
        dt_s = np.diff(at_ns) * np.float64(1e-9)

        # row 0 is the state before this batch, row k that of the k-th message that is ahead
        count = len(at_ns) - len(self._stamps_ns)
        fresh = count - len(dt_s)
        known = np.concatenate(([self._known], np.arange(count) >= fresh))
        added, rate = np.zeros((len(known), 3)), np.zeros((len(known), 3))
        covariance = np.zeros((3, 3, len(known))).transpose(2, 0, 1)
        added[0], covariance[0], rate[0] = self._added, self._covariance, self._rate
        difference, body = _body_difference(clean, correction)
        for column in range(3):
            added[1 + fresh :, column], rate[1 + fresh :, column] = difference[:, column] / dt_s, body[:, column] / dt_s
        covariance[1 + fresh :] = twist_covariance(np.diff(every_sum, axis=1), dt_s)

        self._stamps_ns, self._clean, self._correction = at_ns[-1:], clean[-1:], correction[-1:]
        self._sums = every_sum[:, -1:]
        self._known, self._added, self._covariance, self._rate = bool(known[-1]), added[-1], covariance[-1], rate[-1]
        if isinstance(ahead, slice):
            return TwistChange(known[1:], added[1:], covariance[1:], rate[1:])
        latest = np.zeros(len(stamps_ns), dtype=np.int64)
        latest[ahead] = np.arange(1, count + 1)
        latest = np.maximum.accumulate(latest)
        known = known[latest] & (stamps_ns != reach[:-1])
        return TwistChange(known, added[latest], covariance[latest], rate[latest])


def _body_difference(clean_xyt: Array, correction_xyt: Array) -> tuple[Array, Array]:
    """Return noisy minus clean body increments (n - 1, 3), each at its own mid heading, and the clean ones.

    Only changes of the correction enter: where it is held, the difference is zero to the last bit.
    """
    (x, y, heading), (shift_x, shift_y, angle) = clean_xyt.T, correction_xyt.T
    turn, swing = wrap(np.diff(heading)), np.diff(angle)
    middle = heading[:-1] + turn / 2.0
    shift = rotated(np.diff(shift_x), np.diff(shift_y), -angle[:-1])
    end = x[1:], y[1:]
    swung = rotated(*end, swing)
    noisy_less_clean = shift[0] + (swung[0] - end[0]), shift[1] + (swung[1] - end[1])
    body = rotated(np.diff(x), np.diff(y), -middle)
    less = rotated(*body, -swing / 2.0)
    more = rotated(*noisy_less_clean, -middle - swing / 2.0)
    difference = np.stack((less[0] - body[0] + more[0], less[1] - body[1] + more[1], swing), axis=1)
    return difference, np.stack((*body, turn), axis=1)


PLANAR = np.array([0, 1, 5])
"""Where x, y and yaw stand among x, y, z, roll, pitch, yaw."""

PLANAR_BLOCK = (6 * PLANAR[:, None] + PLANAR).ravel()
"""Where their covariances stand in a row-major 6 x 6 matrix."""


class Target(NamedTuple):
    """n messages of one layout, and the item in them that the correction moves.

    side : whether the correction multiplies the pose from the left or from the right
    stamps_ns, time_ns : (n,) header stamps, and log times as running maxima
    """

    channel: Channel
    layout: Layout
    item: Item
    side: Side
    stamps_ns: NDArray[np.int64]
    time_ns: NDArray[np.int64]


@dataclass(slots=True)
class Changes:
    """Counts of moved messages: by topic, by edge "parent -> child", and those stamped after the end of C(t).

    static : edges on /tf_static, which cannot follow a drift
    """

    odometry: Counter[str] = field(default_factory=Counter)
    edges: Counter[str] = field(default_factory=Counter)
    static: set[str] = field(default_factory=set)
    held: int = 0


class Patcher:
    """Applies the correction to messages, topic by topic."""

    def __init__(self, model: MotionModel, *, keep_twist: bool, keep_covariance: bool) -> None:
        self.changes = Changes()
        self._clocks = tuple(e for e in model.effects if e.clock and acts(e))
        self._steps = model.setup.pose_corrections
        self._moves = not model.noise.coefficients.noise_free or any(acts(e) for e in model.effects if not e.clock)
        self._moves |= self._steps
        self._restores = any(e.restorable for e in model.effects)
        self._twist = not keep_twist
        drawn = any(has_random_part(e, model.track_m) for e in model.effects)
        self._covariance = not keep_covariance and (drawn or not model.noise.coefficients.noise_free)
        self._twists: dict[str, TopicTwist] = {}

    @np.errstate(over="ignore", invalid="ignore")  # NaN and infinite poses stay as they are
    def patch(self, block: Block, targets: list[Target], curve: Curve, first_ns: int) -> None:
        """Apply C(t) to a block's targets in place; first_ns is the first stamp, the origin of clock effects."""
        odometry: dict[str, list[tuple[Target, Correction]]] = {}
        for target in targets:
            at = curve.at(target.stamps_ns, target.time_ns)
            self.changes.held += int(np.count_nonzero(at.held))
            if target.channel.msgtype == ODOMETRY:
                self.changes.odometry[target.channel.topic] += len(target.stamps_ns)
                odometry.setdefault(target.channel.topic, []).append((target, at))
            else:
                item = target.item
                edge = f"{plain(item.frame_id)} -> {plain(item.child_frame_id)}"
                self.changes.edges[edge] += len(target.stamps_ns)
                if target.channel.topic.endswith("tf_static"):
                    self.changes.static.add(edge)
                if self._moves:
                    _move(block, target, at.xyt, _poses(block, target))
            if self._clocks:
                self._shift_stamps(block, target, first_ns)
        if self._moves:
            for topic, parts in odometry.items():
                self._patch_odometry(block, topic, parts)

    def _patch_odometry(self, block: Block, topic: str, parts: list[tuple[Target, Correction]]) -> None:
        clean = []
        for target, at in parts:
            poses = _poses(block, target)
            x, y, _ = poses.position.T
            clean.append(np.stack((x, y, yaw_from_quaternion(poses.quat_xyzw)), axis=1))
            noisy = _move(block, target, at.xyt, poses)
            if self._covariance:
                x, y, _ = noisy.position.T
                covariance = pose_covariance(at.sums, np.stack((x - at.origin_xy[0], y - at.origin_xy[1])))
                _set_planar(block, target, "pose_covariance", covariance, slice(None))
        if not self._twist:
            return
        # one topic's messages may have several layouts: twists are processed in the order of arrival
        follower = self._twists.setdefault(topic, TopicTwist())
        if len(parts) == 1:
            (target, at), change = parts[0], follower.change(parts[0][0].stamps_ns, clean[0], parts[0][1])
            self._patch_twist(block, target, change)
            return
        order = np.argsort(np.concatenate([target.layout.rows for target, _ in parts]))
        back = np.argsort(order)
        every = _rows(_together([at for _, at in parts]), order)
        stamps = np.concatenate([target.stamps_ns for target, _ in parts])[order]
        change = follower.change(stamps, np.concatenate(clean)[order], every)
        start = 0
        for target, _ in parts:
            own = back[start : start + len(target.stamps_ns)]
            start += len(own)
            part = TwistChange(change.known[own], change.added[own], change.covariance[own], change.clean[own])
            self._patch_twist(block, target, part)

    def _patch_twist(self, block: Block, target: Target, change: TwistChange) -> None:
        added = change.added
        moved = change.known & _nonzero(added) & finite_rows(added)
        if moved.any():
            twist = gather(block, target.layout, target.item, "twist")
            if self._restores or self._steps:
                has = _has_already(twist[:, PLANAR] - change.clean, added)
                loss = np.sum(added**2, axis=1) >= _LOSS**2 * np.sum(change.clean**2, axis=1)
                moved &= ~(has & (loss | self._steps))
            rows = slice(None) if moved.all() else np.flatnonzero(moved)
            for column, place in enumerate(PLANAR):
                twist[rows, place] += added[rows, column]
            scatter(block, target.layout, target.item, "twist", twist)
        if self._covariance:
            known = slice(None) if change.known.all() else change.known
            _set_planar(block, target, "twist_covariance", change.covariance, known)

    def _shift_stamps(self, block: Block, target: Target, first_ns: int) -> None:
        t_s = (target.stamps_ns - first_ns) * np.float64(1e-9)
        shift_s = sum(effect.stamp_shift_s(t_s) for effect in self._clocks)
        shift_ns = np.rint(np.asarray(shift_s) * 1e9).astype(np.int64)
        written = gather_stamps_ns(block, target.layout, target.item)
        # a stamp of zero means "no stamp" and stays zero
        scatter_stamps_ns(block, target.layout, target.item, written + np.where(written == 0, 0, shift_ns))


def _rows(at: Correction, rows: slice | NDArray[np.int64]) -> Correction:
    return Correction(at.xyt[rows], at.sums[:, rows], at.origin_xy[:, rows], at.stretch[rows], at.held[rows])


def _together(parts: list[Correction]) -> Correction:
    return Correction(
        np.concatenate([at.xyt for at in parts]),
        np.concatenate([at.sums for at in parts], axis=1),
        np.concatenate([at.origin_xy for at in parts], axis=1),
        np.concatenate([at.stretch for at in parts]),
        np.concatenate([at.held for at in parts]),
    )


def _poses(block: Block, target: Target) -> SpatialPoses:
    layout, item = target.layout, target.item
    return SpatialPoses(gather(block, layout, item, "position"), gather(block, layout, item, "orientation"))


def _move(block: Block, target: Target, correction_xyt: Array, poses: SpatialPoses) -> SpatialPoses:
    """Apply a correction (n, 3) to poses in place; return the moved poses.

    Poses with a zero correction, or that are not finite, keep their bytes.
    """
    moved = _nonzero(correction_xyt) & finite_rows(poses.position) & finite_rows(poses.quat_xyzw)
    if not moved.any():
        return poses
    act = from_left if target.side == "left" else from_right
    if moved.all():
        out = act(correction_xyt, poses)
    else:
        out = SpatialPoses(poses.position.copy(), poses.quat_xyzw.copy())
        some = act(correction_xyt[moved], SpatialPoses(poses.position[moved], poses.quat_xyzw[moved]))
        out.position[moved], out.quat_xyzw[moved] = some.position, some.quat_xyzw
    scatter(block, target.layout, target.item, "position", out.position)
    scatter(block, target.layout, target.item, "orientation", out.quat_xyzw)
    return out


def _nonzero(xyt: Array) -> NDArray[np.bool_]:
    """Return a mask (n,) of the rows of (n, 3) that are not all zero."""
    return (xyt[:, 0] != 0.0) | (xyt[:, 1] != 0.0) | (xyt[:, 2] != 0.0)


def _has_already(twist: Array, added: Array) -> NDArray[np.bool_]:
    """Return a mask (n,) of the twists, less the pose's rates, that already contain the motion `added` (n, 3)."""
    return np.sum(twist * added, axis=1) > 0.5 * np.sum(added**2, axis=1)


def _set_planar(block: Block, target: Target, name: str, covariance: Array, which: slice | NDArray[np.bool_]) -> None:
    """Replace the entries of x, y and yaw in a 6 x 6 covariance."""
    planar = [covariance[:, row, column] for row in range(3) for column in range(3)]
    scatter_columns(block, target.layout, target.item, name, PLANAR_BLOCK, planar, which)
