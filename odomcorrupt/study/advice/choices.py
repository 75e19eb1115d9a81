"""A or B: pairs of names that the data cannot tell apart, and the drive that would."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from odomcorrupt.effects import registry
from odomcorrupt.effects.effect import choices
from odomcorrupt.study.advice.drives import ENOUGH_NATS, best_plan, missing_motion
from odomcorrupt.study.advice.information import separation

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.study.advice.drives import Drives, Gain
    from odomcorrupt.study.advice.information import Field
    from odomcorrupt.study.advice.plan import Plan
    from odomcorrupt.study.search.candidates import Candidate
    from odomcorrupt.study.search.learn import Round

__all__ = ["TOO_FEW_NATS", "Choice", "open_choices"]

TOO_FEW_NATS = 3.0
"""Less than this from ten minutes of the best drive: no drive is worth it."""


@dataclass(frozen=True, slots=True)
class Choice:
    """One of several names, and these data cannot tell which.

    why : what the drive lacked, in words; "" where it lacked nothing
    plan : the drive that would tell, or None where no drive can
    nats : by how much it is expected to favour the right one
    hint : where the two are the very same to every drive: what else can tell; "" where they are only too small
    """

    names: tuple[str, ...]
    why: str
    plan: Plan | None
    nats: float
    hint: str = ""


def open_choices(drives: Drives, look: Round) -> tuple[list[Choice], list[Gain]]:
    """Return the choices that a look left open, and what a drive would tell of each that a drive can settle."""
    if not look.alternatives or look.added is None:
        return [], []
    kinds = registry()
    twins = [n for n in look.alternatives if kinds[n].twin_of in (look.added, *look.alternatives)]
    rivals = {c.score.effect.name: c for c in look.candidates}
    names = [n for n in look.alternatives if n in rivals]
    found, told = [], []
    for name in names:
        gain = _telling(drives, rivals[look.added], rivals[name])
        plan, nats = best_plan(drives, gain)
        if nats < TOO_FEW_NATS:
            found.append(Choice((look.added, name), "", None, nats))
            continue
        found.append(Choice((look.added, name), missing_motion(drives, gain, nats), plan, nats))
        told.append(gain)
    for twin in twins:
        about = kinds[twin].about
        first = str(kinds[twin].twin_of)
        found.append(Choice((first, twin), "", None, 0.0, about.drive if about else ""))
    return found, told


def _telling(drives: Drives, one: Candidate, other: Candidate) -> Gain:
    """Return what tells how many nats a drive adds to the choice between two, whichever of them is true."""
    a, b = (_as_fitted(c) for c in (one, other))
    beside = [e for e in drives.learned.fit.effects if e.name not in {a.name, b.name}]
    inflation = max(one.score.inflation, other.score.inflation)
    pairs = [pair for x in _guises(drives, a, beside) for y in _guises(drives, b, beside) for pair in ((x, y), (y, x))]

    def nats(*drive: Field) -> float:
        fields = [drives.recorded, *drive]
        return min(separation(x, y, beside, fields) for x, y in pairs) / inflation

    known = nats()
    return lambda drive: nats(drive) - known


def _guises(drives: Drives, effect: Effect, beside: Sequence[Effect]) -> list[Effect]:
    """Return an effect with every source of the heading that these data leave open, its own first.

    A straight does not say whether the wheels or a gyro give the heading; what a turn would tell hangs on it.
    """
    words = choices(effect).get("heading", ())
    others = [replace(effect, heading=word) for word in words if word != getattr(effect, "heading", word)]  # type: ignore[type-var]
    return [effect, *(o for o in others if separation(effect, o, beside, [drives.recorded]) < ENOUGH_NATS)]


def _as_fitted(candidate: Candidate) -> Effect:
    if candidate.fit is None:
        return candidate.score.effect
    name = candidate.score.effect.name
    return next(e for e in candidate.fit.effects if e.name == name)
