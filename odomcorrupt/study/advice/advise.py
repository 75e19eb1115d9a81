"""What to do next: which pairs the data cannot tell apart, what they cannot show, and the drive that would."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.effects import registry
from odomcorrupt.effects.effect import amplitudes
from odomcorrupt.study.advice.information import planned_field, recorded_field, separation, sizes
from odomcorrupt.study.advice.lacks import excitation, lacks_of
from odomcorrupt.study.advice.manoeuvres import MANOEUVRES
from odomcorrupt.study.advice.plan import plan_of, safe_limits

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.study.advice.information import Field
    from odomcorrupt.study.advice.plan import Plan
    from odomcorrupt.study.search.candidates import Candidate
    from odomcorrupt.study.search.learn import Learned, Round

__all__ = ["ENOUGH_NATS", "SEEN", "Advice", "Choice", "Limit", "Untestable", "advise"]

ENOUGH_NATS = 10.0
"""A drive that is expected to favour the right one by this much settles the matter."""
SEEN = 4.2
"""An effect this many standard errors large is found nearly always."""
_SHORT_S, _LONG_S = 180.0, 600.0
_TELLING = 0.3
"""A lack is a reason if filling it tells at least this part of what the best drive tells."""
_HIDDEN = 4.0
_IDENTICAL_NATS = 0.5
"""Less than this from ten minutes of the best drive: no drive can tell."""
UNTESTABLE = ("not testable", "cannot be told")
"""How refusals begin that say something of the drive, and nothing of the effect."""


@dataclass(frozen=True, slots=True)
class Choice:
    """One of several names, and these data cannot tell which.

    why : what the drive lacked, in words; "" where it lacked nothing
    plan : the drive that would tell, or None where no drive can
    nats : by how much it is expected to favour the right one
    hint : where no drive can tell: what can
    """

    names: tuple[str, ...]
    why: str
    plan: Plan | None
    nats: float
    hint: str = ""


@dataclass(frozen=True, slots=True)
class Untestable:
    """An effect that these data cannot show, even if it were there.

    why : in words
    plan : the drive that would show its typical size, or None
    hint : where no plan is: what else to do
    """

    effect: str
    why: str
    plan: Plan | None
    hint: str = ""


@dataclass(frozen=True, slots=True)
class Limit:
    """The least size of an effect's parameter that these data would have shown, in its unit."""

    effect: str
    parameter: str
    size: float
    unit: str


@dataclass(frozen=True, slots=True)
class Advice:
    """All that is open after a search; `best` is the plan that settles most of it, choices before the rest."""

    choices: tuple[Choice, ...]
    untestable: tuple[Untestable, ...]
    limits: tuple[Limit, ...]
    best: Plan | None


@dataclass(slots=True)
class _Drives:
    """Recorded and planned drives; a plan is laid out when it is first asked for."""

    learned: Learned
    recorded: Field = field(init=False)
    _planned: dict[tuple[str, float], tuple[Plan, Field]] = field(init=False, default_factory=dict)

    def __post_init__(self) -> None:
        self.recorded = recorded_field(self.learned.fit, self.learned.clocks.free)

    def planned(self, name: str, duration_s: float) -> tuple[Plan, Field]:
        key = (name, duration_s)
        if key not in self._planned:
            manoeuvre = next(m for m in MANOEUVRES if m.name == name)
            plan = plan_of(manoeuvre, safe_limits(self.learned.fit.problem.motions), duration_s)
            self._planned[key] = plan, planned_field(self.learned.fit, plan)
        return self._planned[key]


def advise(learned: Learned) -> Advice:
    """Return what these data leave open, and the drives that would settle it."""
    drives = _Drives(learned)
    choices, gains = [], []
    for look in learned.rounds:
        found, told = _choices(drives, look)
        choices += found
        gains += told
    last = learned.rounds[-1]
    named = {name for choice in choices for name in choice.names}
    refused = [c for c in last.candidates if c.refused.startswith(UNTESTABLE) and c.score.effect.name not in named]
    untestable = [_untestable(drives, c) for c in refused] + _untried(learned)
    if not gains:
        gains = [_showing(drives, c) for c, u in zip(refused, untestable, strict=False) if u.plan is not None]
    return Advice(tuple(choices), tuple(untestable), tuple(_limits(last)), _most(drives, gains) if gains else None)


def _choices(drives: _Drives, look: Round) -> tuple[list[Choice], list[Callable[[Field | None], float]]]:
    """Return the choices that a look left open, and what a drive would tell of each that a drive can settle."""
    if not look.alternatives or look.added is None:
        return [], []
    kinds = registry()
    twins = [n for n in look.alternatives if kinds[n].twin_of in (look.added, *look.alternatives)]
    names = [n for n in look.alternatives if n not in twins]
    rivals = {c.score.effect.name: c for c in look.candidates}
    found, told = [], []
    for name in names:
        gain = _telling(drives, rivals[look.added], rivals[name])
        plan, nats = _best(drives, gain)
        if nats < _IDENTICAL_NATS:
            about = kinds[look.added].about
            found.append(Choice((look.added, name), "", None, nats, about.drive if about else ""))
            continue
        found.append(Choice((look.added, name), _reason(drives, gain, nats), plan, nats))
        told.append(gain)
    for twin in twins:
        about = kinds[twin].about
        first = str(kinds[twin].twin_of)
        found.append(Choice((first, twin), "", None, 0.0, about.drive if about else ""))
    return found, told


def _telling(drives: _Drives, one: Candidate, other: Candidate) -> Callable[[Field | None], float]:
    """Return what tells how many nats a drive adds to the choice between two, whichever of them is true."""
    a, b = (_as_fitted(c) for c in (one, other))
    beside = [e for e in drives.learned.fit.effects if e.name not in {a.name, b.name}]
    inflation = max(one.score.inflation, other.score.inflation)

    def nats(drive: Field | None) -> float:
        fields = [drives.recorded] if drive is None else [drives.recorded, drive]
        return min(separation(a, b, beside, fields), separation(b, a, beside, fields)) / inflation

    known = nats(None)
    return lambda drive: nats(drive) - known


def _as_fitted(candidate: Candidate) -> Effect:
    if candidate.fit is None:
        return candidate.score.effect
    name = candidate.score.effect.name
    return next(e for e in candidate.fit.effects if e.name == name)


def _best(drives: _Drives, gain: Callable[[Field | None], float]) -> tuple[Plan, float]:
    """Return the manoeuvre that tells most in a few minutes, made longer where that is not enough."""
    tried = [drives.planned(m.name, _SHORT_S) for m in MANOEUVRES]
    # a long drive must be worth its time
    worth = [gain(f) * min(1.0, 2.0 * _SHORT_S / plan.duration_s) for plan, f in tried]
    plan, drive = tried[int(np.argmax(worth))]
    nats = gain(drive)
    if nats < ENOUGH_NATS and plan.duration_s < _LONG_S:
        plan, drive = drives.planned(plan.manoeuvre.name, _LONG_S)
        nats = gain(drive)
    return plan, nats


def _most(drives: _Drives, gains: Sequence[Callable[[Field | None], float]]) -> Plan:
    """Return the plan that settles most questions: a second nat counts for less than the first of another."""

    def settled(drive: Field | None) -> float:
        return ENOUGH_NATS * float(np.mean([np.log1p(max(gain(drive), 0.0) / ENOUGH_NATS) for gain in gains]))

    return _best(drives, settled if len(gains) > 1 else gains[0])[0]


def _reason(drives: _Drives, gain: Callable[[Field | None], float], best_nats: float) -> str:
    """Return what the drives lacked that would have told, the most telling first; "" if nothing of that kind."""
    found = []
    for why, names in lacks_of(excitation(drives.learned.fit.problem.motions)):
        told = max(gain(drives.planned(name, _SHORT_S)[1]) for name in names)
        if told >= _TELLING * best_nats:
            found.append((told, why))
    return ", ".join(why for _, why in sorted(found, key=lambda pair: pair[0], reverse=True)[:2])


def _untestable(drives: _Drives, candidate: Candidate) -> Untestable:
    effect = candidate.score.effect
    gain = _showing(drives, candidate)
    plan, nats = _best(drives, gain)
    why = _reason(drives, gain, nats) or _short_of(candidate)
    if masks := _masks(drives, effect):
        why += f", and here it looks like {' and '.join(masks)}"
    if nats < 0.5 * SEEN**2:
        about = effect.about
        return Untestable(effect.name, why, None, about.drive if about else "")
    return Untestable(effect.name, why, plan)


def _showing(drives: _Drives, candidate: Candidate) -> Callable[[Field | None], float]:
    """Return what tells how many nats the typical size of an effect is worth after a drive."""
    effect = candidate.score.effect
    beside = _beside(drives, effect)
    typical = np.array([p.typical for p in amplitudes(effect)])

    def nats(drive: Field | None) -> float:
        fields = [drives.recorded] if drive is None else [drives.recorded, drive]
        return float(np.min(0.5 * (typical / sizes(effect, beside, fields)) ** 2))

    return nats


def _masks(drives: _Drives, effect: Effect) -> list[str]:
    """Return what is believed already and hides an effect: without it, the effect would be known far better."""
    beside = _beside(drives, effect)
    now = float(np.max(sizes(effect, beside, [drives.recorded])))
    found = []
    for e in beside:
        others = [o for o in beside if o is not e]
        if float(np.max(sizes(effect, others, [drives.recorded]))) * _HIDDEN < now:
            found.append(e.name)
    return found


def _beside(drives: _Drives, effect: Effect) -> list[Effect]:
    return [e for e in drives.learned.fit.effects if e.name != effect.name]


def _short_of(candidate: Candidate) -> str:
    """Return in which number the data fall short, where no motion is missing."""
    if not candidate.score.separable:
        return "it looks like other effects on this drive"
    own = amplitudes(candidate.score.effect)
    p, error = max(
        zip(own, candidate.score.standard_error, strict=True),
        key=lambda pair: pair[1] / max(pair[0].high, -pair[0].low),
    )
    unit = f" {p.unit}" if p.unit else ""
    return f"too little motion that shows it: {p.name} is known to {float(error):.2g}{unit} only"


def _untried(learned: Learned) -> list[Untestable]:
    """Return effects that never became candidates: single wheels without a track, places never visited twice."""
    have = {e.name for e in learned.fit.effects} | {c.score.effect.name for c in learned.rounds[-1].candidates}
    track = all(r.track_m is not None for r in learned.fit.problem.recordings)
    found = []
    for name, kind in registry().items():
        if name in have or kind.kind == "noise" or kind.clock or kind.twin_of is not None:
            continue
        hint = kind.about.drive if kind.about else ""
        if kind.needs_track and not track:
            found.append(Untestable(name, "the distance between the wheels is not known; give --track", None, hint))
        else:
            found.append(Untestable(name, "nothing on this drive to try it on", None, hint))
    return found


def _limits(look: Round) -> list[Limit]:
    found = []
    for candidate in look.candidates:
        score = candidate.score
        if score.separable and not candidate.refused.startswith(UNTESTABLE):
            sizes_of = zip(amplitudes(score.effect), score.standard_error, strict=True)
            found += [Limit(score.effect.name, p.name, SEEN * float(error), p.unit) for p, error in sizes_of]
    return found
