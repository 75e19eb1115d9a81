"""Grading of each case's answer as right or wrong."""

from __future__ import annotations

from typing import Any

from laboratory.cases import same_class

__all__ = ["HIGH", "alternatives", "extras", "first_name", "is_excited", "is_separable", "names", "right"]

HIGH = 0.9
"""Confidence from which a name counts as certain."""


def names(row: dict[str, Any]) -> list[str]:
    """Return all systematic names found, clocks first."""
    answer = row.get("answer", {"clocks": [], "added": []})
    return [*answer["clocks"], *answer["added"]]


def first_name(row: dict[str, Any]) -> str:
    """Return the first name: systematic, or noise if there is no other, or "nothing" ("unknown")."""
    if "failed" in row:
        return "failed"
    found = [*names(row), *(name for name, _ in row["answer"]["noise"])]
    if found:
        return found[0]
    return f"unknown ({row['answer']['unknown'][0][0]})" if row["answer"]["unknown"] else "nothing"


def right(name: str, row: dict[str, Any]) -> bool:
    """Return whether a name is one of the causes, or a twin of one."""
    return same_class(name) in {same_class(cause) for cause in row["case"]["causes"]}


def alternatives(row: dict[str, Any]) -> list[str]:
    """Return the first name and its alternatives, one of each class of twins."""
    found = names(row)
    if not found:
        return []
    listed = [found[0]]
    for step in row["answer"]["looks"]:
        if step["added"] == found[0]:
            listed += step["alternatives"]
    return list(dict.fromkeys(same_class(name) for name in listed))


def extras(row: dict[str, Any]) -> list[str]:
    """Return the systematic names that are not causes."""
    return [name for name in names(row) if not right(name, row)]


def is_excited(row: dict[str, Any]) -> bool:
    """Return whether the drive was expected to show the cause; True without an expectation."""
    return bool(row.get("expected", {}).get("excited", True))


def is_separable(row: dict[str, Any]) -> bool:
    """Return whether the drive was expected to separate the cause from all others."""
    return is_excited(row) and bool(row.get("expected", {}).get("separable", True))
