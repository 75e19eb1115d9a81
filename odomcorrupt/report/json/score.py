"""Scores of a batch's estimates as JSON, described in docs/score.md; a baseline of the gate has the same form."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from odomcorrupt.report.json.numbers import finite, picked
from odomcorrupt.scoring.run import METRICS, RunScore, ScoreReport

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.scoring.gate import Verdict

SCHEMA = 1


def score_json(report: ScoreReport, verdicts: Sequence[Verdict] = ()) -> dict[str, Any]:
    """Return a report, and the verdicts of a gate: metres, radians, seconds; unknown and infinite are null."""
    found = report.breakdown
    grown = report.growth
    return finite(
        {
            "schema": SCHEMA,
            **picked(report, "estimate", "truth", "align"),
            "limits": asdict(report.limits),
            "inputs": report.inputs,
            "summary": {name: asdict(report.summary(name)) for name in METRICS},
            "failed": report.failed,
            "identical": report.identical,
            "points": [
                {
                    "name": p.runs[0].point,
                    "drift": p.drift,
                    "runs": len(p.runs),
                    "lost": p.failed,
                    "ate": asdict(p.summary("ate_m")),
                }
                for p in report.points
            ],
            "breakdown": asdict(found),
            "growth": None if grown is None else asdict(grown),
            "sections": [asdict(section) for section in report.sections],
            "runs": [_run(run) for run in report.runs],
            "verdicts": [asdict(verdict) for verdict in verdicts],
            "notes": list(report.notes),
        }
    )


def _run(run: RunScore) -> dict[str, Any]:
    return {
        **picked(run, "name", "seed", "run", "status", "reason", "scored", "failed", "drift", "drift_end_m"),
        "metrics": {name: run.metrics.get(name) for name in METRICS},
        "failure": None if run.failure is None else asdict(run.failure),
        "jumps_s": list(run.jumps_s),
        **picked(run, "coverage", "frame", "source"),
        "events": [{"effect": name, "from_s": begin, "to_s": end} for name, begin, end in run.events],
        "notes": list(run.notes),
    }
