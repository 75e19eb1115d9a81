"""Numbers of other sensors that are linear in the motion of the body, rewritten to the motion of corrupted odometry.

Angles, ticks and speeds of wheels, twists and gyros are running counts or rates of a sum of forward travel, leftward
travel and turn. Its coefficients (of a wheel: one over its radius, and its distance from the middle over its radius)
are estimated from the bag, number by number, so mirrored wheels, any number of wheels and tilted gyros need no setting.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from odomcorrupt.bags.messages import gather, locate, scatter, stamps_or_log_ns
from odomcorrupt.errors import SensorError
from odomcorrupt.geometry.se2 import increments, wrap, yaw_from_quaternion

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from numpy.typing import NDArray

    from odomcorrupt.bags.block import BagReader, Block, Channel
    from odomcorrupt.bags.messages import Item, Layout
    from odomcorrupt.corruption.reorder import Arrivals
    from odomcorrupt.geometry.se2 import Array

SENSORS = frozenset({
    "geometry_msgs/msg/TwistStamped", "geometry_msgs/msg/TwistWithCovarianceStamped",
    "irobot_create_msgs/msg/WheelTicks", "irobot_create_msgs/msg/WheelVels", "sensor_msgs/msg/Imu",
    "sensor_msgs/msg/JointState", "std_msgs/msg/Float32", "std_msgs/msg/Float64", "std_msgs/msg/Int32",
    "std_msgs/msg/Int64",
})  # fmt: skip
"""Message types that are rewritten."""

_STEP_S = 0.5  # long against the delays between sensors
_MOST_REST = 0.1  # part of a number's variance that may not be explained
_MOST_ERROR = 0.1  # largest standard error of a coefficient, relative to all
_LEVER_M = 0.5  # a turn counts as the travel of a wheel here
_LEAST_PART = 0.02  # least size of a motion among the others, and of what others do not explain of it
_JUMP_MPS = 20.0


class Relation(NamedTuple):
    """How a number follows the motion.

    per : (3,) change for each metre forward, metre leftward and radian; of a rate: its own for each of these rates
    rate : whether the number is a rate, else it counts on
    wrapped : whether it is an angle that stays within a turn
    """

    per: Array
    rate: bool
    wrapped: bool


class Follows(NamedTuple):
    """Relations of one item of a topic's messages.

    number : index of the item in the message
    fields : for each field, the relations of its numbers; None for one that does not follow. Of an orientation there
        is one, of its heading
    """

    number: int
    fields: Mapping[str, tuple[Relation | None, ...]]


class Series(NamedTuple):
    """Values (n, k) of a field at stamps (n,)."""

    stamps_ns: NDArray[np.int64]
    values: Array


def find_relations(
    reader: BagReader, channels: Iterable[Channel], poses_of: Callable[[Block], Arrivals], others: set[int]
) -> dict[int, list[Follows]]:
    """Return how the numbers of topics follow the odometry's motion, by channel id, from a pass over the bag.

    channels : those of the sensors
    poses_of : reads the odometry of a block, whose channels are among `others`

    Raises
    ------
    SensorError
        If a sensor of motion does not follow, or the drive does not tell how.
    """
    chosen = {channel.id: channel for channel in channels}
    parts: dict[tuple[int, int, str], list[Series]] = {}
    path: list[Arrivals] = []
    for block in reader.blocks(others | chosen.keys()):
        path.append(poses_of(block))
        for number in sorted(block.present() & chosen.keys()):
            for layout in locate(block, chosen[number]):
                for index, item in enumerate(layout.items):
                    stamps_ns = stamps_or_log_ns(block, layout, item)
                    for field in item.fields:
                        values = _numbers(block, layout, item, field)
                        parts.setdefault((number, index, field), []).append(Series(stamps_ns, values))
    motion = _body_motion(path)
    found: dict[int, list[Follows]] = {}
    for number, channel in chosen.items():
        moves = False
        items: dict[int, dict[str, tuple[Relation | None, ...]]] = {}
        for (own, index, field), pieces in sorted(parts.items(), key=lambda part: part[0]):
            if own == number:
                series = _ordered(*zip(*pieces, strict=True))
                moves |= bool(np.ptp(series.values, axis=0).any()) and _is_wheel(channel, field)
                relations = tuple(_relation(motion, series.stamps_ns, one) for one in series.values.T)
                items.setdefault(index, {})[field] = relations
        found[number] = [Follows(index, fields) for index, fields in items.items()]
        if moves and not any(one for fields in items.values() for relations in fields.values() for one in relations):
            raise SensorError(
                f"{channel.topic}: the bag does not tell how its numbers follow the odometry (they need 6 s of a drive "
                "that turns and changes its speed); leave it out with --exclude-topic, or do without --consistent"
            )
    return found


def _is_wheel(channel: Channel, field: str) -> bool:
    return not channel.msgtype.endswith("JointState") or "wheel" in field.lower()


def _numbers(block: Block, layout: Layout, item: Item, field: str) -> Array:
    """Return the numbers (n, k) of a field; of an orientation its heading."""
    values = gather(block, layout, item, field)
    return yaw_from_quaternion(values)[:, None] if field == "orientation" else values


def _ordered(stamps_ns: tuple[NDArray[np.int64], ...], values: tuple[Array, ...]) -> Series:
    """Return numbers in the order of their stamps, without repeated ones and those that are not finite."""
    every, rows = np.concatenate(stamps_ns), np.concatenate(values)
    good = np.flatnonzero(np.isfinite(rows).all(axis=1))
    at_ns, first = np.unique(every[good], return_index=True)
    return Series(at_ns, rows[good][first])


def _body_motion(path: list[Arrivals]) -> Series:
    """Return running sums (n, 3) of forward and leftward travel and turn, without jumps of the pose."""
    series = _ordered(tuple(one.stamps_ns for one in path), tuple(one.xyt for one in path))
    steps = increments(series.values)
    each = np.stack((steps.ds_m, steps.dl_m, steps.dtheta_rad), axis=1)
    each[np.hypot(steps.ds_m, steps.dl_m) > _JUMP_MPS * np.diff(series.stamps_ns) * 1e-9] = 0.0
    return Series(
        series.stamps_ns, np.concatenate((np.zeros((min(1, len(series.values)), 3)), np.cumsum(each, axis=0)))
    )


def _relation(motion: Series, stamps_ns: NDArray[np.int64], values: Array) -> Relation | None:
    """Return how a number (n,) follows the motion, by least squares; None if it does not, or the drive cannot tell."""
    if min(len(stamps_ns), len(motion.stamps_ns)) < 2:
        return None
    own_s, motion_s = ((at - motion.stamps_ns[0]) * 1e-9 for at in (stamps_ns, motion.stamps_ns))
    first, last = max(own_s[0], motion_s[0]), min(own_s[-1], motion_s[-1])
    grid = np.arange(first, last, max(_STEP_S, 4.0 * float(np.median(np.diff(own_s)))))
    if len(grid) < 12:  # as many as the numbers of the fit, three times
        return None
    body = np.stack([np.diff(np.interp(grid, motion_s, one)) for one in motion.values.T], axis=1) * (1, 1, _LEVER_M)
    size = np.linalg.norm(body, axis=0)
    used = np.flatnonzero(size > _LEAST_PART * size.max())
    if not {0, 2} <= {*used}:
        return None
    # the last column is a bias of a rate, or what turns on its own
    norms = np.append(size[used], np.sqrt(len(body)))
    design = np.column_stack((body[:, used], np.ones(len(body)))) / norms
    if np.linalg.svd(design, compute_uv=False)[-1] < _LEAST_PART:
        return None
    spread = np.sqrt(np.diag(np.linalg.inv(design.T @ design)) / max(len(body) - len(norms), 1))
    wrapped = bool(np.ptp(values) < 2.0 * np.pi + 0.1 and np.abs(np.diff(values)).max() > np.pi)
    best, best_rest = None, _MOST_REST
    totals = np.unwrap(values) if wrapped else values, np.append(0.0, np.cumsum(values[1:] * np.diff(own_s)))
    for rate, total in enumerate(totals):
        steps = np.diff(np.interp(grid, own_s, total))
        found = np.linalg.lstsq(design, steps)[0]
        rest = np.linalg.norm(steps - design @ found)
        share = float(rest / max(float(np.linalg.norm(steps - steps.mean())), 1e-12)) ** 2
        per, error = (found / norms)[:-1], (rest * spread / norms)[:-1]
        if share < best_rest and error.max() < _MOST_ERROR * np.linalg.norm(per):
            whole = np.zeros(3)
            whole[used] = np.where(np.abs(per) > 3.0 * error, per, 0.0)
            best, best_rest = Relation(whole * (1, 1, _LEVER_M), bool(rate), wrapped and not rate), share
    return best


class Rewriter:
    """Adds a run's error of the motion to the numbers that follow it, topic by topic in the order of arrival.

    The error of a rate is the mean one since the message before, so whoever integrates the rates gets the noisy motion.
    """

    def __init__(self) -> None:
        self._last: dict[tuple[int, int, int], tuple[int, Array, Array]] = {}

    def rewrite(
        self, block: Block, channel: Channel, layout: Layout, item: Item, follows: Follows,
        stamps_ns: NDArray[np.int64], added: Array, stretch: NDArray[np.int64],
    ) -> None:  # fmt: skip
        """Change the messages of a layout in place.

        added : (n, 3) running sums of the errors of forward and leftward travel, metres, and turn, radians
        stretch : (n,) index of the time between two restarts
        """
        rates = self._rates((channel.id, follows.number), stamps_ns, added, stretch)
        for field in item.fields:
            relations = follows.fields.get(field, ())
            if not any(relations):
                continue
            values = gather(block, layout, item, field)
            if field == "orientation" and relations[0] is not None:
                half = added @ relations[0].per / 2.0
                x, y, z, w = values.T
                c, s = np.cos(half), np.sin(half)
                values = np.stack((c * x - s * y, c * y + s * x, c * z + s * w, c * w - s * z), axis=1)
            else:
                for column, one in enumerate(relations):
                    if one is not None:
                        more = (rates if one.rate else added) @ one.per
                        moved = values[:, column] + more
                        values[:, column] = np.where(
                            more == 0.0, values[:, column], wrap(moved) if one.wrapped else moved
                        )
            scatter(block, layout, item, field, np.rint(values) if item.number.startswith("i") else values)

    def _rates(
        self, key: tuple[int, int], stamps_ns: NDArray[np.int64], added: Array, stretch: NDArray[np.int64]
    ) -> Array:
        """Return the mean errors (n, 3) of the rates since the message before; repeated stamps get the first one."""
        out = np.zeros_like(added)
        for number in np.unique(stretch).tolist():
            rows = np.flatnonzero(stretch == number)
            begin = int(stamps_ns[rows[0]]) - 1_000_000_000, added[rows[:1]], np.zeros((1, 3))
            reach_ns, last, rate = self._last.get((*key, number), begin)
            ahead = np.maximum.accumulate(np.append(reach_ns, stamps_ns[rows]))
            fresh = np.flatnonzero(np.diff(ahead))
            sums = np.concatenate((last, added[rows[fresh]]))
            dt_s = np.diff(ahead[np.append(0, fresh + 1)])[:, None] * 1e-9
            each = np.concatenate((rate, np.diff(sums, axis=0) / dt_s))
            out[rows] = each[np.searchsorted(fresh, np.arange(len(rows)), side="right")]
            self._last[*key, number] = int(ahead[-1]), sums[-1:], each[-1:]
        return out
