"""Section of the page about advice, as lines of Markdown from rows of results."""

from __future__ import annotations

from typing import Any

import numpy as np

from laboratory.advice.verdicts import cause_of, clear, named, named_first, open_names, said_unseen, settled
from laboratory.tables import part, table

__all__ = ["advice_section"]

Rows = list[dict[str, Any]]
GOAL = "90 %"


def advice_section(rows: Rows) -> list[str]:
    """Return the whole section; empty if the arm has not run."""
    if not rows:
        return []
    good = [row for row in rows if "failed" not in row]
    of_kind = {kind: [row for row in good if row["case"]["kind"] == kind] for kind in ("open", "unseen")}
    asked = [row for row in good if open_names(row)]
    lines = ["## Following the advice", "", f"{len(rows)} robots, {len(rows) - len(good)} failed.", ""]
    lines += ["A or B, on first drives that do not separate two effects:", "", *_opened(of_kind["open"])]
    lines += ["After the drive that was advised, where a choice was open:", "", *_settled(asked)]
    lines += ["Nothing named although there is a cause, and a drive advised:", "", *_shown(good)]
    lines += ["By first drive:", "", *_by_first_drive(good)]
    lines += ["Not settled, or not shown, after one advised drive:", "", *_misses(good)]
    lines += ["Wrong, and named alone by a first drive that does not separate it:", "", *_silent(of_kind["open"])]
    seconds = [step["advise_s"] for row in good for step in row["looks"]]
    return [
        *lines,
        f"CPU seconds of the advice: median {np.median(seconds):.1f}, largest {max(seconds):.1f}.",
        "",
    ]


def _opened(rows: Rows) -> list[str]:
    asked = [row for row in rows if open_names(row)]
    quiet = [row for row in rows if not open_names(row)]
    return table(("quantity", "result"), [
        ["a choice was reported as open", part([bool(open_names(row)) for row in rows])],
        ["the cause was one of its names", part([cause_of(row) in open_names(row) for row in asked])],
        ["a drive was advised for it", part([_advised(row) for row in asked])],
        ["no choice was open: the cause was named first", part([named_first(row, 0) for row in quiet])],
        ["no choice was open: nothing was named", part([not named(row, 0) for row in quiet])],
        ["no choice was open: another was named first",
         part([bool(named(row, 0)) and not named_first(row, 0) for row in quiet])],
    ])  # fmt: skip


def _settled(rows: Rows) -> list[str]:
    there = [row for row in rows if len(row["looks"]) > 1]

    def of(name: str, value: str) -> str:
        return part([settled(row, 1) for row in there if row["case"][name] == value])

    return table(("quantity", "result"), [
        ["**settled**: the cause first, no name of the choice beside it", part([settled(r, 1) for r in there], GOAL)],
        ["the same, where the cause was one of the names",
         part([settled(r, 1) for r in there if cause_of(r) in open_names(r)])],
        *([f"settled, {size}", of("size", size)] for size in ("strong", "medium")),
        *([f"settled, {kind}", of("drive_type", kind)] for kind in ("differential", "skid")),
        ["the cause and nothing else, no alternative", part([clear(r, 1) for r in there])],
        ["settled after advice was followed once more", part([settled(r, -1) or settled(r, 1) for r in there])],
    ])  # fmt: skip


def _shown(rows: Rows) -> list[str]:
    silent = [row for row in rows if not named(row, 0) and not open_names(row)]
    there = [row for row in silent if _advised(row)]
    return table(("quantity", "result"), [
        ["a drive was advised", part([_advised(row) for row in silent])],
        ["the cause was among what was not testable", part([said_unseen(row) for row in silent])],
        ["**found**: the cause named first after the drive", part([settled(row, 1) for row in there])],
        ["the same, where it was said to be not testable",
         part([settled(row, 1) for row in there if said_unseen(row)])],
        ["the cause and nothing else, no alternative", part([clear(row, 1) for row in there])],
        ["found after advice was followed once more", part([settled(r, -1) or settled(r, 1) for r in there])],
    ])  # fmt: skip


def _by_first_drive(rows: Rows) -> list[str]:
    groups: dict[str, Rows] = {}
    for row in rows:
        groups.setdefault(row["case"]["first"], []).append(row)
    out = []
    for first, own in groups.items():
        causes = {row["case"]["cause"] for row in own}
        followed = [settled(row, 1) for row in own if len(row["looks"]) > 1]
        asked, silent = sum(bool(open_names(row)) for row in own), sum(not named(row, 0) for row in own)
        out.append([first, len(own), len(causes), asked, silent, f"{sum(followed)} of {len(followed)}"])
    return table(("first drive", "robots", "causes", "choice open", "nothing named", "settled after one drive"), out)


def _misses(rows: Rows) -> list[str]:
    there = [row for row in rows if (open_names(row) or not named(row, 0)) and not (_advised(row) and settled(row, 1))]
    return [*(_line(row) for row in there), *([] if there else ["None."]), ""]


def _silent(rows: Rows) -> list[str]:
    there = [row for row in rows if not open_names(row) and named(row, 0) and not named_first(row, 0)]
    return [*(_line(row) for row in there), *([] if there else ["None."]), ""]


def _line(row: dict[str, Any]) -> str:
    case = row["case"]
    size = " ".join(f"{k}={v:.3g}" if not isinstance(v, str) else v for k, v in row["truth"][case["cause"]].items())
    said = [f"{key}: {case['first']}, `{case['cause']}` {size}" for key in (row["key"],)]
    said += [case["size"], case["yaw_from"], case["drive_type"]]
    words = [_step(step) for step in row["looks"]]
    return f"- {', '.join(said)}; first {'; then '.join(words)}"


def _step(step: dict[str, Any]) -> str:
    answer = step["answer"]
    beside = {one["added"]: one["alternatives"] for one in answer["looks"] if one["added"] is not None}
    words = [f"{name} ({' or '.join(beside[name])})" if beside.get(name) else name
             for name in (*answer["clocks"], *answer["added"])]  # fmt: skip
    words += [f"noise {name}" for name, _ in answer["noise"]]
    words += [f"unknown: {u[1]} over {u[0]}" for u in answer["unknown"][:1]]
    drive = step["best"]["drive"] if step["best"] else "nothing"
    return f"{', '.join(words) or 'nothing'}, advised {drive}"


def _advised(row: dict[str, Any]) -> bool:
    return row["looks"][0]["best"] is not None
