"""Parts of a drive in which an error may grow: kinds of motion, stretches of time, discs in the truth's plane."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from odomcorrupt.study.validate.error_rates import MOVING

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.validate.error_rates import NodeMotion

__all__ = ["Pattern", "all_patterns"]

_SHARES = (4, 8, 16)
"""Divisors of a run's duration for stretches of time, and of the width of the place for radii of discs."""
_MIN_SHARE, _MAX_SHARE = 0.02, 0.6
"""Least fraction of the drive in a pattern, and largest fraction in a stretch of time or disc."""
_TURN_PER_M = 0.1  # least curvature of a turn, rad/m
_MIN_ACCELERATION = 0.1  # least acceleration, m/s^2


@dataclass(frozen=True, slots=True)
class Pattern:
    """A part of a drive.

    mask : (K,) 1 for intervals in this part
    per : "m" for rates per metre, "s" per second
    amount : metres or seconds in this part
    """

    kind: Literal["motion", "time", "place"]
    where: str
    mask: Array
    per: str
    amount: float
    span_s: tuple[float, float] | None = None
    place: tuple[float, float, float] | None = None


def all_patterns(motion: NodeMotion) -> list[Pattern]:
    """Return the parts of a drive that contain enough of it."""
    total = float(motion.metres.sum())
    wanted = [*_kinds_of_motion(motion), *_stretches(motion), *_discs(motion)]
    kept = []
    for pattern in wanted:
        share = pattern.amount / (total if pattern.per == "m" else float(motion.seconds.sum()))
        if share >= _MIN_SHARE and (pattern.kind == "motion" or share <= _MAX_SHARE):
            kept.append(pattern)
    return kept


def _kinds_of_motion(m: NodeMotion) -> list[Pattern]:
    speed = np.abs(m.v)
    moving = speed > MOVING
    curvature = np.where(moving, m.omega / np.where(moving, m.v, 1.0), 0.0)
    turning = moving & (np.abs(curvature) > _TURN_PER_M)
    fast = float(np.median(speed[moving])) if moving.any() else 0.0
    speeding = m.a * np.sign(m.v)
    kinds = {
        "in all motion": moving,
        "in left turns": turning & (m.omega > 0.0),
        "in right turns": turning & (m.omega < 0.0),
        "on straights": moving & ~turning,
        "in reverse": m.v < -MOVING,
        "at the faster speeds": moving & (speed > fast),
        "at the slower speeds": moving & (speed <= fast),
        "while speeding up": moving & (speeding > _MIN_ACCELERATION),
        "while braking": moving & (speeding < -_MIN_ACCELERATION),
    }
    found = [_pattern("motion", where, mask, m.metres) for where, mask in kinds.items()]
    spot = ~moving & (np.abs(m.omega) > 0.1)
    found += [
        Pattern("motion", where, mask.astype(np.float64), "s", float(m.seconds[mask].sum()))
        for where, mask in (
            ("turning on the spot to the left", spot & (m.omega > 0.0)),
            ("turning on the spot to the right", spot & (m.omega < 0.0)),
            ("at rest", ~moving & ~spot),
        )
    ]
    return found


def _pattern(
    kind: Literal["motion", "time", "place"],
    where: str,
    mask: NDArray[np.bool_],
    metres: Array,
    *,
    span_s: tuple[float, float] | None = None,
    place: tuple[float, float, float] | None = None,
) -> Pattern:
    return Pattern(kind, where, mask.astype(np.float64), "m", float(metres[mask].sum()), span_s, place)


def _stretches(m: NodeMotion) -> list[Pattern]:
    start, end = float(m.t_s[0] - m.seconds[0]), float(m.t_s[-1])
    found = []
    for share in _SHARES:
        length = (end - start) / share
        # overlap by half, so that every event is well inside one of them
        for first in start + length / 2.0 * np.arange(2 * share - 1):
            mask = (m.t_s > first) & (m.t_s <= first + length)
            span = (float(first), float(first + length))
            found.append(_pattern("time", f"from {span[0]:.0f} s to {span[1]:.0f} s", mask, m.metres, span_s=span))
    return found


def _discs(m: NodeMotion) -> list[Pattern]:
    width = float(max(np.ptp(m.x), np.ptp(m.y)))
    found = []
    for share in _SHARES:
        radius = width / share
        if radius <= 0.0:
            continue
        for x in np.arange(m.x.min(), m.x.max() + radius, radius):
            for y in np.arange(m.y.min(), m.y.max() + radius, radius):
                mask = np.hypot(m.x - x, m.y - y) < radius
                where = f"within {radius:.2g} m of ({x:.1f}, {y:.1f})"
                place = (float(x), float(y), radius)
                found.append(_pattern("place", where, mask, m.metres, place=place))
    return found
