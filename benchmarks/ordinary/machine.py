"""Simulation of odometry from the true motion of a body: wheels, steering, encoders, gyro, filter and clock.

All formulas are those of rolling wheels: a rim that turns by an angle travels its radius times that angle minus slip.
The driver integrates counts with nominal parameters by the mid-point rule. Each source has its own stream of random
numbers, so that the same robot with and without a fault has the same noise.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from scipy.signal import lfilter

from ordinary.routes import FINE_HZ
from ordinary.wheels import RIMS, Wheel, grown, play

if TYPE_CHECKING:
    from ordinary.platforms import Platform

__all__ = ["Body", "Odometry", "Rig", "body_motion", "odometry_of", "stream"]

Floats = np.ndarray


@dataclass(frozen=True, slots=True)
class Rig:
    """Properties of the odometry's computation.

    heading : source of the heading: "wheels", "gyro" or "steering"
    command : whether commands are integrated instead of counts
    filter_s : time constants of an EKF's travel and turn, s; zeros for none
    pull : gain of the correction, once a second, of an EKF with poses of a localisation as input; 0 for none
    stamp_step_s : step to which stamps are truncated, s
    stamp_jitter_s : mean of the exponential arrival delay in stamps, s
    """

    heading: str = "wheels"
    command: bool = False
    filter_s: tuple[float, float] = (0.0, 0.0)
    pull: float = 0.0
    stamp_step_s: float = 0.0
    stamp_jitter_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Body:
    """True motion at 200 Hz: times (n,), pose (n, 3) of the base, twist v, w of the wheels, and true yaw rate."""

    time_s: Floats
    xyt: Floats
    v: Floats
    w: Floats
    true_w: Floats
    event: dict[str, float] | None = None

    def at(self, time_s: Floats) -> Floats:
        """Return the true poses (k, 3) at times (k,), held before the first and after the last."""
        return np.column_stack([np.interp(time_s, self.time_s, column) for column in self.xyt.T])


@dataclass(frozen=True, slots=True)
class Odometry:
    """Odometry: times on the truth's clock (s), stamps (s), poses (k, 3) and body twists (k, 2)."""

    time_s: Floats
    stamp_s: Floats
    xyt: Floats
    twist: Floats = field(repr=False)


def stream(seed: int, name: str) -> np.random.Generator:
    """Return the random generator of one source in one drive."""
    return np.random.default_rng([seed, *name.encode()])


def body_motion(
    motion: Floats,
    flaw: tuple[str, dict[str, float]] | None,
    platform: Platform,
    rig: Rig,
    seed: int,
    start: Floats,
) -> Body:
    """Return the true motion of a body: the driver's motion plus that caused by the ground or by an event."""
    t, v, w = motion.T
    name, p = flaw or ("", {})
    extra = np.zeros((len(t), 3))
    event = None
    if name == "side_slip":
        extra[:, 1] = -p["k"] * v * w
    elif name == "icr_shift":
        extra[:, 1] = p["x"] * w
    elif name == "rear_axle_shift":
        extra[:, 1] = p["part"] * platform.track_m * w
    elif name == "castor_kick":
        extra[:, 2] = _kicks(v, p["angle"])
    elif name in ("push", "lift", "bump"):
        rng = stream(seed, "event")
        moving = np.flatnonzero((np.abs(v) > 0.02) == (name != "lift"))
        moving = moving[(t[moving] > 60.0) & (t[moving] < t[-1] - 60.0)]
        begin = float(t[rng.choice(moving)])
        during = (t >= begin) & (t < begin + p["duration"])
        bell = np.where(during, np.sin(np.pi * (t - begin) / p["duration"]) ** 2, 0.0)
        bell /= bell.sum() / FINE_HZ
        side = rng.uniform(0.0, 2.0 * np.pi)
        extra[:, 0] += p["way"] * np.cos(side) * bell
        extra[:, 1] += p["way"] * np.sin(side) * bell
        extra[:, 2] += p["angle"] * bell
        event = {"start_s": begin, "end_s": begin + p["duration"], "angle": p["angle"], "way": p["way"]}
    extra += _contact_noise(v, w, platform, rig, seed)
    true_w = w + extra[:, 2]
    theta = start[2] + _summed(true_w)
    vx, vy = v + extra[:, 0], extra[:, 1]
    east = vx * np.cos(theta) - vy * np.sin(theta)
    north = vx * np.sin(theta) + vy * np.cos(theta)
    if name == "slope":
        east = east + np.abs(v) * p["creep"] * np.cos(p["direction"])
        north = north + np.abs(v) * p["creep"] * np.sin(p["direction"])
    return Body(t, np.column_stack((start[0] + _summed(east), start[1] + _summed(north), theta)), v, w, true_w, event)


def _contact_noise(v: Floats, w: Floats, platform: Platform, rig: Rig, seed: int) -> Floats:
    """Return random body twists (n, 3) relative to the wheels' motion, with variance per travel of each wheel.

    The noise is in the body's motion, because controllers hold the wheels to their speeds. Without a controller
    (odometry from commands) it is three times as large. A car has one driven axle, and tyres that guide it.
    """
    deviation = platform.noise_m * (3.0 if rig.command else 1.0) * np.sqrt(FINE_HZ)
    if platform.drive == "car":
        white = stream(seed, "wheel").normal(0.0, deviation, (len(v), 2)) * np.sqrt(np.abs(v))[:, None]
        return np.column_stack((white[:, 0], 0.3 * white[:, 1], np.zeros_like(v)))
    slips = [
        stream(seed, f"wheel{side}").normal(0.0, deviation, len(v))
        * np.sqrt(np.abs(v + side * 0.5 * platform.track_m * w))
        for side in (-1.0, 1.0)
    ]
    across = 0.3 * stream(seed, "across").normal(0.0, deviation, len(v)) * np.sqrt(np.abs(v))
    return np.column_stack((0.5 * (slips[0] + slips[1]), across, (slips[1] - slips[0]) / platform.track_m))


def _summed(rate: Floats) -> Floats:
    """Return the integral of a rate on the fine grid by the trapezoidal rule."""
    return np.concatenate(([0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1])))) / FINE_HZ


def _kicks(v: Floats, angle: float) -> Floats:
    """Return the yaw rate due to castors swinging round within 0.1 m after each reversal."""
    way = np.cumsum(np.abs(v)) / FINE_HZ
    sign = np.sign(np.where(np.abs(v) > 0.01, v, 0.0))
    moving = np.flatnonzero(sign)
    turned = moving[1:][sign[moving][1:] != sign[moving][:-1]]
    rate = np.zeros_like(v)
    for at in turned:
        inside = (way >= way[at]) & (way < way[at] + 0.1) & (np.arange(len(v)) >= at)
        rate += np.where(inside, sign[at] * angle * np.abs(v) / 0.1, 0.0)
    return rate


def odometry_of(
    body: Body,
    flaw: tuple[str, dict[str, float]] | None,
    platform: Platform,
    rig: Rig,
    seed: int,
    patch: tuple[float, float, float] | None,
) -> Odometry:
    """Return the odometry of a true motion."""
    name, p = flaw or ("", {})
    t_end = body.time_s[-1]
    hz = platform.odometry_hz
    times = np.arange(1, int((t_end - 1.0) * hz)) / hz + stream(seed, "tick").normal(
        0.0, 0.0002, int((t_end - 1.0) * hz) - 1
    )
    late = p["delay"] if name == "channel_delay" else 0.0
    if platform.drive == "car":
        ds, dtheta = _car(body, name, p, platform, seed, times, late)
    else:
        ds, dtheta = _differential(body, name, p, platform, rig, seed, times, late, patch)
    if rig.heading == "gyro":
        dtheta = _gyro(body, name, p, seed, times, late)
    if name == "channel_lag":
        dtheta = _low_pass(dtheta, times, p["tau"])
    if name == "lost_increments":
        lost = stream(seed, "lost").random(len(ds)) < p["fraction"]
        ds, dtheta = np.where(lost, 0.0, ds), np.where(lost, 0.0, dtheta)
    ds, dtheta = _low_pass(ds, times, rig.filter_s[0]), _low_pass(dtheta, times, rig.filter_s[1])
    xyt = _added_up(ds, dtheta)
    if rig.pull > 0.0:
        xyt = _pulled(xyt, body, times, rig.pull, seed)
    steps = np.diff(times, prepend=times[0] - 1.0 / hz)
    twist = np.column_stack((ds, dtheta)) / steps[:, None]
    stamps = (
        times + (p["offset"] if name == "time_offset" else 0.0) + (p["rate"] * times if name == "clock_skew" else 0.0)
    )
    if rig.stamp_jitter_s > 0.0:
        stamps = np.maximum.accumulate(stamps + stream(seed, "arrival").exponential(rig.stamp_jitter_s, len(stamps)))
    if rig.stamp_step_s > 0.0:
        stamps = np.floor(stamps / rig.stamp_step_s) * rig.stamp_step_s
    return Odometry(times, stamps, xyt, twist)


def _added_up(ds: Floats, dtheta: Floats) -> Floats:
    theta = np.cumsum(dtheta)
    middle = theta - 0.5 * dtheta
    return np.column_stack((np.cumsum(ds * np.cos(middle)), np.cumsum(ds * np.sin(middle)), theta))


def _differential(
    body: Body,
    name: str,
    p: dict[str, float],
    platform: Platform,
    rig: Rig,
    seed: int,
    times: Floats,
    late: float,
    patch: tuple[float, float, float] | None,
) -> tuple[Floats, Floats]:
    """Return increments of distance and heading computed by a differential-drive driver from two wheels."""
    track = platform.track_m * (1.0 + (p["e"] if name in ("wheelbase", "wide_contact") else 0.0))
    accel = np.gradient(body.v, 1.0 / FINE_HZ)
    ways, delayed = [], []
    for side in (-1.0, 1.0):
        ground = body.v + side * 0.5 * track * _wheel_yaw(body.w, name, p)
        wheel = Wheel(
            ground, body.time_s, body.v, accel, body.xyt, side, platform, patch,
            lambda source, side=side: stream(seed, f"{source}{side}"),
        )  # fmt: skip
        rim = RIMS[name](wheel, p) if name in RIMS else ground
        travelled = _summed(rim)
        if name == "backlash":
            travelled = travelled + play(ground, p["travel"])
        ways.append(_counted(np.interp(times, body.time_s, travelled), platform, rig))
        delayed.append(_counted(np.interp(times - late, body.time_s, travelled), platform, rig))
    left, right = (np.diff(way, prepend=way[0]) for way in ways)
    late_left, late_right = (np.diff(way, prepend=way[0]) for way in delayed)
    ds, dtheta = 0.5 * (left + right), (late_right - late_left) / platform.track_m
    dt = 1.0 / platform.odometry_hz
    if name == "truncated_velocity":
        ds = np.trunc(ds / dt / p["step"]) * p["step"] * dt
        dtheta = np.trunc(dtheta / dt / p["yaw_step"]) * p["yaw_step"] * dt
    if name == "speed_cutoff":
        slow = np.abs(ds / dt) < p["speed"]
        ds = np.where(slow, 0.0, ds)
    return ds, dtheta


def _wheel_yaw(w: Floats, name: str, p: dict[str, float]) -> Floats:
    return w / (1.0 + p["k"] * np.sign(w)) if name == "turn_asymmetry" else w


def _counted(way: Floats, platform: Platform, rig: Rig) -> Floats:
    if platform.ticks <= 0.0 or rig.command:
        return way
    step = 2.0 * np.pi * platform.radius_m / platform.ticks
    return np.floor(way / step) * step


def _gyro(body: Body, name: str, p: dict[str, float], seed: int, times: Floats, late: float) -> Floats:
    """Return increments of heading from a gyro."""
    rng = stream(seed, "gyro")
    white = rng.normal(0.0, 1e-4 * np.sqrt(FINE_HZ), len(body.true_w))
    rate = body.true_w + white
    if name == "gyro_scale":
        rate = rate + p["e"] * body.true_w
    if name == "gyro_bias":
        rate = rate + p["bias"]
    if name == "gyro_bias_walk":
        rate = rate + p["density"] * np.cumsum(stream(seed, "walk").normal(0.0, np.sqrt(1.0 / FINE_HZ), len(rate)))
    heading = np.interp(times - late, body.time_s, _summed(rate))
    return np.diff(heading, prepend=heading[0])


def _car(
    body: Body, name: str, p: dict[str, float], platform: Platform, seed: int, times: Floats, late: float
) -> tuple[Floats, Floats]:
    """Return increments of a car: distance of the driven axle, and heading from the steering angle."""
    length = platform.track_m
    rolls = np.abs(body.v) > 0.03
    ratio = np.where(rolls, length * body.w / np.where(rolls, body.v, 1.0), np.nan)
    known = np.flatnonzero(rolls)
    angle = np.arctan(np.interp(np.arange(len(ratio)), known, ratio[known]))
    angle = np.clip(angle, -0.65, 0.65)
    if name == "steering_lag":
        angle = angle + p["tau"] * np.clip(np.gradient(angle, 1.0 / FINE_HZ), -1.5, 1.5)
    if name == "steering_ratio":
        angle = angle / (1.0 + p["e"])
    if name == "steering_offset":
        angle = angle - p["angle"]
    ground = body.v
    scale = p["e"] if name == "wheel_scale" else 0.0
    rim = ground / (1.0 + scale)
    if name == "speed_scale":
        rim = grown(ground, p["k"])
    way = _summed(rim)
    if name == "backlash":
        way = way + play(ground, p["travel"])
    way = _counted(np.interp(times, body.time_s, way), platform, Rig())
    ds = np.diff(way, prepend=way[0])
    middle = times - 0.5 / platform.odometry_hz  # the angle is taken at the middle of the step
    shown = np.interp(middle - late, body.time_s, angle)
    shown = shown + stream(seed, "steering").normal(0.0, 0.001, len(times))
    dt = 1.0 / platform.odometry_hz
    if name == "speed_cutoff":
        ds = np.where(np.abs(ds / dt) < p["speed"], 0.0, ds)
    return ds, ds * np.tan(shown) / length


def _low_pass(steps: Floats, times: Floats, tau: float) -> Floats:
    """Return increments filtered by a first-order lag."""
    if tau <= 0.0:
        return steps
    a = float(np.exp(-np.median(np.diff(times)) / tau))
    return np.asarray(lfilter([1.0 - a], [1.0, -a], steps))


def _pulled(xyt: Floats, body: Body, times: Floats, gain: float, seed: int) -> Floats:
    """Return poses of a filter corrected once a second towards external poses with errors of 3 cm and 0.5 degrees."""
    rng = stream(seed, "pull")
    truth = body.at(times) - body.at(times[:1])
    start = body.at(times[:1])[0, 2]
    c, s = np.cos(-start), np.sin(-start)
    truth = np.column_stack((c * truth[:, 0] - s * truth[:, 1], s * truth[:, 0] + c * truth[:, 1], truth[:, 2]))
    out = xyt.copy()
    now = xyt[0].copy()
    every = max(1, round(1.0 / np.median(np.diff(times))))
    for i in range(1, len(xyt)):
        step = xyt[i] - xyt[i - 1]
        turn = now[2] - xyt[i - 1, 2]
        ct, st = np.cos(turn), np.sin(turn)
        now = now + np.array([ct * step[0] - st * step[1], st * step[0] + ct * step[1], step[2]])
        if i % every == 0:
            seen = truth[i] + rng.normal(0.0, [0.03, 0.03, 0.009])
            now = now + gain * (seen - now)
        out[i] = now
    return out
