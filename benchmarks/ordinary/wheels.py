"""Rim speed of a wheel as a function of its ground speed: one function for each fault of wheel or ground."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.signal import lfilter

from ordinary.routes import FINE_HZ

if TYPE_CHECKING:
    from collections.abc import Callable

    from ordinary.platforms import Platform

__all__ = ["RIMS", "Wheel", "grown", "play"]

Floats = np.ndarray
Sizes = dict[str, float]


@dataclass(frozen=True, slots=True)
class Wheel:
    """A wheel's motion on the fine grid: its ground speed, and the body's speed, acceleration and pose.

    side : -1 for the left wheel, 1 for the right one
    patch : x, y and radius (m) of a slippery disc
    chance : random generator of this wheel by the name of the source
    """

    ground: Floats
    time_s: Floats
    v: Floats
    accel: Floats
    xyt: Floats
    side: float
    platform: Platform
    patch: tuple[float, float, float] | None
    chance: Callable[[str], np.random.Generator]


def grown(ground: Floats, k: float) -> Floats:
    """Return the rim's speed if the radius grows by a factor of 1 + k times that speed."""
    rim = ground
    for _ in range(6):
        rim = ground / (1.0 + k * np.abs(rim))
    return rim


def play(ground: Floats, travel: float) -> Floats:
    """Return the motor's motion within the gear's backlash: one `travel` at each reversal, over about 50 ms."""
    sign = np.sign(np.where(np.abs(ground) > 0.002, ground, 0.0))
    last = np.maximum.accumulate(np.where(sign != 0.0, np.arange(len(sign)), 0))
    state = sign[last]
    state[state == 0.0] = state[np.flatnonzero(state)[0]] if state.any() else 1.0
    width = round(0.05 * FINE_HZ)
    smooth = np.convolve(np.concatenate((np.full(width - 1, state[0]), state)), np.ones(width) / width, "valid")
    return 0.5 * travel * smooth


def _skids(wheel: Wheel, p: Sizes) -> Floats:
    braking = wheel.accel * np.sign(wheel.v) < -0.6 * wheel.platform.accel
    return np.where(braking, wheel.ground * (1.0 - p["slip"]), wheel.ground)


def _patch(wheel: Wheel, p: Sizes) -> Floats:
    if wheel.patch is None:
        return wheel.ground
    x, y, radius = wheel.patch
    inside = np.hypot(wheel.xyt[:, 0] - x, wheel.xyt[:, 1] - y) < radius
    return np.where(inside, wheel.ground / (1.0 - p["slip"]), wheel.ground)


def _dead_band(wheel: Wheel, p: Sizes) -> Floats:
    return np.where(np.abs(wheel.ground) > 0.004, wheel.ground + p["speed"] * np.sign(wheel.ground), 0.0)


def _counts_lost(wheel: Wheel, p: Sizes) -> Floats:
    over = np.maximum(np.abs(wheel.ground) - p["part"] * wheel.platform.top_speed, 0.0)
    return np.sign(wheel.ground) * (np.abs(wheel.ground) - p["loss"] * over)


def _flat_spot(wheel: Wheel, p: Sizes) -> Floats:
    if wheel.side < 0.0:
        return wheel.ground
    angle = np.cumsum(wheel.ground) / FINE_HZ / wheel.platform.radius_m
    bell = np.exp(-0.5 * (np.remainder(angle, 2.0 * np.pi) - np.pi) ** 2 / 0.3**2)
    return wheel.ground / (1.0 - p["depth"] * bell)


def _bursts(wheel: Wheel, p: Sizes) -> Floats:
    rng, t = wheel.chance("burst"), wheel.time_s
    spins = np.zeros_like(t)
    for begin in np.cumsum(rng.exponential(1.0 / p["rate"], 200)):
        length = rng.exponential(p["duration"])
        spins[(t >= begin) & (t < begin + length)] = rng.exponential(p["slip"])
    return wheel.ground * (1.0 + spins)


def _wandering(wheel: Wheel, p: Sizes) -> Floats:
    rng = wheel.chance("gain")
    a = float(np.exp(-1.0 / (FINE_HZ * p["tau"])))
    white = rng.normal(0.0, np.sqrt(1.0 - a * a), len(wheel.ground))
    white[0] = rng.normal()
    return wheel.ground * (1.0 + p["sigma"] * np.asarray(lfilter([1.0], [1.0, -a], white)))


RIMS: dict[str, Callable[[Wheel, Sizes], Floats]] = {
    "wheel_scale": lambda wheel, p: wheel.ground / (1.0 + p["e"]),
    "unequal_wheels": lambda wheel, p: wheel.ground / (1.0 + 0.5 * wheel.side * p["e"]),
    "scale_drift": lambda wheel, p: wheel.ground / (1.0 + p["rate"] * wheel.time_s),
    "speed_scale": lambda wheel, p: grown(wheel.ground, p["k"]),
    "accel_slip": lambda wheel, p: wheel.ground / (1.0 - p["k"] * wheel.accel * np.sign(wheel.v)),
    "battery_sag": lambda wheel, p: wheel.ground / (1.0 - p["part"] * wheel.time_s / wheel.time_s[-1]),
    "brake_skid": _skids,
    "region_slip": _patch,
    "dead_band": _dead_band,
    "counts_lost": _counts_lost,
    "flat_spot": _flat_spot,
    "slip_burst": _bursts,
    "gauss_markov": _wandering,
}
"""Rim speed (m/s, with the driver's nominal radius) by name of the cause; rims of wheels without one do not slip."""
