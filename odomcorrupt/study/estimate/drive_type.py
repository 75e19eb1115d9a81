"""Drive type of a robot, given or guessed from its motion, and the library effects that it can have.

A steered robot turns only while it travels, with a smallest radius that does not depend on speed. When it drives
slowly, its steering is often at a stop: at least a fifth of slow driving has the largest curvature of its side. The two
sides differ if the steering's zero is off. A differential drive has no such stop, even if its planner never turns it on
the spot. Many effects of the two types are the same function of the motion (steering offset and unequal wheels); the
drive type then decides the name.

The source of the odometry's heading rules effects out, too. The aliases `wheelbase` and `gyro_scale` are the same yaw
gain. A gyro beside the truth shows whether the odometry's heading comes from the wheels or from a gyro, and so which of
the two effects is meant. If a gyro is the only truth, travel is not measured, and a bias of the yaw rate may be the
bias of that gyro.

Without a gyro in the bag, a heading that goes on changing while no wheel turns comes from a gyro, with its noise and
bias. A heading from wheels stands still then, except for the decay of a filter's lag.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import binary_erosion

from odomcorrupt.drive_types import AUTO, STEERED
from odomcorrupt.effects import registry
from odomcorrupt.effects.effect import parameters
from odomcorrupt.geometry.motion import SMOOTHING_S, slopes
from odomcorrupt.geometry.se2 import increments, rotate
from odomcorrupt.study.estimate.regressors import drives_sideways
from odomcorrupt.study.io.raw_trajectory import runs_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.effects.effect import Effect, Motion
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.io.recording import Recording

GAINS_OF_TURNS = {"wheels": "wheelbase", "gyro": "gyro_scale"}  # yaw gain of each source of the heading
_OF_TRAVEL = ("wheel_scale", "speed_scale", "scale_drift", "sideways_scale", "slope", "lever_arm", "mount_yaw")
_GYROS = ("gyro_bias", "gyro_bias_walk")
_STILL_M, _STILL_RADPS = 1e-9, 0.02
"""Largest travel of a step at rest, m, and largest yaw rate, rad/s: above usual biases, below turns on the spot."""
_SPELL_S, _RESTS_S = 1.0, 2.0
"""Shortest rest, s, and total of all rests that shows whether the heading changes in them."""
_GOES_ON = 0.5
"""Least turn in the second half of a rest relative to that in the first half; less is the decay of a lag."""


def turns_at_rest(recording: Recording) -> bool:
    """Return whether the heading of the odometry goes on changing in at least half the time at which no wheel turns."""
    rests_s, going_on_s = _rests(recording)
    return rests_s >= _RESTS_S and going_on_s >= 0.5 * rests_s


def stands_still(recording: Recording) -> bool:
    """Return whether the heading of the odometry stands still while no wheel turns: there are rests that show it."""
    rests_s, going_on_s = _rests(recording)
    return rests_s >= _RESTS_S and not going_on_s


def _rests(recording: Recording) -> tuple[float, float]:
    """Return the time at which no wheel turns, and that in which the heading of the odometry goes on changing, s."""
    steps, dt_s = increments(recording.odometry.xyt), np.diff(recording.odometry_s)
    turned = np.abs(steps.dtheta_rad)
    still = (np.hypot(steps.ds_m, steps.dl_m) < _STILL_M) & (turned < _STILL_RADPS * dt_s)
    rests_s = going_on_s = 0.0
    for first, last in runs_of(still):
        seconds, middle = float(dt_s[first:last].sum()), (first + last) // 2
        if seconds >= _SPELL_S:
            early, late = float(turned[first:middle].sum()), float(turned[middle:last].sum())
            rests_s += seconds
            going_on_s += seconds * (late > _GOES_ON * early > 0.0)
    return rests_s, going_on_s


def sees_travel(recordings: Sequence[Recording]) -> bool:
    """Return whether any truth measured travel."""
    return any(recording.positioned for recording in recordings)


MOUNTING = ("lever_arm", "mount_yaw")
"""Effects of the position and yaw of the tracked point on the robot, see `mountings`."""

_FAST, _SLOW, _STILL = 0.6, 0.4, 0.03
"""Fractions of the usual speed: the largest curvature is measured above the first and tested below the second; below
the third the robot is at rest."""
_USUAL, _LARGEST = 0.9, 0.995
"""Quantiles that define the usual speed of a moving robot, and the largest curvature at speed."""
_SHARPER = 1.3
"""Largest curvature of a steered robot, relative to the largest at speed or at the stop of its steering."""
_LEAST_RADIUS_M = 0.3
"""Turning radius below which a robot counts as turning on the spot, m."""
_TURNED_RAD = 4.0 * np.pi
"""Least total turn for a guess of the drive type, rad."""
_SLOW_S, _SPELLS = 3.0, 3
"""Least time of slow driving, s, and least number of slow spells for a guess."""
_CREEP = 0.05
"""Fraction of the usual speed below which encoder ticks dominate the curvature."""
_STOP, _STOP_SHARE, _STOP_QUANTILE = 1.15, 0.2, 0.95
"""Steering has a stop if this share of slow driving is within this factor of this quantile of the curvature (a delayed
steering angle exceeds the quantile briefly). The share was a tenth for a robot with two driven wheels (a mower that
never turned on the spot), and a third or more for steered ones."""
_SPOT_RAD = 0.1
"""Largest turn per slow spell beyond the smallest radius that filters and ticks can cause, rad."""
_GYRO_RAD = 1e-4
"""Turn at rest above which the heading of the odometry is not computed from its wheels, rad."""


@dataclass(frozen=True, slots=True)
class DriveType:
    """Drive type of a robot, with facts that decide which effects it can have.

    name : one of `drive_types.DRIVE_TYPES`
    reason : evidence for a guessed type; "" if the type was given, or if differential drive is the default
    gyro : whether the heading may come from a gyro; not for a steered robot with odometry that does not turn at rest
    stated : whether the type was given
    heading_source : source of the heading as shown by a gyro in the bag: "wheels", "gyro", or "" if unknown
    travel : whether any truth measured travel, and not headings alone
    antenna : whether truths are positions alone, of a point that may be anywhere on the robot
    least_radius_m : smallest turning radius of a robot that may be steered, as it never turned on the spot; else 0
    """

    name: str
    reason: str = ""
    gyro: bool = True
    stated: bool = False
    heading_source: str = ""
    travel: bool = True
    antenna: bool = False
    least_radius_m: float = 0.0

    @property
    def known(self) -> bool:
        """Whether the type was given or is evident from the motion."""
        return self.stated or bool(self.reason)

    @property
    def steered(self) -> bool:
        """Whether the robot turns by a steering angle."""
        return self.name in STEERED

    @property
    def sentence(self) -> str:
        """Name of the type and, if guessed from the motion, the evidence."""
        return f"{self.name} ({self.reason})" if self.reason else self.name

    def admits(self, kind: type[Effect]) -> bool:
        """Return whether a robot of this type can have an effect, and it can be named; aliases included.

        Of the two yaw gains, only that of a known source of the heading can. Without a truth that measured travel,
        effects of travel and biases of gyros are excluded.
        """
        if not self.travel and kind.name in (*_OF_TRAVEL, *_GYROS):
            return False
        source = self.heading_source
        named = not source or kind.name not in GAINS_OF_TURNS.values() or kind.name == GAINS_OF_TURNS[source]
        return named and (kind.drives is None or self.name in kind.drives) and (self.gyro or not kind.needs_gyro)


def drive_type_of(recordings: Sequence[Recording]) -> DriveType:
    """Return the drive type of the robot: the one given in the first recording that has one, or guessed from all."""
    sources = {recording.heading_source for recording in recordings}
    return replace(
        _stated_or_guessed(recordings),
        heading_source=sources.pop() if len(sources) == 1 else "",
        travel=sees_travel(recordings),
        antenna=mountings(recordings) == MOUNTING[:1],
    )


def _stated_or_guessed(recordings: Sequence[Recording]) -> DriveType:
    given = next((r.drive_type for r in recordings if r.drive_type != AUTO), None)
    slow = [_slow_driving(r) for r in recordings]
    turns_at_rest = any(s.turned_at_rest > _GYRO_RAD for s in slow)
    if given is not None:
        return DriveType(given, gyro=turns_at_rest or given not in STEERED, stated=True)

    def total(statistic: str) -> float:
        return float(sum(getattr(s, statistic) for s in slow))

    if total("across_m") > 0.1 * total("along_m"):
        return DriveType("omni", "it moves sideways")
    radius_m = 1.0 / max(1e-9, *(s.curvature for s in slow))
    turns_wide = total("turned") >= _TURNED_RAD and radius_m >= _LEAST_RADIUS_M
    enough = total("seconds") >= _SLOW_S and total("spells") >= _SPELLS
    sharper = total("beyond") > _SPOT_RAD * total("spells")
    if any(r.track_m is not None for r in recordings) or not turns_wide or sharper:
        return DriveType("differential")
    if not enough or not _has_stop(np.concatenate([s.slow for s in slow], axis=1)):
        return DriveType("differential", least_radius_m=radius_m)
    gyro = turns_at_rest or total("rest_s") < _RESTS_S
    why = f"steers up to a stop, never turned on the spot; smallest radius {radius_m:.1f} m"
    return DriveType("car", why, gyro=gyro)


def _has_stop(slow: Array) -> bool:
    """Return whether slow driving, as signed curvatures and durations (2, m), is often at the largest of its side."""
    curvature, seconds = slow
    there = np.zeros(len(curvature), dtype=bool)
    for side in (curvature, -curvature):
        if (turns := side > 0.0).any():
            there |= turns & (side * _STOP >= np.quantile(side[turns], _STOP_QUANTILE))
    return bool(there.any() and there.mean() >= _STOP_SHARE and seconds[there].sum() >= _SLOW_S)


def is_holonomic(recordings: Sequence[Recording], motions: Sequence[Motion]) -> bool:
    """Return whether a robot can drive sideways, and did; vy of another comes from turns of a point off its axle."""
    return drives_sideways(motions) and drive_type_of(recordings).name == "omni"


def mountings(recordings: Sequence[Recording]) -> tuple[str, ...]:
    """Return the effects of `MOUNTING` that are possible.

    There are none if a truth is in the frame of the odometry, or is a gyro, whose position has no influence. A mounting
    yaw has no influence on truths of positions alone.
    """
    if any(r.of_base or not r.positioned for r in recordings):
        return ()
    return MOUNTING if any(r.headed for r in recordings) else MOUNTING[:1]


def readings_of(effect: Effect | str, drive: DriveType | None = None) -> tuple[str, ...]:
    """Return the aliases of an effect that a robot of this type can have: names of effects with the same error.

    effect : an effect, whose values have to be within the bounds of an alias; or the name of an effect
    """
    kinds = registry()
    name = effect if isinstance(effect, str) else effect.name
    own = kinds[name].aliased_with if name in kinds else None
    twins = [other for other, kind in kinds.items() if kind.aliased_with == name]
    either = (*twins, *([own] if own else []))
    guessed = drive is not None and drive.steered and not drive.stated
    if guessed:  # perhaps wrongly, so the names for differential drives are reported too
        unsteered = kinds[name].unsteered if name in kinds else None
        either = (*either, *([unsteered] if unsteered else []))
    elif drive is not None:
        either = tuple(other for other in either if drive.admits(kinds[other]))
    return tuple(
        other for other in either
        if all(p.low <= getattr(effect, p.name, p.identity) <= p.high for p in parameters(kinds[other]))
    )  # fmt: skip


@dataclass(frozen=True, slots=True)
class _SlowDriving:
    """Statistics of the turning of a robot, from the odometry of one recording.

    along_m, across_m, turned : total travel forwards and sideways, m, and total turn, rad
    curvature : largest curvature at speed or, if slow driving shows it, at the steering's stop, 1/m
    seconds, spells : duration of slow driving, s, and number of slow spells or stops
    beyond : turn in these beyond the largest curvature, rad
    turned_at_rest, rest_s : turn while the wheels were at rest, rad, and duration of rest, s
    slow : (2, m) signed curvature, 1/m, and duration, s, of each interval of slow driving
    """

    along_m: float
    across_m: float
    turned: float
    curvature: float
    seconds: float
    spells: int
    beyond: float
    turned_at_rest: float
    rest_s: float
    slow: Array


def _slow_driving(recording: Recording) -> _SlowDriving:
    odometry = recording.odometry
    t_s = recording.odometry_s
    middle, dt = (t_s[:-1] + t_s[1:]) / 2.0, np.diff(t_s)
    world = slopes(t_s, odometry.xyt, middle, SMOOTHING_S)
    heading = odometry.heading_at(middle, recording.origin_ns)
    along, across = rotate(world[:, :2], -heading).T
    v, omega = np.abs(along), np.abs(world[:, 2])
    raw = increments(odometry.xyt)
    # at rest together with the five increments on either side
    stands = binary_erosion(np.hypot(raw.ds_m, raw.dl_m) < 1e-9, np.ones(11), border_value=1)
    at_rest = float(np.abs(raw.dtheta_rad[stands]).sum())
    moving = v[v > _STILL * float(v.max(initial=0.0))]
    usual = float(np.quantile(moving, _USUAL)) if len(moving) else 0.0
    fast, slow = v > _FAST * usual, v < _SLOW * usual
    curvature = float(np.quantile(omega[fast] / v[fast], _LARGEST)) if fast.any() else 0.0
    creeps = slow & (v > _CREEP * usual)
    bends = np.stack((world[creeps, 2] / along[creeps], dt[creeps]))
    if _has_stop(bends):  # who slows down for tight bends never reaches it at speed
        curvature = max(curvature, float(np.quantile(np.abs(bends[0]), _STOP_QUANTILE)))
    begins = np.count_nonzero(np.diff(slow.astype(np.int8)) == 1)
    beyond = float((np.maximum(omega - _SHARPER * curvature * v, 0.0) * dt)[slow].sum())
    return _SlowDriving(
        float((v * dt).sum()), float((np.abs(across) * dt).sum()), float((omega * dt).sum()), curvature,
        float(dt[slow & (v > _STILL * usual)].sum()), int(begins), beyond, at_rest,
        float(dt[stands].sum()), bends,
    )  # fmt: skip
