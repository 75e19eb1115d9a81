"""A simulated recording: the drive, its sensors and faults, its bag and its answer."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import partial
from hashlib import sha256
from pathlib import Path
from struct import pack
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np
from mcap.writer import CompressionType, Writer
from rosbags.typesys import Stores, get_typestore

from odomcorrupt.simulation.faults import (
    CAUSES,
    EVERY,
    Parameters,
    draw_fault,
    is_placed,
    names_of,
    source_of_turns,
    with_faults,
)
from odomcorrupt.simulation.robot import add_up_steps, build_robot, drive, stream, wheel_angles, wrap
from odomcorrupt.simulation.routes import ROUTES, Commands, Segment, follow, obey
from odomcorrupt.simulation.sensors import TRACKERS, Odometry, Rig, Track, Tracker, dock, reckon, watch

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence


EPOCH_NS = 1_750_000_000_000_000_000


@dataclass(frozen=True, slots=True)
class SimulatedRun:
    """A recording and its fault. Poses are m, m, rad wrapped to (-pi, pi]; twists m/s, m/s, rad/s in the body.

    Attributes
    ----------
    odom_stamps_ns : ndarray of int64, shape (n,)
        Stamps of the odometry's clock.
    odom_xyt, odom_twist : ndarray, shape (n, 3)
        Pose of the base in the odometry frame; mean twist since the previous sample.
    truth_stamps_ns : ndarray of int64, shape (m,)
        Stamps of the tracker's clock.
    truth_xyt : ndarray, shape (m, 3)
        Pose of the tracked frame in the world.
    answer : dict
        ``cause`` (str, several joined by +, or None), ``parameters`` of a single cause (names and units as in the
        effects' table), ``causes`` (parameters of each by its name) and ``track_m`` (nominal).
    track_m : float
        Nominal track, m.
    """

    odom_stamps_ns: np.ndarray
    odom_xyt: np.ndarray
    odom_twist: np.ndarray
    truth_stamps_ns: np.ndarray
    truth_xyt: np.ndarray
    answer: dict[str, Any]
    track_m: float


def record(odom: Odometry, track: Track, faults: Mapping[str, Parameters], track_m: float) -> SimulatedRun:
    """Return the recording of odometry and tracker, with its faults.

    faults : parameters of each fault by its name
    track_m : nominal track, m
    """
    causes = {name: dict(parameters) for name, parameters in faults.items()}
    single = next(iter(causes.values())) if len(causes) == 1 else {}
    return SimulatedRun(
        odom_stamps_ns=_to_ns(odom.stamps_s),
        odom_xyt=_wrapped(odom.xyt),
        odom_twist=odom.twist,
        truth_stamps_ns=_to_ns(track.stamps_s),
        truth_xyt=_wrapped(track.xyt),
        answer={"cause": "+".join(causes) or None, "parameters": single, "causes": causes, "track_m": track_m},
        track_m=track_m,
    )


def _to_ns(times_s: np.ndarray) -> np.ndarray:
    return EPOCH_NS + np.rint(times_s * 1e9).astype(np.int64)


def _wrapped(xyt: np.ndarray) -> np.ndarray:
    return np.column_stack((xyt[:, :2], wrap(xyt[:, 2])))


def format_answer(run: SimulatedRun, seed: int, made: Mapping[str, str | float]) -> str:
    """Return the fault as TOML, with a salt against recovery from the hash by guessing.

    seed : seed of the run
    made : other arguments of the run
    """
    lines = ["schema = 1", f"seed = {seed}", f'salt = "{stream(seed, "salt").bytes(16).hex()}"']
    lines += [f"{name} = {_toml(value)}" for name, value in made.items()]
    lines += [f"track_m = {run.track_m!r}"]
    if not run.answer["causes"]:
        lines += ["causes = []"]
    for name, parameters in run.answer["causes"].items():
        lines += ["", "[[causes]]", f'name = "{name}"', f"in_library = {str(name in CAUSES).lower()}"]
        if name not in CAUSES:
            lines += [f'depends_on = "{EVERY[name].depends_on}"']
        lines += ["[causes.parameters]", *(f"{key} = {_toml(value)}" for key, value in parameters.items())]
    return "\n".join(lines) + "\n"


def fingerprint(answer: str) -> str:
    """Return the SHA-256 of an answer file's text, in hexadecimal."""
    return sha256(answer.encode()).hexdigest()


def _toml(value: str | float) -> str:
    return f'"{value}"' if isinstance(value, str) else repr(value)


STEP_S = 0.002
DAY_S = 600.0
"""Duration of the usual route along which the place of a fault is drawn, s."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Scenario:
    """Drive, tracker and size of the fault of a simulated recording.

    duration_s : length, s
    size : factor on the drawn magnitude of the fault
    truth : "mocap", "rtk" or a `Tracker`: source of the truth
    parameters : parameters of the fault instead of drawn ones; for several faults, by their names
    route : a key of `ROUTES`, manoeuvres, or speed commands, instead of a random office drive
    rig : electronics and floor
    yaw_from : "encoders" or "gyro": the odometry's source of turns; by default one with which the fault shows. See
        `simulate_without`
    robot_seed : seed of the robot and its fault, for several drives of one robot; by default that of the drive
    drive_type : "differential" or "skid": wheel layout
    at_dock : whether the start pose depends on the robot's seed, not the drive's; by default if a fault has a place
    home : a key of `ROUTES`: the usual route, along which the place of a fault is drawn. By default `route`, or the
        office for speed commands
    """

    duration_s: float = 600.0
    size: float = 1.0
    truth: str | Tracker = "mocap"
    parameters: Mapping[str, Any] | None = None
    route: str | Sequence[Segment] | Commands | None = None
    rig: Rig = field(default_factory=Rig)
    yaw_from: str | None = None
    robot_seed: int | None = None
    drive_type: str = "differential"
    at_dock: bool | None = None
    home: str | None = None


def simulate(
    seed: int, cause: str | Sequence[str] | None, scenario: Scenario | None = None, **changes: Any
) -> SimulatedRun:
    """Return a simulated recording of a robot with one fault, several or none.

    Every layer has its own random stream, so runs that differ only in `cause` share robot, drive and noise.

    seed : seed of the drive and all noise
    cause : keys of `CAUSES` or `OUTSIDE`; None for a robot without faults
    scenario : drive, tracker and size of the fault
    **changes : fields of the scenario that differ
    """
    what = replace(scenario or Scenario(), **changes)
    tracker = TRACKERS[what.truth] if isinstance(what.truth, str) else what.truth
    robot_seed = seed if what.robot_seed is None else what.robot_seed
    causes = names_of(cause)
    yaw_from = what.yaw_from or source_of_turns(causes)
    placed = is_placed(causes)
    docked = placed if what.at_dock is None else what.at_dock
    start_xyt = dock(stream(robot_seed if docked else seed, "world"))
    grid_s = np.arange(round(what.duration_s / STEP_S) + 1) * STEP_S

    given: Mapping[str, Any] = {cause: what.parameters} if isinstance(cause, str) else (what.parameters or {})
    daily = what.home or ("office" if isinstance(what.route, Commands) else what.route)
    path = _plan(daily, robot_seed, start_xyt) if placed else None
    faults = {name: draw_fault(name, what.size, robot_seed, path, given.get(name)) for name in causes}
    robot = with_faults(build_robot(stream(robot_seed, "robot"), what.drive_type), faults)

    streams = partial(stream, seed)
    speeds = _speeds(what.route, what.duration_s, seed, grid_s)
    angle_rad = wheel_angles(speeds, STEP_S, robot, what.rig.motor_ripple, streams("motor"))
    driven = drive(grid_s, angle_rad, robot, what.rig.creep, streams, start_xyt)
    odom = reckon(driven, robot, what.rig, yaw_from, streams)
    track = watch(driven, robot, tracker, streams)
    return record(odom, track, faults, robot.nominal_track_m)


def simulate_without(seed: int, cause: str | Sequence[str] | None, **options: Any) -> SimulatedRun:
    """Return the recording of `simulate` for the same arguments and sensors, but without the fault."""
    causes = names_of(cause)
    same = {"yaw_from": source_of_turns(causes), "at_dock": is_placed(causes)}
    return simulate(seed, None, **{**same, **options, "parameters": None})


def _speeds(
    route: str | Sequence[Segment] | Commands | None, duration_s: float, seed: int, grid_s: np.ndarray
) -> np.ndarray:
    if isinstance(route, Commands):
        return obey(route, grid_s)
    if route is None or isinstance(route, str):
        route = ROUTES[route or "office"](duration_s, stream(seed, "route"))
    return follow(route, grid_s)


def _plan(route: str | Sequence[Segment] | None, seed: int, start_xyt: np.ndarray) -> np.ndarray:
    """Return the path of a perfect robot over `DAY_S`, every 0.1 s, x + iy in the truth frame, m."""
    grid_s = np.arange(round(DAY_S / 0.1)) * 0.1
    steps = _speeds(route, DAY_S, seed, grid_s) * 0.1
    planned = add_up_steps(steps[:, 0], np.zeros(len(steps)), steps[:, 1])
    way = planned[:, 0] + 1j * planned[:, 1]
    return np.asarray(complex(start_xyt[0], start_xyt[1]) + way * np.exp(1j * start_xyt[2]))


STORE = get_typestore(Stores.ROS2_HUMBLE)
TYPES = {
    "/odom": "nav_msgs/msg/Odometry",
    "/tf": "tf2_msgs/msg/TFMessage",
    "/ground_truth": "geometry_msgs/msg/PoseStamped",
}
_MARKS = tuple(1.0 + i * np.pi for i in range(7))
"""Placeholder numbers in a template message."""
_MARK_SEC, _MARK_NANOSEC = 0x5EC05EC, 0x2A205EC


def odometry(run: SimulatedRun) -> np.ndarray:
    """Return the serialised Odometry messages (odom to base_link), one per row."""
    x, y, qz, qw, forward, left, turn = _MARKS
    pose = _new("PoseWithCovariance", pose=_pose(x, y, qz, qw), covariance=_spread(1e-3, 1e-3, 1e-2))
    twist = _new("Twist", linear=_vector(forward, left), angular=_vector(0.0, 0.0, turn))
    stamped = STORE.types[TYPES["/odom"]](
        header=_header("odom"),
        child_frame_id="base_link",
        pose=pose,
        twist=_new("TwistWithCovariance", twist=twist, covariance=_spread(1e-4, 1e-4, 1e-3)),
    )
    numbers = np.column_stack((_planar(run.odom_xyt), run.odom_twist))
    return _fill(stamped, TYPES["/odom"], run.odom_stamps_ns, numbers)


def links(run: SimulatedRun) -> np.ndarray:
    """Return the odometry as serialised TFMessages, one per row."""
    x, y, qz, qw = _MARKS[:4]
    link = _new("Transform", translation=_vector(x, y), rotation=_turned(qz, qw))
    stamped = _new("TransformStamped", header=_header("odom"), child_frame_id="base_link", transform=link)
    message = STORE.types[TYPES["/tf"]](transforms=[stamped])
    return _fill(message, TYPES["/tf"], run.odom_stamps_ns, _planar(run.odom_xyt))


def poses(run: SimulatedRun) -> np.ndarray:
    """Return the truth as serialised PoseStamped messages in world, one per row."""
    message = _new("PoseStamped", header=_header("world"), pose=_pose(*_MARKS[:4]))
    return _fill(message, TYPES["/ground_truth"], run.truth_stamps_ns, _planar(run.truth_xyt))


def _planar(xyt: np.ndarray) -> np.ndarray:
    return np.column_stack((xyt[:, :2], np.sin(0.5 * xyt[:, 2]), np.cos(0.5 * xyt[:, 2])))


def _fill(message: Any, typename: str, stamps_ns: np.ndarray, numbers: np.ndarray) -> np.ndarray:
    """Return serialised messages, one per row: copies of a template with placeholders replaced by stamps and numbers.

    stamps_ns : (n,) stamps of the headers
    numbers : (n, k) values for the first k placeholders
    """
    one = bytes(STORE.serialize_cdr(message, typename))
    rows = np.tile(np.frombuffer(one, dtype=np.uint8), (len(stamps_ns), 1))
    sec, nanosec = np.divmod(stamps_ns, 1_000_000_000)
    columns = [(pack("<i", _MARK_SEC), sec.astype("<i4")), (pack("<I", _MARK_NANOSEC), nanosec.astype("<u4"))]
    columns += [(pack("<d", mark), column.astype("<f8")) for mark, column in zip(_MARKS, numbers.T, strict=False)]
    for mark, values in columns:
        at = one.index(mark)
        rows[:, at : at + len(mark)] = np.ascontiguousarray(values).view(np.uint8).reshape(-1, len(mark))
    return rows


def _new(kind: str, **fields: Any) -> Any:
    return STORE.types[f"geometry_msgs/msg/{kind}"](**fields)


def _header(frame_id: str) -> Any:
    stamp = STORE.types["builtin_interfaces/msg/Time"](sec=_MARK_SEC, nanosec=_MARK_NANOSEC)
    return STORE.types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame_id)


def _vector(x: float, y: float, z: float = 0.0) -> Any:
    return _new("Vector3", x=x, y=y, z=z)


def _turned(qz: float, qw: float) -> Any:
    return _new("Quaternion", x=0.0, y=0.0, z=qz, w=qw)


def _pose(x: float, y: float, qz: float, qw: float) -> Any:
    return _new("Pose", position=_new("Point", x=x, y=y, z=0.0), orientation=_turned(qz, qw))


def _spread(x: float, y: float, yaw: float) -> np.ndarray:
    return np.diag([x, y, 1e6, 1e6, 1e6, yaw]).ravel()


def write_mcap(
    run: SimulatedRun,
    target: str | Path | BinaryIO,
    *,
    odom_topic: str = "/odom",
    truth_topic: str = "/ground_truth",
    tf: bool = True,
    metadata: Mapping[str, str] | None = None,
) -> None:
    """Write a run as one MCAP file with zstd chunks, in order of the stamps (which are also the log times).

    run : the recording; its ground-truth fault is not written
    target : the output file
    odom_topic, truth_topic : topics of the Odometry (odom to base_link) and of the PoseStamped (in world)
    tf : whether /tf repeats the odometry as odom to base_link
    metadata : content of the metadata record ``simulate``
    """
    if isinstance(target, str | Path):
        with Path(target).open("wb") as file:
            return write_mcap(run, file, odom_topic=odom_topic, truth_topic=truth_topic, tf=tf, metadata=metadata)
    topics = [(odom_topic, TYPES["/odom"], run.odom_stamps_ns, odometry(run))]
    if tf:
        topics.append(("/tf", TYPES["/tf"], run.odom_stamps_ns, links(run)))
    topics.append((truth_topic, TYPES["/ground_truth"], run.truth_stamps_ns, poses(run)))
    stamps_ns = np.concatenate([stamps for _, _, stamps, _ in topics])
    sizes = [len(stamps) for _, _, stamps, _ in topics]
    places = np.column_stack((np.repeat(np.arange(len(sizes)), sizes), np.concatenate([np.arange(n) for n in sizes])))
    # at equal stamps: odometry, transform, truth
    order = np.lexsort((places[:, 0], stamps_ns))
    writer: Any = Writer(target, compression=CompressionType.ZSTD)
    writer.start(profile="ros2", library="wheelsim")
    if metadata is not None:
        writer.add_metadata("simulate", dict(metadata))
    channels: dict[int, int] = {}
    pairs = zip(stamps_ns[order].tolist(), places[order].tolist(), strict=True)
    for sequence, (stamp_ns, (topic, row)) in enumerate(pairs):
        if topic not in channels:
            channels[topic] = _channel(writer, *topics[topic][:2])
        data = topics[topic][3][row].tobytes()
        writer.add_message(channels[topic], log_time=stamp_ns, publish_time=stamp_ns, sequence=sequence, data=data)
    writer.finish()
    return None


def _channel(writer: Any, topic: str, typename: str) -> int:
    text, _ = STORE.generate_msgdef(typename, ros_version=2)
    schema_id = writer.register_schema(typename, "ros2msg", text.encode())
    return int(writer.register_channel(topic, "cdr", schema_id))
