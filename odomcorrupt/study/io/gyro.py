"""A gyro as a witness of turning: angular velocities of an Imu topic, their vertical axis, and the heading they give.

A gyro measures turns alone, up to a gain and an offset of its own. Beside a truth it shows whether the odometry's
heading comes from the wheels or from the gyro, which no truth can. Without one it is the truth itself, of headings:
its positions are the odometry's travel along its own headings, their variance such that they carry no information.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.bags.messages import gather, gather_stamps_ns, locate
from odomcorrupt.bags.open import open_reader
from odomcorrupt.errors import RecordingError, TopicError
from odomcorrupt.geometry.se2 import rotate
from odomcorrupt.study.io.address import plain
from odomcorrupt.study.io.raw_trajectory import Samples
from odomcorrupt.study.io.topic_selection import near

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array

__all__ = ["SCALE_ACCURACY", "Gyro", "YawGyro", "gyro_truth", "only_imu", "read_gyro", "yaw_gyro"]

IMU = "sensor_msgs/msg/Imu"
SCALE_ACCURACY = 0.01
"""Standard deviation of a gyro's own scale error where nobody says better: 1 % (MEMS, not calibrated)."""
_FEWEST = 50
_GRID_S = 0.05
_LAG_S = 1.0
_ALIKE = 0.6
_SPREAD_S = 0.3
_STILL_S = 1.0
_STILL_MPS, _STILL_RADPS = 2e-3, 2e-3
_LEAST_STILL_S = 3.0
_KNOWN_BIAS_RADPS, _UNKNOWN_BIAS_RADPS = 3e-4, 0.02
_MOST_BIAS_RADPS = 0.05
_SAME, _OTHER = 0.1, 0.5
_EXACT_RAD = 1e-7
_RIDGE = 0.05
_MOST_HZ = 100.0
_UNKNOWN_M2 = 100.0
_LAG_SAID_S = 0.01


@dataclass(frozen=True, slots=True)
class Gyro:
    """Angular velocities as recorded.

    place : what messages call the topic: "run.bag: /imu/data"
    stamps_ns : (n,) growing
    rates : (n, 3) rad/s in the sensor's axes
    """

    place: str
    topic: str
    stamps_ns: NDArray[np.int64]
    rates: Array


@dataclass(frozen=True, slots=True)
class YawGyro:
    """The vertical part of a gyro, on the odometry's clock.

    stamps_ns : (n,)
    rate : (n,) yaw rate less the bias, rad/s; its gain is the gyro's own
    bias_error_radps : standard deviation of what may be left of the bias
    heading_source : where the odometry's heading comes from: "wheels", "gyro", or "" where it does not show
    notes : what was found, in words
    """

    place: str
    topic: str
    stamps_ns: NDArray[np.int64]
    rate: Array
    bias_error_radps: float
    heading_source: str
    notes: tuple[str, ...]

    def heading_at(self, stamps_ns: NDArray[np.int64]) -> Array:
        """Return the summed heading (m,) at stamps within the record, rad; zero at its start."""
        origin = int(self.stamps_ns[0])
        own = (self.stamps_ns - origin) * 1e-9
        heading = np.concatenate(([0.0], np.cumsum(0.5 * (self.rate[1:] + self.rate[:-1]) * np.diff(own))))
        at: Array = np.interp((stamps_ns - origin) * 1e-9, own, heading)
        return at


def only_imu(path: Path) -> str | None:
    """Return the only Imu topic of a bag; None where there is none, or several."""
    with open_reader(path) as reader:
        topics = {c.topic for c in reader.channels.values() if c.msgtype == IMU}
    return topics.pop() if len(topics) == 1 else None


def read_gyro(path: Path, place: str, topic: str) -> Gyro:
    """Read the angular velocities of an Imu topic.

    Raises
    ------
    TopicError
        Where the bag has no such topic.
    RecordingError
        Where it holds too few, or nothing but zeros: a driver without a gyro.

    """
    parts: list[tuple[NDArray[np.int64], NDArray[np.int64], Array]] = []
    with open_reader(path) as reader:
        channels = [c for c in reader.channels.values() if c.msgtype == IMU and plain(c.topic) == plain(topic)]
        if not channels:
            there = near(topic, (c.topic for c in reader.channels.values() if c.msgtype == IMU))
            raise TopicError(f"{place}: no Imu on {topic} ({there}); name another with --imu")
        for block in reader.blocks():
            for channel in channels:
                for layout in locate(block, channel):
                    item = layout.items[0]
                    logs = block.table["log_ns"][layout.rows].astype(np.int64)
                    stamps = gather_stamps_ns(block, layout, item)
                    parts.append((stamps, logs, gather(block, layout, item, "angular_velocity")))
    empty = (np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, 3)))
    stamps, logs, rates = (np.concatenate(part) for part in zip(empty, *parts, strict=True))
    stamps = stamps if stamps.any() else logs
    good = np.isfinite(rates).all(axis=1) & (np.abs(rates) < 100.0).all(axis=1)
    _, index = np.unique(stamps[good], return_index=True)
    stamps, rates = stamps[good][index], rates[good][index]
    where = f"{place}: {topic}"
    if len(stamps) < _FEWEST:
        raise RecordingError(f"{where} holds {len(stamps)} angular velocities; leave --imu out, or record it longer")
    if not rates.any():
        raise RecordingError(f"{where}: all angular velocities are zero: there is no gyro behind it; leave --imu out")
    return Gyro(where, topic, stamps, rates)


def yaw_gyro(gyro: Gyro, odometry: Samples) -> YawGyro:
    """Return the part of a gyro that is the robot's yaw rate, its lag and bias taken out.

    The vertical axis is the direction in which its rates follow the odometry's turns: TF need not say it, and often
    says it wrongly.

    Raises
    ------
    RecordingError
        Where the odometry does not turn, or the gyro does not turn with it.

    """
    odo_s = odometry.seconds_since(int(odometry.stamps_ns[0]))
    own_s = (gyro.stamps_ns - odometry.stamps_ns[0]) * 1e-9
    first, last = max(odo_s[0], own_s[0]), min(odo_s[-1], own_s[-1])
    if last - first < 10.0:
        raise RecordingError(
            f"{gyro.place} and {odometry.name} share {max(last - first, 0.0):.1f} s: their clocks differ; leave --imu "
            "out"
        )
    heading = np.unwrap(odometry.yaw_rad)
    grid = np.arange(first + _LAG_S, last - _LAG_S, _GRID_S)
    turned = _rate_on(odo_s, heading, grid)
    if float(np.std(turned)) < 5.0 * _STILL_RADPS:
        raise RecordingError(f"{odometry.place}: hardly turns; a gyro has nothing to witness: leave --imu out")
    angles = _summed(own_s, gyro.rates)
    lag_s, coefficients, alike = _lagged(own_s, angles, grid, turned)
    if alike < _ALIKE:
        raise RecordingError(
            f"{gyro.place}: turns unlike the odometry (their yaw rates correlate by {alike:.2f} at best): it is not on "
            "this robot, or its clock is more than a second off; leave --imu out"
        )
    axis = coefficients / np.linalg.norm(coefficients)
    stamps = gyro.stamps_ns - round(lag_s * 1e9)
    rate = gyro.rates @ axis
    still = _still(odometry)
    at = np.interp((stamps - odometry.stamps_ns[0]) * 1e-9, odo_s, still.astype(np.float64)) > 1.0 - 1e-9
    interval_s = float(np.median(np.diff(stamps))) * 1e-9
    still_s = float(np.count_nonzero(at)) * interval_s
    if still_s > _LEAST_STILL_S:
        bias, error = float(np.median(rate[at])), _KNOWN_BIAS_RADPS
        how = f"measured in {still_s:.0f} s at rest"
    else:
        own = angles @ axis
        bias, error = float(np.median(_rate_on(own_s - lag_s, own, grid) - turned)), _UNKNOWN_BIAS_RADPS
        how = "taken from the odometry, which hardly rests: not known"
        if abs(bias) > _MOST_BIAS_RADPS:
            # wheels that skid, not a gyro that is off by degrees a second
            bias, how = 0.0, "not known, for the odometry hardly rests"
    found = YawGyro(gyro.place, gyro.topic, stamps, rate - bias, error, "", ())
    source = _heading_source(found, odometry, still)
    notes = [_axis_words(axis), f"its bias is {np.degrees(bias):.3f} deg/s, {how}"]
    if abs(lag_s) > _LAG_SAID_S:
        word = "late" if lag_s > 0.0 else "early"
        notes.append(f"stamped {abs(lag_s):.3f} s {word} against the odometry's turns; taken out")
    notes.append(_SOURCES[source])
    said = tuple(f"{gyro.topic}: {note}" for note in notes)
    return YawGyro(gyro.place, gyro.topic, stamps, rate - bias, error, source, said)


_SOURCES = {
    "gyro": "the odometry's heading comes from this gyro: of a wrong gain of turns, gyro_scale is meant",
    "wheels": "the odometry's heading comes from the wheels (at rest it says exactly nothing, the gyro does not): of a "
    "wrong gain of turns, wheelbase is meant",
    "": "whether the odometry's heading comes from the wheels or from a gyro does not show",
}


def gyro_truth(odometry: Samples, gyro: YawGyro) -> Samples:
    """Return a truth of headings: positions are the odometry's travel along the gyro's headings, and carry nothing.

    Raises
    ------
    RecordingError
        Where the odometry's heading is this gyro's, so that there is no second witness.

    """
    if gyro.heading_source == "gyro":
        raise RecordingError(
            f"{gyro.place}: the odometry's heading comes from this gyro, which is no witness against itself; give a "
            "truth or a laser (--truth, --scan)"
        )
    inside = (odometry.stamps_ns >= gyro.stamps_ns[0]) & (odometry.stamps_ns <= gyro.stamps_ns[-1])
    kept = odometry.only(inside)
    heading = np.unwrap(kept.yaw_rad)
    theirs = gyro.heading_at(kept.stamps_ns)
    middle = 0.5 * (heading[1:] + heading[:-1])
    body = rotate(np.diff(kept.xyz[:, :2], axis=0), -middle)
    step = rotate(body, 0.5 * (theirs[1:] + theirs[:-1]))
    xy = np.concatenate((np.zeros((1, 2)), np.cumsum(step, axis=0)))
    rate_hz = 1e9 / float(np.median(np.diff(gyro.stamps_ns)))
    every = max(1, round(rate_hz / _MOST_HZ))
    stamps = gyro.stamps_ns[::every]
    stamps = stamps[(stamps >= kept.stamps_ns[0]) & (stamps <= kept.stamps_ns[-1])]
    origin = int(kept.stamps_ns[0])
    at, own = (stamps - origin) * 1e-9, kept.seconds_since(origin)
    xyz = np.column_stack([*(np.interp(at, own, xy[:, i]) for i in (0, 1)), np.zeros(len(at))])
    covariance = np.broadcast_to(np.diag([_UNKNOWN_M2, _UNKNOWN_M2, 1.0]), (len(stamps), 3, 3))
    return Samples(
        place=gyro.place,
        name=gyro.topic,
        frame="",
        stamps_ns=stamps,
        xyz=xyz,
        yaw_rad=gyro.heading_at(stamps),
        log_ns=np.zeros(0, dtype=np.int64),
        variance_m2=np.zeros(0),
        notes=gyro.notes,
        covariance=covariance,
        relative=True,
    )


def _summed(t_s: Array, rates: Array) -> Array:
    """Return angles (n, c) summed from rates (n, c) by trapezia, rad."""
    steps = 0.5 * (rates[1:] + rates[:-1]) * np.diff(t_s)[:, None]
    return np.concatenate((np.zeros((1, rates.shape[1])), np.cumsum(steps, axis=0)))


def _rate_on(t_s: Array, angle: Array, grid: Array) -> Array:
    """Return the mean rate (m,) of an angle (n,) over 0.3 s around each time of a grid."""
    half = 0.5 * _SPREAD_S
    after: Array = np.interp(grid + half, t_s, angle)
    before: Array = np.interp(grid - half, t_s, angle)
    return (after - before) / _SPREAD_S


def _lagged(own_s: Array, angles: Array, grid: Array, turned: Array) -> tuple[float, Array, float]:
    """Return the gyro's lag, coefficients (3,) that make its rates the odometry's yaw rate, and their correlation."""

    def tried(lag: float) -> tuple[float, Array]:
        rates = np.stack([_rate_on(own_s - lag, angles[:, i], grid) for i in range(3)], axis=1)
        rates -= np.median(rates[resting], axis=0) if resting.sum() > _FEWEST else 0.0
        square = rates.T @ rates
        # of an axis that hardly turns nothing is known: it must not stand in for one that does
        solution = np.linalg.solve(square + _RIDGE * np.trace(square) * np.eye(3), rates.T @ turned)
        fitted = rates @ solution
        return float(fitted @ turned) / max(float(np.linalg.norm(fitted) * np.linalg.norm(turned)), 1e-12), solution

    resting = np.abs(turned) < _STILL_RADPS
    lags = np.arange(-_LAG_S, _LAG_S + 1e-9, 0.05)
    lag = float(lags[int(np.argmax([tried(float(one))[0] for one in lags]))])
    for step in (0.01, 0.002):
        near_it = lag + step * np.arange(-6, 7)
        lag = float(near_it[int(np.argmax([tried(float(one))[0] for one in near_it]))])
    alike, solution = tried(lag)
    return lag, solution, alike


def _still(odometry: Samples) -> NDArray[np.bool_]:
    """Return which samples (n,) of the odometry lie in a second or more without motion."""
    t_s = odometry.seconds_since(int(odometry.stamps_ns[0]))
    half = 0.5 * _STILL_S
    ahead, behind = (np.clip(t_s + sign * half, t_s[0], t_s[-1]) for sign in (1.0, -1.0))
    moved = [np.interp(ahead, t_s, odometry.xyz[:, i]) - np.interp(behind, t_s, odometry.xyz[:, i]) for i in (0, 1)]
    # how far it went, not how far it came: back and forth is no rest
    way = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(odometry.xyz[:, :2], axis=0), axis=1))))
    gone = np.maximum(np.hypot(*moved), np.interp(ahead, t_s, way) - np.interp(behind, t_s, way))
    heading = np.unwrap(odometry.yaw_rad)
    turned = np.abs(np.interp(ahead, t_s, heading) - np.interp(behind, t_s, heading))
    span = np.maximum(ahead - behind, 1e-9)
    still: NDArray[np.bool_] = (gone / span < _STILL_MPS) & (turned / span < 10.0 * _STILL_RADPS)
    return still


def _heading_source(gyro: YawGyro, odometry: Samples, still: NDArray[np.bool_]) -> str:
    """Return where the odometry's heading comes from, by what it shares with the gyro that no wheel can.

    Fast jitter of the gyro (third differences) is in an odometry whose heading is summed from it and in no other. And
    wheels that rest say exactly nothing, while a gyro always says something.
    """
    inside = (odometry.stamps_ns > gyro.stamps_ns[0]) & (odometry.stamps_ns < gyro.stamps_ns[-1])
    stamps, rest = odometry.stamps_ns[inside], still[inside]
    heading = np.unwrap(odometry.yaw_rad[inside])
    theirs = gyro.heading_at(stamps)
    ours, other = (np.diff(angle, n=3) for angle in (heading, theirs))
    scale = float(ours @ other / max(float(other @ other), 1e-30))
    alone = 1.4826 * float(np.median(np.abs(ours - scale * other)))
    jitter = 1.4826 * float(np.median(np.abs(other)))
    if abs(scale - 1.0) < 0.2 and alone < _SAME * jitter:
        return "gyro"
    resting = rest[:-1] & rest[1:]
    if np.count_nonzero(resting) > _FEWEST:
        own = np.abs(np.diff(heading)[resting])
        seen = np.abs(np.diff(theirs)[resting])
        if np.mean(own < _EXACT_RAD) > 0.9 and float(np.median(seen)) > _EXACT_RAD:
            return "wheels"
        shared = np.corrcoef(np.diff(heading)[resting], np.diff(theirs)[resting])[0, 1] if own.any() else 0.0
        if shared > _OTHER:
            return "gyro"
    return ""


def _axis_words(axis: Array) -> str:
    """Return which axis of the sensor points up, in words."""
    largest = int(np.argmax(np.abs(axis)))
    sign = "" if axis[largest] > 0.0 else "-"
    tilt = float(np.degrees(np.arccos(min(abs(float(axis[largest])), 1.0))))
    return f"yaw is about its {sign}{'xyz'[largest]} axis" + (f", {tilt:.0f} deg off" if tilt > 3.0 else "")
