"""Grading of each case's advice."""

from __future__ import annotations

from typing import Any

from laboratory.cases import same_class

__all__ = ["cause_of", "clear", "named", "named_first", "open_names", "said_unseen", "settled"]

Row = dict[str, Any]


def named(row: Row, step: int) -> list[str]:
    """Return all systematic names found after `step` advised drives, clocks first, twins as one."""
    answer = row["looks"][step]["answer"]
    return [same_class(name) for name in (*answer["clocks"], *answer["added"])]


def open_names(row: Row, step: int = 0) -> set[str]:
    """Return all names reported as ambiguous; twins, which no drive can separate, are one."""
    found = [{same_class(name) for name in choice["names"]} for choice in row["looks"][step]["choices"]]
    return set().union(*(names for names in found if len(names) > 1))


def cause_of(row: Row) -> str:
    """Return the common name of the hidden cause and its twins."""
    return same_class(row["case"]["cause"])


def named_first(row: Row, step: int) -> bool:
    """Return whether the cause was the first name."""
    return named(row, step)[:1] == [cause_of(row)]


def settled(row: Row, step: int) -> bool:
    """Return whether the cause is the first name, and no other ambiguous name is an alternative or named."""
    rivals = open_names(row) - {cause_of(row)}
    return named_first(row, step) and not rivals & {*_beside(row, step), *named(row, step)}


def clear(row: Row, step: int) -> bool:
    """Return whether the cause is the first name, without alternatives and other names."""
    return named_first(row, step) and not _beside(row, step) and len(named(row, step)) == 1


def said_unseen(row: Row) -> bool:
    """Return whether the cause was reported as not testable with the first drive."""
    return cause_of(row) in {same_class(one["effect"]) for one in row["looks"][0]["untestable"]}


def _beside(row: Row, step: int) -> set[str]:
    """Return the alternatives of the cause if it was added, without its twins."""
    own = [one for one in row["looks"][step]["answer"]["looks"] if one["added"] is not None]
    rivals = {same_class(n) for one in own if same_class(one["added"]) == cause_of(row) for n in one["alternatives"]}
    return rivals - {cause_of(row)}
