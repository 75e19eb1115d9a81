"""Steps of reported speeds, and the mean reported speed of a robot whose encoder counts are truncated to such steps."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from odomcorrupt.geometry.se2 import Array

_ON, _ALL = 0.02, 0.995
"""Largest distance from a multiple, steps, for this share of the speeds: printed numbers have few digits."""
_FEW = 4
"""Fewest different multiples that show a step."""
_MOST = 1000
"""Largest multiple: of finer steps nothing is lost."""
_SAME = 0.01
"""Relative difference of both steps, as speeds of a rim, below which they are ticks of encoders."""
_FLICKER = (0.15, 0.08)
"""Least share of moving intervals in which speed or yaw rate goes a step up and down again, or down and up, if ticks
are counted before. Jitter of the loop makes speeds flicker in proportion to their size, and yaw rates less, because
most driving is straight. Measured without ticks: at most 0.11 and 0.04 in seven drives; with ticks of a third of a
step and more, yaw rates 0.13 to 0.28 in eight."""
_ROUNDS, _GAIN = 12, 0.4
"""Rounds of the inversion, and its gain: the mean rises by up to two steps per step where ticks and steps coincide."""
_EXACTLY = 1.0 + 1e-9


def speed_steps(v: Array, omega: Array, dt_s: Array, track_m: float | None) -> tuple[float, float] | None:
    """Return the steps, m/s and rad/s, of which all reported speeds (n,) are multiples and between which they flicker.

    None if there are no steps, or if speeds do not flicker: then they are no counts of ticks in a loop. Increments are
    multiples in the loop's period, even if stamps vary, or speeds are in the time between stamps. Ticks of encoders
    alone give steps as well, of both channels in the ratio of half the track, and lose nothing.
    """
    found = _steps_shown(v, omega, dt_s)
    if found is None or are_ticks((found.along, found.turn), track_m):
        return None
    along, turn, scale = found
    flickers = _flicker(v * scale / along) > _FLICKER[0] or _flicker(omega * scale / turn) > _FLICKER[1]
    return (along, turn) if flickers else None


class _Shown(NamedTuple):
    """Steps of speed, m/s, and yaw rate, rad/s, of speeds multiplied by `scale` (n,)."""

    along: float
    turn: float
    scale: Array


def _steps_shown(v: Array, omega: Array, dt_s: Array) -> _Shown | None:
    """Return the steps of which all reported speeds (n,) are multiples, whatever their cause; None without any."""
    usual_s = float(np.median(dt_s)) if len(dt_s) > 2 else 0.0
    if not usual_s > 0.0:
        return None
    for scale in (dt_s / usual_s, np.ones_like(dt_s)):
        along, turn = _step(v * scale), _step(omega * scale)
        if along is not None and turn is not None:
            return _Shown(along, turn, scale)
    return None


def are_ticks(steps: tuple[float, float], track_m: float | None) -> bool:
    """Return whether steps of speed, m/s, and yaw rate, rad/s, are in the ratio of ticks of two wheels."""
    return track_m is not None and abs(0.5 * steps[1] * track_m / steps[0] - 1.0) < _SAME


def has_steps_of_speed(v: Array, omega: Array, dt_s: Array, track_m: float) -> bool:
    """Return whether speeds (n,) and yaw rates are reported in whole steps that are no ticks of two wheels."""
    found = _steps_shown(v, omega, dt_s)
    return found is not None and not are_ticks((found.along, found.turn), track_m)


def _flicker(speed: Array) -> float:
    """Return the share of moving intervals in which a speed (n,), in steps, is a local extremum."""
    change = np.diff(np.rint(speed))
    turns = change[:-1] * change[1:] < 0.0
    moves = (np.lib.stride_tricks.sliding_window_view(speed, 3) != 0.0).any(axis=1)
    return float(np.mean(turns[moves])) if moves.any() else 0.0


def _step(values: Array) -> float | None:
    """Return the step of which values (n,) are multiples: the least difference of two of them, refined; or None."""
    size = np.abs(values[values != 0.0])
    largest = float(size.max(initial=0.0))
    if not largest > 0.0:
        return None
    levels = np.unique(np.round(size / (1e-6 * largest))) * 1e-6 * largest
    gaps = np.diff(levels)
    gaps = gaps[gaps > largest / _MOST]
    if not len(gaps):
        return None
    step = float(gaps.min())
    for _ in range(2):
        count = np.rint(size / step)
        step = float(size @ count / max(count @ count, 1.0))
    count = np.rint(size / step)
    plain = len(np.unique(count)) >= _FEW and np.mean(np.abs(size / step - count) < _ON) >= _ALL
    return step if plain else None


def lost_parts(
    v: Array, omega: Array, tick_mps: float, steps: tuple[float, float], track_m: float
) -> tuple[Array, Array]:
    """Return the parts of a step (n,), forward and in yaw, that are lost where the mean reported speeds are v, omega.

    Between two counts a wheel reports both, in proportion; the phases of the wheels are independent. The mean of the
    truncated counts is inverted by iteration from half a step more.

    tick_mps : rim speed of one tick per loop
    """
    true_v, true_w = (u + 0.5 * step * np.sign(u) for u, step in zip((v, omega), steps, strict=True))
    for _ in range(_ROUNDS):
        mean_v, mean_w = _mean_truncated(true_v, true_w, tick_mps, steps, track_m)
        true_v, true_w = true_v + _GAIN * (v - mean_v), true_w + _GAIN * (omega - mean_w)
    return (true_v - v) / steps[0], (true_w - omega) / steps[1]


def _mean_truncated(
    v: Array, omega: Array, tick_mps: float, steps: tuple[float, float], track_m: float
) -> tuple[Array, Array]:
    """Return the means (n,) of truncated speed and yaw rate over the phases of the ticks."""
    right, left = (v + 0.5 * track_m * omega) / tick_mps, (v - 0.5 * track_m * omega) / tick_mps
    whole_right, whole_left = np.floor(right), np.floor(left)
    mean_v, mean_w = np.zeros_like(v), np.zeros_like(v)
    for a, p in ((0.0, 1.0 - right + whole_right), (1.0, right - whole_right)):
        for b, q in ((0.0, 1.0 - left + whole_left), (1.0, left - whole_left)):
            r, s = whole_right + a, whole_left + b
            # a count that equals a step exactly is not lost to rounding of its product
            mean_v += p * q * steps[0] * np.trunc(0.5 * (r + s) * tick_mps / steps[0] * _EXACTLY)
            mean_w += p * q * steps[1] * np.trunc((r - s) * tick_mps / track_m / steps[1] * _EXACTLY)
    return mean_v, mean_w
