"""Recorded and planned drives: the most informative manoeuvre for a question, and kinds of motion missing so far."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import pi
from operator import itemgetter
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from odomcorrupt.geometry.motion import slopes
from odomcorrupt.study.design.information import planned_field, recorded_field
from odomcorrupt.study.design.manoeuvres import MANOEUVRES
from odomcorrupt.study.design.plan import plan_of, safe_limits

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from odomcorrupt.effects.effect import Motion
    from odomcorrupt.study.design.information import Field
    from odomcorrupt.study.design.plan import Plan
    from odomcorrupt.study.select.result import Learned

_MOVING_MPS = 0.05
_TURNING_RADPS = 0.1
_SECTORS = 8


@dataclass(frozen=True, slots=True)
class Excitation:
    """Kinds of motion in all drives together.

    forward_m, reverse_m : distance travelled
    left_rad, right_rad, spot_rad : angle turned to either side, and on the spot
    standing_s, minutes : time at rest, and total time
    speeds, turning_speeds : 10 % and 90 % quantiles of the speed, m/s, by distance, and by angle while turning
    hard_s : time at more than 0.25 m/s^2
    headings : number of eight sectors with more than a fiftieth of the distance
    """

    forward_m: float
    reverse_m: float
    left_rad: float
    right_rad: float
    spot_rad: float
    standing_s: float
    minutes: float
    speeds: tuple[float, float]
    turning_speeds: tuple[float, float]
    hard_s: float
    headings: int


@dataclass(frozen=True, slots=True)
class MissingExcitation:
    """An excitation that a drive may lack.

    why : returns a description if it is missing, else ""
    primitives : names of the manoeuvres with this excitation and as little else as possible
    """

    why: Callable[[Excitation], str]
    primitives: tuple[str, ...]


def excitation(motions: Sequence[Motion]) -> Excitation:
    """Return the excitation of all drives together."""
    dt = np.concatenate([m.dt_s for m in motions])
    v = np.concatenate([m.v for m in motions])
    speed = np.concatenate([m.speed for m in motions])
    omega = np.concatenate([m.omega for m in motions])
    theta = np.concatenate([m.theta for m in motions])
    # Average over 0.5 s, because the ripple of a motor is no acceleration of the body.
    hard = np.concatenate([np.abs(slopes(m.t_s, m.v[:, None], m.t_s, 0.5)[:, 0]) for m in motions])
    way, turn = speed * dt, omega * dt
    turning = np.abs(omega) > _TURNING_RADPS
    sector = np.floor((theta % (2.0 * pi)) / (2.0 * pi / _SECTORS)).astype(int) % _SECTORS
    share = np.bincount(sector, way, _SECTORS) / max(float(way.sum()), 1e-9)
    return Excitation(
        forward_m=float(way[v > _MOVING_MPS].sum()),
        reverse_m=float(way[v < -_MOVING_MPS].sum()),
        left_rad=float(turn[omega > _TURNING_RADPS].sum()),
        right_rad=-float(turn[omega < -_TURNING_RADPS].sum()),
        spot_rad=float(np.abs(turn)[turning & (speed < _MOVING_MPS)].sum()),
        standing_s=float(dt[(speed < 0.01) & (np.abs(omega) < 0.01)].sum()),
        minutes=float(dt.sum()) / 60.0,
        speeds=_middle(speed, way * (speed > _MOVING_MPS)),
        turning_speeds=_middle(speed, np.abs(turn) * turning),
        hard_s=float(dt[hard > 0.25].sum()),
        headings=int((share > 0.02).sum()),
    )


def _middle(values: np.ndarray, weight: np.ndarray) -> tuple[float, float]:
    """Return the weighted 10 % and 90 % quantiles; zeros if the total weight is zero."""
    total = float(weight.sum())
    if total <= 0.0:
        return 0.0, 0.0
    order = np.argsort(values)
    part = np.cumsum(weight[order]) / total
    low, high = np.interp((0.1, 0.9), part, values[order])
    return float(low), float(high)


def _speed(e: Excitation) -> str:
    low, high = e.speeds
    return f"always near {high:.2g} m/s" if 0.0 < high < 1.3 * low else ""


def _turning_speed(e: Excitation) -> str:
    low, high = e.turning_speeds
    return f"every turn was taken near {high:.2g} m/s" if 0.0 < high < 1.3 * low else ""


def _turned(e: Excitation) -> str:
    least = 0.03 * max(e.left_rad, e.right_rad, 10.0)
    left, right = e.left_rad < least, e.right_rad < least
    return "never turned" if left and right else "never turned left" if left else "never turned right" if right else ""


EXCITATIONS: tuple[MissingExcitation, ...] = (
    MissingExcitation(lambda e: "hardly drove" if e.forward_m + e.reverse_m < 5.0 else "", ("squares",)),
    MissingExcitation(
        lambda e: "never reversed" if e.reverse_m < 0.01 * e.forward_m + 0.1 else "", ("there_and_back",)
    ),
    MissingExcitation(_turned, ("spins", "eights")),
    MissingExcitation(lambda e: "hardly at rest" if e.standing_s < 10.0 else "", ("stands",)),
    MissingExcitation(_speed, ("two_speeds", "eights_at_two_speeds")),
    MissingExcitation(_turning_speed, ("turns_apart", "eights_at_two_speeds")),
    MissingExcitation(lambda e: "never turned on the spot" if e.spot_rad < 1.0 else "", ("spins",)),
    MissingExcitation(lambda e: "hardly sped up or braked" if e.hard_s < 5.0 else "", ("hard",)),
    MissingExcitation(lambda e: "hardly more than one heading" if e.headings <= 2 else "", ("star",)),
)
"""In the order of evaluation: the more informative first."""


def missing_excitations(drive: Excitation) -> list[tuple[str, tuple[str, ...]]]:
    """Return descriptions of the motions that a drive lacks, with the manoeuvres that contain them."""
    return [(why, lack.primitives) for lack in EXCITATIONS if (why := lack.why(drive))]


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
    """Recorded and planned drives; plans are computed on first use.

    with_clocks : the recorded drives with offsets and rates of all clocks free
    """

    learned: Learned
    recorded: Field = field(init=False)
    with_clocks: Field = field(init=False)
    _planned: dict[tuple[str, float], tuple[Plan, Field]] = field(init=False, default_factory=dict)

    def __post_init__(self) -> None:
        self.recorded = recorded_field(self.learned.fit)
        self.with_clocks = replace(self.recorded, clocks=self.recorded.problem.clock_columns())

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
        shares = [float(np.mean([_share(gain(drive)) for gain in gains])) for gains in (first, beside) if gains]
        return float(np.dot(shares, (1.0, _SECONDARY_WEIGHT)[: len(shares)]))

    def answered(drive: Field) -> int:
        return sum(gain(drive) >= ENOUGH_NATS for gain in first or beside)

    plan, drive = _most_valuable(drives, answered_nats)
    if answered(drive) >= (len(first) or 1):
        return plan
    gains = [(answered(field_), longer) for longer, field_ in _longer(drives, plan)]
    return max([(answered(drive), plan), *gains], key=itemgetter(0))[1]


def _share(nats: float) -> float:
    """Return the fraction (0 to 1) of a question answered by an amount of information, nats."""
    return max(nats, 0.0) / (max(nats, 0.0) + ENOUGH_NATS)


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
    found = []
    for why, names in missing_excitations(excitation(drives.learned.fit.problem.motions)):
        gains = max(gain(drives.planned(name, _SHORT_S)[1]) for name in names)
        if gains >= _SUFFICIENT_SHARE * best_nats:
            found.append((gains, why))
    return ", ".join(why for _, why in sorted(found, key=lambda pair: pair[0], reverse=True)[:2])
