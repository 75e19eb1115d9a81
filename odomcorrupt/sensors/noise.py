"""Errors of other sensors than the odometry: ranges of laser scans, and white noise and bias walks of IMUs, by seed."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from odomcorrupt.bags.messages import SCAN, gather, scatter
from odomcorrupt.bags.rosbag2.bounded_yaml import load_yaml
from odomcorrupt.errors import ModelError
from odomcorrupt.input_files import read_input
from odomcorrupt.rng import stream

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from odomcorrupt.bags.block import Block, Channel
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
