"""Detection of a truth whose travel is copied from the odometry.

Filters write such truths if they take speed from the wheels and heading from a gyro.
Slip, ticks and noise of the wheels are then in both, so that no error of travel can be seen. No sensor agrees with
wheels to 0.1 mm in half a second: in 15 recordings by others the usual difference is 0.2 mm and more. Exact poses of a
simulator may agree as well, but they are smooth where the odometry has ticks.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from odomcorrupt.errors import RecordingError
from odomcorrupt.geometry.se2 import increments

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.io.raw_trajectory import Samples

_WINDOW_S = 0.5
_MAX_LAG_S = 1.0
_LAG_STEPS_S = (0.02, 0.002, 0.0002)
_MOVING, _TOP = 0.2, 95.0  # part of the usual top speed from which a window counts; percentile of that speed
_MIN_WINDOWS = 20
_NO_SENSOR_M, _NO_SENSOR = 1e-4, 5e-4
"""Usual difference of travel in half a second, m and relative to the travel, that no sensor reaches."""
_ROUGH_M = 1e-6  # noise of odometry's steps, m: less is the rounding of a smooth simulation
_AS_ROUGH = 0.3  # noise of the truth's travel relative to the odometry's


class _Travel(NamedTuple):
    t_s: Array
    gone_m: Array

    def in_windows(self, starts_s: Array) -> Array:
        """Return the signed travel (k,) in half a second from each start."""
        begin, end = (np.interp(at, self.t_s, self.gone_m) for at in (starts_s, starts_s + _WINDOW_S))
        return np.asarray(end - begin)

    @property
    def noise_m(self) -> float:
        """Usual noise of a step while the robot moves, from third differences of the travel, m."""
        rough = np.abs(np.diff(self.gone_m, n=3))[_moving(np.diff(self.gone_m))[2:]]
        return float(np.median(rough)) / np.sqrt(20.0) if len(rough) else 0.0


def check_travel(odometry: Samples, truth: Samples) -> None:
    """Refuse a truth whose travel is the odometry's with its noise, at whatever lag and rate.

    Raises
    ------
    RecordingError
        With the difference found and the remedy.
    """
    if not truth.headed or truth.covariance is not None or truth.relative:
        return
    own, real = (_travel(path, int(odometry.stamps_ns[0])) for path in (odometry, truth))
    noise_m = own.noise_m
    if noise_m < _ROUGH_M or real.noise_m < _AS_ROUGH * noise_m:
        return
    starts = np.arange(max(own.t_s[0], real.t_s[0]), min(own.t_s[-1], real.t_s[-1]), _WINDOW_S)
    starts = starts[(starts >= own.t_s[0] + _MAX_LAG_S) & (starts < own.t_s[-1] - _MAX_LAG_S - _WINDOW_S)]
    own_m = own.in_windows(starts)
    used = _moving(own_m)
    if used.sum() < _MIN_WINDOWS:
        return
    starts, own_m = starts[used], own_m[used]

    def off_m(lag_s: float) -> float:
        return float(np.median(np.abs(real.in_windows(starts + lag_s) - own_m)))

    lag_s, reach_s = 0.0, _MAX_LAG_S
    for step_s in _LAG_STEPS_S:
        lag_s = min(np.arange(lag_s - reach_s, lag_s + reach_s, step_s).tolist(), key=off_m)
        reach_s = step_s
    found_m, gone_m = off_m(lag_s), float(np.median(np.abs(own_m)))
    if found_m < min(_NO_SENSOR_M, _NO_SENSOR * gone_m):
        raise RecordingError(
            f"{truth.place}: repeats the travel of {odometry.name} with its noise and slip (usually to "
            f"{found_m * 1e3:.2g} mm in {gone_m * 1e3:.0f}): a filter that takes its speed from these wheels, so that "
            "errors of travel cannot be seen; name a truth that does not come from them"
        )


def _travel(path: Samples, origin_ns: int) -> _Travel:
    steps = increments(path.trajectory().xyt)
    return _Travel(path.seconds_since(origin_ns), np.concatenate(([0.0], np.cumsum(steps.ds_m))))


def _moving(steps_m: Array) -> NDArray[np.bool_]:
    size = np.abs(steps_m)
    return size > _MOVING * np.percentile(size, _TOP) if len(size) else size > 0.0
