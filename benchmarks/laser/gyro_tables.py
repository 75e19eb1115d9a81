"""The tables of wheels and a gyro alone, from the results."""

from __future__ import annotations

from typing import Any

from laboratory.verdicts import right

from laser.cases import TRAVEL

__all__ = ["gyro_tables"]

EXCITED = 4.0


def gyro_tables(rows: list[dict[str, Any]]) -> str:
    """Return the table of the gyro arm in Markdown, with misses listed by name."""
    broken = [r["key"] for r in rows if "failed" in r]
    refused = [r["key"] for r in rows if "refused" in r]
    rows = [r for r in rows if "failed" not in r and "refused" not in r]
    controls = [r for r in rows if not r["case"]["causes"]]
    travel = [r for r in rows if set(r["case"]["causes"]) & set(TRAVEL)]
    turning = [r for r in rows if r["case"]["causes"] and r not in travel]
    excited = [r for r in turning if r["deviations"] > EXCITED]
    named = [(one, r) for r in rows for one in r["found"] if one["kind"] == "effect"]
    lines = [
        f"{len(rows)} drives with wheels and a gyro alone",
        f"broke: {', '.join(broken) or 'none'}; refused: {', '.join(refused) or 'none'}",
        "",
        "| measured | result | goal |",
        "|---|---|---|",
        _row("controls with anything named", [bool(_names(r) or r["unknown"]) for r in controls], "at most 2 %"),
    ]
    for least in (0.5, 0.9):
        some = [(one["effect"], r) for one, r in named if one["confidence"] >= least]
        lines.append(_row(f"names of confidence {least} or more that are right", [right(*s) for s in some], "95 %"))
        gains = [right(*s) or _is_gain(*s) for s in some]
        lines.append(_row("the same, a gain of turns of larger wheels counted as right", gains, ""))
    lines.append(_row("causes of turning that are excited and named", [_is_named(r) for r in excited], ""))
    for cause in dict.fromkeys(r["case"]["causes"][0] for r in excited):
        own = [_is_named(r) for r in excited if r["case"]["causes"][0] == cause]
        lines.append(_row(f"of these {cause}", own, ""))
    said = [set(r["case"]["causes"]) <= set(r["untestable"]) for r in travel]
    lines.append(_row("causes of travel reported as not testable", said, "all"))
    lines.append(_row("causes of travel with anything named", [bool(_names(r)) for r in travel], "none"))
    lines += ["", "Misses:", ""]
    for row in rows:
        wrong = [name for name in _names(row) if not right(name, row)]
        missed = row in excited and not _is_named(row)
        false = not row["case"]["causes"] and row["unknown"]
        if wrong or missed or false or (row in travel and not set(row["case"]["causes"]) <= set(row["untestable"])):
            lines.append(_miss(row))
    return "\n".join(lines)


def _names(row: dict[str, Any]) -> list[str]:
    """Return what is named as an effect or noise of the robot, without clocks."""
    return [one["effect"] for one in row["found"] if one["kind"] != "setup"]


def _is_named(row: dict[str, Any]) -> bool:
    return any(right(name, row) for name in _names(row))


def _is_gain(name: str, row: dict[str, Any]) -> bool:
    """Return whether a name states the gain of turns that larger wheels have as well."""
    return name in ("wheelbase", "gyro_scale") and "wheel_scale" in row["case"]["causes"]


def _miss(row: dict[str, Any]) -> str:
    case = row["case"]
    wanted = f"{case['size']} {case['causes'][0]}" if case["causes"] else "nothing"
    if case["causes"]:
        wanted += f" {row['truth'][case['causes'][0]]}, {row['deviations']:.1f} standard deviations"
    found = [
        f"{one['effect']} {', '.join(_value(p, v) for p, v in one['parameters'].items())} (confidence "
        f"{one['confidence'] if one['confidence'] is None else round(one['confidence'], 2)})"
        for one in row["found"]
        if one["kind"] != "setup"
    ]
    return f"- {row['key']} ({case['route']}, gain of the gyro {row['gyro']['gain']:+.4f}): {wanted}: " + (
        "; ".join([*found, *(f"depends on {', '.join(map(str, one))}" for one in row["unknown"])]) or "nothing"
    )


def _value(name: str, number: dict[str, Any]) -> str:
    error = number["standard_error"]
    return f"{name} {number['value']:.4g}" + (f" +- {error:.2g}" if error is not None else "")


def _row(words: str, flags: list[bool], goal: str) -> str:
    share = f" ({100.0 * sum(flags) / len(flags):.0f} %)" if flags else ""
    return f"| {words} | {sum(flags)} of {len(flags)}{share} | {goal} |"
