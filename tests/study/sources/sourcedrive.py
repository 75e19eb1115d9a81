"""A drive with turns both ways: rows of its odometry and truth, which a test can change before writing them."""

from dataclasses import dataclass, replace

import numpy as np

from odomcorrupt.study.io.raw_trajectory import Samples

START_NS = 1_700_000_000_123_456_789


@dataclass(frozen=True)
class Rows:
    """Stamps (n,) in ns, positions (n, 3) and headings (n,) of one path."""

    stamps_ns: np.ndarray
    xyz: np.ndarray
    yaw: np.ndarray

    def __len__(self):
        return len(self.stamps_ns)

    @property
    def quat(self):
        """Quaternions xyzw (n, 4)."""
        return np.stack((0 * self.yaw, 0 * self.yaw, np.sin(self.yaw / 2), np.cos(self.yaw / 2)), axis=1)

    @property
    def xyt(self):
        return np.column_stack((self.xyz[:, :2], self.yaw))

    def having(self, **changes):
        return replace(self, **changes)

    def only(self, rows):
        return Rows(self.stamps_ns[rows], self.xyz[rows], self.yaw[rows])


def path(t, scale=1.0, drift=0.0):
    """Poses (n, 3) of a robot at times (n,), integrated in steps of a millisecond."""
    fine = np.arange(0.0, t[-1] + 0.002, 0.001)
    speed = scale * (0.5 + 0.3 * np.sin(0.4 * fine))
    turn = 0.6 * np.sin(0.25 * fine) + 0.4 * np.sin(0.61 * fine + 1.0) + drift
    yaw = 0.3 + np.concatenate(([0.0], np.cumsum(turn[:-1]) * 0.001))
    x = np.concatenate(([0.0], np.cumsum((speed * np.cos(yaw))[:-1]) * 0.001))
    y = np.concatenate(([0.0], np.cumsum((speed * np.sin(yaw))[:-1]) * 0.001))
    return np.stack([np.interp(t, fine, value) for value in (x, y, yaw)], axis=1)


def rows(duration_s=30.0, rate_hz=20.0, *, scale=1.0, drift=0.0, noise=0.0, late_ns=0):
    t_ns = (np.arange(round(duration_s * rate_hz)) * 1e9 / rate_hz).astype(np.int64) + late_ns
    poses = path(t_ns * 1e-9, scale, drift)
    poses = poses + noise * np.random.default_rng(7).standard_normal(poses.shape)
    xyz = np.column_stack((poses[:, :2], 0.0 * poses[:, 0]))
    return Rows(START_NS + t_ns, xyz, poses[:, 2])


def odometry(duration_s=30.0, **more):
    """What a robot with slightly large wheels reports."""
    return rows(duration_s, **{"scale": 1.02, "drift": 0.002} | more)


def truth(duration_s=30.0, **more):
    """The same drive as a tracker sees it, at another rate."""
    return rows(duration_s, **{"rate_hz": 33.0, "noise": 0.001, "late_ns": 4_000_000} | more)


def samples(t_s, xy, yaw=None, *, name="/odom", frame="", **more):
    """Poses as read from a topic: positions (n, 2 or 3) m, and headings (n,) rad unless there are none.

    t_s : times (n,) in s, or integers in ns
    """
    t_s = np.asarray(t_s)
    stamps_ns = t_s if t_s.dtype.kind == "i" else np.round(t_s * 1e9).astype(np.int64)
    xyz = np.zeros((len(t_s), 3))
    xyz[:, : np.shape(xy)[1]] = xy
    none = {"log_ns": np.zeros(0, np.int64), "variance_m2": np.zeros(0)}
    headings = np.full(len(xyz), np.nan) if yaw is None else yaw
    return Samples(name, name, frame, stamps_ns, xyz, headings, **(none | more))
