"""Recorded and planned drives: which manoeuvre answers a question best, and what the recorded ones lack."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.study.advice.information import planned_field, recorded_field
from odomcorrupt.study.advice.lacks import excitation, lacks_of
from odomcorrupt.study.advice.manoeuvres import MANOEUVRES
from odomcorrupt.study.advice.plan import plan_of, safe_limits

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from odomcorrupt.study.advice.information import Field
    from odomcorrupt.study.advice.plan import Plan
    from odomcorrupt.study.search.learn import Learned

__all__ = ["ENOUGH_NATS", "Drives", "best_plan", "missing_motion", "most_useful"]

ENOUGH_NATS = 10.0
"""A drive that is expected to favour the right one by this much settles the matter."""
_SHORT_S, _LONG_S = 180.0, 600.0
_TELLING = 0.3
"""A lack is a reason if filling it tells at least this part of what the best drive tells."""


@dataclass(slots=True)
class Drives:
    """Recorded and planned drives; a plan is laid out when it is first asked for."""

    learned: Learned
    recorded: Field = field(init=False)
    _planned: dict[tuple[str, float], tuple[Plan, Field]] = field(init=False, default_factory=dict)

    def __post_init__(self) -> None:
        self.recorded = recorded_field(self.learned.fit, self.learned.clocks.free)

    def planned(self, name: str, duration_s: float) -> tuple[Plan, Field]:
        """Return a manoeuvre as this robot would drive it."""
        key = (name, duration_s)
        if key not in self._planned:
            manoeuvre = next(m for m in MANOEUVRES if m.name == name)
            plan = plan_of(manoeuvre, safe_limits(self.learned.fit.problem.motions), duration_s)
            self._planned[key] = plan, planned_field(self.learned.fit, plan)
        return self._planned[key]


def best_plan(drives: Drives, gain: Callable[[Field | None], float]) -> tuple[Plan, float]:
    """Return the manoeuvre that tells most in a few minutes, made longer where that is not enough."""
    tried = [drives.planned(m.name, _SHORT_S) for m in MANOEUVRES]
    # a long drive must be worth its time
    worth = [gain(f) * min(1.0, _SHORT_S / plan.duration_s) for plan, f in tried]
    plan, drive = tried[int(np.argmax(worth))]
    nats = gain(drive)
    if nats < ENOUGH_NATS and plan.duration_s < _LONG_S:
        plan, drive = drives.planned(plan.manoeuvre.name, _LONG_S)
        nats = gain(drive)
    return plan, nats


def most_useful(drives: Drives, gains: Sequence[Callable[[Field | None], float]]) -> Plan:
    """Return the plan that settles most questions: a second nat counts for less than the first of another."""

    def settled(drive: Field | None) -> float:
        return ENOUGH_NATS * float(np.mean([np.log1p(max(gain(drive), 0.0) / ENOUGH_NATS) for gain in gains]))

    return best_plan(drives, settled if len(gains) > 1 else gains[0])[0]


def missing_motion(drives: Drives, gain: Callable[[Field | None], float], best_nats: float) -> str:
    """Return what the drives lacked that would have told, the most telling first; "" if nothing of that kind."""
    found = []
    for why, names in lacks_of(excitation(drives.learned.fit.problem.motions)):
        told = max(gain(drives.planned(name, _SHORT_S)[1]) for name in names)
        if told >= _TELLING * best_nats:
            found.append((told, why))
    return ", ".join(why for _, why in sorted(found, key=lambda pair: pair[0], reverse=True)[:2])
