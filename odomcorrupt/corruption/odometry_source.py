"""The odometry source, a topic or a TF edge, whose poses the model is applied to; and the edges that move with it."""

from __future__ import annotations

import re
import struct
from functools import reduce
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from odomcorrupt.bags.messages import TRANSFORMS, locate
from odomcorrupt.corruption.pose_faults import PoseFaults
from odomcorrupt.corruption.reorder import Arrivals
from odomcorrupt.errors import TopicError
from odomcorrupt.sensors import SENSORS

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from numpy.typing import NDArray

    from odomcorrupt.bags.block import BagReader, Block, Channel
    from odomcorrupt.bags.messages import Layout


ODOMETRY = "nav_msgs/msg/Odometry"
ENCODINGS = frozenset({"cdr", "ros1"})

GLOBAL_FRAMES = frozenset({"map", "world", "earth", "utm"})
"""Frames above odom, whatever namespace they carry: an edge between odom and one of them is localisation."""

_LOCALISED = "geometry_msgs/msg/PoseWithCovarianceStamped"

Side = Literal["left", "right"]


class Frames(NamedTuple):
    """The odom and base frames, without leading slashes; base is None if unknown."""

    odom: str
    base: str | None


def plain(name: str) -> str:
    """Return a frame or topic name without leading slashes, for comparisons."""
    return name.lstrip("/")


def tree_of(topic: str, channels: Iterable[Channel]) -> str:
    """Return the namespace of the TF topic whose tree contains the frames of a topic's messages, without slashes.

    Of a bag's TF topics it is the one with the longest namespace that the topic is in, "" if there is none; a topic
    outside all namespaces belongs to the only TF topic.

    channels : all channels of the bag
    """
    spaces = {_space(c.topic) for c in channels if c.msgtype in TRANSFORMS}
    space = _space(topic)
    if not space and len(spaces) == 1:
        return spaces.pop()
    return max((one for one in spaces if f"{space}/".startswith(f"{one}/") and one), key=len, default="")


def _space(topic: str) -> str:
    return plain(topic).rpartition("/")[0]


_TRUTH = re.compile(r"truth|(^|[/_])gt([/_]|$)|mocap|vicon|optitrack|motion_capture|qualisys")


def says_truth(topic: str) -> bool:
    """Return whether a topic's name marks it as ground truth, which the correction must not move."""
    return bool(_TRUTH.search(topic.lower()))


def find_odometry(channels: Iterable[Channel], asked: str | None, bag: str, usual: str | None = None) -> str:
    """Return the topic of the odometry source.

    channels : all channels of the bag
    asked : requested topic; None for the only odometry topic that is not named like a truth
    bag : name of the bag, for error messages
    usual : topic that is taken where there are several and it is among them: the one that a model was learned from

    Raises
    ------
    TopicError
        If there is none, or several and none was chosen.
    """
    channels = tuple(channels)
    topics = sorted({c.topic for c in channels if c.msgtype == ODOMETRY and c.encoding in ENCODINGS})
    found = ", ".join(sorted({c.topic for c in channels})) or "no topic at all"
    if asked is not None:
        if same := [topic for topic in topics if plain(topic) == plain(asked)]:
            return same[0]
        kinds = sorted({f"{c.msgtype} in {c.encoding}" for c in channels if plain(c.topic) == plain(asked)})
        if kinds:
            raise TopicError(f"{bag}: {asked} is {', '.join(kinds)}; --odom-topic must name a nav_msgs/Odometry")
        offer = f"nav_msgs/Odometry is on {', '.join(topics)}" if topics else f"found {found}"
        raise TopicError(f"{bag}: no topic {asked} ({offer}); name another one with --odom-topic")
    if not topics:
        way_out = "there is nothing to corrupt"
        if any(c.msgtype in TRANSFORMS for c in channels):
            way_out = "to corrupt TF alone, name its edge with --odom-frame and --base-frame"
        other = sorted({f"{c.topic} is nav_msgs/Odometry in {c.encoding}" for c in channels if c.msgtype == ODOMETRY})
        unread = f"; {', '.join(other)}, which is not read: CDR and the serialisation of ROS 1 are" if other else ""
        raise TopicError(f"{bag}: no nav_msgs/Odometry topic (found {found}){unread}; {way_out}")
    topics = [topic for topic in topics if not says_truth(topic)] or topics
    same = [topic for topic in topics if usual is not None and plain(topic) == plain(usual)]
    if len(topics) > 1 and not same:
        found = f"{len(topics)} nav_msgs/Odometry topics ({', '.join(topics)})"
        raise TopicError(f"{bag}: {found}; name the one that drives the model with --odom-topic")
    return same[0] if same else topics[0]


def side_of(parent: str, child: str, frames: Frames) -> Side | None:
    """Return the side from which the correction acts on the transform parent -> child; None where it does not.

    Edges between odom and its ancestors are localisation and are not moved. Of the edges that end in odom, only that
    from base is odometry (inverted).

    parent, child : frames of the transform, without leading slashes
    frames : odom and base frame
    """
    parent, child = plain(parent), plain(child)
    if parent == frames.odom and last_part(child) not in GLOBAL_FRAMES:
        return "left"
    if child == frames.odom and frames.base is not None and parent == frames.base:
        return "right"
    return None


def localisation_side_of(parent: str, child: str, frames: Frames) -> Side | None:
    """Return the side from which the correction acts on localisation edges, so that map -> base stays true."""
    if side_of(parent, child, frames) is not None:
        return None
    if plain(child) == frames.odom:
        return "right"
    return "left" if plain(parent) == frames.odom else None


def contains_truth(topic: str, parent: str, child: str, frames: Frames) -> bool:
    """Return whether an edge of TF that stays contains the true motion of the robot, or of its wheels."""
    if "static" in topic or localisation_side_of(parent, child, frames) or last_part(plain(child)) in GLOBAL_FRAMES:
        return False
    named = any(says_truth(name) for name in (topic, parent, child))
    return named or last_part(plain(parent)) in GLOBAL_FRAMES or "wheel" in child.lower()


def localisation_words(edges: Mapping[str, str], frames: Frames, channels: Iterable[Channel] = ()) -> list[str]:
    """Return a sentence on localisation that stays, without a full stop; none where there is no localisation.

    edges : topics of the edges of TF that stay, "parent -> child"; channels : all of the bag
    """
    pairs = ((topic, *edge.split(" -> ")) for edge, topic in sorted(edges.items()) if "static" not in topic)
    tf = [f"{topic}:{parent}.{child}" for topic, parent, child in pairs if localisation_side_of(parent, child, frames)]
    poses = {c.topic for c in channels if c.msgtype == _LOCALISED and not says_truth(c.topic)}
    every = [*tf, *sorted(topic for topic in poses if last_part(topic) not in SETPOINT_TOPICS)]
    way_out = f"leave it out with {' '.join(f'--exclude-topic {one}' for one in every)} and localise again"
    moved = ", or move TF with --keep-localisation" if tf else ""
    return [f"recorded localisation stays, and is of the true odometry: {way_out}{moved}"] if every else []


def last_part(frame: str) -> str:
    """Return a frame, topic or type without its namespace."""
    return frame.rsplit("/", 1)[-1]


def has_poses(channel: Channel) -> bool:
    """Return whether a channel's messages are odometry or transforms that can be read."""
    return channel.encoding in ENCODINGS and (channel.msgtype == ODOMETRY or channel.msgtype in TRANSFORMS)


def frames_of(stated: str, child: str, odom_frame: str | None, base_frame: str | None) -> Frames | None:
    """Return the frames of odometry, or those requested; None if its own frame is a global one, and none was requested.

    stated, child : frames of its messages
    """
    if odom_frame is None and (not plain(stated) or last_part(plain(stated)) in GLOBAL_FRAMES):
        return None
    base = plain(base_frame if base_frame is not None else child)
    return Frames(plain(stated if odom_frame is None else odom_frame), base or None)


class OdometrySource:
    """Odometry source of a bag: finds its topic and reads its poses.

    usual : topic to take where there are several and none was requested
    topic : its topic, as requested until the first message (of one publisher as TOPIC@NODE); None for any TF topic
    frames : of its first message, or of the options
    by_edge : whether the source is a TF edge
    faults : counts of unusable poses
    """

    def __init__(
        self, topic: str | None, odom_frame: str | None, base_frame: str | None, usual: str | None = None
    ) -> None:
        asked, _, node = (topic or "").partition("@")
        self.topic = self._asked = asked or None
        self._node = plain(node)
        self._usual = usual
        self.frames: Frames | None = None
        self._odom_frame = odom_frame
        self._base_frame = base_frame
        self.by_edge = False
        self.faults = PoseFaults()
        self._edges: set[str] = set()
        self._edge_topics: set[str] = set()
        self._channels: Mapping[int, Channel] = {}
        self._node_of: Callable[[Channel], str] = lambda _: ""

    @property
    def elsewhere(self) -> str:
        """Advice to name another topic, or an edge of TF with its frames, as the end of an error message."""
        if self.by_edge and self._edges:
            return (
                f" (TF has {', '.join(sorted(self._edges)[:12])}); name one of these with --odom-frame and --base-frame"
            )
        return "; name another topic with --odom-topic"

    @property
    def one_publisher(self) -> str:
        """Advice where two publishers share the source."""
        topics = {c.topic: "" for c in self._channels.values() if c.msgtype == ODOMETRY and c.encoding in ENCODINGS}
        others = ", ".join(topic for topic in topics if self.topic is None or plain(topic) != plain(self.topic))
        named = f"name the odometry of one with --odom-topic ({others}), or " if others else ""
        nodes = self._publishers()
        if len(nodes) > 1:
            return f"{named}choose one of its nodes with --odom-topic {' or '.join(nodes)}"
        return f"{named}record the topic of one node alone"

    @property
    def name(self) -> str:
        """Name of the source for messages to the user."""
        if self.by_edge and self.frames is not None:
            return f"TF {self.frames.odom} -> {self.frames.base}"
        return self.topic or ""

    def prepare(self, reader: BagReader, name: str) -> None:
        """Find the source's topic before anything is read or written.

        Raises
        ------
        TopicError
            If there is none, or several, or the channels of a pipe do not decide it yet.
        """
        self._channels = reader.channels
        self._node_of = lambda channel: plain(reader.definition(channel).metadata.get("callerid", ""))
        if self._asked is not None and hasattr(reader, "renamed"):
            self.topic = self._asked = reader.renamed(self._asked)
        if not reader.complete:
            if self._asked is None:
                raise TopicError(
                    f"{name}: on a pipe topics are not known beforehand; name the odometry with --odom-topic"
                )
            return
        channels = reader.channels.values()
        readable = [c for c in channels if c.encoding in ENCODINGS]
        asked = {c.msgtype for c in readable if self._asked is None or plain(c.topic) == plain(self._asked)}
        if None not in (self._odom_frame, self._base_frame) and asked & TRANSFORMS and ODOMETRY not in asked:
            self._use_edge()
        else:
            self.topic = find_odometry(channels, self._asked, name, self._usual)
        nodes = self._publishers() if self._node else []
        if self._node and not any(one.endswith(f"@/{self._node}") for one in nodes):
            found = f"there are {', '.join(nodes)}" if nodes else "only ROS 1 bags that stay so say nodes"
            raise TopicError(f"{name}: {self.name} has no publisher /{self._node} ({found}); name another one")

    def _publishers(self) -> list[str]:
        """Return the publishers of the source's topic, as TOPIC@NODE, as far as the bag says."""
        kinds, topic = TRANSFORMS if self.by_edge else {ODOMETRY}, self._asked if self.by_edge else self.topic
        own = [c for c in self._channels.values() if c.msgtype in kinds and plain(topic or c.topic) == plain(c.topic)]
        return sorted({f"{c.topic}@/{node}" for c in own if (node := self._node_of(c))})

    def _use_edge(self) -> None:
        self.by_edge = True
        self.frames = Frames(plain(self._odom_frame or ""), plain(self._base_frame or ""))

    def is_odometry(self, channel: Channel) -> bool:
        """Return whether a channel carries the odometry source."""
        own = channel.msgtype == ODOMETRY and self.topic is not None and plain(channel.topic) == plain(self.topic)
        return own and (not self._node or self._node_of(channel) == self._node)

    def shares_tree(self, channel: Channel) -> bool:
        """Return whether a channel's frames are those of the source: of the same TF tree, not of another robot's."""
        topic = next(iter(self._edge_topics), self.topic) if self.by_edge else self.topic
        if topic is None or plain(topic) == plain(channel.topic):
            return True
        channels = self._channels.values()
        return tree_of(topic, channels) == tree_of(channel.topic, channels)

    def read_block(self, block: Block, reader: BagReader) -> Arrivals:
        """Return the source's poses in a block of a bag, as they arrived by the log times."""
        own = [reader.channels[number] for number in sorted(block.present())]
        parts = [(channel, layout) for channel in own if has_poses(channel) for layout in locate(block, channel)]
        return self.read(block, parts, block.table["log_ns"])

    def read(self, block: Block, parts: list[tuple[Channel, Layout]], time_ns: NDArray[np.int64]) -> Arrivals:
        """Return the source's poses in a block, in the order of its messages."""
        if self.frames is None and not self.by_edge:
            self._recognise(parts)
        found = []
        for channel, layout in parts:
            if self.by_edge:
                self._edges |= {f"{plain(item.frame_id)} -> {plain(item.child_frame_id)}" for item in layout.items}
                asked = plain(self._asked or channel.topic) == plain(channel.topic)
                asked &= not self._node or self._node_of(channel) == self._node
                edges = [{plain(item.frame_id), plain(item.child_frame_id)} for item in layout.items] if asked else []
                items = [layout.items[i] for i, edge in enumerate(edges) if edge == set(self.frames or ())]
                if items and not self.shares_tree(channel):  # of several robots, with equal frames
                    topics = ", ".join(sorted({*self._edge_topics, channel.topic}))
                    raise TopicError(
                        f"{self.name}: is on {topics}, of several robots; name one of these with --odom-topic"
                    )
                self._edge_topics |= {channel.topic} if items else set()
            else:
                items = [layout.items[0]] if self.is_odometry(channel) else []
            for item in items:
                side = None if self.frames is None else side_of(item.frame_id, item.child_frame_id, self.frames)
                stamps_ns, xyt = self.faults.read(block, layout, item, inverse=side == "right")
                found.append((layout.rows, Arrivals(stamps_ns, time_ns[layout.rows], xyt)))
        if not found:
            none = np.zeros(0, dtype=np.int64)
            return Arrivals(none, none, np.zeros((0, 3)))
        if len(found) == 1:
            return found[0][1]
        order = np.argsort(np.concatenate([rows for rows, _ in found]), kind="stable")
        return reduce(Arrivals.followed_by, [poses for _, poses in found]).take(order)

    def _recognise(self, parts: list[tuple[Channel, Layout]]) -> None:
        """Set topic and frames from the first odometry message, or from the TF edge where there is none."""
        if driving := [(channel, layout) for channel, layout in parts if self.is_odometry(channel)]:
            channel, layout = min(driving, key=lambda part: int(part[1].rows[0]))
            self.topic, item = channel.topic, layout.items[0]
            self.frames = frames_of(item.frame_id, item.child_frame_id, self._odom_frame, self._base_frame)
            if self.frames is None:
                raise TopicError(
                    f"{self.topic}: its messages are in frame {item.frame_id!r}, which is not an odometry frame; name "
                    "the frame that is to drift with --odom-frame"
                )
        elif self._odom_frame is not None and self._base_frame is not None and self._asked is not None:
            asked = plain(self._asked)
            if any(channel.msgtype in TRANSFORMS and plain(channel.topic) == asked for channel, _ in parts):
                self._use_edge()


MOTION_TYPES = frozenset({
    "AccelStamped", "AccelWithCovarianceStamped", "DynamicJointState", "EstimatorStates", "Feedback", "GPSFix",
    "GeoPointStamped", "GeoPoseStamped", "Imu", "JointState", "LinkStates", "LynxMultiFeedback", "MagneticField",
    "ModelStates", "MultiDOFJointState", "NavPVT", "NavSatFix", "Odometry", "ParticleCloud", "Path", "PointStamped",
    "Pose", "Pose2D", "PoseArray", "PoseStamped", "PoseWithCovariance", "PoseWithCovarianceStamped",
    "PumaMultiFeedback", "SensorCombined", "SensorGps", "SensorState", "TransformStamped", "TwistStamped",
    "TwistWithCovariance", "TwistWithCovarianceStamped", "VehicleAcceleration", "VehicleAngularVelocity",
    "VehicleAttitude", "VehicleGlobalPosition", "VehicleImu", "VehicleLocalPosition", "VehicleOdometry",
    "VelocityReport", "VescStateStamped",
})  # fmt: skip
"""Messages that carry motion or poses, of whatever package: last part of the type."""

_WHEELS = re.compile(
    r"(?i)(?<!steering[_/])wheels?([_/]?(tick|vel|speed|stat|odom|enc|rpm|angle|pos|count|left|right)|$)|ticks?\b|encoder|rpm"
)
"""Types, or topics of plain numbers, that carry the motion of wheels."""

_COMMANDS = re.compile(r"cmd|command|target|setpoint|desired|reference")

SETPOINT_TOPICS = frozenset({"clicked_point", "cmd_vel", "goal", "goal_pose", "initialpose"})
"""Topics that say where a robot should be, not where it is: last part of the name."""

FRAMED_TYPES = {
    "sensor_msgs/msg/PointCloud2": 0,
    "nav_msgs/msg/GridCells": 0,
    "nav_msgs/msg/OccupancyGrid": 0,
    "map_msgs/msg/OccupancyGridUpdate": 0,
    "nav2_msgs/msg/Costmap": 0,
    "nav2_msgs/msg/VoxelGrid": 0,
    "geometry_msgs/msg/PolygonStamped": 0,
    "visualization_msgs/msg/Marker": 0,
    "visualization_msgs/msg/MarkerArray": 4,
}
"""Message types that contain the true motion if given in the odom frame, and the byte of their (first) header."""

PLACED_TYPES = FRAMED_TYPES.keys() - {"sensor_msgs/msg/PointCloud2", "nav2_msgs/msg/VoxelGrid"}
"""Those that are read for their frame's sake alone."""


def can_be_consistent(channel: Channel) -> bool:
    """Return whether a channel's numbers can be rewritten to the noisy motion: of a known type, and no command."""
    name = channel.topic.lower()
    known = channel.msgtype in SENSORS and channel.encoding in ENCODINGS and not says_truth(name)
    if not known or _COMMANDS.search(name) or last_part(name) in SETPOINT_TOPICS:
        return False
    return not channel.msgtype.startswith("std_msgs") or _of_wheels(channel)


def topics_with_true_motion(
    channels: Iterable[Channel], moved: Iterable[str], frames: Mapping[int, str], odom_frame: str
) -> list[str]:
    """Return the unmodified topics with messages that contain the true motion, without those of other robots.

    moved : topics that are moved
    frames : by channel id, those of `frame_of`
    """
    channels, moved = tuple(channels), set(moved)
    trees = {tree_of(topic, channels) for topic in moved}
    return sorted({
        c.topic
        for c in channels
        if c.topic not in moved
        and (not trees or tree_of(c.topic, channels) in trees)
        and last_part(c.topic) not in SETPOINT_TOPICS
        and (
            last_part(c.msgtype) in MOTION_TYPES
            or _of_wheels(c)
            or frames.get(c.id) == plain(odom_frame)
            or (c.msgtype in FRAMED_TYPES and "costmap" in c.topic)  # centred on the robot even in the map frame
        )
    })  # fmt: skip


def _of_wheels(channel: Channel) -> bool:
    """Return whether a channel carries what wheels did, by its type, or the name of a topic of plain numbers."""
    package, _, kind = channel.msgtype.rpartition("/")
    said = channel.topic if package.startswith("std_msgs") else kind
    return bool(_WHEELS.search(said)) and not _COMMANDS.search(channel.topic.lower())


def frame_of(block: Block, channel: Channel) -> str | None:
    """Return the frame of a channel's first message in a block, without leading slashes.

    None where its type has none, or the message is too short.
    """
    offset = FRAMED_TYPES.get(channel.msgtype)
    rows = np.flatnonzero(block.table["channel"] == channel.id)
    if offset is None or channel.encoding not in ENCODINGS or not len(rows):
        return None
    row = block.table[rows[0]]
    data = block.data[int(row["offset"]) : int(row["offset"]) + min(int(row["length"]), 1 << 12)].tobytes()
    # offset: the header's stamp, its sequence number in ROS 1, the four CDR bytes in ROS 2
    start = offset + 12
    order = "<" if channel.encoding == "ros1" or data[1:2] == b"\1" else ">"
    if len(data) < start + 4:
        return None
    (length,) = struct.unpack_from(f"{order}I", data, start)
    return plain(data[start + 4 : start + 4 + length].rstrip(b"\0").decode(errors="replace"))
