"""Recorded and planned drives: which manoeuvre answers a question best, and what the recorded ones lack."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from operator import itemgetter
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from odomcorrupt.study.design.excitation import excitation, lacks_of
from odomcorrupt.study.design.information import planned_field, recorded_field
from odomcorrupt.study.design.manoeuvres import MANOEUVRES
from odomcorrupt.study.design.plan import plan_of, safe_limits

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from odomcorrupt.study.design.information import Field
    from odomcorrupt.study.design.plan import Plan
    from odomcorrupt.study.select.stepwise import Learned

__all__ = ["ENOUGH_NATS", "Drives", "Gain", "best_plan", "missing_motion", "most_useful"]

Gain: TypeAlias = "Callable[[Field], float]"
"""What a planned drive adds to the answer of one question, nats."""
ENOUGH_NATS = 10.0
"""A drive that is expected to favour the right one by this much settles the matter."""
_SHORT_S, _LONG_S = 180.0, 600.0
_SUFFICIENT_SHARE = 0.3
"""A missing excitation is given as reason if adding it yields at least this share of the best drive's information."""
_BESIDE = 0.2
"""What questions that come second weigh together, where those that come first weigh 1."""


@dataclass(slots=True)
class Drives:
    """Recorded and planned drives; a plan is laid out when it is first asked for.

    with_clocks : the recorded drives, both numbers of all their clocks free
    """

    learned: Learned
    recorded: Field = field(init=False)
    with_clocks: Field = field(init=False)
    _planned: dict[tuple[str, float], tuple[Plan, Field]] = field(init=False, default_factory=dict)

    def __post_init__(self) -> None:
        self.recorded = recorded_field(self.learned.fit)
        self.with_clocks = replace(self.recorded, clocks=self.recorded.problem.clock_columns())

    def planned(self, name: str, duration_s: float) -> tuple[Plan, Field]:
        """Return a manoeuvre as this robot would drive it."""
        key = (name, duration_s)
        if key not in self._planned:
            manoeuvre = next(m for m in MANOEUVRES if m.name == name)
            plan = plan_of(manoeuvre, safe_limits(self.learned.fit.problem.motions), duration_s)
            self._planned[key] = plan, planned_field(self.learned.fit, plan)
        return self._planned[key]


def best_plan(drives: Drives, gain: Gain) -> tuple[Plan, float]:
    """Return the most informative manoeuvre of a few minutes, or where that is not enough, of more."""
    plan, drive = _worthiest(drives, gain)
    nats = gain(drive)
    if nats < ENOUGH_NATS:
        gains = [(gain(field_), longer) for longer, field_ in _longer(drives, plan)]
        nats, plan = max([(nats, plan), *gains], key=itemgetter(0))
    return plan, nats


def most_useful(drives: Drives, first: Sequence[Gain], beside: Sequence[Gain] = ()) -> Plan:
    """Return the plan that settles most questions: nats beyond what settles one count for little.

    first : what matters, and is worth a longer drive
    beside : what is answered on the way, if a plan that does so settles the first as well
    """
    if len(first) + len(beside) == 1:
        return best_plan(drives, (*first, *beside)[0])[0]

    def settled(drive: Field) -> float:
        shares = [float(np.mean([_share(gain(drive)) for gain in gains])) for gains in (first, beside) if gains]
        return float(np.dot(shares, (1.0, _BESIDE)[: len(shares)]))

    def answered(drive: Field) -> int:
        return sum(gain(drive) >= ENOUGH_NATS for gain in first or beside)

    plan, drive = _worthiest(drives, settled)
    if answered(drive) >= (len(first) or 1):
        return plan
    gains = [(answered(field_), longer) for longer, field_ in _longer(drives, plan)]
    return max([(answered(drive), plan), *gains], key=itemgetter(0))[1]


def _share(nats: float) -> float:
    """Return the part (0 to 1) of a question that so many nats answer."""
    return max(nats, 0.0) / (max(nats, 0.0) + ENOUGH_NATS)


def _worthiest(drives: Drives, worth: Gain) -> tuple[Plan, Field]:
    """Return the manoeuvre that is worth most in a few minutes; a minute more must be worth its time."""
    tried = [drives.planned(m.name, _SHORT_S) for m in MANOEUVRES if m.least_s <= _SHORT_S]
    return max(tried, key=lambda pair: worth(pair[1]) * min(1.0, _SHORT_S / pair[0].duration_s))


def _longer(drives: Drives, plan: Plan) -> list[tuple[Plan, Field]]:
    """Return what takes longer: the same for ten minutes, and what is nothing in less."""
    slow = [m.name for m in MANOEUVRES if m.least_s > _SHORT_S]
    return [drives.planned(name, _LONG_S) for name in (plan.manoeuvre.name, *slow)]


def missing_motion(drives: Drives, gain: Gain, best_nats: float) -> str:
    """Return the missing excitations that would have been informative, most informative first; "" if none."""
    found = []
    for why, names in lacks_of(excitation(drives.learned.fit.problem.motions)):
        gains = max(gain(drives.planned(name, _SHORT_S)[1]) for name in names)
        if gains >= _SUFFICIENT_SHARE * best_nats:
            found.append((gains, why))
    return ", ".join(why for _, why in sorted(found, key=lambda pair: pair[0], reverse=True)[:2])
