"""What a search found, as plain text: effects, noise, what is unknown, and what would have been seen."""

from __future__ import annotations

from typing import TYPE_CHECKING

from odomcorrupt.effects.effect import amplitudes, parameters
from odomcorrupt.report.tables import ladder_text, value_text

if TYPE_CHECKING:
    from odomcorrupt.study.search.learn import Learned
    from odomcorrupt.study.search.unknown import Unknown

__all__ = ["found_text"]

_SEEN = 4.2
"""An effect this many standard errors large is found nearly always."""


def found_text(learned: Learned) -> str:
    """Return the findings in the order of their weight; a sentence with sizes where nothing is missing."""
    lines = []
    if learned.added:
        lines += ["missing, in the order of evidence, each on top of the ones before:", ladder_text(learned)]
    for gain in learned.noise:
        values = ", ".join(
            f"{p.name} {value_text(getattr(gain.effect, p.name), None, p.unit)}" for p in parameters(gain.effect)
        )
        channel = f" ({gain.effect.channel})" if hasattr(gain.effect, "channel") else ""
        lines.append(f"noise: {gain.effect.name}{channel}, {values}: {gain.effect.summary}")
    for unknown in learned.unknown[:3]:
        lines += _unknown_lines(unknown)
    if not lines:
        lines = ["nothing is missing: no known effect would explain more than chance does", *_limits(learned)]
    return "\n".join(lines)


def _unknown_lines(unknown: Unknown) -> list[str]:
    driver = unknown.driver.replace("_", " ")
    finding = f"unknown: the {unknown.channel} error depends on {driver} ({unknown.nats:.0f} nats)"
    return [f"{finding}, and no known effect explains it", f"  to try: {unknown.expression}"]


def _limits(learned: Learned) -> list[str]:
    seen = []
    for candidate in learned.rounds[-1].candidates:
        score = candidate.score
        if not score.separable or candidate.refused == "not testable on this drive":
            continue
        sizes = zip(amplitudes(score.effect), score.standard_error, strict=True)
        seen += [f"{score.effect.name} {value_text(_SEEN * float(error), None, p.unit)}" for p, error in sizes]
    return [f"these sizes would have been seen: {', '.join(seen)}"] if seen else []
