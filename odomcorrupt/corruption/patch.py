"""In-place replacement of poses, twists, covariances and stamps in serialised messages."""

from __future__ import annotations

from collections import Counter, defaultdict
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from odomcorrupt.bags.messages import gather, gather_stamps_ns, scatter, scatter_columns, scatter_stamps_ns
from odomcorrupt.corruption.correction import Correction, body_difference
from odomcorrupt.corruption.covariance import STEP_SUMS, has_random_part, pose_covariance, twist_covariance
from odomcorrupt.corruption.odometry_source import ODOMETRY, plain
from odomcorrupt.corruption.pose_faults import Alternation
from odomcorrupt.corruption.se2_on_se3 import (
    PLANAR,
    SpatialPoses,
    finite_rows,
    from_left,
    from_right,
    in_level_frame,
    planar_poses,
    poses_in,
    tilted_rows,
    tilts,
    turns_about_vertical,
)  # fmt: skip
from odomcorrupt.geometry.se2 import rotated
from odomcorrupt.sensors import Rewriter

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from odomcorrupt.bags.block import Block, Channel
    from odomcorrupt.bags.messages import Item, Layout
    from odomcorrupt.corruption.correction import Curve
    from odomcorrupt.corruption.odometry_source import Side
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.model.motion_model import MotionModel
    from odomcorrupt.sensors import Relations


class TwistChange(NamedTuple):
    """Changes of n twists.

    known : (n,) whether there is a motion up to the message; others are not changed
    added : (n, 3) noisy minus clean, forward and leftward m/s, yaw rad/s, in the body's level frame at mid heading
    covariance : (n, 3, 3) of these
    clean : (n, 3) rates of the clean poses themselves, likewise
    odom_axes : (n,) whether the topic's twists are in the axes of the odom frame; all others then are, too
    """

    known: NDArray[np.bool_]
    added: Array
    covariance: Array
    clean: Array
    odom_axes: NDArray[np.bool_]

    def take(self, rows: NDArray[np.int64]) -> TwistChange:
        """Return the changes of some twists."""
        return TwistChange._make(column[rows] for column in self)


class Motions(NamedTuple):
    """Clean poses and twists of n messages of one topic: stamps (n,), xyt (n, 3), quat_xyzw (n, 4), twist (n, 6)."""

    stamps_ns: NDArray[np.int64]
    xyt: Array
    quat_xyzw: Array
    twist: Array

    def take(self, rows: slice | NDArray[np.int64]) -> Motions:
        """Return some of them."""
        return Motions._make(column[rows] for column in self)


class TopicTwist:
    """Twist changes of one topic, from messages in the order of arrival.

    The error of a twist is the mean derivative of the error of the poses over the last interval in which the pose was
    measured. A message without a new measurement gets that of the message before: one with the same or an earlier
    stamp, one whose pose is not a number, or one whose pose is repeated while its twist moves on.

    Whether twists are in the axes of the child frame, as the message type requires, or in those of the odom frame
    follows from the squared differences so far to the rates of the poses in both; odom_axes is
    the answer at the last message.
    """

    def __init__(self) -> None:
        self._stretch = -1
        self.odom_axes = False
        self._misfit = np.zeros(3)  # sums of squares, (m/s)^2: misfit in the body, misfit in odom axes, motion

    def _begin(self, stretch: int) -> None:
        self._stretch = stretch
        self._reach_ns = int(np.iinfo(np.int64).min)
        self._pose, self._speed2 = np.full((1, 3), np.nan), np.zeros(1)
        self._stamps_ns: NDArray[np.int64] = np.zeros(0, dtype=np.int64)
        self._clean, self._correction, self._sums = np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 0))
        self._quat = np.zeros((0, 4))
        self._known, self._added, self._covariance = False, np.zeros(3), np.zeros((3, 3))
        self._rate, self._swing = np.zeros(3), np.zeros(2)

    def change(self, own: Motions, at: Correction) -> TwistChange:
        """Return the changes of the twists of the next n messages; `at` is the correction at their stamps."""
        n = len(own.stamps_ns)
        edges = np.flatnonzero(np.diff(at.stretch)) + 1
        parts = []
        for start, stop in zip([0, *edges], [*edges, n], strict=True):
            if at.stretch[start] != self._stretch:
                self._begin(int(at.stretch[start]))
            rows = slice(int(start), int(stop))
            parts.append(self._within_stretch(own.take(rows), at.take(rows)))
        if len(parts) == 1:
            return parts[0]
        return TwistChange._make(np.concatenate(column) for column in zip(*parts, strict=True))

    def _measured(self, own: Motions) -> NDArray[np.int64] | slice:
        """Return which messages have a measurement of their own; nearly always all, and need not be picked out."""
        reach = np.maximum.accumulate(np.concatenate(([self._reach_ns], own.stamps_ns)))
        self._reach_ns = int(reach[-1])
        fresh = (own.stamps_ns > reach[:-1]) & finite_rows(own.xyt)
        rows = slice(None) if fresh.all() else np.flatnonzero(fresh)
        if not fresh.any():
            return rows
        poses = np.concatenate((self._pose, own.xyt[rows]))
        changed = (poses[1:] != poses[:-1]).any(axis=1)
        speed2 = np.square(own.twist[rows]).sum(axis=1)
        # the twist with which the present pose was measured
        first = np.concatenate((self._speed2, speed2[changed]))[np.cumsum(changed)]
        # square of the part of its speed below which a robot has stopped, where its pose stays the same
        repeated = ~changed & (speed2 > 0.0) & (speed2 >= 0.25 * first)
        self._pose, self._speed2 = poses[-1:], first[-1:]
        return np.flatnonzero(fresh)[~repeated] if repeated.any() else rows

    def _within_stretch(self, own: Motions, at: Correction) -> TwistChange:
        n, sums = len(own.stamps_ns), at.sums[STEP_SUMS]
        if not len(self._stamps_ns):
            self._sums = sums[:, :0]
        measured = self._measured(own)
        at_ns = np.concatenate((self._stamps_ns, own.stamps_ns[measured]))
        clean = np.concatenate((self._clean, own.xyt[measured]))
        correction = np.concatenate((self._correction, at.xyt[measured]))
        every_sum = np.concatenate((self._sums, sums[:, measured]), axis=1)
        dt_s = np.diff(at_ns) * np.float64(1e-9)

        # row 0 is the state before this batch, row k that of its k-th measurement
        count = len(at_ns) - len(self._stamps_ns)
        fresh = count - len(dt_s)
        known = np.concatenate(([self._known], np.arange(count) >= fresh))
        added, rate, swing = (np.zeros((columns, count + 1)).T for columns in (3, 3, 2))
        covariance = np.zeros((3, 3, count + 1)).transpose(2, 0, 1)
        added[0], covariance[0], rate[0], swing[0] = self._added, self._covariance, self._rate, self._swing
        quat = np.concatenate((self._quat, own.quat_xyzw[measured]))
        difference, body = body_difference(clean, correction, turns_about_vertical(quat))
        for column in range(3):
            added[1 + fresh :, column], rate[1 + fresh :, column] = difference[:, column] / dt_s, body[:, column] / dt_s
        # headings of the clean and of the noisy body at the middle of the interval
        swing[1 + fresh :, 0] = clean[1:, 2] - body[:, 2] / 2.0
        swing[1 + fresh :, 1] = swing[1 + fresh :, 0] + (correction[:-1, 2] + correction[1:, 2]) / 2.0
        covariance[1 + fresh :] = twist_covariance(
            np.diff(every_sum, axis=1), dt_s, swing[1 + fresh :, 1], body[:, :2].T
        )

        if len(at_ns):
            self._stamps_ns, self._clean, self._correction = at_ns[-1:], clean[-1:], correction[-1:]
            self._sums, self._quat = every_sum[:, -1:], quat[-1:]
        self._known, self._added, self._covariance = bool(known[-1]), added[-1], covariance[-1]
        self._rate, self._swing = rate[-1], swing[-1]
        if isinstance(measured, slice):
            rows: slice | NDArray[np.int64] = slice(1, None)
        else:
            rows = np.zeros(n, dtype=np.int64)
            rows[measured] = np.arange(1, count + 1)
            rows = np.maximum.accumulate(rows)
        found = TwistChange(known[rows], added[rows], covariance[rows], rate[rows], np.zeros(n, dtype=bool))
        return self._in_their_axes(own, at, found, swing[rows])

    def _in_their_axes(self, own: Motions, at: Correction, found: TwistChange, heading_rad: Array) -> TwistChange:
        """Return the changes in the axes that the topic's twists are in.

        heading_rad : (n, 2) of the clean and of the noisy body
        """
        rate = found.clean
        # faster than 5 cm/s: axes of slower motion are noise
        moving = found.known & (np.square(rate[:, :2]).sum(axis=1) > 0.05**2) & finite_rows(own.twist)
        odom = np.stack(rotated(rate[:, 0], rate[:, 1], heading_rad[:, 0])).T
        # roll and pitch rates, which a planar motion has not, tell the axes of tilted bodies apart
        still = np.zeros((2, len(rate))).T
        level, stated = (one[:, _SEEN] for one in (in_level_frame(own.twist, own.quat_xyzw, own.xyt[:, 2]), own.twist))
        terms = np.stack([
            np.where(moving, np.square(one).sum(axis=1), 0.0)
            for one in (level - np.hstack((rate[:, :2], still)), stated - np.hstack((odom, still)), rate[:, :2])
        ])  # fmt: skip
        misfit = np.cumsum(np.concatenate((self._misfit[:, None], terms), axis=1), axis=1)
        self._misfit, (in_body, in_odom, motion) = misfit[:, -1], misfit[:, 1:]
        # as the latest message decides that tells them apart
        pairs = (in_body, in_odom), (in_odom, in_body)
        decides = [(_FITS * bad > good) & (bad > _MISFIT * motion) for bad, good in pairs]
        latest = np.maximum.accumulate(np.where(decides[0] | decides[1], np.arange(1, len(rate) + 1), 0))
        axes = np.concatenate(([self.odom_axes], decides[0]))[latest]
        self.odom_axes = bool(axes[-1])
        if not axes.any():
            return found
        rows = np.flatnonzero(axes)
        added, covariance, clean = found.added.copy(), found.covariance.copy(), rate.copy()
        noisy_rad = heading_rad[rows, 1]
        forward, left = (rate + added)[rows, :2].T
        noisy = np.stack(rotated(forward, left, noisy_rad), axis=1)
        added[rows, :2], clean[rows, :2] = noisy - odom[rows], odom[rows]
        turn = np.zeros((len(rows), 3, 3))
        turn[:, 0, 0] = turn[:, 1, 1] = np.cos(noisy_rad)
        turn[:, 1, 0] = np.sin(noisy_rad)
        turn[:, 0, 1], turn[:, 2, 2] = -turn[:, 1, 0], 1.0
        covariance[rows] = turn @ covariance[rows] @ turn.transpose(0, 2, 1)
        # an error of the heading turns the velocity, whose own error counts: of a robot that only seems to stand, too
        faster = np.where((np.hypot(*noisy.T) < np.hypot(*odom[rows].T))[:, None], odom[rows], noisy)
        square = covariance[rows, :2, :2] + faster[:, :, None] * faster[:, None, :]
        yaw = pose_covariance(at.sums[:, rows], np.zeros((2, len(rows))))[:, 2, 2]
        covariance[rows, :2, :2] += yaw[:, None, None] * square[:, ::-1, ::-1] * [[1.0, -1.0], [-1.0, 1.0]]
        return TwistChange(found.known, added, covariance, clean, axes)


_SEEN = np.array([0, 1, 3, 4])
_FITS, _MISFIT = 0.25, 0.01
"""Parts of sums of squares: below the first one axes fit better than others, above the second those do not fit."""


PLANAR_BLOCK = (6 * PLANAR[:, None] + PLANAR).ravel()
"""Where their covariances stand in a row-major 6 x 6 matrix."""


class Target(NamedTuple):
    """n messages of one layout, and the item in them that the correction moves.

    side : whether the correction multiplies the pose from the left or from the right
    stamps_ns, time_ns : (n,) header stamps, and log times as running maxima
    follows : how numbers of the messages follow the motion, of another sensor than the odometry; {} if they do not
    """

    channel: Channel
    layout: Layout
    item: Item
    side: Side
    stamps_ns: NDArray[np.int64]
    time_ns: NDArray[np.int64]
    follows: Relations | None = None


@dataclass(slots=True, eq=False, repr=False)
class Changes:
    """Counts of moved messages: by topic, by edge "parent -> child", and those stamped after the end of C(t).

    static : edges on /tf_static, which cannot follow a drift
    odom_axes : topics whose twists are in the axes of the odom frame
    sensors : topics of other sensors that are rewritten
    noisy : messages with noise of their own, by topic
    paths : tests of edges for two publishers
    """

    odometry: Counter[str] = field(default_factory=Counter)
    edges: Counter[str] = field(default_factory=Counter)
    static: set[str] = field(default_factory=set)
    odom_axes: set[str] = field(default_factory=set)
    sensors: set[str] = field(default_factory=set)
    noisy: Counter[str] = field(default_factory=Counter)
    paths: defaultdict[str, Alternation] = field(default_factory=lambda: defaultdict(Alternation))
    held: int = 0


class Patcher:
    """Applies the correction to messages, topic by topic."""

    def __init__(self, model: MotionModel, *, keep_twist: bool, keep_covariance: bool) -> None:
        self.changes = Changes()
        self._clocks = tuple(e for e in model.effects if e.clock and e.acts)
        self._steps = model.setup.pose_corrections
        acts = any(e.acts for e in model.effects if not e.clock) or self._steps
        self._moves = acts or not model.noise.coefficients.noise_free
        self._restores = any(e.restorable for e in model.effects)
        self._twist = not keep_twist
        drawn = any(has_random_part(e, model.track_m) for e in model.effects)
        self._covariance = not keep_covariance and (drawn or not model.noise.coefficients.noise_free)
        self._twists: dict[str, TopicTwist] = {}
        self._sensors = Rewriter()

    @np.errstate(over="ignore", invalid="ignore")  # NaN and infinite poses stay as they are
    def patch(self, block: Block, targets: list[Target], curve: Curve, first_ns: int) -> None:
        """Apply C(t) to a block's targets in place; first_ns is the first stamp, the origin of clock effects."""
        odometry: dict[str, list[tuple[Target, Correction]]] = {}
        paths: dict[str, list[tuple[NDArray[np.int64], Array]]] = defaultdict(list)
        for target in targets:
            at = curve.at(target.stamps_ns, target.time_ns)
            if target.follows is not None:
                if self._moves and target.follows:
                    self.changes.sensors.add(target.channel.topic)
                    own = target.channel.id, target.layout, target.follows, target.stamps_ns
                    self._sensors.rewrite(block, *own, at.added, at.stretch)
                continue
            self.changes.held += int(np.count_nonzero(at.held))
            if target.channel.msgtype == ODOMETRY:
                self.changes.odometry[target.channel.topic] += len(target.stamps_ns)
                odometry.setdefault(target.channel.topic, []).append((target, at))
            else:
                item = target.item
                edge = f"{plain(item.frame_id)} -> {plain(item.child_frame_id)}"
                self.changes.edges[edge] += len(target.stamps_ns)
                self.changes.static |= {edge} if target.channel.topic.endswith("tf_static") else set()
                poses = poses_in(block, target.layout, target.item)
                paths[edge].append((target.layout.rows, poses.position))
                if self._moves:
                    _move(block, target, at.xyt, poses)
            if self._clocks:
                self._shift_stamps(block, target, first_ns)
        for edge, of_each in paths.items():  # of all publishers
            rows, xyz = (np.concatenate(one) for one in zip(*of_each, strict=True))
            self.changes.paths[edge].take(xyz if len(of_each) == 1 else xyz[np.argsort(rows, kind="stable")])
        if self._moves:
            for topic, parts in odometry.items():
                self._patch_odometry(block, topic, parts)

    def _patch_odometry(self, block: Block, topic: str, parts: list[tuple[Target, Correction]]) -> None:
        motions = []
        for target, at in parts:
            poses = poses_in(block, target.layout, target.item)
            if self._twist:
                twist = np.asfortranarray(gather(block, target.layout, target.item, "twist"))
                motions.append(Motions(target.stamps_ns, planar_poses(poses), poses.quat_xyzw, twist))
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
            self._patch_twist(block, parts[0][0], motions[0], follower.change(motions[0], parts[0][1]))
        else:
            order = np.argsort(np.concatenate([target.layout.rows for target, _ in parts]))
            every = Motions._make(np.concatenate(column) for column in zip(*motions, strict=True))
            change = follower.change(every.take(order), Correction.joined([at for _, at in parts]).take(order))
            ends = np.cumsum([len(own.stamps_ns) for own in motions])[:-1]
            for (target, _), own, rows in zip(parts, motions, np.split(np.argsort(order), ends), strict=True):
                self._patch_twist(block, target, own, change.take(rows))
        if follower.odom_axes:
            self.changes.odom_axes.add(topic)

    def _patch_twist(self, block: Block, target: Target, own: Motions, change: TwistChange) -> None:
        added, yaw = change.added, own.xyt[:, 2]
        tilted, turn = tilted_rows(own.quat_xyzw), np.zeros((0, 3, 3))
        if len(tilted):
            tilted = tilted[~change.odom_axes[tilted] & np.isfinite(yaw[tilted])]
            turn = tilts(own.quat_xyzw[tilted], yaw[tilted])
        moved = change.known & added.any(axis=1) & finite_rows(added)
        if moved.any():
            twist = own.twist
            if self._restores or self._steps:
                level = np.where(change.odom_axes[:, None], twist, in_level_frame(twist, own.quat_xyzw, yaw))
                size2 = np.sum(added**2, axis=1)
                # twists that, less the pose's rates, already contain the motion
                has = np.sum((level[:, PLANAR] - change.clean) * added, axis=1) > 0.5 * size2
                # smallest motion that counts as a restored loss, as a fraction of the pose's: of both wheels, the pose
                # stands; of one, it moves as much as is lost
                loss = size2 >= 0.3**2 * np.sum(change.clean**2, axis=1)
                moved &= ~(has & (loss | self._steps))
            rows = slice(None) if moved.all() else np.flatnonzero(moved)
            more = np.zeros_like(twist)
            more[:, PLANAR] = added
            if len(tilted):
                more[tilted] = (_planar_axes(turn) @ added[tilted, :, None])[:, :, 0]
            twist[rows] += more[rows]
            scatter(block, target.layout, target.item, "twist", twist)
        if self._covariance:
            upright = change.known.copy()
            upright[tilted] = False
            _set_planar(block, target, "twist_covariance", change.covariance, slice(None) if upright.all() else upright)
            keep = change.known[tilted]
            if keep.any():
                _set_tilted(block, target, tilted[keep], _planar_axes(turn[keep]), change.covariance[tilted[keep]])

    def _shift_stamps(self, block: Block, target: Target, first_ns: int) -> None:
        t_s = (target.stamps_ns - first_ns) * np.float64(1e-9)
        shift_s = sum(effect.stamp_shift_s(t_s) for effect in self._clocks)
        shift_ns = np.rint(np.asarray(shift_s) * 1e9).astype(np.int64)
        written = gather_stamps_ns(block, target.layout, target.item)
        # a stamp of zero means "no stamp" and stays zero
        scatter_stamps_ns(block, target.layout, target.item, written + np.where(written == 0, 0, shift_ns))


def _move(block: Block, target: Target, correction_xyt: Array, poses: SpatialPoses) -> SpatialPoses:
    """Apply a correction (n, 3) to poses in place; return the moved poses.

    Poses with a zero correction, or that are not finite, keep their bytes.
    """
    moved = correction_xyt.any(axis=1) & finite_rows(poses.position) & finite_rows(poses.quat_xyzw)
    if not moved.any():
        return poses
    act = from_left if target.side == "left" else from_right
    if moved.all():
        out = act(correction_xyt, poses)
    else:
        out = SpatialPoses(poses.position.copy(), poses.quat_xyzw.copy())
        some = act(correction_xyt[moved], SpatialPoses(poses.position[moved], poses.quat_xyzw[moved]))
        out.position[moved], out.quat_xyzw[moved] = some.position, some.quat_xyzw
    whole = target.item._replace(fields={"pose": (target.item.fields["position"][0], 7)})
    scatter(block, target.layout, whole, "pose", np.concatenate(out, axis=1))
    return out


def _set_planar(block: Block, target: Target, name: str, covariance: Array, which: slice | NDArray[np.bool_]) -> None:
    """Replace the entries of x, y and yaw in a 6 x 6 covariance."""
    scatter_columns(block, target.layout, target.item, name, PLANAR_BLOCK, [*covariance.reshape(-1, 9).T], which)


def _planar_axes(turn: Array) -> Array:
    """Return the maps (n, 6, 3) of planar twists in level frames to twists in child frames; turn as of `tilts`."""
    out = np.zeros((len(turn), 6, 3))
    out[:, :3, :2] = turn[:, :2].transpose(0, 2, 1)
    out[:, 3:, 2] = turn[:, 2]
    return out


def _set_tilted(block: Block, target: Target, rows: NDArray[np.int64], axes: Array, covariance: Array) -> None:
    """Replace the planar part of the 6 x 6 covariances of twists in tilted child frames.

    Of the covariance as it was, each axis keeps the part that lies outside the plane of motion.

    axes : (n, 6, 3) as of `_planar_axes`
    covariance : (n, 3, 3) in level frames
    """
    flat = gather(block, target.layout, target.item, "twist_covariance")
    before = flat[rows].reshape(-1, 6, 6)
    outside = np.sqrt(np.maximum(1.0 - np.square(axes).sum(axis=2), 0.0))
    both = outside[:, :, None] * outside[:, None, :]
    planar = axes @ covariance @ axes.transpose(0, 2, 1)
    after = planar + np.where(both > 0.0, both * before, 0.0)
    diagonal = np.arange(6)
    # a negative variance means "unknown" there, and lowers none here
    after[:, diagonal, diagonal] = np.fmax(after[:, diagonal, diagonal], planar[:, diagonal, diagonal])
    flat[rows] = after.reshape(-1, 36)
    scatter(block, target.layout, target.item, "twist_covariance", flat)
