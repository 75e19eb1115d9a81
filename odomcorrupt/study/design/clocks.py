"""Undetermined clocks, effects that a clock offset would explain as well, and drives that would separate them.

Clocks are estimated first, together with effects that resemble them, and are therefore no candidates. This module
computes the information of a drive on a clock in the same terms. A clock belongs to one drive; the next has another.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from odomcorrupt.effects import registry
from odomcorrupt.effects.effect import amplitudes
from odomcorrupt.study.design.ambiguities import TOO_FEW_NATS, Ambiguity
from odomcorrupt.study.design.drives import best_plan, missing_motion
from odomcorrupt.study.design.identifiability import FOUND, MASKED, UntestableEffect
from odomcorrupt.study.design.information import clock_errors, separation
from odomcorrupt.study.estimate.clocks import RIVALS

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.study.design.drives import Drives, Gain
    from odomcorrupt.study.design.information import Field
    from odomcorrupt.study.select.stepwise import Step

__all__ = ["CLOCKS", "UntestableClock", "clock_ambiguities", "undetermined_clocks"]

CLOCKS = ("time_offset", "clock_skew")
"""In the order of a clock's parameters."""


class UntestableClock(NamedTuple):
    """A clock parameter that was not tested, and a drive's expected information on it."""

    untestable: UntestableEffect
    shows: Gain


def undetermined_clocks(drives: Drives) -> list[UntestableClock]:
    """Return the clock parameters that no recording would determine if they had their typical size."""
    beside = _beside_clocks(drives)
    found = []
    for number, name in enumerate(CLOCKS):
        kind = registry()[name]
        typical = amplitudes(kind)[0].typical
        now = float(clock_errors(beside, drives.with_clocks)[number])
        if FOUND * now <= typical or any(free[number] for free in drives.learned.clocks.free):
            continue

        def shows(drive: Field, number: int = number, typical: float = typical) -> float:
            return 0.5 * (typical / float(clock_errors(beside, drive, drives.recorded)[number])) ** 2

        masks = [
            e.name
            for e in beside
            if MASKED * float(clock_errors([o for o in beside if o is not e], drives.with_clocks)[number]) < now
        ]
        plan, nats = best_plan(drives, shows)
        why = missing_motion(drives, shows, nats) or "too little motion that shows it"
        why += f", and here it looks like {' and '.join(masks)}" if masks else ""
        about = kind.about
        seen = nats >= 0.5 * FOUND**2
        untestable = UntestableEffect(name, why, plan if seen else None, "" if seen or about is None else about.drive)
        found.append(UntestableClock(untestable, shows))
    return found


def clock_ambiguities(drives: Drives, step: Step) -> tuple[list[Ambiguity], list[Gain]]:
    """Return the ambiguity between the included effect and a constant clock offset, if these data leave it open."""
    if step.added not in RIVALS or any(free[0] for free in drives.learned.clocks.free):
        return [], []
    own = next((e for e in drives.learned.fit.effects if e.name == step.added), None)
    if own is None:
        return [], []
    beside = [e for e in drives.learned.fit.effects if e is not own]
    inflation = step.candidates[0].score.inflation
    known = separation(own, None, beside, [drives.with_clocks]) / inflation
    if known >= drives.learned.decisions.alternative_nats:
        return [], []

    def separation_gain(drive: Field) -> float:
        return separation(own, None, beside, [drives.with_clocks, drive]) / inflation - known

    names = (step.added, CLOCKS[0])
    plan, nats = best_plan(drives, separation_gain)
    if nats < TOO_FEW_NATS:
        return [Ambiguity(names, "", None, nats)], []
    return [Ambiguity(names, missing_motion(drives, separation_gain, nats), plan, nats)], [separation_gain]


def _beside_clocks(drives: Drives) -> Sequence[Effect]:
    """Return the terms that are free beside a clock: included ones, and those that resemble a clock."""
    own = drives.learned.fit.effects
    track = all(r.track_m is not None for r in drives.learned.fit.problem.recordings)
    kinds = [registry()[name] for name in RIVALS if track or not registry()[name].needs_track]
    return [*own, *(kind() for kind in kinds if kind.name not in {e.name for e in own})]
