"""Advice on the next drive: aliased names, untestable effects, and the drive that resolves them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from odomcorrupt.study.design.ambiguities import (
    Ambiguity,
    clock_ambiguities,
    dependence_ambiguities,
    open_ambiguities,
    undetermined_clocks,
)
from odomcorrupt.study.design.drives import Drives, most_useful
from odomcorrupt.study.design.identifiability import (
    DetectionLimit,
    UntestableEffect,
    is_untestable,
    limits,
    untestable,
    untried,
)

if TYPE_CHECKING:
    from odomcorrupt.study.design.plan import Plan
    from odomcorrupt.study.select.result import Learned

__all__ = ["Advice", "Ambiguity", "DetectionLimit", "UntestableEffect", "advise"]


@dataclass(frozen=True, slots=True)
class Advice:
    """Open questions after a selection; `best` is the plan that answers most of them, ambiguities first."""

    choices: tuple[Ambiguity, ...]
    untestable: tuple[UntestableEffect, ...]
    limits: tuple[DetectionLimit, ...]
    best: Plan | None


def advise(learned: Learned) -> Advice:
    """Return the questions that these data leave open, and the drives that would answer them."""
    drives = Drives(learned)
    choices = dependence_ambiguities(drives)
    for step in learned.steps:
        choices += [*open_ambiguities(drives, step), *clock_ambiguities(drives, step)]
    last = learned.rounds[-1]
    named = {name for choice in choices for name in choice.names}
    refused = [c for c in last.candidates if is_untestable(c) and c.score.effect.name not in named]
    hidden = [untestable(drives, c) for c in refused]
    hidden += [one for one in undetermined_clocks(drives) if one.effect not in named]
    gains = [choice.gain for choice in choices if choice.gain is not None]
    shown = [one.shows for one in hidden if one.shows is not None]
    hidden += untried(learned)
    best = most_useful(drives, gains, shown) if gains or shown else None
    return Advice(tuple(choices), tuple(hidden), tuple(limits(last)), best)
