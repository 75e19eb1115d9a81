"""Recorded and planned drives: the most informative manoeuvre for a question, and kinds of motion missing so far."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import pi
from operator import itemgetter
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from odomcorrupt.geometry.motion import slopes
from odomcorrupt.study.design.information import planned_field, recorded_field
from odomcorrupt.study.design.plan import MANOEUVRES, plan_of, safe_limits

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from odomcorrupt.effects.effect import Motion
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.design.information import Field
    from odomcorrupt.study.design.plan import Plan
    from odomcorrupt.study.select.result import Learned

_MOVING_MPS, _TURNING_RADPS = 0.05, 0.1
_SECTORS = 8


def missing_excitations(motions: Sequence[Motion]) -> list[tuple[str, tuple[str, ...]]]:
    """Return descriptions of the motions that drives lack together, the more informative first.

    Beside each are names of the manoeuvres with this motion and as little else as possible.
    """
    names = ("dt_s", "v", "speed", "omega", "theta")
    dt, v, speed, omega, theta = (np.concatenate([getattr(m, name) for m in motions]) for name in names)
    # Average over 0.5 s, because the ripple of a motor is no acceleration of the body.
    hard = np.concatenate([np.abs(slopes(m.t_s, m.v[:, None], m.t_s, 0.5)[:, 0]) for m in motions])
    way, turn, turning = speed * dt, np.abs(omega) * dt, np.abs(omega) > _TURNING_RADPS
    forward_m, reverse_m = (way[sign * v > _MOVING_MPS].sum() for sign in (1.0, -1.0))
    left_rad, right_rad = (turn[sign * omega > _TURNING_RADPS].sum() for sign in (1.0, -1.0))
    least_rad = 0.03 * max(left_rad, right_rad, 10.0)
    sides = [side for side, angle in (("left", left_rad), ("right", right_rad)) if angle < least_rad]
    sector = np.floor((theta % (2.0 * pi)) / (2.0 * pi / _SECTORS)).astype(int) % _SECTORS
    headings = np.count_nonzero(np.bincount(sector, way, _SECTORS) > 0.02 * way.sum())
    usual, turned = _one_speed(speed, way * (speed > _MOVING_MPS)), _one_speed(speed, turn * turning)
    lacks = [
        (forward_m + reverse_m < 5.0, "hardly drove", ("squares",)),
        (reverse_m < 0.01 * forward_m + 0.1, "never reversed", ("there_and_back",)),
        (bool(sides), "never turned" + (f" {sides[0]}" if len(sides) == 1 else ""), ("spins", "eights")),
        (dt[(speed < 0.01) & (np.abs(omega) < 0.01)].sum() < 10.0, "hardly at rest", ("stands",)),
        (bool(usual), f"always near {usual}", ("two_speeds", "eights_at_two_speeds")),
        (bool(turned), f"every turn was taken near {turned}", ("turns_apart", "eights_at_two_speeds")),
        (turn[turning & (speed < _MOVING_MPS)].sum() < 1.0, "never turned on the spot", ("spins",)),
        (dt[hard > 0.25].sum() < 5.0, "hardly sped up or braked", ("hard",)),
        (headings <= 2, "hardly more than one heading", ("star",)),
    ]
    return [(why, manoeuvres) for lacking, why, manoeuvres in lacks if lacking]


def _one_speed(speed: Array, weight: Array) -> str:
    """Return the speed (n,) that hardly varies by its weighted 10 % and 90 % quantiles; "" if it varies or is zero."""
    total = float(weight.sum())
    if total <= 0.0:
        return ""
    order = np.argsort(speed)
    low, high = np.interp((0.1, 0.9), np.cumsum(weight[order]) / total, speed[order])
    return f"{high:.2g} m/s" if 0.0 < high < 1.3 * low else ""


Gain: TypeAlias = "Callable[[Field], float]"
"""Information that a planned drive adds on one question, nats."""
ENOUGH_NATS = 10.0
"""Expected log likelihood ratio from which a question counts as answered."""
_SHORT_S, _LONG_S = 180.0, 600.0
_SUFFICIENT_SHARE = 0.3
"""A missing excitation is given as reason if adding it yields at least this fraction of the best information."""
_SECONDARY_WEIGHT = 0.2
"""Joint weight of secondary questions, relative to the primary ones."""


@dataclass(slots=True)
class Drives:
    """Recorded and planned drives; plans are computed on first use."""

    learned: Learned
    recorded: Field = field(init=False)
    _planned: dict[tuple[str, float], tuple[Plan, Field]] = field(init=False, default_factory=dict)

    def __post_init__(self) -> None:
        self.recorded = recorded_field(self.learned.fit)

    def planned(self, name: str, duration_s: float) -> tuple[Plan, Field]:
        """Return a manoeuvre planned within this robot's limits."""
        key = (name, duration_s)
        if key not in self._planned:
            manoeuvre = next(m for m in MANOEUVRES if m.name == name)
            plan = plan_of(manoeuvre, safe_limits(self.learned.fit.problem.motions), duration_s)
            self._planned[key] = plan, planned_field(self.learned.fit, plan)
        return self._planned[key]


def best_plan(drives: Drives, gain: Gain) -> tuple[Plan, float]:
    """Return the most informative manoeuvre of a few minutes, or of more if that is not enough."""
    plan, drive = _most_valuable(drives, gain)
    nats = gain(drive)
    if nats < ENOUGH_NATS:
        gains = [(gain(field_), longer) for longer, field_ in _longer(drives, plan)]
        nats, plan = max([(nats, plan), *gains], key=itemgetter(0))
    return plan, nats


def most_useful(drives: Drives, first: Sequence[Gain], beside: Sequence[Gain] = ()) -> Plan:
    """Return the plan that answers most questions; nats beyond those that answer a question count little.

    first : primary questions, which justify a longer drive
    beside : secondary questions, considered among plans for the primary ones
    """
    if len(first) + len(beside) == 1:
        return best_plan(drives, (*first, *beside)[0])[0]

    def answered_nats(drive: Field) -> float:
        nats = [np.maximum([gain(drive) for gain in gains], 0.0) for gains in (first, beside) if gains]
        shares = [float(np.mean(n / (n + ENOUGH_NATS))) for n in nats]
        return sum(share * w for share, w in zip(shares, (1.0, _SECONDARY_WEIGHT), strict=False))

    def answered(drive: Field) -> int:
        return sum(gain(drive) >= ENOUGH_NATS for gain in first or beside)

    plan, drive = _most_valuable(drives, answered_nats)
    if answered(drive) >= (len(first) or 1):
        return plan
    gains = [(answered(field_), longer) for longer, field_ in _longer(drives, plan)]
    return max([(answered(drive), plan), *gains], key=itemgetter(0))[1]


def _most_valuable(drives: Drives, value: Gain) -> tuple[Plan, Field]:
    """Return the manoeuvre of highest value in a few minutes, discounted for its additional duration."""
    tried = [drives.planned(m.name, _SHORT_S) for m in MANOEUVRES if m.least_s <= _SHORT_S]
    return max(tried, key=lambda pair: value(pair[1]) * min(1.0, _SHORT_S / pair[0].duration_s))


def _longer(drives: Drives, plan: Plan) -> list[tuple[Plan, Field]]:
    """Return longer plans: the same manoeuvre for ten minutes, and those that need more time to be informative."""
    slow = [m.name for m in MANOEUVRES if m.least_s > _SHORT_S]
    return [drives.planned(name, _LONG_S) for name in (plan.manoeuvre.name, *slow)]


def missing_motion(drives: Drives, gain: Gain, best_nats: float) -> str:
    """Return the missing excitations that would have been informative, most informative first; "" if none."""
    found = [
        (max(gain(drives.planned(name, _SHORT_S)[1]) for name in names), why)
        for why, names in missing_excitations(drives.learned.fit.problem.motions)
    ]
    enough = [one for one in found if one[0] >= _SUFFICIENT_SHARE * best_nats]
    informative = sorted(enough, key=itemgetter(0), reverse=True)
    return ", ".join(why for _, why in informative[:2])
