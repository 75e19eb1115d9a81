"""Drive type: how the wheels steer a robot, as it was given or guessed from its motion; and the effects it can have.

A robot whose wheels are steered turns only as it travels, within a radius that no speed changes, and where it drives
slowly its wheels are often turned as far as they go: a fifth of it is at one and the same large curvature. One that
turns by the difference of its wheels has no such stop, even where its planner never turns it on the spot. Many effects
of the two kinds are one and the same function of the motion (an offset of the steering, and one wheel larger than the
other): the drive type then chooses the name.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.drive_types import AUTO, STEERED
from odomcorrupt.effects import registry
from odomcorrupt.effects.effect import parameters
from odomcorrupt.effects.wheels import brings_track
from odomcorrupt.geometry.increments import increments
from odomcorrupt.geometry.motion import SMOOTHING_S, slopes
from odomcorrupt.geometry.se2 import rotate
from odomcorrupt.study.terms.heading_source import (
    heading_source_of,
    is_nameable,
    is_settled,
    sees_travel,
    with_known_heading,
)
from odomcorrupt.study.terms.regressors import drives_sideways
from odomcorrupt.study.terms.term import LibraryTerm

if TYPE_CHECKING:
    from collections.abc import Container, Sequence

    from numpy.typing import NDArray

    from odomcorrupt.effects.effect import Effect, Motion
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.io.recording import Recording

__all__ = ["MOUNTING", "DriveType", "drive_type_of", "library_families", "mountings", "readings_of"]

MOUNTING = ("lever_arm", "mount_yaw")
"""Where on the robot sits what the truth follows, see `mountings`."""

_FAST, _SLOW, _STILL = 0.6, 0.4, 0.03
"""Parts of the usual speed: the largest curvature is seen above one, tested below one; and those of a robot at rest."""
_USUAL, _LARGEST = 0.9, 0.995
"""Quantiles: of the speed while it moves, and of the curvature on the way."""
_SHARPER = 1.3
"""A steered robot's curvature is no larger than so many times the largest that it has at speed."""
_LEAST_RADIUS_M = 0.3
"""What turns within less is taken to turn on the spot."""
_TURNED_RAD = 4.0 * np.pi
"""Less turning in all says nothing of how a robot turns."""
_SLOW_S, _SPELLS = 3.0, 3
"""Seconds of slow driving, and times that a robot slowed down, that it takes to see how it turns then."""
_CREEP = 0.05
"""Part of the usual speed below which ticks make the curvature."""
_STOP, _STOP_SHARE, _STOP_QUANTILE = 1.15, 0.2, 0.95
"""Steering has a stop where so large a share of slow driving is within this factor of the curvature's quantile, which
a late steering angle exceeds for moments. Robots with two driven wheels have a tenth of it there (a mower that never
turned on the spot), steered ones a third and more."""
_SPOT_RAD = 0.1
"""Turn in each slow spell beyond what the radius allows that filters and ticks may make, radians."""
_REST_S = 2.0
_GYRO_RAD = 1e-4
"""An odometry that turns by more while its wheels stand has a heading that is not theirs."""


@dataclass(frozen=True, slots=True)
class DriveType:
    """How the wheels steer a robot.

    name : one of `drive_types.DRIVE_TYPES`
    reason : why, where it was guessed; "" where it was given, or where nothing speaks against a differential drive
    stated : whether it was given
    gyro : whether the heading may be a gyro's; a steered robot's is not where the odometry does not turn at rest
    heading_source : what a gyro in the bag shows the heading to come from: "wheels", "gyro", or ""
    travel : whether a truth measured travel, and not headings alone
    antenna : whether truths are positions alone of a point that may be anywhere on the robot
    """

    name: str
    reason: str = ""
    gyro: bool = True
    stated: bool = False
    heading_source: str = ""
    travel: bool = True
    antenna: bool = False

    @property
    def known(self) -> bool:
        """Whether it was given, or the motion shows it."""
        return self.stated or bool(self.reason)

    @property
    def steered(self) -> bool:
        """Whether a steering angle turns it."""
        return self.name in STEERED

    @property
    def sentence(self) -> str:
        """What it is, and where it was guessed from the motion, why."""
        return f"{self.name} ({self.reason})" if self.reason else self.name

    def admits(self, kind: type[Effect]) -> bool:
        """Tell whether a robot of this type can have an effect, twins and all."""
        possible = (kind.drives is None or self.name in kind.drives) and (self.gyro or not kind.needs_gyro)
        return possible and is_nameable(kind, self.heading_source, travel=self.travel)


def drive_type_of(recordings: Sequence[Recording]) -> DriveType:
    """Return the drive type of the robot in recordings: as the first that names one says, or guessed from all."""
    return replace(
        _stated_or_guessed(recordings),
        heading_source=heading_source_of(recordings),
        travel=sees_travel(recordings),
        antenna=mountings(recordings) == MOUNTING[:1],
    )


def _stated_or_guessed(recordings: Sequence[Recording]) -> DriveType:
    given = next((r.drive_type for r in recordings if r.drive_type != AUTO), None)
    slow = [_slow_driving(r) for r in recordings]
    turns_at_rest = any(s.turned_at_rest > _GYRO_RAD for s in slow)
    if given is not None:
        return DriveType(given, gyro=turns_at_rest or given not in STEERED, stated=True)
    along, across = sum(s.along_m for s in slow), sum(s.across_m for s in slow)
    if across > 0.1 * along:
        return DriveType("omni", "it moves sideways")
    turned, seconds = sum(s.turned for s in slow), sum(s.seconds for s in slow)
    spells, beyond = sum(s.spells for s in slow), sum(s.beyond for s in slow)
    radius_m = 1.0 / max(1e-9, *(s.curvature for s in slow))
    if any(r.track_m is not None for r in recordings) or turned < _TURNED_RAD or radius_m < _LEAST_RADIUS_M:
        return DriveType("differential")
    if seconds < _SLOW_S or spells < _SPELLS or beyond > _SPOT_RAD * spells:
        return DriveType("differential")
    if not _has_stop(np.concatenate([s.slow for s in slow], axis=1)):
        return DriveType("differential")
    gyro = turns_at_rest or sum(s.rest_s for s in slow) < _REST_S
    return DriveType(
        "car", f"steers up to a stop, never turned on the spot; smallest radius {radius_m:.1f} m", gyro=gyro
    )


def _has_stop(slow: Array) -> bool:
    """Tell whether slow driving, curvatures and seconds (2, m), is again and again at one largest curvature."""
    curvature, seconds = slow
    if not len(curvature):
        return False
    largest = float(np.quantile(curvature, _STOP_QUANTILE))
    there = curvature * _STOP >= largest
    return bool(there.mean() >= _STOP_SHARE and seconds[there].sum() >= _SLOW_S)


def library_families(
    recordings: Sequence[Recording], motions: Sequence[Motion], have: Container[str]
) -> list[tuple[LibraryTerm, ...]]:
    """Return every systematic effect of the library that a robot can have and that can be tested, at every shape.

    Clocks are apart, and a twin is named as another reading of the one with the same error; where that is no effect
    of this drive type, the twin takes its place. Single wheels need a track, given or their own.

    Parameters
    ----------
    recordings, motions : what is studied, and its smooth motion
    have : names of effects that the model has

    """
    drive = drive_type_of(recordings)
    track = not drive.steered and all(m.track_m is not None for m in motions)
    sideways = drive.name == "omni" or (drive.name != "differential" and drives_sideways(motions))
    families = []
    for name, kind in registry().items():
        wanted = kind.kind not in ("noise", "event") and not kind.clock and name not in have and _leads(kind, drive)
        possible = (sideways or not kind.needs_sideways) and (track or not kind.needs_track or brings_track(kind))
        if name in MOUNTING and name not in mountings(recordings):
            continue
        if wanted and possible:
            family = with_known_heading(LibraryTerm.family(kind, motions), drive.heading_source)
            if drive.steered:  # it has no two wheels that odometry compares
                family = tuple(t for t in family if not (getattr(t.start, "track", 0.0) or kind.needs_track))
            families.append(family)
    return [family for family in families if family]


def mountings(recordings: Sequence[Recording]) -> tuple[str, ...]:
    """Return which of `MOUNTING` can exist.

    None of it where a truth is of the odometry's own frame, or of a gyro, which has no place; and no mounting yaw where
    there are positions alone, of which it changes nothing.
    """
    if any(r.of_base or not r.positioned for r in recordings):
        return ()
    return MOUNTING if any(r.headed for r in recordings) else MOUNTING[:1]


def _leads(kind: type[Effect], drive: DriveType) -> bool:
    """Tell whether an effect is tested itself, and is not named as another reading of one that is."""
    if not drive.admits(kind):
        return False
    # a lever arm has a second number, so what a steered robot's has one of is tested beside it; not of an antenna,
    # which is likelier off the axle than the base frame is
    of_steered = drive.steered and kind.drives is not None and not drive.antenna
    return kind.twin_of is None or of_steered or is_settled(kind, drive.heading_source)


def readings_of(effect: Effect | str, drive: DriveType | None = None) -> tuple[str, ...]:
    """Return the other readings of an effect that a robot of this type can have: names of the very same error.

    effect : with its values, which another reading has to admit; or its name
    """
    kinds = registry()
    name = effect if isinstance(effect, str) else effect.name
    own = kinds[name].twin_of if name in kinds else None
    twins = [other for other, kind in kinds.items() if kind.twin_of == name]
    either = (*twins, *([own] if own else []))
    guessed = drive is not None and drive.steered and not drive.stated
    if guessed:  # and perhaps wrongly: the names for two driven wheels stay beside those of a steered robot
        unsteered = kinds[name].unsteered if name in kinds else None
        either = (*either, *([unsteered] if unsteered else []))
    elif drive is not None:
        either = tuple(other for other in either if drive.admits(kinds[other]))
    return tuple(other for other in either if _admits(kinds[other], effect))


def _admits(kind: type[Effect], effect: Effect | str) -> bool:
    """Tell whether the values of an effect are within the bounds of a twin."""
    return all(p.low <= getattr(effect, p.name, p.identity) <= p.high for p in parameters(kind))


@dataclass(frozen=True, slots=True)
class _SlowDriving:
    """What one recording's odometry says of how the robot turns.

    along_m, across_m, turned : way forwards and sideways, and turn in all, m and rad
    curvature : the largest at speed, 1/m
    seconds, spells : how long, and how often, it drove slowly or stopped
    beyond : turn in these that the largest curvature does not allow, rad
    turned_at_rest, rest_s : turn while the wheels stood, rad, and for how long they did
    slow : (2, m) curvature, 1/m, and duration, s, of each interval of slow driving
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
    stands = _settled(np.hypot(raw.ds_m, raw.dl_m) < 1e-9)
    at_rest = float(np.abs(raw.dtheta_rad[stands]).sum())
    moving = v[v > _STILL * float(v.max(initial=0.0))]
    usual = float(np.quantile(moving, _USUAL)) if len(moving) else 0.0
    fast, slow = v > _FAST * usual, v < _SLOW * usual
    curvature = float(np.quantile(omega[fast] / v[fast], _LARGEST)) if fast.any() else 0.0
    begins = np.count_nonzero(np.diff(slow.astype(np.int8)) == 1)
    beyond = float((np.maximum(omega - _SHARPER * curvature * v, 0.0) * dt)[slow].sum())
    creeps = slow & (v > _CREEP * usual)
    return _SlowDriving(
        float((v * dt).sum()), float((np.abs(across) * dt).sum()), float((omega * dt).sum()), curvature,
        float(dt[slow & (v > _STILL * usual)].sum()), int(begins), beyond, at_rest,
        float(dt[stands].sum()), np.stack((omega[creeps] / v[creeps], dt[creeps])),
    )  # fmt: skip


def _settled(still: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return where something has been still for some increments on either side, too."""
    both = still.copy()
    for shift in range(1, 6):
        both[shift:] &= still[:-shift]
        both[:-shift] &= still[shift:]
    return both
