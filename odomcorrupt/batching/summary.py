"""Text of a batch's result."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from odomcorrupt.summary import Line, Summary, command_line

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from odomcorrupt.batching.runner import Failure
    from odomcorrupt.summary import Tone

_NAMED = 8
"""Failed runs that are named."""


def brief(
    directory: Path,
    records: Sequence[dict[str, Any]],
    made_now: int,
    seed: int,
    failures: Sequence[Failure],
    losses: Sequence[str],
    places: Sequence[Line] = (),
) -> Summary:
    """Return the summary of a batch: number of runs, effects of places, drift, failures, next command."""
    tone: Tone = "bad" if failures else "good"
    lines = [Line("FAILED" if failures else "MADE", f"{made_now} runs made now, {len(records)} in {directory}", tone)]
    lines += [*places, Line("seed", str(seed))]
    drifts = [record["drift"] for record in records if "end_drawn_m" in record.get("drift", {})]
    if drifts:
        metres = math.sqrt(sum(d["end_drawn_m"] ** 2 for d in drifts) / len(drifts))
        radians = math.sqrt(sum(d["end_drawn_rad"] ** 2 for d in drifts) / len(drifts))
        far = max(d["distance_m"] for d in drifts)
        lines.append(Line("drift", f"{metres:.3g} m, {math.degrees(radians):.3g} deg RMS at the end of {far:.4g} m"))
    if failures:
        first, reason = failures[0]
        lines.append(Line("failed", f"{len(failures)} runs, tried twice; run {first}: {reason}", "bad"))
    lines += [Line("lost", loss, "warning") for loss in losses]
    return Summary((*lines, command_line(["odomcorrupt", "spread", directory])))


def sentences(
    directory: Path, count: int, made_now: int, seed: int, failures: Sequence[Failure], losses: Sequence[str]
) -> str:
    """Return the summary in sentences, with the numbers of the failed runs."""
    said = f"{made_now} runs made now, {count} in {directory}, seed {seed}."
    if failures:
        first, reason = failures[0]
        names = ", ".join(str(run) for run, _ in failures[:_NAMED]) + (", ..." if len(failures) > _NAMED else "")
        said += f" Not made, tried twice: {len(failures)} runs ({names}); run {first}: {reason}"
    return said + "".join(f" Lost: {loss}." for loss in losses)
