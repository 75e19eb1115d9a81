"""The tables of the laser arm, from its results."""

from __future__ import annotations

from typing import Any

import numpy as np
from laboratory.verdicts import extras, is_separable, names, right

__all__ = ["tables"]

_SURE = 0.9
_CLOCKS = ("time_offset", "clock_skew")


def tables(rows: list[dict[str, Any]]) -> str:
    """Return all tables in Markdown, with misses listed by name."""
    broken = [r["key"] for r in rows if "failed" in r]
    refused = [r for r in rows if "refused" in r]
    rows = [r for r in rows if "failed" not in r and "refused" not in r]
    lines = [f"{len(rows)} drives; {len(broken)} broke: {', '.join(broken) or 'none'}", ""]
    lines += ["| measured | by the laser | by motion capture | goal |", "|---|---|---|---|"]
    controls, single = (_arm(rows, arm) for arm in ("controls", "single"))
    good, before = [r for r in single if is_separable(r)], [r for r in single if _is_separable_by_mocap(r)]
    lines.append(_row("controls with anything named", _share([bool(_robots(r, "answer")) for r in controls]),
                      _share([bool(_robots(r, "mocap")) for r in controls]), "at most 2 %"))  # fmt: skip
    lines.append(_row("first name right, excited", *(_share([_first(r, who) for r in good]) for who in _WHO), "95 %"))
    lines.append(
        _row("the same, excited with motion capture", *(_share([_first(r, who) for r in before]) for who in _WHO), "")
    )
    lines.append(_row("extras a drive", *(f"{np.mean([len(_extras(r, w)) for r in good]):.2f}" for w in _WHO), ""))
    covered = [c for r in good for e in r["errors"].values() if e for c in e["covered"]]
    theirs = [c for r in good for e in r["mocap_errors"].values() if e for c in e["covered"]]
    lines.append(_row("parameters within their 95 % interval", _share(covered), _share(theirs), "90 to 98 %"))
    ratio = "held-out 10 s error over motion capture's: median, 90th percentile"
    for key, words in (("laser", ratio), ("exact_scale", "the same, the laser's drawn scale error divided out")):
        lines.append(_row(words, _ratios(good, key), "1", "1.02, 1.10"))
        lines.append(_row("of drives excited with motion capture", _ratios(before, key), "1", ""))
    sure = [_wrong_and_sure(r) for r in [*controls, *single]]
    lines.append(_row("confidently wrong (0.9)", _share(sure), "", "at most 1 %"))
    corridor = _arm(rows, "corridor")
    false = [[n for n in _robots(r, "answer") if not right(n, r)] for r in corridor]
    turned_down = [r["case"]["arm"] == "corridor" and "not testable" in r["refused"] for r in refused]
    lines.append(_row("refused, of these corridors with what is not testable", _share(turned_down), "", ""))
    lines.append(_row("corridor: anything false", _share([bool(f) for f in false]), "", "none"))
    blind = [r for r in corridor if r["case"]["causes"] and r["case"]["causes"][0] in ("wheel_scale", "speed_scale")]
    said = [r["case"]["causes"][0] in r["untestable"] for r in blind]
    lines.append(_row("corridor: scale reported as not testable", _share(said), "", "where it is"))
    lines += ["", "Misses:", ""]
    for row in [*controls, *single, *corridor]:
        wanted = "+".join(row["case"]["causes"]) or "nothing"
        found = ", ".join(_robots(row, "answer")) or "nothing"
        fine = set(_robots(row, "answer")) == set(row["case"]["causes"])
        if not fine:
            mark = "" if row not in single or is_separable(row) else " (not excited)"
            other = ", ".join(_robots(row, "mocap")) or "nothing"
            lines.append(f"- {row['key']} ({row['world']}, {row['case']['route']}): {wanted}{mark}: {found}; by motion "
                         f"capture {other}")  # fmt: skip
    accuracy = np.array([r["accuracy"]["rms"] + r["accuracy"]["robust"] for r in [*controls, *single]])
    if len(accuracy):
        middle = np.median(accuracy, axis=0)
        took_s = np.median([r["matching_s"] for r in rows])
        lines += [
            "",
            f"Motion over 1 s by the laser, median drive: RMS {_three(middle[:3])}; robust {_three(middle[3:])}.",
        ]
        lines.append(f"Matching took {took_s:.1f} CPU s of 300 s.")
    return "\n".join(lines)


_WHO = ("answer", "mocap")


def _ratios(rows: list[dict[str, Any]], key: str) -> str:
    """Return median and 90th percentile of an error over motion capture's; "-" in runs that did not measure it."""
    ratio = [r["error"][key] / r["error"]["mocap"] for r in rows if key in r["error"]]
    return f"{np.median(ratio):.3f}, {np.percentile(ratio, 90):.3f}" if ratio else "-"


def _is_separable_by_mocap(row: dict[str, Any]) -> bool:
    """Return whether motion capture would excite and separate the cause, as runs one to six counted drives."""
    return is_separable({**row, "expected": row.get("expected_by_mocap", row["expected"])})


def _arm(rows: list[dict[str, Any]], arm: str) -> list[dict[str, Any]]:
    return [r for r in rows if r["case"]["arm"] == arm]


def _robots(row: dict[str, Any], who: str) -> list[str]:
    """Return the names found for the robot, without clocks: the laser has a clock error itself."""
    noise = [name for name, _ in row[who]["noise"]]
    return [n for n in names({"answer": row[who]}) if n not in _CLOCKS] + noise


def _first(row: dict[str, Any], who: str) -> bool:
    found = [n for n in names({"answer": row[who]}) if n not in _CLOCKS]
    return bool(found) and right(found[0], row)


def _extras(row: dict[str, Any], who: str) -> list[str]:
    return [n for n in extras({"answer": row[who], "case": row["case"]}) if n not in _CLOCKS]


def _wrong_and_sure(row: dict[str, Any]) -> bool:
    """Return whether the final model has a wrong name of high confidence; steps that were taken back do not count."""
    return any(
        step["added"] in row["answer"]["added"] and not right(step["added"], row) and step["confidence"] >= _SURE
        for step in row["answer"]["looks"]
    )


def _three(values: np.ndarray) -> str:
    return f"{values[0]:.1f}, {values[1]:.1f} mm, {values[2]:.3f} deg"


def _share(flags: list[bool]) -> str:
    return f"{sum(flags)} of {len(flags)}" if flags else "-"


def _row(*cells: str) -> str:
    return "| " + " | ".join(cells) + " |"
