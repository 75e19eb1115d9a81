"""Page of results: goals, a table by situation, calibration, and every miss with its planted cause."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from laboratory.tables import part, table

from ordinary import verdicts as v
from ordinary.cases import LENGTHS, SITUATIONS
from ordinary.causes import CAUSES

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["page"]

FINDINGS = Path(__file__).parent / "findings.md"
Rows = list[dict[str, Any]]
Lines = list[str]
HEAD = """\
# Benchmark of ordinary recordings

How far to trust `learn` on recordings as users have them: a truth of AMCL, SLAM or RTK, odometry from a filter, cars,
hobby robots, bad clocks, single events, monotonous drives, skids. The recordings are simulated, so the hidden cause
is known; two drives in five have none (controls). Every command of a user is run: `learn`, then `correct` and
`compare` on another drive of the same robot, corruption, and `batch`.

- **Error**: 10 s error on the other drive; *before* any correction, *after* `correct`, and its *floor*: that of the
  same drive without the fault, uncorrected. After a filter's lag has been removed too, an error is below its floor
  (`ekf`).
- **Excited**: the drive contains what shows the cause, decided before any run by the generator alone.
- **Right**: the first effect that is identified (its name) is the cause, or equals it. **Confidently wrong**: a drive
  with a wrong effect of confidence 0.9 or more. **Harm**: the error after `correct` is more than 3 % above that before.

`benchmarks/ordinary/protocol.md` has the details; `python benchmarks/ordinary.py page` writes this page.
"""
BINS = (0.0, 0.5, 0.7, 0.8, 0.9, 0.95, 0.98, 1.0001)


def page(rows: Rows) -> str:
    """Return the page in Markdown."""
    order = list(SITUATIONS)
    rows = sorted(rows, key=lambda row: (order.index(row["case"]["situation"]), row["case"]["number"]))
    lines = [
        *HEAD.splitlines(),
        "",
        "## Findings",
        "",
        FINDINGS.read_text(encoding="utf8"),
        "## Goals",
        "",
        *_goals(rows),
        "## By situation",
        "",
        *_situations(rows),
        "## Calibration of the confidence",
        "",
        *_calibration(rows),
    ]
    sections: dict[str, Callable[[dict[str, Any]], str]] = {
        "Confidently wrong": lambda row: ", ".join(v.wrong_and_sure(row)),
        "False alarms": lambda row: ", ".join(v.false_alarms(row)),
        "Models or commands that failed": lambda row: "; ".join(v.refusals(row)),
        "Worse than no model": lambda row: _error(row) if v.harmed(row) else "",
        "Excited and not right": _miss,
    }
    listed = {title: _list(rows, what) for title, what in sections.items()}
    for title, own in listed.items():
        lines += [f"## {title}", "", *own, ""] if own else []
    empty = [title[0].lower() + title[1:] for title, own in listed.items() if not own]
    lines += [f"There are no drives of these kinds: {'; '.join(empty)}.", ""] if empty else []
    if any(listed.values()):
        lines += [f"A drive is repeated by its key: `{v.reproduce(rows[0])}`."]
    return "\n".join(lines) + "\n"


def _causes(rows: Rows) -> Rows:
    return [row for row in rows if not v.is_control(row) and v.is_excited(row)]


def _judged(rows: Rows, over: str = "floor_m") -> list[float]:
    """Return ratios of the error after correction to the floor, for excited causes that are not events."""
    own = [v.ratio(row, over) for row in _causes(rows) if not CAUSES[row["case"]["cause"]].event]
    return [one for one in own if one is not None]


def _right(rows: Rows, low: float, high: float) -> list[bool]:
    """Return whether each name with a confidence in [low, high) is right; names equal to the cause do not count."""
    named = [(row, *named) for row in rows for named in v.names(row)]
    own = [v.grade(name, row) for row, name, confidence in named if low <= (confidence or 0.0) < high]
    return [grade != "wrong" for grade in own if grade != "equal"]


def _spread(ratios: list[float]) -> str:
    return f"{np.median(ratios):.2f} / {np.quantile(ratios, 0.9):.2f}" if ratios else ""


def _goals(rows: Rows) -> Lines:
    controls = [row for row in rows if v.is_control(row)]
    excited = _causes(rows)
    named = [row for row in excited if not CAUSES[row["case"]["cause"]].event]
    events = [row for row in excited if CAUSES[row["case"]["cause"]].event]
    used = [row for row in rows if row.get("after_m") is not None]
    return table(
        ("quantity", "found", "goal"),
        [
            ["drives", len(rows), f"at least 300 (of {sum(LENGTHS.values())} planned)"],
            ["false alarms", part([bool(v.false_alarms(row)) for row in controls]), "at most 2 %"],
            ["right name or regressor first, excited", part([v.right(row) for row in named]), "at least 90 %"],
            ["event found, excited", part([v.right(row) for row in events]), "at least 90 %"],
            ["confidently wrong, drives", part([bool(v.wrong_and_sure(row)) for row in rows]), "at most 1 %"],
            ["held-out error after over floor, excited, median / p90", _spread(_judged(rows)), "1.05 / 1.5"],
            ["the same over what is attainable", _spread(_judged(rows, "attainable_m")), ""],
            ["above the error without a model by more than 3 %", part([v.harmed(row) for row in used]), "none"],
            ["a command failed or refused the model", part([bool(v.refusals(row)) for row in rows]), "none"],
            ["names of confidence 0.85 to 0.95 that are right", part(_right(rows, 0.85, 0.95)), "85 to 95 %"],
            ["names of confidence 0.9 or more that are right", part(_right(rows, v.SURE, 1.01)), ""],
        ],
    )


def _situations(rows: Rows) -> Lines:
    out = []
    for situation in SITUATIONS:
        own = [row for row in rows if row["case"]["situation"] == situation]
        if not own:
            continue
        controls, excited = [row for row in own if v.is_control(row)], _causes(own)
        out.append([
            situation, len(own), f"{sum(bool(v.false_alarms(row)) for row in controls)} of {len(controls)}",
            f"{sum(v.right(row) for row in excited)} of {len(excited)}",
            sum(bool(v.wrong_and_sure(row)) for row in own),
            _spread(_judged(own)), sum(v.harmed(row) for row in own), sum(bool(v.refusals(row)) for row in own),
        ])  # fmt: skip
    head = (
        "situation", "drives", "false alarms", "right first (excited)", "confidently wrong",
        "after / floor, median / p90", "harm", "failed",
    )  # fmt: skip
    return table(head, out)


def _calibration(rows: Rows) -> Lines:
    named = [
        (confidence, v.grade(name, row) != "wrong") for row in rows for name, confidence in v.names(row)
        if confidence is not None and v.grade(name, row) != "equal"
    ]  # fmt: skip
    out = []
    for low, high in pairwise(BINS):
        own = [(c, hit) for c, hit in named if low <= c < high]
        if own:
            mean = float(np.mean([c for c, _ in own]))
            out.append([f"{low:g} to {min(high, 1.0):g}", f"{mean:.3f}", part([hit for _, hit in own])])
    return table(("confidence", "mean", "right"), out)


def _list(rows: Rows, what: Callable[[dict[str, Any]], str]) -> Lines:
    lines = []
    for row in rows:
        said = what(row)
        if said:
            lines += [f"- **{row['key']}** {_planted(row)}: {said}."]
    return lines


def _planted(row: dict[str, Any]) -> str:
    how = SITUATIONS[row["case"]["situation"]][row["case"]["setting"]]
    where = f"({how.platform}, {how.truth}, heading {how.rig.heading}, {how.route.kind})"
    if not row.get("flaw"):
        return f"{where} nothing planted"
    name, sizes = row["flaw"]
    shown = " ".join(f"{key}={value:.3g}" for key, value in sizes.items())
    return f"{where} planted `{name}` {shown}{'' if v.is_excited(row) else ', not excited'}"


def _miss(row: dict[str, Any]) -> str:
    if v.is_control(row) or not v.is_excited(row) or v.right(row):
        return ""
    kind = v.grade(v.first(row), row) if not v.first(row).startswith(("unknown", "nothing", "no answer")) else ""
    return f"{v.first(row)} first{' (equal here)' if kind == 'equal' else ''}; all: {_said(row)}; {_error(row)}"


def _said(row: dict[str, Any]) -> str:
    shown = [name if confidence is None else f"{name} {confidence:.2f}" for name, confidence in v.names(row)]
    shown += [f"unknown {u['channel']} over {u['depends_on']}{' (in the model)' if u.get('in_model') else ''}"
              for u in row.get("answer", {}).get("unknown", [])]  # fmt: skip
    return ", ".join(shown) or "nothing"


def _error(row: dict[str, Any]) -> str:
    e, after = row["expected"], row.get("after_m")
    shown = "none" if after is None else f"{1e3 * after:.1f}"
    return f"10 s error {1e3 * e['before_m']:.1f} before, {shown} after, floor {1e3 * e['floor_m']:.1f} mm"
