"""Grading of each drive's answer as right or wrong, by the rules of protocol.md."""

from __future__ import annotations

from typing import Any

from ordinary.cases import PILOT_SEED, SITUATIONS
from ordinary.causes import CAUSES, matches

__all__ = [
    "EVENT_S", "HARM", "SURE", "answered", "event_found", "false_alarms", "first", "grade", "harmed", "is_control",
    "is_excited", "names", "ratio", "refusals", "reproduce", "right", "wrong_and_sure",
]  # fmt: skip

SURE = 0.9
HARM = 1.03
EVENT_S = 5.0
"""Largest difference between the reported and the planted time of an event that is found, seconds."""

Row = dict[str, Any]


def is_control(row: Row) -> bool:
    """Return whether the drive is a control, without a planted cause."""
    return not row["case"]["cause"]


def is_excited(row: Row) -> bool:
    """Return whether the generator expects the cause to be detectable."""
    return bool(row.get("expected", {}).get("excited", False))


def answered(row: Row) -> bool:
    """Return whether `learn` gave an answer."""
    return "answer" in row


def names(row: Row) -> list[tuple[str, float | None]]:
    """Return the reported names with their confidences, in order."""
    return [(one["effect"], one["confidence"]) for one in row.get("answer", {}).get("found", [])]


def grade(name: str, row: Row) -> str:
    """Return "right", "equal" (same effect on this robot by another physical cause), "present" or "wrong"."""
    case = row["case"]
    cause = CAUSES.get(case["cause"])
    if cause is not None and matches(name, cause.accepted):
        return "right"
    if matches(name, SITUATIONS[case["situation"]][case["setting"]].present):
        return "present"
    return "equal" if cause is not None and matches(name, cause.equal) else "wrong"


def first(row: Row) -> str:
    """Return the first name that is not present in every such robot; else an unknown dependence, else "nothing"."""
    if not answered(row):
        return "no answer"
    left = [name for name, _ in names(row) if grade(name, row) != "present"]
    if left:
        return left[0]
    unknown = _unknown(row)
    return f"unknown ({unknown[0]['channel']} over {unknown[0]['depends_on']})" if unknown else "nothing"


def _unknown(row: Row) -> list[Row]:
    """Return the unknown dependences whose regressor is not present in every such robot."""
    case = row["case"]
    present = SITUATIONS[case["situation"]][case["setting"]].present
    return [one for one in row.get("answer", {}).get("unknown", []) if not matches(one["depends_on"], present)]


def right(row: Row) -> bool:
    """Return whether the first name, the regressor of an unknown dependence, or the event is that of the cause."""
    cause = CAUSES[row["case"]["cause"]]
    if cause.event:
        return event_found(row)
    said = first(row)
    if said.startswith("unknown ("):
        return matches(_unknown(row)[0]["depends_on"], cause.drivers)
    return grade(said, row) == "right"


def event_found(row: Row) -> bool:
    """Return whether an event is listed within `EVENT_S` of the planted one."""
    planted = row.get("event") or {}
    for key, listed in row.get("answer", {}).items():
        if "event" not in key or not isinstance(listed, list):
            continue
        for one in listed:
            times = [
                one[k] for k in ("time_s", "start_s", "begin_s", "t", "at_s") if isinstance(one.get(k), int | float)
            ]
            if any(planted["start_s"] - EVENT_S <= at <= planted["end_s"] + EVENT_S for at in times):
                return True
    return False


def false_alarms(row: Row) -> list[str]:
    """Return the names and unknown dependences, in the model or offered, reported of a robot without a cause."""
    if not is_control(row):
        return []
    wrong = [_with(name, confidence) for name, confidence in names(row) if grade(name, row) == "wrong"]
    unknown = [
        f"unknown ({one['channel']} over {one['depends_on']}{', in the model' if one.get('in_model') else ''})"
        for one in _unknown(row)
    ]
    return wrong + unknown


def wrong_and_sure(row: Row) -> list[str]:
    """Return wrong names with a confidence of 0.9 or more."""
    sure = ((name, confidence) for name, confidence in names(row) if (confidence or 0.0) >= SURE)
    return [_with(name, confidence) for name, confidence in sure if grade(name, row) == "wrong"]


def _with(name: str, confidence: float | None) -> str:
    return name if confidence is None else f"{name} {confidence:.3f}"


def harmed(row: Row) -> bool:
    """Return whether the held-out error is more than 3 % above that without a model."""
    return row.get("after_m") is not None and row["after_m"] > HARM * row["expected"]["before_m"]


def ratio(row: Row, over: str = "floor_m") -> float | None:
    """Return the ratio of the held-out error after correction to the floor (or the attainable); None without one."""
    return None if row.get("after_m") is None else row["after_m"] / row["expected"][over]


def refusals(row: Row) -> list[str]:
    """Return the errors of the commands."""
    if "failed" in row:
        return [f"the laboratory broke: {row['failed'].strip().splitlines()[-1]}"]
    if "learn" in row:
        return [f"learn: {row['learn']}"]
    return [f"{name}: {why}" for name, why in row.get("uses", {}).items() if why]


def reproduce(row: Row) -> str:
    """Return the command that repeats this drive."""
    pilot = " --pilot" if row["case"]["seed"] < PILOT_SEED + 10_000 else ""
    return f"python benchmarks/ordinary.py run again.jsonl{pilot} --key {row['key']} --keep again"
