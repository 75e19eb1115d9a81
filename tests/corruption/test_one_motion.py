"""After corruption every topic states the same noisy motion: generated bags, read by another library, judged by SE(3).

The bags differ in storage, encoding, namespaces, attitude of the child frame, axes of the twists, repetition of
messages, in whether other sensors are made consistent, and in how many laser scans are kept. Nothing here uses the
product but its call.
"""

from __future__ import annotations

import itertools
from collections import Counter
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import get_types_from_msg
from scipy.spatial.transform import Rotation

import odomcorrupt
import rosmessages
from rosmessages import STORES, edge, floats, header, new, odometry, tree

TEXT, SCAN, TICKS = "std_msgs/msg/String", "sensor_msgs/LaserScan", "irobot_create_msgs/WheelTicks"
TOPICS = ("imu", "joint_states", "left_encoder", "ticks")
RADIUS_M, TRACK_M, PER_RAD = 0.05, 0.34, 4000.0
for store in STORES.values():
    text = "std_msgs/Header header\nint32 ticks_left\nint32 ticks_right"
    store.register(get_types_from_msg(text, TICKS.replace("/", "/msg/")))
S = np.sqrt(0.5)
STORAGES = ("ros1", "mcap", "sqlite3", "mcap zstd", "mcap big-endian")
LAYOUTS = ("root", "namespace", "two robots", "prefixes")
ATTITUDES = {
    "level": (0.0, 0.0, 0.0, 1.0), "ramp": (0.0, np.sin(np.pi / 18), 0.0, np.cos(np.pi / 18)),
    "on its side": (S, 0.0, 0.0, S), "upside down": (1.0, 0.0, 0.0, 0.0), "optical": (-0.5, 0.5, -0.5, 0.5),
    "nose down": (0.0, S, 0.0, S), "nose up": (0.0, -S, 0.0, S),
    "leaning": (0.02, -0.013, 0.0, np.sqrt(1.0 - 0.02**2 - 0.013**2)),
}  # fmt: skip
REPEATS = ("none", "same stamp", "0.1 ms later", "held", "ten per stamp", "10 ms stamps")
AXES = ("child", "odom")
SENSORS = ("stay", "consistent")


@dataclass(frozen=True)
class Kind:
    """One combination; `number` is the seed of the drive and of the noise."""

    number: int
    storage: str
    layout: str
    attitude: str
    repeats: str
    axes: str
    sensors: str = "none"
    every: ClassVar = tuple(itertools.product(STORAGES, LAYOUTS, ATTITUDES, REPEATS, AXES, SENSORS))

    @property
    def ros(self) -> int:
        """Generation of the messages."""
        return 1 if self.storage == "ros1" else 2

    @property
    def scan_every(self) -> int:
        """Which laser scans are kept."""
        return 1 + self.number % 3

    @property
    def names(self) -> tuple[str, str]:
        """Odometry and TF topic of the robot that is corrupted."""
        space = "/robot1" if self.layout in ("namespace", "two robots") else ""
        return f"{space}/odom", f"{space}/tf"

    @property
    def both(self) -> bool:
        """Whether the second robot is corrupted, too."""
        return self.layout == "two robots" and self.number % 2 == 1

    @property
    def frames(self) -> tuple[str, str]:
        return ("robot1/odom", "robot1/base") if self.layout == "prefixes" else ("odom", "base_link")


def kinds(count: int, seed: int = 5) -> list[Kind]:
    """Return combinations, spread evenly over all, of drives and noises that depend on the seed."""
    rows = np.random.default_rng(seed).permutation(len(Kind.every))
    return [Kind(seed * 1000 + i, *Kind.every[rows[i % len(rows)]]) for i in range(count)]


def covering(seed: int = 5) -> list[Kind]:
    """Return combinations with every two values of any properties; of attitudes and repeats with axes and sensors."""
    groups = (*itertools.combinations(range(6), 2), (2, 4, 5), (3, 4, 5))
    rng, found = np.random.default_rng(seed), []
    pieces = {row: {(group, *(row[i] for i in group)) for group in groups} for row in Kind.every}
    left = set().union(*pieces.values())
    while left:
        tried = [Kind.every[i] for i in rng.integers(len(Kind.every), size=60)]
        best = max(tried, key=lambda row: len(pieces[row] & left))
        if pieces[best] & left:
            found.append(Kind(seed * 1000 + len(found), *best))
            left -= pieces[best]
    return found


def rates(t_s, position, quat, axes):
    """Twists (n - 1, 6) between poses: the constant one, at the middle of each interval."""
    start, dt = Rotation.from_quat(quat[:-1]), np.diff(t_s)[:, None]
    turn = (start.inv() * Rotation.from_quat(quat[1:])).as_rotvec()
    middle = start * Rotation.from_rotvec(turn / 2)
    world = np.diff(position, axis=0) / dt
    if axes == "odom":
        return np.hstack((world, middle.apply(turn / dt)))
    return np.hstack((middle.inv().apply(world), turn / dt))


@dataclass
class Drive:
    """Messages of one robot: stamps and log times (ns), position (n, 3), quat (n, 4), twist (n, 6).

    measured : rows of the messages with a stamp and a pose of their own
    t, v, w, flat : times (ns), speeds, turn rates and level poses (x, y, yaw) of the robot itself
    """

    stamps: np.ndarray
    logs: np.ndarray
    position: np.ndarray
    quat: np.ndarray
    twist: np.ndarray
    measured: np.ndarray
    t: np.ndarray
    v: np.ndarray
    w: np.ndarray
    flat: np.ndarray


def drive(kind: Kind, start_rad: float) -> Drive:
    rng = np.random.default_rng([kind.number, int(start_rad * 10)])
    n, dt = 200 if kind.sensors == "consistent" else 150, 0.05
    v = 0.5 + 0.2 * np.sin(np.arange(n) * 0.03 + rng.uniform(0, 6))
    w = 0.5 * np.sin(np.arange(n) * 0.05 + rng.uniform(0, 6))
    yaw = start_rad + np.concatenate(([0.0], np.cumsum(w[1:] * dt)))
    middle = yaw - w * dt / 2
    steps = np.column_stack((v * dt * np.cos(middle), v * dt * np.sin(middle), np.zeros(n)))
    steps[0] = rng.uniform(-5, 5, 3)
    position = np.cumsum(steps, axis=0)
    quat = (Rotation.from_euler("z", yaw[:, None]) * Rotation.from_quat(ATTITUDES[kind.attitude])).as_quat()
    t = 1_700_000_000 * 10**9 + np.round(np.arange(n) * dt * 1e9).astype(np.int64)
    stamps, logs, rows = t, t + 2_000_000, np.arange(n)
    measured = np.arange(n)
    if kind.repeats in ("same stamp", "0.1 ms later"):
        rows, later = np.repeat(rows, 2), np.tile([0, 100_000 * (kind.repeats != "same stamp")], n)
        stamps, logs, measured = t[rows] + later, t[rows] + 2_000_000 + np.tile([0, 100_000], n), measured * 2
    elif kind.repeats == "held":
        rows, later = np.repeat(rows, 5), np.tile(np.arange(5) * 10_000_000, n)
        stamps, logs, measured = t[rows] + later, t[rows] + later + 2_000_000, measured * 5
    elif kind.repeats == "ten per stamp":
        stamps, measured = t[rows // 10 * 10], measured[::10]
    elif kind.repeats == "10 ms stamps":
        t = t[0] + (t - t[0]) * (39 if kind.sensors == "consistent" else 7) // 40  # 8.75 ms apart, or 48.75 ms
        stamps, logs = t // 10**7 * 10**7, t + 2_000_000
        measured = np.flatnonzero(np.diff(stamps, prepend=0))
    # twists are those of the stamps, as a driver computes them
    twist = np.zeros((len(rows), 6))
    own = rates((stamps[measured] - stamps[0]) * 1e-9, position[rows[measured]], quat[rows[measured]], kind.axes)
    latest = np.searchsorted(measured, np.arange(len(rows)), side="right") - 1
    twist[:] = own[np.maximum(latest - 1, 0)]
    level = np.column_stack((position[:, :2], yaw))
    return Drive(stamps, logs, position[rows], quat[rows], twist, measured, t, v, w, level)


def robot(kind: Kind, start_rad: float, space: str):
    """Yield (log time, topic, message) of one robot."""
    ros, (odom, base) = kind.ros, kind.frames
    d = drive(kind, start_rad)
    outer = np.random.default_rng(kind.number).uniform(0.1, 1.0, (6, 6))
    covariance = (np.diag([1e-3, 1e-3, 1e6, 1e6, 1e6, 1e-3]) + 1e-5 * (outer + outer.T)).ravel()
    for i, (stamp, log) in enumerate(zip(d.stamps, d.logs, strict=True)):
        place, turn = d.position[i], d.quat[i]
        more = {"frames": (odom, base), "speeds": d.twist[i], "covariances": (covariance, covariance)}
        yield int(log), f"{space}/odom", odometry(ros, stamp, place, turn, **more)
        wheel = edge(ros, stamp, base, "laser", (0.1, 0.2, 0), (0, 0, 0, 1))
        yield int(log) + 1000, f"{space}/tf", tree(ros, edge(ros, stamp, odom, base, place, turn), wheel)
        if i % 20 == 0 and kind.number % 3 == 0:
            above = edge(ros, stamp, "map", odom, (1, 2, 0), (0, 0, S, S))
            yield int(log) + 1500, f"{space}/tf", tree(ros, above)
        if i % 4 == 0:
            limits = (-1.0, 1.0, 0.5, 0.0, 0.1, 0.1, 30.0)
            ranges = np.arange(i, i + 5, dtype=np.float32)
            scan = new(ros, SCAN, header(ros, stamp, "laser"), *limits, ranges, np.zeros(0, dtype=np.float32))
            yield int(log) + 1700, f"{space}/scan", scan
        if i % 20 == 0:
            yield int(log) + 2000, "/note", new(ros, "std_msgs/String", f"note {i}")


def turned(xy, angle):
    c, s = np.cos(angle), np.sin(angle)
    return np.stack((c * xy[..., 0] - s * xy[..., 1], s * xy[..., 0] + c * xy[..., 1]), axis=-1)


def sensors(kind: Kind, start_rad: float, space: str):
    """Yield other sensors of one robot: the right wheel is mirrored, the IMU upside down."""
    ros, d = kind.ros, drive(kind, start_rad)
    dt = np.diff(d.t, prepend=d.t[0]) * 1e-9
    per_s = np.divide(1.0, dt, out=np.zeros(len(dt)), where=dt > 0)
    ds, turn = d.v * 0.05 * (dt > 0), np.diff(d.flat[:, 2], prepend=start_rad)
    steps = np.column_stack([(ds + sign * turn * TRACK_M / 2) / RADIUS_M for sign in (-1, 1)])
    none, nine = np.zeros(0), np.zeros(9)
    v = lambda *xyz: floats(ros, "Vector3", xyz)  # noqa: E731
    for i, (stamp, yaw) in enumerate(zip(d.t, d.flat[:, 2], strict=True)):
        log, head, (left, right) = int(stamp) + 2_000_000, header(ros, stamp, ""), steps[: i + 1].sum(axis=0)
        angles = np.array([(left + np.pi) % (2 * np.pi) - np.pi, 0.3, -right, 9.0 * i])
        speeds = np.array([steps[i, 0], 0.0, -steps[i, 1], 9.0]) * per_s[i]
        names = ["left_wheel", "arm", "right_wheel", "scanner"]
        yield log, f"{space}/joint_states", new(ros, "sensor_msgs/JointState", head, names, angles, speeds, none)
        yield log, f"{space}/ticks", new(ros, TICKS, head, int(PER_RAD * left), int(PER_RAD * right))
        yield log, f"{space}/left_encoder", new(ros, "std_msgs/Int32", int(-PER_RAD * left))
        q = floats(ros, "Quaternion", (0, 0, np.sin(yaw / 2), np.cos(yaw / 2)))
        rate = v(0, 0, 0.01 - turn[i] * per_s[i])
        yield log, f"{space}/imu", new(ros, "sensor_msgs/Imu", head, q, nine, rate, nine, v(0, 0, -9.8), nine)


def write(kind: Kind, path) -> None:
    space = kind.names[0].removesuffix("/odom")
    spaces = {space: 0.4, **({"/robot2": 2.0} if kind.layout == "two robots" else {})}
    parts = (robot, sensors) if kind.sensors != "none" else (robot,)
    rows = [row for part in parts for own, start_rad in spaces.items() for row in part(kind, start_rad, own)]
    rows.sort(key=lambda row: row[0])
    if kind.ros == 1:
        writer = Writer1(path)
    else:
        plugin = StoragePlugin.SQLITE3 if kind.storage == "sqlite3" else StoragePlugin.MCAP
        writer = Writer2(path, version=9, storage_plugin=plugin)
        if kind.storage == "mcap zstd":
            writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    rosmessages.write(path, rows, writer=writer, little="big-endian" not in kind.storage)


def read(path, store):
    with AnyReader([path], default_typestore=store) as reader:
        return [
            (c.topic, t, bytes(raw), reader.deserialize(raw, c.msgtype) if c.msgtype != TEXT else None)
            for c, t, raw in reader.messages()
        ]


def numbers(messages):
    """Return stamps, position, quat, twist, pose and twist covariances of Odometry messages."""
    v = lambda one: (one.x, one.y, one.z)  # noqa: E731
    stamps = np.array([m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for m in messages])
    position = np.array([v(m.pose.pose.position) for m in messages])
    quat = np.array([(*v(m.pose.pose.orientation), m.pose.pose.orientation.w) for m in messages])
    twist = np.array([(*v(m.twist.twist.linear), *v(m.twist.twist.angular)) for m in messages])
    covariances = [np.array([getattr(m, name).covariance for m in messages]) for name in ("pose", "twist")]
    return stamps, position, quat, twist, *(one.reshape(-1, 6, 6) for one in covariances)


def edges_at(messages):
    """Return the moving edge's poses by stamp, and whether the others are as written."""
    at, stay = {}, True
    for one in itertools.chain.from_iterable(m.transforms for m in messages):
        q, p, time = one.transform.rotation, one.transform.translation, one.header.stamp
        if one.child_frame_id == "laser":
            stay &= (p.x, p.y, q.w) == (0.1, 0.2, 1.0)
        elif one.header.frame_id == "map":
            stay &= (p.x, p.y, q.w) == (1.0, 2.0, S)
        else:
            at.setdefault(time.sec * 10**9 + time.nanosec, []).append((p.x, p.y, p.z, q.x, q.y, q.z, q.w))
    return at, stay


def violations(kind: Kind, folder) -> list[str]:
    """Return what an independent reader finds wrong after the corruption of a bag of this kind."""
    source, target = (folder / f"{name}{kind.number}{'.bag' if kind.ros == 1 else ''}" for name in ("in", "out"))
    write(kind, source)
    robots = {kind.names: 0.4}
    if kind.both:
        robots["/robot2/odom", "/robot2/tf"] = 2.0
    noise = odomcorrupt.Noise(alpha=(0.05, 0.02, 0.05, 0.01))
    first, *also = (odom for odom, _ in robots)
    options = {"odom_topic": first, "also": also, "model": noise, "consistent": kind.sensors == "consistent"}
    options["scan_every"] = kind.scan_every
    done = odomcorrupt.corrupt(source, target, seed=kind.number, **options)
    before, after = (read(path, STORES[kind.ros]) for path in (source, target))
    scans: Counter[str] = Counter()
    left_out = []
    for i, (topic, *_) in enumerate(before):
        left_out += [i] if topic.endswith("scan") and scans[topic] % kind.scan_every else []
        scans[topic] += 1
    before = [m for i, m in enumerate(before) if i not in left_out]
    wrong = []
    if [m[:2] for m in before] != [m[:2] for m in after]:
        wrong.append("topics and log times")
    if [len(m[2]) for m in before] != [len(m[2]) for m in after]:
        wrong.append("lengths of messages")
    changing = {topic for names in robots for topic in names}
    others = {odom.replace("odom", name) for odom, _ in robots for name in TOPICS}
    if done.outcome.with_true_motion != (sorted(others) if kind.sensors == "stay" else []):
        wrong.append(f"{done.outcome.with_true_motion} have the true motion")
    changing |= others if kind.sensors == "consistent" else set()
    wrong += [f"bytes of {a[0]}" for a, b in zip(before, after, strict=True) if a[0] not in changing and a[2] != b[2]]
    ends = []
    for names, start_rad in robots.items():
        found, error = inconsistencies(kind, *([m for m in bag if m[0] in names] for bag in (before, after)), start_rad)
        wrong += found
        ends.append(error)
        if kind.sensors == "consistent":
            space = names[0].removesuffix("/odom")
            wrong += of_sensors(kind, [m for m in after if m[0].startswith(f"{space}/")], space, start_rad)
    if len(ends) == 2 and np.abs(ends[0] - ends[1]).max() < 1e-3:
        wrong.append("both robots have the same noise")
    return [f"{kind}: {one}" for one in wrong]


def inconsistencies(kind: Kind, before, after, start_rad: float):
    """Return what is wrong in the messages of one robot, and the errors (n, 2) of its positions, metres."""
    wrong = []

    def claim(holds, sentence):
        if not holds:
            wrong.append(sentence)

    was, now = ([m[3] for m in bag if m[0].endswith("odom")] for bag in (before, after))
    at, stay = edges_at([m[3] for m in after if m[0].endswith("tf")])
    claim(stay, "other edges stay")
    heads = [[repr((m.header, m.child_frame_id)) for m in one] for one in (was, now)]
    claim(heads[0] == heads[1], "headers stay")
    t, place0, quat0, twist0, pose_cov0, twist_cov0 = numbers(was)
    _, place, quat, twist, pose_cov, twist_cov = numbers(now)

    for stamp in np.unique(t):
        rows = np.flatnonzero(t == stamp)
        off = np.array(at[stamp]) - np.hstack((place[rows], quat[rows]))
        claim(np.abs(off).max() < 1e-9, f"TF is the odometry at {stamp}")

    # C is a planar motion of the odom frame
    claim(np.array_equal(place[:, 2], place0[:, 2]), "heights stay")
    up = [Rotation.from_quat(q).as_matrix()[:, 2] for q in (quat0, quat)]
    claim(np.abs(up[0] - up[1]).max() < 1e-9, "tilts stay")
    claim(np.hypot(*(place - place0)[-1, :2]) > 1e-4, "there is noise")

    # twist = motion of the poses
    d = drive(kind, start_rad)
    m = d.measured
    noisy, clean = (rates((t[m] - t[0]) * 1e-9, p[m], q[m], kind.axes) for p, q in ((place, quat), (place0, quat0)))
    latest = np.searchsorted(m, np.arange(len(t)), side="right") - 1
    # that twists are in odom axes takes some motion to see
    moving = np.arange(len(t)) >= m[5 if kind.axes == "odom" else 1]
    expected = (noisy - clean)[latest[moving] - 1]
    off = np.abs((twist - twist0)[moving] - expected).max()
    claim(off < 1e-4, f"twists are the motion of the poses: off by {off:.2g}")
    claim((np.abs((twist - twist0)[moving]).max(axis=1) > 0.0).all(), "no moving twist stays true")

    # covariances: positive, and as large as what was injected, to first order: a vector turned by a heading error
    # may also be shorter by its length times one minus the cosine of that error
    turned = 2.0 * np.arccos(np.minimum(np.abs(np.sum(quat * quat0, axis=1)), 1.0))
    shorter = np.linalg.norm(twist0[:, :3], axis=1) * (1.0 - np.cos(turned)) * (kind.axes == "odom")
    for name, C, C0, e in (
        ("pose", pose_cov, pose_cov0, np.column_stack((place - place0, np.zeros((len(t), 3))))),
        ("twist", twist_cov[moving], twist_cov0[moving], (twist - twist0)[moving]),
    ):
        claim(np.linalg.eigvalsh(C)[:, 0].min() > -1e-4, f"{name} covariances are positive")
        claim(np.abs(C - np.swapaxes(C, 1, 2)).max() < 1e-9, f"{name} covariances are symmetric")
        claim(np.diagonal(C, axis1=1, axis2=2).min() > 0.0, f"no {name} variance is zero")
        beyond = np.maximum(np.abs(e) - (shorter[moving, None] if name == "twist" else 0.0), 0.0)
        ratio = np.square(beyond) / np.diagonal(C, axis1=1, axis2=2)
        claim(ratio.max() < 36.0, f"{name} variances are those of the noise: {np.sqrt(ratio.max()):.2g} sigma")
        claim((C[:, 2, 2] > 1e3).all() or kind.attitude not in ("level", "leaning", "ramp"), f"{name}: unknown")
        if kind.attitude == "level":
            rest = np.ones((6, 6), dtype=bool)
            rest[np.ix_([0, 1, 5], [0, 1, 5])] = False
            claim(np.array_equal(C[:, rest], C0[:, rest]), f"{name} covariances of other axes stay")
    return wrong, place[:, :2] - place0[:, :2]


def of_sensors(kind: Kind, after, space: str, start_rad: float) -> list[str]:
    """Return what is wrong in the sensors of one robot: whoever integrates them gets the noisy odometry."""
    at = {name: [m[3] for m in after if m[0] == f"{space}/{name}"] for name in ("odom", *TOPICS)}
    d = drive(kind, start_rad)
    rows = np.flatnonzero(np.isin(d.t, d.stamps[d.measured])) if kind.repeats != "10 ms stamps" else np.arange(len(d.t))
    _, place, quat, *_ = numbers(at["odom"])
    level = Rotation.from_quat(quat) * Rotation.from_quat(ATTITUDES[kind.attitude]).inv()
    noisy = np.column_stack((place[:, :2], level.as_rotvec()[:, 2]))[d.measured]
    drift_m = np.hypot(*(noisy - d.flat[rows])[:, :2].T).max()
    # stamps that are cut are of another time than the sensor's
    late = 8e-3 if kind.repeats == "10 ms stamps" else 1e-3
    # a curve between two stamps; wheels do not slip sideways, as the noise of a child frame that travels so does
    coarse = 0.03 if kind.repeats == "ten per stamp" else 2e-3
    rolled = np.inf if kind.attitude == "optical" else coarse
    start = np.array([*noisy[0, :2], start_rad])
    found = [(*one, rolled, late) for one in by_wheels(at, d, start)]
    found += [(*one, np.inf, late) for one in by_imu(at, d, start)]
    wrong = []
    for name, poses, most_m, most_rad in found:
        off = poses[rows] - noisy
        far, turn = np.hypot(*off[:, :2].T).max(), np.abs((off[:, 2] + np.pi) % (2 * np.pi) - np.pi).max()
        if not (far < most_m + late + 0.03 * drift_m and turn < most_rad):
            wrong.append(f"{name}: {far:.3g} m and {turn:.2g} rad off at a drift of {drift_m:.3g} m")
    angles = np.array([m.position for m in at["joint_states"]])
    others = np.column_stack((np.full(len(angles), 0.3), 9.0 * np.arange(len(angles))))
    if np.abs(angles[:, 0]).max() > np.pi or not np.array_equal(angles[:, [1, 3]], others):
        wrong.append("wrapped angles stay so, other joints as they are")
    encoder, ticks = np.array([(-e.data, m.ticks_left) for e, m in zip(at["left_encoder"], at["ticks"], strict=True)]).T
    if np.abs(encoder - ticks)[rows].max() > PER_RAD * (coarse + 5.0 * late) / RADIUS_M:
        wrong.append("the encoder is that of the wheel")
    return wrong


def by_wheels(at, d: Drive, start):
    """Yield names and poses (n, 3) of what wheels integrate to."""
    angles, speeds = (np.array([getattr(m, one) for m in at["joint_states"]]) for one in ("position", "velocity"))
    turned_by = speeds * np.diff(d.t, prepend=d.t[0])[:, None] * 1e-9
    ticks = np.array([(m.ticks_left, m.ticks_right) for m in at["ticks"]]) / PER_RAD
    for name, left, right in (
        ("wheels", np.unwrap(angles[:, 0]), -angles[:, 2]),
        ("speeds of wheels", np.cumsum(turned_by[:, 0]), -np.cumsum(turned_by[:, 2])),
        ("ticks", *ticks.T),
    ):
        left, right = RADIUS_M * np.diff(left), RADIUS_M * np.diff(right)  # noqa: PLW2901 - metres
        yaw = start[2] + np.concatenate(([0.0], np.cumsum(right - left))) / TRACK_M
        steps = turned(np.column_stack(((left + right) / 2, np.zeros(len(left)))), (yaw[1:] + yaw[:-1]) / 2)
        yield name, np.column_stack((np.cumsum(np.vstack((start[:2], steps)), axis=0), yaw))


def by_imu(at, d: Drive, start):
    """Yield names and poses (n, 3) of an IMU, whose places are none."""
    dt = np.diff(d.t, prepend=d.t[0]) * 1e-9
    rate, z, w = np.array([(m.angular_velocity.z, m.orientation.z, m.orientation.w) for m in at["imu"]]).T
    for name, yaw in (("gyro", start[2] + np.cumsum((0.01 - rate) * dt)), ("IMU", 2.0 * np.arctan2(z, w))):
        yield name, np.column_stack((np.zeros((len(dt), 2)), yaw))


# of the last one, the rounding of a scanner's constant rate resembles the motion
@pytest.mark.parametrize("kind", [*kinds(6), *kinds(157, 92)[-1:]], ids=lambda kind: str(kind.number))
def test_every_topic_states_the_same_noisy_motion(kind, tmp_path):
    assert violations(kind, tmp_path) == []


@pytest.mark.slow
@pytest.mark.parametrize("part", range(4))
def test_every_topic_of_bags_of_all_kinds_states_the_same_noisy_motion(part, tmp_path):
    assert [said for kind in covering()[part::4] for said in violations(kind, tmp_path)] == []


@pytest.mark.parametrize("roll_rad", [0.0, 0.1])
def test_twists_are_the_motion_of_a_body_that_pitches_over_the_vertical_where_its_heading_jumps(roll_rad, tmp_path):
    kind = Kind(3, "mcap", "root", "level", "none", "child")
    d = drive(kind, 0.4)
    pitch_rad = np.deg2rad(90.0 - 20.0 * np.cos(np.linspace(0.0, 6.0 * np.pi, len(d.t))))
    tilt = Rotation.from_euler("yx", np.column_stack((pitch_rad, np.full(len(d.t), roll_rad))))
    d.quat = (Rotation.from_euler("z", d.flat[:, 2:]) * tilt).as_quat()
    d.twist[1:] = rates((d.t - d.t[0]) * 1e-9, d.position, d.quat, "child")
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(globals(), "drive", lambda *_: d)
        write(kind, tmp_path / "in")
    odomcorrupt.corrupt(tmp_path / "in", tmp_path / "out", model="typical", seed=3, odom_topic="/odom")
    messages = [[m[3] for m in read(tmp_path / name, STORES[2]) if m[0] == "/odom"] for name in ("in", "out")]
    (t, place0, quat0, twist0, *_), (_, place, quat, twist, *_) = map(numbers, messages)
    noisy, clean = (rates((t - t[0]) * 1e-9, p, q, "child") for p, q in ((place, quat), (place0, quat0)))
    off, error = (twist - twist0)[1:] - (noisy - clean), np.linalg.norm(noisy - clean, axis=1)
    # a twist in the axes at its stamp differs from one in those at the middle by half of the turn between two stamps
    assert np.all(np.linalg.norm(off, axis=1) < 0.06 * error + 1e-4)


def test_a_batch_of_two_robots_has_the_bytes_of_single_runs(tmp_path):
    source = tmp_path / "in.mcap"
    write(Kind(3, "mcap", "two robots", "level", "none", "child", "consistent"), source)
    (file,) = source.glob("*.mcap")
    options = {"seed": 3, "odom_topic": "/robot1/odom", "also": ("/robot2/odom",), "model": "typical"}
    options["consistent"] = True
    made = odomcorrupt.batch(file, tmp_path / "runs", runs=2, **options)
    for number, path in enumerate(made.paths):
        odomcorrupt.corrupt(file, tmp_path / "one.mcap", run=number, overwrite=True, **options)
        assert path.read_bytes() == (tmp_path / "one.mcap").read_bytes()
        assert "--also /robot2/odom" in made.records[number]["command"]
    with pytest.raises(odomcorrupt.errors.BatchError, match="also"):
        odomcorrupt.batch(file, tmp_path / "overlays", runs=1, output="overlay", **options)


@pytest.mark.parametrize(("words", "code", "said"), [
    ([], 1, "the bag does not tell how"), (["--tf", "correction", "--new-odom-frame", "a"], 2, "leave one"),
])  # fmt: skip
def test_what_cannot_be_consistent_is_one_line(tmp_path, invoke, words, code, said):
    write(Kind(0, "mcap", "root", "level", "10 ms stamps", "child", "stay"), tmp_path / "in")  # 1.3 s are too short
    assert said in invoke([tmp_path / "in", tmp_path / "out", "--consistent", *words], code).err
    assert not (tmp_path / "out").exists()
