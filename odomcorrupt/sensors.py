"""Other sensors of the robot: their own noise, and numbers that are linear in the motion, rewritten to the noisy one.

Angles, ticks and speeds of wheels, twists and gyros are running counts or rates of a sum of forward travel, leftward
travel and turn. Its coefficients (of a wheel: one over its radius, and its distance from the middle over its radius)
are estimated from the bag, number by number, so mirrored wheels, any number of wheels and tilted gyros need no setting.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np

from odomcorrupt.bags.messages import SCAN, SECOND_NS, gather, locate, scatter, stamps_or_log_ns
from odomcorrupt.bags.rosbag2.bounded_yaml import load_yaml
from odomcorrupt.errors import ModelError, TopicError
from odomcorrupt.geometry.se2 import increments, wrap, yaw_from_quaternion
from odomcorrupt.input_files import read_input
from odomcorrupt.rng import stream

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping
    from pathlib import Path

    from numpy.typing import NDArray

    from odomcorrupt.bags.block import BagReader, Block, Channel
    from odomcorrupt.bags.messages import Layout
    from odomcorrupt.geometry.se2 import Array


IMU = "sensor_msgs/msg/Imu"


class ImuNoise(NamedTuple):
    """Noise of an IMU, as in the file that Kalibr reads.

    gyroscope_noise_density, accelerometer_noise_density : white noise, rad/s/sqrt(Hz) and m/s^2/sqrt(Hz)
    gyroscope_random_walk, accelerometer_random_walk : of the biases, rad/s^2/sqrt(Hz) and m/s^3/sqrt(Hz)
    update_rate : at which the white noise is sampled, Hz
    file : name of the file
    """

    gyroscope_noise_density: float
    gyroscope_random_walk: float
    accelerometer_noise_density: float
    accelerometer_random_walk: float
    update_rate: float
    file: str = ""


def read_imu(path: Path) -> ImuNoise:
    """Return the noise of an IMU from a YAML file of Kalibr, whose other keys have no effect.

    Raises
    ------
    ModelError
        If it cannot be read, or lacks one of the five numbers.
    """
    text = read_input(path, 1 << 14, "file of an IMU's noise", ModelError).decode(errors="replace")
    try:
        table = load_yaml(text)
    except ValueError as error:
        raise ModelError(f"{path}: is no YAML: {error}") from error
    table = table.get("imu0", table) if isinstance(table, dict) else {}
    numbers: list[Any] = []
    for name in ImuNoise._fields[:5]:
        value: Any = table.get(name) if isinstance(table, dict) else None
        known = isinstance(value, int | float) and not isinstance(value, bool)
        if not (known and 0.0 <= value <= 1e6 and (value or name != "update_rate")):
            said = "missing" if value is None else repr(value)[:40]
            raise ModelError(
                f"{path}: {name} is {said}; Kalibr's five numbers of an IMU are 0 or more, its rate above 0"
            )
        numbers.append(float(value))
    return ImuNoise._make([*numbers, str(path)])


class SensorNoise:
    """Adds noise to laser scans and IMUs of a bag, in one run.

    A scan's noise follows from its topic and stamps alone, that of an IMU from its messages in order: neither depends
    on threads, on the division of the bag into blocks, or on other topics.

    std_m, keep : standard deviation of the ranges, metres, and part of the beams that is kept
    imu : noise of IMUs, None for none
    msgtypes : types of the messages that get noise
    counts : messages with noise, by topic
    """

    def __init__(self, std_m: float, keep: float, imu: ImuNoise | None, seed: int, run: int) -> None:
        given = {SCAN: bool(std_m or keep < 1.0), IMU: imu is not None}
        self.msgtypes = {msgtype for msgtype, wanted in given.items() if wanted}
        self.counts: Counter[str] = Counter()
        self._std_m, self._keep, self._imu, self._seed, self._run = std_m, keep, imu, seed, run
        self._imus: dict[tuple[int, str], tuple[np.random.Generator, int, Array]] = {}

    def add(self, block: Block, channel: Channel, layout: Layout, stamps_ns: NDArray[np.int64]) -> None:
        """Change the messages of a layout in place, if they get noise; stamps_ns (n,) are their header stamps."""
        if channel.msgtype in self.msgtypes:
            self.counts[channel.topic] += len(stamps_ns)
            if channel.msgtype == IMU:
                self._add_to_imu(block, channel, layout, stamps_ns)
            elif "ranges" in layout.items[0].fields:
                self._add_to_scans(block, channel.topic, layout, stamps_ns)

    def _add_to_scans(self, block: Block, topic: str, layout: Layout, stamps_ns: NDArray[np.int64]) -> None:
        key = stream(self._seed, self._run, f"scan {topic}").integers(2**63, size=2).astype(np.uint64)
        ranges, limits = (gather(block, layout, layout.items[0], name) for name in ("ranges", "limits"))
        limits = np.where(limits[:, 1:] > limits[:, :1], limits, (0.0, np.inf))  # some drivers state none
        stamps = zip(stamps_ns.tolist(), block.table["log_ns"][layout.rows].tolist(), strict=True)
        for own, (low, high), when in zip(ranges, limits, stamps, strict=True):
            counter = np.array([0, 0, *when], dtype=np.int64).view(np.uint64)
            rng = np.random.Generator(np.random.Philox(key=key, counter=counter))
            # what is no measurement stays: infinite, NaN, zero, or a number beyond the limits
            measured = np.flatnonzero(np.isfinite(own) & (own > 0.0) & (own >= low) & (own <= high))
            noisy = own[measured] + self._std_m * rng.standard_normal(len(own))[measured]
            noisy[noisy < low], noisy[noisy > high] = -np.inf, np.inf
            noisy[rng.random(len(own))[measured] >= self._keep] = np.nan
            own[measured] = noisy
        scatter(block, layout, layout.items[0], "ranges", ranges)

    def _add_to_imu(self, block: Block, channel: Channel, layout: Layout, stamps_ns: NDArray[np.int64]) -> None:
        noise, item = self._imu, layout.items[0]
        assert noise is not None  # noqa: S101 - as `msgtypes` says
        key = channel.id, item.frame_id
        if key not in self._imus:
            rng = stream(self._seed, self._run, f"imu {channel.topic} {item.frame_id}", channel.id)
            self._imus[key] = rng, int(stamps_ns[0]), np.zeros((1, 6))
        rng, last_ns, bias = self._imus[key]
        draws = rng.standard_normal((len(stamps_ns), 12))
        dt_s = np.maximum(np.diff(stamps_ns, prepend=last_ns), 0) * 1e-9
        density, walk = (np.repeat(np.array(noise[first:4:2], dtype=np.float64), 3) for first in (0, 1))
        biases = np.cumsum(np.concatenate((bias, draws[:, 6:] * walk * np.sqrt(dt_s)[:, None])), axis=0)
        added = biases[1:] + draws[:, :6] * density * np.sqrt(noise.update_rate)
        self._imus[key] = rng, int(stamps_ns[-1]), biases[-1:]
        for name, columns in (("angular_velocity", slice(3)), ("linear_acceleration", slice(3, 6))):
            scatter(block, layout, item, name, gather(block, layout, item, name) + added[:, columns])


SENSORS = frozenset({
    "geometry_msgs/msg/TwistStamped", "geometry_msgs/msg/TwistWithCovarianceStamped",
    "irobot_create_msgs/msg/WheelTicks", "irobot_create_msgs/msg/WheelVels", "sensor_msgs/msg/Imu",
    "sensor_msgs/msg/JointState", "std_msgs/msg/Float32", "std_msgs/msg/Float64", "std_msgs/msg/Int32",
    "std_msgs/msg/Int64",
})  # fmt: skip
"""Message types that are rewritten."""

_MOST = 0.1  # part of a number's variance that is not explained, and error of a coefficient relative to all
_LEAST = 0.02  # size of a motion among the others, and of what others do not explain of it


class Relation(NamedTuple):
    """How a number follows the motion.

    per : (3,) change for each metre forward, metre leftward and radian; of a rate: its own for each of these rates
    rate : whether the number is a rate, else it counts on
    wrapped : whether it is an angle that stays within a turn
    """

    per: Array
    rate: bool
    wrapped: bool


Relations: TypeAlias = "Mapping[int, Mapping[str, tuple[Relation | None, ...]]]"
"""Of a topic's messages: by item of the message and field, of each of its numbers (of an orientation, of its heading);
None for one that does not follow."""


def find_relations(
    reader: BagReader, channels: Iterable[Channel], poses_of: Callable[[Block], Array], others: set[int]
) -> dict[int, Relations]:
    """Return how the numbers of topics follow the odometry's motion, by channel id, from a pass over the bag.

    channels : those of the sensors
    poses_of : reads the odometry of a block, whose channels are among `others`: rows (n, 4) of times, s, and poses

    Raises
    ------
    TopicError
        If a sensor of motion does not follow, or the drive does not tell how.
    """
    chosen = {channel.id: channel for channel in channels}
    parts: dict[tuple[int, int, str], list[Array]] = defaultdict(list)
    path = []
    for block in reader.blocks(others | chosen.keys()):
        path.append(poses_of(block))
        for number in sorted(block.present() & chosen.keys()):
            for layout in locate(block, chosen[number]):
                for index, item in enumerate(layout.items):
                    for field in item.fields:
                        values = gather(block, layout, item, field)
                        values = yaw_from_quaternion(values)[:, None] if field == "orientation" else values
                        t_s = stamps_or_log_ns(block, layout, item) * np.float64(1e-9)
                        parts[number, index, field].append(np.column_stack((t_s, values)))
    motion = _body_motion(path)
    found: dict[int, dict[int, dict[str, tuple[Relation | None, ...]]]] = {number: {} for number in chosen}
    moving, known = set(), set()
    for (number, index, field), pieces in parts.items():
        series = _ordered(pieces)
        is_joint = "JointState" in chosen[number].msgtype
        own_s, may_be = series[:, 0], (bool(index),) if is_joint else (False, True)
        relations = tuple(_relation(motion, own_s, one, may_be) for one in series[:, 1:].T)
        found[number].setdefault(index, {})[field] = relations
        if any(relations):
            known.add(number)
        elif np.ptp(series[:, 1:], axis=0).any():  # of joints, only wheels must follow
            moving |= {number} if "wheel" in field.lower() or not is_joint else set()
    for number in sorted(moving - known):
        raise TopicError(
            f"{chosen[number].topic}: the bag does not tell how its numbers follow the odometry (they need 6 s of a "
            "drive that turns and changes its speed); leave it out with --exclude-topic, or do without --consistent"
        )
    return dict(found)


def _ordered(parts: list[Array]) -> Array:
    """Return rows that begin with times in the order of time, without repeated times and what is not finite."""
    rows = np.concatenate(parts)
    rows = rows[np.isfinite(rows).all(axis=1)]
    return rows[np.unique(rows[:, 0], return_index=True)[1]]


def _body_motion(path: list[Array]) -> Array:
    """Return times with running sums of forward and leftward travel and turn, (n, 4), without jumps of the pose."""
    rows = _ordered(path)
    steps = increments(rows[:, 1:])
    each = np.stack((steps.ds_m, steps.dl_m, steps.dtheta_rad), axis=1)
    # a pose that moves faster was set
    each[np.hypot(steps.ds_m, steps.dl_m) > 20.0 * np.diff(rows[:, 0])] = 0.0
    rows[:1, 1:], rows[1:, 1:] = 0.0, np.cumsum(each, axis=0)
    return rows


def _relation(motion: Array, own_s: Array, values: Array, rates: tuple[bool, ...]) -> Relation | None:
    """Return how a number (n,) at times (n,) follows the motion, by least squares; None if not, or nothing tells."""
    if min(len(own_s), len(motion)) < 2:
        return None
    first, last = np.maximum(own_s[0], motion[0, 0]), np.minimum(own_s[-1], motion[-1, 0])
    # long against the delays between sensors
    grid = np.arange(first, last, max(0.5, 4.0 * float(np.median(np.diff(own_s)))))
    if len(grid) < 12:  # as many as the numbers of the fit, three times
        return None
    body = np.stack([np.diff(np.interp(grid, motion[:, 0], one)) for one in motion[:, 1:].T], axis=1)
    size = np.linalg.norm(body, axis=0)
    used = np.flatnonzero(size > _LEAST * size.max())
    if len(used) < 2 or used[-1] != 2:  # travel and turns
        return None
    # the last column is a bias of a rate, or what turns on its own
    norms = np.append(size[used], np.sqrt(len(body)))
    design = np.column_stack((body[:, used], np.ones(len(body)))) / norms
    if np.linalg.svd(design, compute_uv=False)[-1] < _LEAST:
        return None
    spread = np.sqrt(np.diag(np.linalg.inv(design.T @ design)) / max(len(body) - len(norms), 1))
    wrapped = bool(np.ptp(values) < 2.0 * np.pi + 0.1 and np.abs(np.diff(values)).max() > np.pi)
    best, best_rest = None, _MOST
    totals = np.unwrap(values) if wrapped else values, np.append(0.0, np.cumsum(values[1:] * np.diff(own_s)))
    for rate in rates:  # those that it may be
        steps = np.diff(np.interp(grid, own_s, totals[rate]))
        found = np.linalg.lstsq(design, steps)[0]
        rest = np.linalg.norm(steps - design @ found) + 1e-6 * np.abs(steps).max() + 1e-12  # and rounding
        share = float(rest / max(np.linalg.norm(steps - steps.mean()), rest)) ** 2
        per, error = (found / norms)[:-1], (rest * spread / norms)[:-1]
        if share < best_rest and error.max() < _MOST * np.linalg.norm(per):
            whole = np.zeros(3)
            whole[used] = np.where(np.abs(per) > 3.0 * error, per, 0.0)
            best, best_rest = Relation(whole, rate, wrapped and not rate), share
    return best


class Rewriter:
    """Adds a run's error of the motion to the numbers that follow it, topic by topic in the order of arrival.

    The error of a rate is the mean one since the message before, so whoever integrates the rates gets the noisy motion.
    """

    def __init__(self) -> None:
        self._last: dict[tuple[int, int], tuple[int, Array, Array]] = {}

    def rewrite(
        self, block: Block, channel: int, layout: Layout, relations: Relations, stamps_ns: NDArray[np.int64],
        added: Array, stretch: NDArray[np.int64],
    ) -> None:  # fmt: skip
        """Change the messages of a layout in place.

        channel : id of their channel
        added : (n, 3) running sums of the errors of forward and leftward travel, metres, and turn, radians
        stretch : (n,) index of the time between two restarts
        """
        rates = self._rates(channel, stamps_ns, added, stretch)
        for index, fields in relations.items():
            item = layout.items[index]
            for field in (field for field in item.fields if any(fields.get(field, ()))):
                values = gather(block, layout, item, field)
                for column, one in enumerate(fields[field]):
                    more = np.zeros(len(values)) if one is None else (rates if one.rate else added) @ one.per
                    if field == "orientation":
                        (x, y, z, w), c, s = values.T, np.cos(more / 2.0), np.sin(more / 2.0)
                        values = np.stack((c * x - s * y, c * y + s * x, c * z + s * w, c * w - s * z), axis=1)
                        continue
                    moved = values[:, column] + more
                    moved = wrap(moved) if one is not None and one.wrapped else moved
                    values[:, column] = np.where(more == 0.0, values[:, column], moved)
                scatter(block, layout, item, field, np.rint(values) if item.number.startswith("i") else values)

    def _rates(self, channel: int, stamps_ns: NDArray[np.int64], added: Array, stretch: NDArray[np.int64]) -> Array:
        """Return the mean errors (n, 3) of the rates since the message before; repeated stamps get the first one."""
        out = np.zeros_like(added)
        for number in np.unique(stretch).tolist():
            rows = np.flatnonzero(stretch == number)
            begin = int(stamps_ns[rows[0]]) - SECOND_NS, added[rows[:1]], np.zeros((1, 3))
            reach_ns, last, rate = self._last.get((channel, number), begin)
            ahead = np.maximum.accumulate(np.append(reach_ns, stamps_ns[rows]))
            fresh = np.flatnonzero(np.diff(ahead))
            sums = np.concatenate((last, added[rows[fresh]]))
            dt_s = np.diff(ahead[np.append(0, fresh + 1)])[:, None] * 1e-9
            each = np.concatenate((rate, np.diff(sums, axis=0) / dt_s))
            out[rows] = each[np.searchsorted(fresh, np.arange(len(rows)), side="right")]
            self._last[channel, number] = int(ahead[-1]), sums[-1:], each[-1:]
        return out
