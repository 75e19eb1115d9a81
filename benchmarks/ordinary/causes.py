"""Causes of odometry error: ranges of their sizes, and the names that count as right.

`accepted` are library names (or patterns of names that it may have later) that count as right. `equal` are names with
the same effect on this robot but another physical cause: they count neither as right nor as confidently wrong.
`drivers` are the regressors with which an unknown dependence counts as right.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from fnmatch import fnmatch

import numpy as np

__all__ = ["CAUSES", "Cause", "matches", "sizes_of"]


LATE = ("*acceleration",)
"""Regressors of an error due to a late channel."""
SPEEDS = ("speed", "yaw_rate", "wheel_speed")


@dataclass(frozen=True, slots=True)
class Cause:
    """A cause: ranges of its parameters (log-uniform; with a random sign if `signed`), and its right names."""

    ranges: dict[str, tuple[float, float]]
    signed: bool = True
    accepted: tuple[str, ...] = ()
    equal: tuple[str, ...] = ()
    drivers: tuple[str, ...] = ()
    event: bool = False
    fixed: dict[str, tuple[float, float]] = field(default_factory=dict)


def _known(
    name: str, *twins: str, equal: tuple[str, ...] = (), signed: bool = True, **ranges: tuple[float, float]
) -> Cause:
    return Cause(ranges, signed, (name, *twins), equal)


CAUSES: dict[str, Cause] = {
    # names of the library
    "wheel_scale": _known("wheel_scale", e=(0.006, 0.03)),
    "unequal_wheels": _known("unequal_wheels", e=(0.003, 0.02)),
    "wheelbase": _known("wheelbase", "gyro_scale", e=(0.015, 0.08)),
    "wide_contact": Cause({"e": (0.2, 0.8)}, signed=False, accepted=("wheelbase", "gyro_scale")),
    "gyro_bias": _known("gyro_bias", bias=(0.001, 0.012)),
    "gyro_scale": _known("gyro_scale", "wheelbase", e=(0.01, 0.04)),
    "side_slip": _known("side_slip", signed=False, k=(0.02, 0.1)),
    "icr_shift": _known("icr_shift", "lever_arm", x=(0.02, 0.08)),
    "lever_arm": _known("lever_arm", "icr_shift", x=(0.03, 0.2), y=(0.02, 0.1)),
    "mount_yaw": _known("mount_yaw", yaw=(0.01, 0.06)),
    "accel_slip": _known("accel_slip", signed=False, k=(0.01, 0.06)),
    "speed_scale": _known("speed_scale", k=(0.01, 0.05)),
    "scale_drift": _known("scale_drift", rate=(2.5e-5, 1e-4)),
    "backlash": _known("backlash", signed=False, travel=(0.003, 0.012)),
    "turn_asymmetry": _known("turn_asymmetry", k=(0.01, 0.04)),
    "region_slip": _known("region_slip", signed=False, slip=(0.05, 0.2), part=(0.15, 0.25)),
    "slope": Cause({"creep": (0.008, 0.03)}, signed=False, accepted=("slope",), fixed={"direction": (0.0, 6.28)}),
    "time_offset": _known("time_offset", offset=(0.003, 0.08)),
    "clock_skew": _known("clock_skew", rate=(1e-4, 6e-4)),
    "gyro_bias_walk": _known("gyro_bias_walk", signed=False, density=(2e-4, 1e-3)),
    "slip_burst": _known("slip_burst", signed=False, rate=(0.03, 0.1), slip=(0.3, 0.8), duration=(0.2, 0.5)),
    "lost_increments": _known("lost_increments", signed=False, fraction=(0.01, 0.05)),
    "gauss_markov": _known("gauss_markov", signed=False, sigma=(0.02, 0.05), tau=(5.0, 30.0)),
    # cars
    "steering_ratio": Cause(
        {"e": (0.03, 0.12)}, accepted=("steering_ratio", "steering_gain", "steering_scale", "wheelbase", "gyro_scale")
    ),
    "steering_offset": Cause(
        {"angle": (0.005, 0.035)}, accepted=("steering_offset", "steering_bias"), equal=("unequal_wheels",)
    ),
    "steering_lag": Cause(
        {"tau": (0.08, 0.3)}, signed=False, accepted=("*lag*", "*delay*"), equal=("time_offset",), drivers=LATE
    ),
    "rear_axle_shift": Cause(
        {"part": (0.1, 0.4)}, signed=False, accepted=("rear_axle*", "icr_shift", "lever_arm", "axle_shift")
    ),
    # channels of the odometry that are late
    "channel_delay": Cause(
        {"delay": (0.04, 0.15)}, signed=False, accepted=("*delay*", "*lag*"), equal=("time_offset",), drivers=LATE
    ),
    "channel_lag": Cause(
        {"tau": (0.05, 0.3)}, signed=False, accepted=("*lag*", "*delay*"), equal=("time_offset",), drivers=LATE
    ),
    # hobby robots
    "dead_band": Cause(
        {"speed": (0.01, 0.04)}, signed=False, accepted=("dead_band", "deadband"), drivers=SPEEDS
    ),
    "battery_sag": Cause(
        {"part": (0.05, 0.2)}, signed=False, accepted=("battery_sag", "scale_drift"), drivers=("time", "distance")
    ),
    "truncated_velocity": Cause(
        {"step": (0.01, 0.03), "yaw_step": (0.03, 0.1)}, signed=False,
        accepted=("truncated_velocity", "truncation"), equal=("quantization",), drivers=SPEEDS,
    ),
    "counts_lost": Cause(
        {"part": (0.5, 0.8), "loss": (0.15, 0.5)}, signed=False, accepted=("counts_lost", "lost_counts"),
        equal=("speed_scale",), drivers=("speed", "wheel_speed"),
    ),
    "speed_cutoff": Cause(
        {"speed": (0.03, 0.06)}, signed=False, accepted=("dead_band", "deadband", "speed_cutoff"),
        equal=("backlash",), drivers=("speed", "wheel_speed"),
    ),
    "flat_spot": Cause(
        {"depth": (0.08, 0.3)}, signed=False, accepted=("flat_spot", "eccentric_wheel"),
        equal=("unequal_wheels", "wheel_scale"), drivers=("distance", "way*", "wheel_angle"),
    ),
    # the ground
    "castor_kick": Cause(
        {"angle": (0.01, 0.05)}, accepted=("castor*", "caster*"), equal=("backlash",),
        drivers=(*LATE, "speed", "distance"),
    ),
    "brake_skid": Cause(
        {"slip": (0.05, 0.25)}, signed=False, accepted=("accel_slip", "brake_skid"), drivers=("*acceleration",)
    ),
    # single events
    "push": Cause({"angle": (0.14, 0.5), "way": (0.05, 0.3), "duration": (1.0, 3.0)}, event=True),
    "lift": Cause({"angle": (0.1, 0.5), "way": (0.1, 0.4), "duration": (1.5, 3.0)}, event=True),
    "bump": Cause({"angle": (0.05, 0.17), "way": (0.02, 0.05), "duration": (0.2, 0.4)}, event=True),
}  # fmt: skip


def sizes_of(cause: str, rng: np.random.Generator) -> dict[str, float]:
    """Return randomly drawn parameters of a cause for one robot."""
    kind = CAUSES[cause]
    sizes = {key: float(np.exp(rng.uniform(np.log(low), np.log(high)))) for key, (low, high) in kind.ranges.items()}
    for key, (low, high) in kind.fixed.items():
        sizes[key] = float(rng.uniform(low, high))
    if kind.signed:
        sizes = {
            key: value * (1.0 if key in ("duration", "tau") or rng.random() < 0.5 else -1.0)
            for key, value in sizes.items()
        }
    return sizes


def matches(name: str, patterns: tuple[str, ...]) -> bool:
    """Return whether a name matches one of the patterns."""
    return any(fnmatch(name, pattern) for pattern in patterns)
