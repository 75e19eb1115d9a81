"""What a search found, as plain text: effects, noise, what is unknown, and what would have been seen."""

from __future__ import annotations

from typing import TYPE_CHECKING

from odomcorrupt.effects.effect import parameters
from odomcorrupt.report.advice import advice_text, limits_sentence
from odomcorrupt.report.tables import ladder_text, value_text

if TYPE_CHECKING:
    from odomcorrupt.study.advice.advise import Advice
    from odomcorrupt.study.search.learn import Learned
    from odomcorrupt.study.search.unknown import Unknown

__all__ = ["NOTHING", "found_text"]

NOTHING = "nothing is missing: no known effect would explain more than chance does"


def found_text(learned: Learned, advice: Advice) -> str:
    """Return the findings in the order of their weight, what is open, and the sizes that would have been seen."""
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
        lines = [NOTHING]
    lines += [text for text in (advice_text(advice), limits_sentence(advice.limits)) if text]
    return "\n".join(lines)


def _unknown_lines(unknown: Unknown) -> list[str]:
    driver = unknown.driver.replace("_", " ")
    finding = f"unknown: the {unknown.channel} error depends on {driver} ({unknown.nats:.0f} nats)"
    return [f"{finding}, and no known effect explains it", f"  to try: {unknown.expression}"]
