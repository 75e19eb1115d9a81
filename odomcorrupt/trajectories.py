"""Whole trajectories of a bag: its odometry, other poses, and odometry integrated from velocities."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np

from odomcorrupt.bags.messages import TRANSFORMS, gather, locate, located, scatter, stamps_or_log_ns
from odomcorrupt.bags.open import open_reader, open_writer
from odomcorrupt.corruption.odometry_source import ODOMETRY, Frames, find_odometry, plain, side_of, tree_of
from odomcorrupt.corruption.se2_on_se3 import PLANAR, from_left, from_right, poses_in
from odomcorrupt.errors import ModelError, RecordingError, TopicError
from odomcorrupt.geometry.se2 import compose, inverse, yaw_from_quaternion
from odomcorrupt.geometry.trajectory import Trajectory, distance_along
from odomcorrupt.rng import stream

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from odomcorrupt.bags.block import BagReader, Channel
    from odomcorrupt.geometry.se2 import Array


POSES = (ODOMETRY, "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/PoseWithCovarianceStamped")


@dataclass(frozen=True, slots=True)
class Drive:
    """Odometry of a drive: n messages with strictly increasing stamps.

    frame_id, child_frame_id : as in the first message
    stamps_ns : (n,) header stamps
    xyt : (n, 3) poses, metres and radians, headings unwrapped
    twist : (n, 3) vx, vy in m/s and yaw rate in rad/s, in the robot's frame
    notes : messages left out, one sentence each
    """

    topic: str
    frame_id: str
    child_frame_id: str
    stamps_ns: NDArray[np.int64]
    xyt: Array
    twist: Array
    notes: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.stamps_ns)

    @property
    def t_s(self) -> Array:
        """Seconds since the first stamp (n,)."""
        return (self.stamps_ns - self.stamps_ns[0]) * np.float64(1e-9)

    @property
    def distance_m(self) -> Array:
        """Distance travelled (n,) since the first pose, metres."""
        return distance_along(self.xyt)

    @property
    def trajectory(self) -> Trajectory:
        """The poses without the twists."""
        return Trajectory(self.stamps_ns, self.xyt)


def read_drive(path: Path, topic: str | None) -> Drive:
    """Return the odometry of a bag; topic None: its only odometry topic.

    Raises
    ------
    BagError
        If the bag cannot be read.
    TopicError
        If there is no odometry, or several topics and none was chosen.
    RecordingError
        If there are fewer than two usable messages.
    """
    with open_reader(path) as reader:
        name = find_odometry(reader.channels.values(), topic, reader.name)
        channels = [c for c in reader.channels.values() if c.topic == name and c.msgtype == ODOMETRY]
        return _drive(reader, channels, name)


def read_poses(path: Path, topic: str) -> Trajectory:
    """Return the trajectory of an Odometry, PoseStamped or PoseWithCovarianceStamped topic, in its own frame."""
    with open_reader(path) as reader:
        channels = [c for c in reader.channels.values() if plain(c.topic) == plain(topic)]
        if not channels:
            found = ", ".join(sorted({c.topic for c in reader.channels.values()})) or "nothing"
            raise TopicError(f"{reader.name}: no topic {topic} (found {found}); name another one")
        if channels[0].msgtype not in POSES:
            raise TopicError(f"{reader.name}: {topic} is a {channels[0].msgtype}; poses are {', '.join(POSES)}")
        return _drive(reader, channels, topic).trajectory


def find_truth(path: Path) -> str | None:
    """Return the pose topic whose name marks it as ground truth; None if there is none or more than one."""
    with open_reader(path) as reader:
        named = {c.topic for c in reader.channels.values() if c.msgtype in POSES and "truth" in c.topic}
    return named.pop() if len(named) == 1 else None


def _drive(reader: BagReader, channels: list[Channel], topic: str) -> Drive:
    """Return the stamps, poses and twists of the channels of one topic; twists are zero in messages without them."""
    parts: list[tuple[NDArray[np.int64], Array]] = [(np.zeros(0, dtype=np.int64), np.zeros((0, 6)))]
    frames: tuple[str, str] | None = None
    for block, _, layout in located(reader, channels):
        item = layout.items[0]
        frames = frames or (item.frame_id, item.child_frame_id)
        xy = gather(block, layout, item, "position")[:, :2]
        yaw = yaw_from_quaternion(gather(block, layout, item, "orientation"))
        has_twist = "twist" in item.fields
        twist = gather(block, layout, item, "twist")[:, PLANAR] if has_twist else np.zeros((len(yaw), 3))
        parts.append((stamps_or_log_ns(block, layout, item), np.column_stack((xy, yaw, twist))))
    stamps, numbers = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    good = np.isfinite(numbers).all(axis=1)
    # of messages with equal stamps the last one is used: its twist is the one that continues
    kept, index = np.unique(stamps[good][::-1], return_index=True)
    if len(kept) < 2:
        raise RecordingError(f"{reader.name}: {topic} holds {len(kept)} usable messages; it takes two or more")
    unusable, repeated = int(np.count_nonzero(~good)), int(good.sum()) - len(kept)
    notes = [f"{topic}: {unusable} messages without numbers and {repeated} duplicates left out"]
    numbers = numbers[good][::-1][index]
    xyt = numbers[:, :3].copy()
    xyt[:, 2] = np.unwrap(xyt[:, 2])
    frame, child = frames or ("", "")
    return Drive(topic, frame, child, kept, xyt, numbers[:, 3:], tuple(notes) if len(kept) < len(stamps) else ())


Rule = Literal["euler", "midpoint", "exact"]
Hold = Literal["next", "previous"]


def integrate(start_xyt: Array, twist: Array, t_s: Array, rule: Rule, *, hold: Hold = "next") -> Array:
    """Return poses (..., n, 3) at n stamps, the first one being the start.

    start_xyt : (3,) metres and radians
    twist : (..., n, 3) vx, vy in m/s and yaw rate in rad/s, in the robot's frame
    t_s : (n,) ascending times, seconds
    rule : over an interval of constant twist: a straight line along the initial heading (`euler`) or the heading at
        mid-interval (`midpoint`), or the circular arc (`exact`)
    hold : whether a twist holds from its stamp to the next one (`next`), or from the previous one to its own
    """
    for name, word, words in (("rule", rule, get_args(Rule)), ("hold", hold, get_args(Hold))):
        if word not in words:
            raise ModelError(f"{name} {word}: is not one of {', '.join(words)}")
    held = twist[..., :-1, :] if hold == "next" else twist[..., 1:, :]
    step = held * np.diff(t_s)[:, None]
    turn = step[..., 2]
    first = np.broadcast_to(start_xyt[2], (*turn.shape[:-1], 1))
    theta = np.cumsum(np.concatenate((first, turn), axis=-1), axis=-1)
    along = theta[..., :-1] + (0.0 if rule == "euler" else turn / 2.0)
    # length of the chord over that of the arc
    length = np.sinc(turn / (2.0 * np.pi)) if rule == "exact" else 1.0
    c, s = np.cos(along) * length, np.sin(along) * length
    out = np.empty((*theta.shape, 3))
    out[..., 0, :2] = start_xyt[:2]
    out[..., 1:, 0] = c * step[..., 0] - s * step[..., 1]
    out[..., 1:, 1] = s * step[..., 0] + c * step[..., 1]
    out[..., :2] = np.cumsum(out[..., :2], axis=-2)
    out[..., 2] = theta
    return out


def noisy_twists(twist: Array, sd_v: float, sd_omega: float, *, seed: int, runs: range) -> Array:
    """Return twists (runs, n, 3) with independent normal noise of sd_v (m/s) and sd_omega (rad/s) on each.

    The variance of the drift is proportional to the time between messages.
    Run k does not depend on the number of runs drawn.
    """
    if not (np.isfinite([sd_v, sd_omega]).all() and min(sd_v, sd_omega) >= 0.0):
        raise ModelError(f"twist noise: {sd_v} m/s, {sd_omega} rad/s; both must be zero or more")
    out = np.repeat(twist[None], len(runs), axis=0)
    for row, run in zip(out, runs, strict=True):
        draws = stream(seed, run, "twist_noise").standard_normal((len(twist), 2))
        row[:, 0] += sd_v * draws[:, 0]
        row[:, 2] += sd_omega * draws[:, 1]
    return out


@dataclass(frozen=True, slots=True)
class Rewritten:
    """Numbers of moved odometry messages and transforms."""

    messages: int
    transforms: int


def rewrite_path(
    source: Path, target: Path, drive: Drive, xyt: Array, provenance: dict[str, str], *, overwrite: bool = False
) -> Rewritten:
    """Copy a bag with odometry poses replaced by xyt (n, 3), m and rad; return the numbers of moved messages.

    TF edges of the odom frame are moved accordingly, at their own stamps. z, roll and pitch, and all other bytes, are
    kept.
    """
    origin_ns = int(drive.stamps_ns[0])
    correction = Trajectory(drive.stamps_ns, compose(xyt, inverse(drive.xyt)))
    frames = Frames(plain(drive.frame_id), plain(drive.child_frame_id) or None)
    messages = transforms = 0
    with open_reader(source) as reader, open_writer(target, reader, overwrite=overwrite) as writer:
        every = reader.channels.values()
        odometry = {c.id for c in every if c.msgtype == ODOMETRY and c.topic == drive.topic}
        tree = tree_of(drive.topic, every)
        channels = [
            c for c in every if c.id in odometry or (c.msgtype in TRANSFORMS and tree_of(c.topic, every) == tree)
        ]
        for block in reader.blocks():
            for channel in channels:
                for layout in locate(block, channel):
                    for item in layout.items:
                        own = channel.id in odometry
                        side = "left" if own else side_of(item.frame_id, item.child_frame_id, frames)
                        if side is None:
                            continue
                        stamps_ns = np.clip(stamps_or_log_ns(block, layout, item), origin_ns, drive.stamps_ns[-1])
                        at = correction.at((stamps_ns - origin_ns) * np.float64(1e-9), origin_ns)
                        moved = (from_left if side == "left" else from_right)(at, poses_in(block, layout, item))
                        scatter(block, layout, item, "position", moved.position)
                        scatter(block, layout, item, "orientation", moved.quat_xyzw)
                        messages += len(layout.rows) * own
                        transforms += len(layout.rows) * (not own)
            writer.write(block)
        writer.provenance("odomcorrupt", provenance)
    return Rewritten(messages, transforms)
