"""Yaw rate from an IMU topic, used to separate wheel errors from heading errors.

A gyro measures turns only, with a scale error and a bias. In addition to a truth it shows whether the odometry's
heading comes from the wheels or from the gyro, which a truth cannot show. Without a truth it serves as a truth of
headings; its positions are the odometry's travel along the gyro's headings, with a variance that removes their weight.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.integrate import cumulative_trapezoid

from odomcorrupt.bags.messages import gather, gather_stamps_ns, located
from odomcorrupt.bags.open import open_reader
from odomcorrupt.corruption.odometry_source import plain
from odomcorrupt.errors import RecordingError, TopicError
from odomcorrupt.geometry.se2 import accumulate, increments
from odomcorrupt.geometry.trajectory import Trajectory, distance_along
from odomcorrupt.study.io.raw_trajectory import FEWEST, REPORTED_LAG_S, Samples
from odomcorrupt.study.io.topic_selection import near

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array

IMU = "sensor_msgs/msg/Imu"
SCALE_ACCURACY = 0.01
"""Default standard deviation of a gyro's scale error: 1 % (uncalibrated MEMS)."""
_GRID_S = 0.05
_MAX_LAG_S = 1.0  # largest lag between gyro and odometry
_MIN_CORR = 0.6  # least correlation of their yaw rates
_WINDOW_S = 0.3  # time over which yaw rates are averaged
_STILL_S = 1.0  # shortest rest
_STILL_MPS, _STILL_RADPS = 2e-3, 2e-3
_MIN_STILL_S = 3.0  # total rest for a measured bias
_MAX_BIAS_RADPS = 0.05
_MAX_JITTER, _REST_CORR = 0.1, 0.5  # residual jitter (relative) and correlation at rest of a heading from the gyro
_EXACT_RAD = 1e-7  # smaller heading steps count as zero
_RIDGE = 0.05  # regularisation of the axis estimate, relative to the trace
_MAX_HZ = 100.0  # highest rate of a truth made from a gyro
_UNKNOWN_M2 = 100.0  # position variance of such a truth


@dataclass(frozen=True, slots=True)
class Gyro:
    """Angular velocities as recorded.

    place : name of bag and topic in messages: "run.bag: /imu/data"
    stamps_ns : (n,) increasing
    rates : (n, 3) angular velocities in the sensor's axes, rad/s
    """

    place: str
    topic: str
    stamps_ns: NDArray[np.int64]
    rates: Array


@dataclass(frozen=True, slots=True)
class YawGyro:
    """Yaw rate from a gyro, on the odometry's clock.

    stamps_ns : (n,)
    rate : (n,) yaw rate minus the estimated bias, rad/s; includes the gyro's scale error
    heading_source : source of the odometry's heading: "wheels", "gyro", or "" if undecided
    notes : findings, for reports
    """

    place: str
    topic: str
    stamps_ns: NDArray[np.int64]
    rate: Array
    heading_source: str
    notes: tuple[str, ...]

    def heading_at(self, stamps_ns: NDArray[np.int64]) -> Array:
        """Return the integrated heading (m,) at stamps within the record, rad; zero at its start."""
        origin = int(self.stamps_ns[0])
        own = (self.stamps_ns - origin) * 1e-9
        return np.interp((stamps_ns - origin) * 1e-9, own, cumulative_trapezoid(self.rate, own, initial=0.0))


def only_imu(path: Path) -> str | None:
    """Return the Imu topic of a bag with exactly one; otherwise None."""
    with open_reader(path) as reader:
        topics = {c.topic for c in reader.channels.values() if c.msgtype == IMU}
    return topics.pop() if len(topics) == 1 else None


def read_gyro(path: Path, place: str, topic: str) -> Gyro:
    """Return the angular velocities of an Imu topic.

    Raises
    ------
    TopicError
        If the bag has no such topic.
    RecordingError
        If there are too few angular velocities, or all are zero (a driver without a gyro).
    """
    parts: list[tuple[NDArray[np.int64], NDArray[np.int64], Array]] = []
    with open_reader(path) as reader:
        channels = [c for c in reader.channels.values() if c.msgtype == IMU and plain(c.topic) == plain(topic)]
        if not channels:
            there = near(topic, (c.topic for c in reader.channels.values() if c.msgtype == IMU))
            raise TopicError(f"{place}: no Imu on {topic} ({there}); name another with --imu")
        for block, _, layout in located(reader, channels):
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
    if len(stamps) < FEWEST:
        raise RecordingError(f"{where} holds {len(stamps)} angular velocities; leave --imu out, or record it longer")
    if not rates.any():
        raise RecordingError(f"{where}: all angular velocities are zero: it contains no gyro; leave --imu out")
    return Gyro(where, topic, stamps, rates)


def yaw_gyro(gyro: Gyro, odometry: Samples) -> YawGyro:
    """Return the robot's yaw rate according to a gyro, corrected for lag and bias.

    The vertical axis is found by regression of the odometry's yaw rate on the gyro's rates; TF is not used, because it
    is often missing or wrong.

    Raises
    ------
    RecordingError
        If the odometry does not turn, or if the gyro's rates do not correlate with its turns.
    """
    odo_s = odometry.t_s
    own_s = (gyro.stamps_ns - odometry.stamps_ns[0]) * 1e-9
    first, last = max(odo_s[0], own_s[0]), min(odo_s[-1], own_s[-1])
    if last - first < 10.0:
        raise RecordingError(
            f"{gyro.place} and {odometry.name} share {max(last - first, 0.0):.1f} s: their clocks differ; leave --imu "
            "out"
        )
    heading = np.unwrap(odometry.yaw_rad)
    grid = np.arange(first + _MAX_LAG_S, last - _MAX_LAG_S, _GRID_S)
    turned = _rate_on(odo_s, heading, grid)
    if float(np.std(turned)) < 5.0 * _STILL_RADPS:
        raise RecordingError(f"{odometry.place}: hardly turns, so that a gyro shows nothing: leave --imu out")
    angles = cumulative_trapezoid(gyro.rates, own_s, axis=0, initial=0.0)
    lag_s, coefficients, corr = _lagged(own_s, angles, grid, turned)
    if corr < _MIN_CORR:
        raise RecordingError(
            f"{gyro.place}: turns unlike the odometry (their yaw rates correlate by {corr:.2f} at best): it is not on "
            "this robot, or its clock is more than a second off; leave --imu out"
        )
    axis = coefficients / np.linalg.norm(coefficients)
    stamps = gyro.stamps_ns - round(lag_s * 1e9)
    rate = gyro.rates @ axis
    still = _at_rest(odometry)
    at = np.interp((stamps - odometry.stamps_ns[0]) * 1e-9, odo_s, still.astype(np.float64)) > 1.0 - 1e-9
    interval_s = float(np.median(np.diff(stamps))) * 1e-9
    still_s = float(np.count_nonzero(at)) * interval_s
    if still_s > _MIN_STILL_S:
        bias = float(np.median(rate[at]))
        how = f"measured in {still_s:.0f} s at rest"
    else:
        own = angles @ axis
        bias = float(np.median(_rate_on(own_s - lag_s, own, grid) - turned))
        how = "taken from the odometry, which hardly rests, and so uncertain"
        if abs(bias) > _MAX_BIAS_RADPS:
            # A difference this large comes from skidding wheels, not from a gyro.
            bias, how = 0.0, "unknown, because the odometry hardly rests"
    found = YawGyro(gyro.place, gyro.topic, stamps, rate - bias, "", ())
    source = _heading_source(found, odometry, still)
    largest = int(np.argmax(np.abs(axis)))
    tilt = float(np.degrees(np.arccos(min(abs(float(axis[largest])), 1.0))))
    up = f"{'' if axis[largest] > 0.0 else '-'}{'xyz'[largest]} axis{f', {tilt:.0f} deg off' if tilt > 3.0 else ''}"
    notes = [f"yaw is about its {up}", f"its bias is {np.degrees(bias):.3f} deg/s, {how}"]
    if abs(lag_s) > REPORTED_LAG_S:
        word = "late" if lag_s > 0.0 else "early"
        notes.append(f"stamped {abs(lag_s):.3f} s {word} against the odometry's turns; taken out")
    notes.append(_SOURCES[source])
    said = tuple(f"{gyro.topic}: {note}" for note in notes)
    return replace(found, heading_source=source, notes=said)


_SOURCES = {
    "gyro": "the odometry's heading comes from this gyro: a wrong gain of turns is gyro_scale",
    "wheels": "the odometry's heading comes from the wheels (at rest it is exactly constant, the gyro's is not): a "
    "wrong gain of turns is wheelbase",
    "": "whether the odometry's heading comes from the wheels or from a gyro is not known",
}


def gyro_truth(odometry: Samples, gyro: YawGyro) -> Samples:
    """Return a truth of headings from a gyro; its positions are the odometry's travel and have a large variance.

    Raises
    ------
    RecordingError
        If the odometry's heading comes from this gyro, which then cannot serve as a reference.
    """
    if gyro.heading_source == "gyro":
        raise RecordingError(
            f"{gyro.place}: the odometry's heading comes from this gyro, so the two cannot be compared; give a "
            "truth or a laser (--truth, --scan)"
        )
    inside = (odometry.stamps_ns >= gyro.stamps_ns[0]) & (odometry.stamps_ns <= gyro.stamps_ns[-1])
    kept = odometry.only(inside).trajectory()
    theirs = gyro.heading_at(kept.stamps_ns)
    steps = replace(increments(kept.xyt), dtheta_rad=np.diff(theirs))
    travelled = Trajectory(kept.stamps_ns, accumulate(np.array([0.0, 0.0, theirs[0]]), steps))
    rate_hz = 1e9 / float(np.median(np.diff(gyro.stamps_ns)))
    stamps = gyro.stamps_ns[:: max(1, round(rate_hz / _MAX_HZ))]
    stamps = stamps[(stamps >= kept.stamps_ns[0]) & (stamps <= kept.stamps_ns[-1])]
    origin = int(kept.stamps_ns[0])
    xyt = travelled.at((stamps - origin) * 1e-9, origin)
    covariance = np.broadcast_to(np.diag([_UNKNOWN_M2, _UNKNOWN_M2, 1.0]), (len(stamps), 3, 3))
    xyt[:, 2] = gyro.heading_at(stamps)
    return Samples.planar(gyro.place, gyro.topic, stamps, xyt, notes=gyro.notes, covariance=covariance, relative=True)


def _rate_on(t_s: Array, angle: Array, grid: Array) -> Array:
    """Return the mean rate (m,) of an angle (n,) over 0.3 s around each time of a grid."""
    half = 0.5 * _WINDOW_S
    after: Array = np.interp(grid + half, t_s, angle)
    before: Array = np.interp(grid - half, t_s, angle)
    return (after - before) / _WINDOW_S


def _lagged(own_s: Array, angles: Array, grid: Array, turned: Array) -> tuple[float, Array, float]:
    """Return the gyro's lag, s, the coefficients (3,) that give the odometry's yaw rate, and the correlation."""

    def fit_at(lag: float) -> tuple[float, Array]:
        rates = np.stack([_rate_on(own_s - lag, angles[:, i], grid) for i in range(3)], axis=1)
        rates -= np.median(rates[resting], axis=0) if resting.sum() > FEWEST else 0.0
        square = rates.T @ rates
        # Regularised: an axis that hardly turns must not replace one that does.
        solution = np.linalg.solve(square + _RIDGE * np.trace(square) * np.eye(3), rates.T @ turned)
        fitted = rates @ solution
        return float(fitted @ turned) / max(float(np.linalg.norm(fitted) * np.linalg.norm(turned)), 1e-12), solution

    resting = np.abs(turned) < _STILL_RADPS
    lag = 0.0
    for step, reach in ((0.05, _MAX_LAG_S), (0.01, 0.06), (0.002, 0.012)):
        count = round(reach / step)
        lag = max((lag + step * np.arange(-count, count + 1)).tolist(), key=lambda one: fit_at(one)[0])
    corr, solution = fit_at(lag)
    return lag, solution, corr


def _at_rest(odometry: Samples) -> NDArray[np.bool_]:
    """Return which odometry samples (n,) belong to a rest of at least 1 s."""
    t_s = odometry.t_s
    half = 0.5 * _STILL_S
    ahead, behind = (np.clip(t_s + sign * half, t_s[0], t_s[-1]) for sign in (1.0, -1.0))
    moved = [np.interp(ahead, t_s, odometry.xyz[:, i]) - np.interp(behind, t_s, odometry.xyz[:, i]) for i in (0, 1)]
    # Use the travelled path in addition to the displacement, because back and forth is no rest.
    way = distance_along(odometry.xyz)
    gone = np.maximum(np.hypot(*moved), np.interp(ahead, t_s, way) - np.interp(behind, t_s, way))
    heading = np.unwrap(odometry.yaw_rad)
    turned = np.abs(np.interp(ahead, t_s, heading) - np.interp(behind, t_s, heading))
    span = np.maximum(ahead - behind, 1e-9)
    return (gone / span < _STILL_MPS) & (turned / span < 10.0 * _STILL_RADPS)


def _heading_source(gyro: YawGyro, odometry: Samples, still: NDArray[np.bool_]) -> str:
    """Return the source of the odometry's heading: "wheels", "gyro" or "".

    Fast jitter of the gyro (third differences) appears only in a heading integrated from it. At rest, a heading from
    wheels is exactly constant, while the gyro's is noisy.
    """
    inside = (odometry.stamps_ns > gyro.stamps_ns[0]) & (odometry.stamps_ns < gyro.stamps_ns[-1])
    stamps, rest = odometry.stamps_ns[inside], still[inside]
    heading = np.unwrap(odometry.yaw_rad[inside])
    theirs = gyro.heading_at(stamps)
    ours, other = (np.diff(angle, n=3) for angle in (heading, theirs))
    scale = float(ours @ other / max(float(other @ other), 1e-30))
    alone = 1.4826 * float(np.median(np.abs(ours - scale * other)))
    jitter = 1.4826 * float(np.median(np.abs(other)))
    if abs(scale - 1.0) < 0.2 and alone < _MAX_JITTER * jitter:
        return "gyro"
    resting = rest[:-1] & rest[1:]
    if np.count_nonzero(resting) > FEWEST:
        own = np.abs(np.diff(heading)[resting])
        seen = np.abs(np.diff(theirs)[resting])
        if np.mean(own < _EXACT_RAD) > 0.9 and float(np.median(seen)) > _EXACT_RAD:
            return "wheels"
        shared = np.corrcoef(np.diff(heading)[resting], np.diff(theirs)[resting])[0, 1] if own.any() else 0.0
        if shared > _REST_CORR:
            return "gyro"
    return ""
