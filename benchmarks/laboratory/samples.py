"""Tables of the arms that compare answers with each other, and of the simulated body."""

from __future__ import annotations

from typing import Any

from laboratory.cases import same_class
from laboratory.tables import part, table

__all__ = ["bodies", "plants", "sames"]

Rows = list[dict[str, Any]]


def sames(rows: Rows) -> list[str]:
    """Return a table of how often each transformation of a drive gave the same result."""
    hits: dict[str, list[bool]] = {}
    worst: dict[str, float] = {}
    lines = []
    for row in rows:
        first = row["answers"]["as it came"]
        for name, answer in row["answers"].items():
            if name == "as it came":
                continue
            moved = _moved(first, answer)
            hits.setdefault(name, []).append(moved is not None and moved <= 1.0)
            worst[name] = max(worst.get(name, 0.0), float("inf") if moved is None else moved)
            if moved is None or moved > 1.0:
                lines.append(f"- {row['key']}, {name}: {_words(answer)} instead of {_words(first)}")
    out = [[name, part(own), f"{worst[name]:.2g}"] for name, own in hits.items()]
    return [*table(("transformation", "same result", "largest change in standard errors"), out), *lines, ""]


def _moved(first: dict[str, Any], other: dict[str, Any]) -> float | None:
    """Return the largest change of a parameter in its standard errors; None if names differ."""
    if _words(first) != _words(other):
        return None
    changes = [0.0]
    for name, own in first["found"].items():
        for key, error in own["errors"].items():
            away = abs(own["values"][key] - other["found"][name]["values"][key])
            changes.append(away / error if error > 0.0 else 0.0)
    return max(changes)


def _words(answer: dict[str, Any]) -> str:
    found = [*answer["clocks"], *sorted(answer["added"]), *(name for name, _ in answer["noise"])]
    return ", ".join(found) or "nothing"


def plants(rows: Rows) -> list[str]:
    """Return a table of planted effects in real recordings and their estimates."""
    there = [row for row in rows if "planted" in row]
    if not there:
        return ["The recordings were not there.", ""]
    out, hits = [], []
    for row in there:
        cause = row["case"]["causes"][0]
        (key, size), name = next(iter(row["planted"].items())), same_class(cause)
        before = row["beside"].get(name, {key: 0.0})[key]
        after = row["answer"]["found"].get(name, {"values": {}})["values"].get(key)
        change = None if after is None else after - before
        hits.append(change is not None and abs(change / size - 1.0) <= 0.1)
        error = row["answer"]["found"].get(name, {"errors": {}})["errors"].get(key)
        out.append([
            row["recording"], f"`{cause}`", f"{size:+.4g}", "not named" if change is None else f"{change:+.4g}",
            "" if error is None else f"{error:.2g}",
        ])  # fmt: skip
    head = ("recording", "planted", "size", "difference that came back", "its standard error")
    return [f"Within 10 %: {part(hits)}.", "", *table(head, out)]


def bodies(rows: Rows) -> list[str]:
    """Return a table of the names found for causes built into the simulated body."""
    out = []
    for row in rows:
        truth = ", ".join(f"{name} {_numbers(values)}" for name, values in row["truth"].items()) or "none"
        found = [f"{name} {_numbers(own['values'])}" for name, own in row["answer"]["found"].items()]
        noise = [f"noise {name}" for name, _ in row["answer"]["noise"]]
        unknown = [f"unknown: {u[1]} over {u[0]}" for u in row["answer"]["unknown"][:2]]
        said = "; ".join([*found, *noise, *unknown])
        out.append([row["body"]["name"] or "none", truth, said or "nothing"])
    return table(("built", "in the table's words", "found"), out)


def _numbers(values: dict[str, Any]) -> str:
    return " ".join(f"{key}={value:.3g}" if not isinstance(value, str) else f"{key}={value}"
                    for key, value in values.items())  # fmt: skip
