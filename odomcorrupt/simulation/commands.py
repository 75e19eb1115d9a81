"""Simulation of a base controller that follows recorded /cmd_vel commands."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from odomcorrupt.errors import BagError, TopicError

MAX_MPS2 = 2.5
MAX_RADPS2 = 6.0
REST_S = 2.0
TYPES = ("geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped")


@dataclass(frozen=True, slots=True)
class Commands:
    """Speed commands: times since the first command (s), forward speeds (m/s), turn rates (rad/s); shape (n,) each."""

    times_s: np.ndarray
    v_mps: np.ndarray
    omega_radps: np.ndarray

    @property
    def duration_s(self) -> float:
        """Duration of the commands with a rest before and after, s."""
        return float(self.times_s[-1]) + 2.0 * REST_S


def obey(commands: Commands, grid_s: np.ndarray) -> np.ndarray:
    """Return the speeds set by the base's controller: the last command, with limited acceleration.

    Parameters
    ----------
    grid_s : ndarray, shape (n,)
        Times, s; the first command comes `REST_S` after the first of them, and after the last one the robot stops.

    Returns
    -------
    ndarray, shape (n, 2)
        Forward speed in m/s, turn rate in rad/s.
    """
    step_s = float(grid_s[1] - grid_s[0])
    last = np.searchsorted(commands.times_s, grid_s - REST_S, side="right") - 1
    going = (last >= 0) & (grid_s - REST_S < commands.times_s[-1] + 0.1)
    wanted = np.where(going, np.stack((commands.v_mps[last], commands.omega_radps[last])), 0.0)
    pairs = zip(wanted, (MAX_MPS2 * step_s, MAX_RADPS2 * step_s), strict=True)
    return np.column_stack([_approach(row.tolist(), change) for row, change in pairs])


def _approach(wanted: list[float], change: float) -> list[float]:
    now, speeds = 0.0, []
    for speed in wanted:
        now = min(max(speed, now - change), now + change)
        speeds.append(now)
    return speeds


def read_commands(path: str | Path, topic: str | None = None) -> Commands:
    """Return the speed commands of a bag (MCAP file, ROS 1 bag or rosbag2 directory).

    Parameters
    ----------
    topic : str, optional
        Topic of the Twist or TwistStamped; by default /cmd_vel, or else the only one there is.

    Raises
    ------
    BagError
        If the bag cannot be read.
    TopicError
        If it has no such topic, several, or no command.
    """
    from rosbags.highlevel import AnyReader, AnyReaderError  # noqa: PLC0415 - only needed to play a bag
    from rosbags.typesys import Stores, get_typestore  # noqa: PLC0415 - as above

    try:
        with AnyReader([Path(path)], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            found = [c for c in reader.connections if c.msgtype in TYPES]
            chosen = [c for c in found if c.topic == topic] if topic else found
            if topic is None and any(c.topic == "/cmd_vel" for c in found):
                chosen = [c for c in found if c.topic == "/cmd_vel"]
            if len({c.topic for c in chosen}) != 1:
                names = ", ".join(sorted({c.topic for c in reader.connections})) or "nothing"
                raise TopicError(f"{path}: no one topic of speed commands (found {names}); record /cmd_vel as Twist")
            rows = []
            for connection, stamp_ns, data in reader.messages(connections=chosen):
                message = reader.deserialize(data, connection.msgtype)
                twist: Any = getattr(message, "twist", message)
                rows.append((stamp_ns, twist.linear.x, twist.angular.z))
    except (AnyReaderError, OSError) as error:
        raise BagError(f"{path}: cannot be read as a bag ({error})") from error
    if not rows:
        raise TopicError(f"{path}: {chosen[0].topic} carries no command; record some")
    stamps_ns = np.array([row[0] for row in rows], dtype=np.int64)
    speeds = np.array([row[1:] for row in rows])
    return Commands((stamps_ns - stamps_ns[0]) * 1e-9, speeds[:, 0], speeds[:, 1])
