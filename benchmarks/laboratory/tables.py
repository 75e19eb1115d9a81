"""Tables of the page: one function per arm that turns rows of results into lines of Markdown."""

from __future__ import annotations

from collections import Counter
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from laboratory.answer import errors_of
from laboratory.verdicts import HIGH, alternatives, extras, first_name, is_excited, is_separable, names, right

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = [
    "confusion",
    "controls",
    "falls",
    "misses",
    "mixtures",
    "noise",
    "outside",
    "part",
    "reliability",
    "single",
    "table",
]

Rows = list[dict[str, Any]]
Lines = list[str]


def part(hits: Sequence[bool], goal: str = "") -> str:
    """Return the number of hits out of all tries as text, with the percentage."""
    if not len(hits):
        return "none ran"
    share = f"{sum(hits)} of {len(hits)} ({100.0 * np.mean(hits):.0f} %)"
    return _with_goal(share, goal)


def _with_goal(figure: str, goal: str) -> str:
    return f"{figure}; goal {goal}" if goal else figure


def table(head: Sequence[str], rows: Sequence[Sequence[object]]) -> Lines:
    """Return a table in Markdown."""
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    return [*lines, *("| " + " | ".join(str(cell) for cell in row) + " |" for row in rows), ""]


def controls(truth: str, rows: Rows, goal: str) -> Lines:
    """Return how often anything is named in controls with such a truth, and a line for each of these drives."""
    named = [row for row in rows if first_name(row) != "nothing"]
    hits = part([first_name(row) != "nothing" for row in rows], goal)
    return [f"{truth}: anything is named in {hits}.", "", *(f"- {_drive(row)}: {_said(row)}" for row in named)]


def single(rows: Rows) -> Lines:
    """Return a table of hits of names, alternatives, parameters and intervals by size."""
    goals = {"strong": ("99 %", "100 %"), "medium": ("98 %", "99 %"), "weak": ("90 %", "96 %")}
    out = []
    for size, (first_goal, listed_goal) in goals.items():
        own = [row for row in rows if row["case"]["size"] == size]
        separable, excited = [r for r in own if is_separable(r)], [r for r in own if is_excited(r)]
        listed = [row for row in excited if names(row)]
        out.append([
            size,
            part([right(first_name(row), row) for row in separable], first_goal),
            part([any(right(name, row) for name in alternatives(row)) for row in excited], listed_goal),
            f"{np.mean([len(alternatives(row)) for row in listed]):.2f}; goal 1.5" if listed else "none",
            part([right(first_name(row), row) for row in own]),
            _errors(excited),
            f"{np.mean([len(extras(row)) for row in own]):.2f}" if own else "",
        ])  # fmt: skip
    head = (
        "size", "first name right (excited, separable)", "in the list (excited)", "listed", "first right, all drives",
        "parameter error, median / p90; within 10 %", "false extras a drive",
    )  # fmt: skip
    covered = [hit for row in rows if is_excited(row) for e in _errors_of(row) for hit in e["covered"]]
    return [*table(head, out), f"95 % intervals that cover: {part(covered, '90 to 98 %')}.", ""]


def _errors_of(row: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the parameter errors of the causes found, recomputed from the stored answers."""
    if "found" not in row.get("answer", {}):
        return []
    found = row["answer"]["found"]
    errors = (errors_of(truth, cause, found) for cause, truth in row.get("truth", {}).items())
    return [e for e in errors if e is not None]


def _errors(rows: Rows) -> str:
    found = [e["relative"] for row in rows for e in _errors_of(row)]
    if not found:
        return "none"
    return f"{100 * np.median(found):.1f} / {100 * np.quantile(found, 0.9):.1f} %; {part([e <= 0.1 for e in found])}"


def falls(rows: Rows, title: str) -> list[object]:
    """Return a table row: ratios of the held-out error after and before correction to that without the fault."""
    errors = [row["error"] for row in rows if "error" in row]
    if not errors:
        return [title, 0, "", "", ""]
    after = np.array([e["after"] / e["floor"] for e in errors])
    before = np.array([e["before"] / e["floor"] for e in errors])
    return [
        title, len(errors), f"{np.median(before):.2f} / {np.quantile(before, 0.9):.2f}", f"{np.median(after):.3f}",
        f"{np.quantile(after, 0.9):.3f}",
    ]  # fmt: skip


def confusion(rows: Rows) -> Lines:
    """Return a list of causes with the names found first: the confusion matrix without its zeros."""
    out = []
    for cause in sorted({row["case"]["causes"][0] for row in rows}):
        own = [row for row in rows if row["case"]["causes"][0] == cause]
        counts = Counter(first_name(row) for row in own)
        z = [row["expected"]["standard_errors"] for row in own if "expected" in row]
        size = f"{min(z):.0f} to {max(z):.0f}" if z else ""
        found = ", ".join(f"{name} {n}" if not right(name, own[0]) else f"**{name} {n}**"
                          for name, n in counts.most_common())  # fmt: skip
        out.append([f"`{cause}`", len(own), size, found])
    return table(("cause", "drives", "expected standard errors", "named first (right in bold)"), out)


def misses(rows: Rows) -> Lines:
    """Return a line for each drive with a wrong first name or an excited cause; a count of the other misses."""
    lines, silent = [], 0
    for row in rows:
        if right(first_name(row), row):
            continue
        if first_name(row) == "nothing" and "answer" in row and not is_excited(row):
            silent += 1
            continue
        expected = row.get("expected")
        why = ""
        if expected:
            state = "" if expected["excited"] else ", not excited"
            state += "" if expected["separable"] or not expected["excited"] else ", not separable"
            why = f" ({expected['nats']:.0f} nats, {expected['apart_nats']:.0f} beside {expected['rival']}{state})"
        lines.append(f"- {_drive(row)}{why}: {_said(row)}")
    more = f"Nothing is named in {silent} drives that do not show their cause."
    return [*(lines or ["None."]), "", *([more, ""] if silent else [])]


def outside(rows: Rows) -> Lines:
    """Return a table of regressors, known names and expressions found for causes outside the library."""
    regressor = [
        any(u[0] == row["depends_on"] for u in row["answer"]["unknown"][:1]) for row in rows if "answer" in row
    ]
    anywhere = [any(u[0] == row["depends_on"] for u in row["answer"]["unknown"]) for row in rows if "answer" in row]
    known = [any(c is not None and c >= HIGH for _, c in _confidences(row)) for row in rows if "answer" in row]
    excited = [row for row in rows if "answer" in row and is_excited(row)]
    offered = [row["error"]["offered"] / row["error"]["floor"] for row in excited if row["error"]["offered"]]
    lines = table(("measure", "result"), [
        ["right regressor first", part(regressor, "90 %")],
        ["right regressor among those named", part(anywhere)],
        ["right regressor first, excited", part([any(u[0] == r["depends_on"] for u in r["answer"]["unknown"][:1])
                                              for r in excited], "90 %")],
        ["known name with high confidence", part(known, "at most 5 %")],
        ["error with the expression at most 1.25 of that without the fault", part([o <= 1.25 for o in offered])],
        ["its median and 90th percentile", f"{np.median(offered):.2f} / {np.quantile(offered, 0.9):.2f}; goal 1.25"
         if offered else "none offered"],
    ])  # fmt: skip
    wrong = [
        row for row in rows
        if "answer" not in row or {u[0] for u in row["answer"]["unknown"][:1]} != {row["depends_on"]} or names(row)
    ]  # fmt: skip
    listed = (f"- {_drive(row)}: depends on {row.get('depends_on')}; {_said(row)}" for row in wrong)
    return [*lines, "Other regressors first, or beside a known name:", "", *listed, ""]


def mixtures(rows: Rows, goals: Sequence[str] = ("97 %", "80 %", "0.2")) -> Lines:
    """Return a table of how many of two causes were named, including noise causes; `goals` may be empty."""
    one, both, extra = goals or ("", "", "")
    hits = []
    for row in rows:
        found = [*names(row), *(n for n, _ in row.get("answer", {"noise": []})["noise"])]
        hits.append(sum(any(right(n, {"case": {"causes": [cause]}}) for n in found) for cause in row["case"]["causes"]))
    more = f"{np.mean([len(extras(row)) for row in rows]):.2f}" if rows else ""
    lines = table(("measure", "result"), [
        ["one right", part([h >= 1 for h in hits], one)],
        ["both right", part([h == 2 for h in hits], both)],
        ["false extras a drive", _with_goal(more, extra) if rows else "none"],
    ])  # fmt: skip
    wrong = [(row, h) for row, h in zip(rows, hits, strict=True) if h < 2 or extras(row)]
    return [*lines, *(f"- {_drive(row)}: {h} right; {_said(row)}" for row, h in wrong), ""]


def noise(rows: Rows) -> Lines:
    """Return a table of noise causes and the noise named."""
    out = []
    for cause in sorted({row["case"]["causes"][0] for row in rows}):
        own = [row for row in rows if row["case"]["causes"][0] == cause and "answer" in row]
        hits = [any(name == cause for name, _ in row["answer"]["noise"]) for row in own]
        named = Counter(n for row in own for n in [*(m for m, _ in row["answer"]["noise"]), *names(row)])
        out.append([f"`{cause}`", part(hits), ", ".join(f"{n} {c}" for n, c in named.most_common()) or "nothing"])
    return table(("noise cause", "named as noise", "all names"), out)


def reliability(rows: Rows) -> Lines:
    """Return a table of how often names were right, by their confidence."""
    pairs = [(c, right(name, row)) for row in rows if "answer" in row for name, c in _confidences(row) if c is not None]
    edges = (0.0, 0.5, 0.8, 0.9, 0.99, 0.999, 1.0 + 1e-9)
    out = []
    for low, high in pairwise(edges):
        own = [(c, hit) for c, hit in pairs if low <= c < high]
        if own:
            out.append([f"{low:g} to {min(high, 1.0):g}", f"{np.mean([c for c, _ in own]):.3f}",
                        part([hit for _, hit in own])])  # fmt: skip
    return table(("confidence", "mean", "right"), out)


def _confidences(row: dict[str, Any]) -> list[tuple[str, float | None]]:
    kept = row["answer"]["added"]
    return [(step["added"], step.get("confidence")) for step in row["answer"]["looks"] if step["added"] in kept]


def _drive(row: dict[str, Any]) -> str:
    case = row["case"]
    words = [" + ".join(case["causes"]) or "nothing", case["size"], case["route"], case["yaw_from"]]
    return f"{row['key']} " + ", ".join(w for w in (*words, "skid" if case["drive_type"] == "skid" else "") if w)


def _said(row: dict[str, Any]) -> str:
    if "failed" in row:
        return "failed: " + row["failed"].strip().splitlines()[-1]
    answer = row["answer"]
    words = [f"named {', '.join(names(row))}"] if names(row) else []
    words += [f"noise {', '.join(n for n, _ in answer['noise'])}"] if answer["noise"] else []
    words += ["unknown " + ", ".join(f"{u[1]} over {u[0]}" for u in answer["unknown"][:2])] if answer["unknown"] else []
    return "; ".join(words) or "nothing"
