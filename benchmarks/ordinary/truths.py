"""Simulated truths of a recording: motion capture, cameras, AMCL and SLAM as topics or over TF, RTK fixes.

Each function returns messages and their standard deviations of position and heading, from which the generator computes
whether a cause is excited. Sources of rates, jumps and noise: protocol.md, section Truths.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ordinary.machine import Body, Odometry, stream

__all__ = ["TRUTHS", "Messages", "Truth", "make_truth"]

Floats = np.ndarray
EARTH_M = 6_378_137.0


@dataclass(frozen=True, slots=True)
class Messages:
    """Messages of a topic: `kind` is "pose", "pose_cov", "tf" (with its frames) or "fix"; stamps and log times in s."""

    topic: str
    kind: str
    stamp_s: Floats
    log_s: Floats
    rows: Floats
    frames: tuple[str, str] = ("map", "base_link")
    status: Floats = field(default_factory=lambda: np.zeros(0))
    variance: Floats = field(default_factory=lambda: np.zeros(0))


@dataclass(frozen=True, slots=True)
class Truth:
    """Messages, argument of `--truth`, and standard deviations of one reading (m; rad, None without headings)."""

    messages: list[Messages]
    option: str
    sigma_m: float
    sigma_rad: float | None


def make_truth(
    kind: str, body: Body, mark: tuple[float, float, float], odometry: Odometry, seed: int, frame: Floats
) -> Truth:
    """Return the truth of a recording.

    Parameters
    ----------
    kind
        A key of TRUTHS.
    mark
        Tracked point in the base frame: x, y (m), yaw (rad).
    frame
        The world's origin in the truth's frame: x, y (m), yaw (rad).
    """
    return TRUTHS[kind](body, mark, odometry, stream(seed, kind), frame)


def composed(a: Floats, b: Floats) -> Floats:
    """Return the composition of poses a and b, both (n, 3) or broadcast."""
    a, b = np.atleast_2d(a), np.atleast_2d(b)
    c, s = np.cos(a[:, 2]), np.sin(a[:, 2])
    return np.column_stack(
        (a[:, 0] + c * b[:, 0] - s * b[:, 1], a[:, 1] + s * b[:, 0] + c * b[:, 1], a[:, 2] + b[:, 2])
    )


def inverse(a: Floats) -> Floats:
    """Return inverse poses."""
    a = np.atleast_2d(a)
    c, s = np.cos(a[:, 2]), np.sin(a[:, 2])
    return np.column_stack((-c * a[:, 0] - s * a[:, 1], s * a[:, 0] - c * a[:, 1], -a[:, 2]))


def tracked(body: Body, mark: tuple[float, float, float], time_s: Floats, frame: Floats) -> Floats:
    """Return true poses of the tracked point in the truth's frame."""
    return composed(frame, composed(body.at(time_s), np.array(mark)))


def _mocap(body: Body, mark: tuple[float, float, float], _: Odometry, rng: np.random.Generator, frame: Floats) -> Truth:
    times = np.arange(0.3, body.time_s[-1] - 0.3, 0.02) + rng.uniform(0.0, 0.02)
    poses = tracked(body, mark, times, frame) + rng.normal(0.0, [0.0015, 0.0015, 0.003], (len(times), 3))
    lost = (np.sin(times / 37.0 + rng.uniform(0, 6)) > 0.997) & (times > 5.0)
    keep = ~lost
    message = Messages("/mocap/pose", "pose", times[keep], times[keep] + 0.004, poses[keep], ("world", "marker"))
    return Truth([message], "/mocap/pose", 0.0015, 0.003)


def _cameras(
    body: Body, mark: tuple[float, float, float], _: Odometry, rng: np.random.Generator, frame: Floats
) -> Truth:
    times = np.arange(0.3, body.time_s[-1] - 0.3, 1.0 / 30.0) + rng.normal(0.0, 0.0005)
    poses = tracked(body, mark, times, frame) + rng.normal(0.0, [0.004, 0.004, 0.009], (len(times), 3))
    seen = rng.random(len(times)) > 0.03
    message = Messages("/aruco/pose", "pose", times[seen], times[seen] + 0.05, poses[seen], ("ceiling", "tag"))
    return Truth([message], "/aruco/pose", 0.004, 0.009)


def _updates(body: Body, rate_hz: float, least_m: float, least_rad: float, rng: np.random.Generator) -> Floats:
    """Return the times of a localisation's corrections: scans after the robot has moved far enough."""
    scans = np.arange(0.5, body.time_s[-1] - 0.5, 1.0 / rate_hz) + rng.uniform(0.0, 1.0 / rate_hz)
    poses = body.at(scans)
    chosen, last = [0], poses[0]
    for i in range(1, len(scans)):
        moved = np.hypot(poses[i, 0] - last[0], poses[i, 1] - last[1])
        if moved > least_m or abs(poses[i, 2] - last[2]) > least_rad:
            chosen.append(i)
            last = poses[i]
    return scans[chosen]


def _correlated(way: Floats, length: float, sigma: Floats, rng: np.random.Generator) -> Floats:
    """Return errors (n, 3) with a correlation length along the path `way` (n,)."""
    errors = np.zeros((len(way), 3))
    errors[0] = rng.normal(0.0, sigma)
    for i in range(1, len(way)):
        a = np.exp(-(way[i] - way[i - 1]) / length)
        errors[i] = a * errors[i - 1] + rng.normal(0.0, sigma) * np.sqrt(1.0 - a * a)
    return errors


def _way(body: Body, times: Floats) -> Floats:
    return np.interp(times, body.time_s, np.cumsum(np.abs(body.v) + 0.2 * np.abs(body.true_w)) / 200.0)


def _amcl_estimates(body: Body, rng: np.random.Generator, frame: Floats) -> tuple[Floats, Floats]:
    times = _updates(body, 10.0, 0.25, 0.2, rng)
    sigma = np.array([0.02, 0.02, 0.009]) * rng.uniform(0.7, 1.5)
    errors = _correlated(_way(body, times), 1.0, sigma, rng)
    for begin in np.cumsum(rng.exponential(150.0, 20)):
        i = int(np.searchsorted(times, begin))
        jump = rng.normal(0.0, [0.1, 0.1, 0.03])
        for k in range(i, min(i + int(rng.integers(2, 7)), len(times))):
            errors[k] += jump
    return times, composed(frame, body.at(times)) + errors


def _slam_estimates(body: Body, rng: np.random.Generator, frame: Floats) -> tuple[Floats, Floats]:
    times = _updates(body, 10.0, 0.5, 0.5, rng)
    errors = _correlated(_way(body, times), 0.5, np.array([0.01, 0.01, 0.005]), rng)
    way = _way(body, times)
    steps = np.sqrt(np.diff(way, prepend=0.0))[:, None] * rng.normal(0.0, [0.004, 0.004, 0.0015], (len(times), 3))
    drift = np.cumsum(steps, axis=0)
    for begin in np.cumsum(rng.uniform(60.0, 140.0, 10)):
        i = int(np.searchsorted(times, begin))
        if i < len(times):
            drift[i:] -= 0.9 * drift[i]
    return times, composed(frame, body.at(times)) + errors + drift


def _over_tf(
    estimates: tuple[Floats, Floats],
    odometry: Odometry,
    publish_hz: float,
    ahead_s: float,
    sigma: tuple[float, float],
    rng: np.random.Generator,
) -> Truth:
    """Return a truth over TF: map -> odom of the last correction, sent repeatedly, and odom -> base from odometry."""
    times, poses = estimates
    said = np.column_stack([np.interp(times, odometry.time_s, column) for column in odometry.xyt.T])
    offsets = composed(poses, inverse(said))
    sent = np.arange(times[0] + 0.05, odometry.time_s[-1], 1.0 / publish_hz) + rng.uniform(0.0, 0.02)
    late = 0.03  # duration of matching a scan
    last = np.clip(np.searchsorted(times + late, sent, side="right") - 1, 0, len(times) - 1)
    map_odom = Messages("/tf", "tf", sent + ahead_s, sent + 0.001, offsets[last], ("map", "odom"))
    odom_base = Messages("/tf", "tf", odometry.stamp_s, odometry.stamp_s + 0.001, odometry.xyt, ("odom", "base_link"))
    return Truth([map_odom, odom_base], "/tf:map.base_link", *sigma)


def _amcl_tf(
    body: Body, _: tuple[float, float, float], odometry: Odometry, rng: np.random.Generator, frame: Floats
) -> Truth:
    return _over_tf(_amcl_estimates(body, rng, frame), odometry, 10.0, 1.0, (0.025, 0.01), rng)


def _amcl_pose(
    body: Body, _: tuple[float, float, float], __: Odometry, rng: np.random.Generator, frame: Floats
) -> Truth:
    times, poses = _amcl_estimates(body, rng, frame)
    return Truth([Messages("/amcl_pose", "pose_cov", times, times + 0.03, poses)], "/amcl_pose", 0.025, 0.01)


def _slam_tf(
    body: Body, _: tuple[float, float, float], odometry: Odometry, rng: np.random.Generator, frame: Floats
) -> Truth:
    return _over_tf(_slam_estimates(body, rng, frame), odometry, 50.0, 0.2, (0.015, 0.006), rng)


def _slam_pose(
    body: Body, _: tuple[float, float, float], __: Odometry, rng: np.random.Generator, frame: Floats
) -> Truth:
    times, poses = _slam_estimates(body, rng, frame)
    return Truth([Messages("/slam/pose", "pose_cov", times, times + 0.05, poses)], "/slam/pose", 0.015, 0.006)


def _rtk(body: Body, mark: tuple[float, float, float], _: Odometry, rng: np.random.Generator, frame: Floats) -> Truth:
    hz = float(rng.choice([5.0, 8.0, 10.0]))
    times = np.arange(0.4, body.time_s[-1] - 0.4, 1.0 / hz) + rng.uniform(0.0, 0.05)
    points = tracked(body, mark, times, frame)[:, :2]
    wander = _correlated(times / 60.0, 1.0, np.array([0.008, 0.008, 0.0]), rng)[:, :2]
    points = points + wander + rng.normal(0.0, 0.008, points.shape)
    sigma = np.full(len(times), 0.014)
    for begin in np.cumsum(rng.exponential(120.0, 20)):
        inside = (times >= begin) & (times < begin + rng.uniform(10.0, 40.0))
        away = rng.uniform(0.1, 0.5) * np.exp(1j * rng.uniform(0.0, 2.0 * np.pi))
        settle = np.exp(-(times[inside] - begin) / 20.0)
        points[inside] += np.column_stack((away.real * settle, away.imag * settle))
        points[inside] += rng.normal(0.0, 0.03, (int(inside.sum()), 2))
        sigma[inside] = 0.3
    kept = np.ones(len(times), dtype=bool)
    for begin in np.cumsum(rng.exponential(200.0, 10)):
        kept &= ~((times >= begin) & (times < begin + rng.uniform(4.0, 15.0)))
    lat0, lon0 = 48.1, 11.5
    north = lat0 + np.degrees(
        points[:, 1] / (EARTH_M * (1.0 - 0.00669438) / (1.0 - 0.00669438 * np.sin(np.radians(lat0)) ** 2) ** 1.5)
    )
    east = lon0 + np.degrees(
        points[:, 0] / (EARTH_M * np.cos(np.radians(lat0)) / np.sqrt(1.0 - 0.00669438 * np.sin(np.radians(lat0)) ** 2))
    )
    rows = np.column_stack((north, east, np.full(len(times), 520.0)))[kept]
    status = np.where(sigma > 0.1, 0 if rng.random() < 0.5 else 2, 2)[kept]
    latency = rng.uniform(0.05, 0.12)
    message = Messages(
        "/fix", "fix", times[kept], times[kept] + latency, rows, ("gps", "gps"), status, (sigma**2)[kept]
    )  # fmt: skip
    return Truth([message], "/fix", 0.014, None)


TRUTHS = {
    "mocap": _mocap,
    "cameras": _cameras,
    "amcl_tf": _amcl_tf,
    "amcl_pose": _amcl_pose,
    "slam_tf": _slam_tf,
    "slam_pose": _slam_pose,
    "rtk": _rtk,
}
