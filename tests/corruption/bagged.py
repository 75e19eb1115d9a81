"""Bags that exist in memory alone: messages packed by hand, readers that are lists, and what a robot sends."""

import struct
from dataclasses import dataclass, field

import numpy as np
from mcap.writer import Writer

from odomcorrupt.bags.block import TABLE, Block, Channel
from odomcorrupt.bags.messages import gather, gather_stamps_ns, locate
from odomcorrupt.bags.open import open_reader
from odomcorrupt.geometry.se2 import yaw_from_quaternion

ODOM = Channel(1, "/odom", "nav_msgs/msg/Odometry", "cdr")
TF = Channel(2, "/tf", "tf2_msgs/msg/TFMessage", "cdr")
IMU = Channel(3, "/imu", "sensor_msgs/msg/Imu", "cdr")
OTHER = Channel(4, "/filtered", "nav_msgs/msg/Odometry", "cdr")
TRUTH = Channel(5, "/truth", "nav_msgs/msg/Odometry", "cdr")


def _text(out, text):
    out += b"\0" * (-(len(out) - 4) % 4)
    out += struct.pack("<I", len(text) + 1) + text.encode() + b"\0"


def _header(out, stamp_ns, frame):
    out += b"\0" * (-(len(out) - 4) % 4)
    out += struct.pack("<iI", *divmod(int(stamp_ns), 10**9))
    _text(out, frame)


def _doubles(out, values):
    out += b"\0" * (-(len(out) - 4) % 8)
    out += np.asarray(values, dtype="<f8").tobytes()


def quaternion(yaw, roll=0.0, pitch=0.0):
    """The quaternion xyzw of z-y-x Euler angles."""
    cr, sr, cp, sp = np.cos(roll / 2), np.sin(roll / 2), np.cos(pitch / 2), np.sin(pitch / 2)
    cy, sy = np.cos(yaw / 2), np.sin(yaw / 2)
    return np.array(
        [
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
            cr * cp * cy + sr * sp * sy,
        ]
    )


def odometry(stamp_ns, xyt, twist=(0, 0, 0), *, frame="odom", child="base_link", z=0.0, tilt=(0.0, 0.0)):
    out = bytearray(b"\0\1\0\0")
    _header(out, stamp_ns, frame)
    _text(out, child)
    covariance = np.arange(36) / 1000.0
    _doubles(out, [xyt[0], xyt[1], z, *quaternion(xyt[2], *tilt), *covariance])
    _doubles(out, [twist[0], twist[1], 0, 0, 0, twist[2], *(covariance + 1)])
    return bytes(out)


def transforms(*edges):
    """Pack edges (stamp, parent, child, xyt)."""
    out = bytearray(b"\0\1\0\0" + struct.pack("<I", len(edges)))
    for stamp_ns, parent, child, xyt in edges:
        _header(out, stamp_ns, parent)
        _text(out, child)
        _doubles(out, [xyt[0], xyt[1], 0.0, *quaternion(xyt[2])])
    return bytes(out)


def blocks_of(messages, size=40):
    """Cut messages (channel, log_ns, bytes) into blocks of `size` messages, or of the sizes in a list."""
    sizes = [size] * (len(messages) // size + 1) if isinstance(size, int) else list(size)
    out, i = [], 0
    for count in sizes:
        part = messages[i : i + count]
        i += count
        if part:
            lengths = [len(data) for _, _, data in part]
            table = np.zeros(len(part), dtype=TABLE)
            table["channel"] = [channel.id for channel, _, _ in part]
            table["log_ns"] = [log_ns for _, log_ns, _ in part]
            table["length"] = lengths
            table["offset"] = np.cumsum([0, *lengths[:-1]])
            out.append(Block(np.frombuffer(b"".join(data for _, _, data in part), np.uint8).copy(), table))
    assert i >= len(messages)
    return out


@dataclass
class MemoryBag:
    """A reader over blocks."""

    held: list
    channels: dict = field(default_factory=lambda: {c.id: c for c in (ODOM, TF, IMU)})
    complete: bool = True
    kind: str = "mcap"
    name: str = "test.mcap"

    def blocks(self, _only=None):
        yield from self.held


def messages_of(blocks):
    return [
        (int(row["channel"]), int(row["log_ns"]), block.data[row["offset"] : row["offset"] + row["length"]].tobytes())
        for block in blocks
        for row in block.table
    ]


def read(blocks, channel, name, edge=None):
    """Return stamps (n,) and a field (n, count) of a channel's messages, in bag order; `edge` picks a transform."""
    stamps, values = [], []
    for block in blocks:
        found = []
        for layout in locate(block, channel):
            for item in layout.items:
                if edge is None or edge == (item.frame_id, item.child_frame_id):
                    pairs = zip(gather_stamps_ns(block, layout, item), gather(block, layout, item, name), strict=True)
                    found += [(row, s, v) for row, (s, v) in zip(layout.rows, pairs, strict=True)]
        for _, stamp, value in sorted(found, key=lambda entry: entry[0]):
            stamps.append(stamp)
            values.append(value)
    return np.array(stamps), np.array(values)


def planar(blocks, channel=ODOM, edge=None):
    """Return x, y, yaw (n, 3) of a channel's messages, in bag order; `edge` picks a transform."""
    (_, position), (_, quat) = (read(blocks, channel, name, edge) for name in ("position", "orientation"))
    return np.column_stack((position[:, :2], yaw_from_quaternion(quat)))


@dataclass
class Rows:
    """Messages of one topic or edge: stamps (n,), poses (n, 3), and other columns, where the messages have them."""

    stamps_ns: np.ndarray
    xyt: np.ndarray
    columns: dict

    def __getattr__(self, name):
        return self.columns[name]


def rows_of(path, topic="/odom", edge=None):
    """Read a topic of a bag, in the order of its stamps; `edge` (parent, child) picks transforms."""
    stamps, columns = [], {}
    with open_reader(path) as reader:
        channels = [channel for channel in reader.channels.values() if channel.topic == topic]
        found = ((b, layout) for b in reader.blocks() for channel in channels for layout in locate(b, channel))
        for block, layout in found:
            for item in layout.items:
                if edge in (None, (item.frame_id, item.child_frame_id)):
                    stamps.append(gather_stamps_ns(block, layout, item))
                    for name in item.fields:
                        columns.setdefault(name, []).append(gather(block, layout, item, name))
    stamps = np.concatenate(stamps)
    order = np.argsort(stamps, kind="stable")
    columns = {name: np.concatenate(parts)[order] for name, parts in columns.items()}
    yaw = yaw_from_quaternion(columns["orientation"])
    return Rows(stamps[order], np.column_stack((columns["position"][:, :2], yaw)), columns)


def messages_in(path, **options):
    """Return topic, log time and bytes of every message of a bag, in its order."""
    with open_reader(path, **options) as reader:
        return [
            (reader.channels[channel].topic, log_ns, block.data[at : at + size].tobytes())
            for block in reader.blocks()
            for channel, log_ns, at, size in block.table.tolist()
        ]


def write_mcap(path, messages):
    """Write messages (channel, log_ns, bytes) to a file, in their order; return its path."""
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2")
        ids = {}
        for channel, log_ns, data in messages:
            if (channel.id, channel.topic) not in ids:
                schema = writer.register_schema(channel.msgtype, "ros2msg", b"")
                ids[channel.id, channel.topic] = writer.register_channel(channel.topic, "cdr", schema)
            writer.add_message(ids[channel.id, channel.topic], int(log_ns), data, int(log_ns))
        writer.finish()
    return path


def twists(t, poses):
    """Twists whose mid-point integration gives the poses back."""
    dt = np.diff(t) * 1e-9
    turn = np.diff(poses[:, 2])
    middle = poses[:-1, 2] + turn / 2
    dx, dy = np.diff(poses[:, 0]), np.diff(poses[:, 1])
    along, across = np.cos(middle) * dx + np.sin(middle) * dy, np.cos(middle) * dy - np.sin(middle) * dx
    return np.vstack((np.zeros((1, 3)), np.column_stack((along, across, turn)) / dt[:, None]))


def driven(t, poses, *edges, **options):
    """Odometry of a drive, and beside each message transforms: parent, child, and a pose or a function of its."""
    out = []
    for stamp, pose in zip(t, poses, strict=True):
        out.append((ODOM, int(stamp), odometry(stamp, pose, **options)))
        if edges:
            tree = [(stamp, *frames, own(pose) if callable(own) else own) for *frames, own in edges]
            out.append((TF, int(stamp), transforms(*tree)))
    return out


def robot(t, poses, latency_ns=3_000_000):
    """What a robot sends on that drive: odometry, TF a little later, an IMU that is none of our business."""
    out = []
    for stamp, pose, twist in zip(t, poses, twists(t, poses), strict=True):
        log = int(stamp) + latency_ns
        out.append((ODOM, log, odometry(stamp, pose, twist)))
        edges = (
            (stamp, "odom", "base_link", pose),
            (stamp, "map", "odom", (0.5, 0.2, 0.1)),
            (stamp, "base_link", "laser", (0.1, 0.0, 0.0)),
        )
        out.extend(((TF, log + 1000, transforms(*edges)), (IMU, log + 2000, b"\0\1\0\0anything at all")))
    return out
