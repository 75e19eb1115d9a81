"""Experiment design as sentences, for the terminal and the report."""

from __future__ import annotations

from dataclasses import replace
from math import degrees
from typing import TYPE_CHECKING

from odomcorrupt.report.text.numbers import value_text

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from odomcorrupt.study.design.advise import Advice, Ambiguity, DetectionLimit, UntestableEffect
    from odomcorrupt.study.design.plan import Plan


def advice_text(advice: Advice, instead: Mapping[str, str] | None = None) -> str:
    """Return all advice, one sentence per line; "" if no alternatives are open.

    instead : as of `advice_sentences`
    """
    return "\n".join(advice_sentences(advice, instead))


def advice_sentences(advice: Advice, instead: Mapping[str, str] | None = None) -> list[str]:
    """Return a sentence for every ambiguity, and one per group of effects with the same reason and drive.

    instead : effects with evidence of their own, each with the effect that was selected in its place
    """
    groups: dict[tuple[str, str], list[UntestableEffect]] = {}
    for one in advice.untestable:
        chosen = (instead or {}).get(one.effect)
        own = replace(one, why=f"not separated from {chosen}" if chosen else f"not testable here: {one.why}")
        groups.setdefault((own.why, _drive_words(one.plan, one.hint)), []).append(own)
    return [*map(_choice_sentence, advice.choices), *map(_untestable_sentence, groups.values())]


def _choice_sentence(choice: Ambiguity) -> str:
    """Return "A or B: these data do not separate them; drive X"."""
    names = " or ".join(choice.names)
    if choice.plan is None:
        if choice.hint:
            return f"{names}: identical on every drive: {choice.hint}"
        return f"{names}: these data do not separate them, and no drive of ten minutes would"
    why = f" ({choice.why})" if choice.why else ""
    return (
        f"{names}: these data do not separate them{why}; drive {drive_sentence(choice.plan)}: "
        f"that is expected to separate them by {choice.nats:.0f} nats"
    )


def inseparable_sentence(advice: Advice, readings: Callable[[str], Sequence[str]]) -> str:
    """Return "These data cannot separate A from B and C, nor D from E: drive X", of all ambiguities; "" without any.

    readings : aliases of a name, which no drive separates and which are therefore not reported as open
    """
    against: dict[str, list[str]] = {}
    for choice in advice.choices:
        name, *others = choice.names
        rivals = [other for other in others if other not in readings(name)]
        if rivals:
            against.setdefault(name, []).extend(rivals)
    if not against:
        return ""
    pairs = [f"{name} from {' or '.join(dict.fromkeys(others))}" for name, others in against.items()]
    resolvable = any(choice.plan is not None for choice in advice.choices if choice.names[0] in against)
    words = "; no drive of ten minutes would"
    if resolvable and advice.best is not None:  # the drive that resolves most ambiguities
        minutes = advice.best.duration_s / 60.0
        words = f": drive {advice.best.manoeuvre.sentence}, for {minutes:.0f} minutes"
    return f"These data cannot separate {', nor '.join(pairs)}{words}"


def _untestable_sentence(group: Sequence[UntestableEffect]) -> str:
    """Return "A, B: not testable here: never reversed; drive X" of effects with the same reason and drive."""
    names = ", ".join(one.effect for one in group)
    words = _drive_words(group[0].plan, group[0].hint)
    return f"{names}: {group[0].why}" + (f"; {words}" if words else "")


def _drive_words(plan: Plan | None, hint: str) -> str:
    """Return "drive X", or the effect's own hint if no plan excites it."""
    return f"drive {drive_sentence(plan)}" if plan is not None else hint


def drive_sentence(plan: Plan) -> str:
    """Return a drive's manoeuvre, duration, speed and floor area."""
    length, width = plan.floor_m
    moving = f"up to {plan.fastest_mps:.1f} m/s on {length + 1.0:.0f} m x {width + 1.0:.0f} m"
    if plan.fastest_mps == 0.0:
        moving = f"up to {degrees(plan.quickest_radps):.0f} deg/s"
    return f"{plan.manoeuvre.sentence}, for {plan.duration_s / 60.0:.0f} minutes ({moving})"


def limits_sentence(limits: Sequence[DetectionLimit]) -> str:
    """Return the smallest detectable sizes in common units; "" if there are none."""
    if not limits:
        return ""
    every = [limit.effect for limit in limits]
    names = [one.effect if every.count(one.effect) == 1 else f"{one.effect} {one.parameter}" for one in limits]
    sizes = ", ".join(f"{name} {limit_size(limit)}" for name, limit in zip(names, limits, strict=True))
    return f"smallest detectable sizes: {sizes}"


def limit_size(limit: DetectionLimit) -> str:
    """Return a size with two figures in a common unit."""
    number, _, unit = value_text(limit.size, None, limit.unit).partition(" ")
    return f"{float(f'{float(number):.2g}'):g} {unit}".strip()
