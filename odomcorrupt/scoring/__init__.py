"""Errors of a localisation or SLAM under odometry noise, over the runs of a batch, and a gate for regressions.

`score` reads the estimates of a batch, `check` compares the result with an earlier one.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from odomcorrupt.scoring.errors import Limits, PathErrors, path_errors
    from odomcorrupt.scoring.gate import Verdict, check, compare_paired
    from odomcorrupt.scoring.run import RunScore, ScoreReport, score

__all__ = ["Limits", "PathErrors", "RunScore", "ScoreReport", "Verdict", "check", "compare_paired", "path_errors",
           "score"]  # fmt: skip

_HOMES = {
    "Limits": "errors", "PathErrors": "errors", "path_errors": "errors", "Verdict": "gate", "check": "gate",
    "compare_paired": "gate", "RunScore": "run", "ScoreReport": "run", "score": "run",
}  # fmt: skip


def __getattr__(name: str) -> Any:
    """Import a name on first access."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
