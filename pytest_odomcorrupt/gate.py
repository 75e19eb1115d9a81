"""The assertion of the plugin: errors of runs against those of an earlier version, paired by seed."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.errors import OdomCorruptError
from odomcorrupt.result_files import write_text
from odomcorrupt.scoring.gate import STATISTICS, Comparison, compare_paired

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

__all__ = ["ErrorGate"]

SCHEMA = 1


class ErrorGate:
    """Compares errors with a baseline file, or writes it.

    path : of the baseline
    update : whether to write it in place of comparing
    """

    def __init__(self, path: Path, *, update: bool) -> None:
        self.path = path
        self.update = update

    def __call__(
        self, errors: Mapping[str, float], *, rise: float = 0.2, statistic: str = "p90", most: float | None = None
    ) -> Comparison | None:
        """Assert that errors have not risen.

        Parameters
        ----------
        errors
            One number above 0 for each run, by its name (`CorruptedBag.name`).
        rise
            What must be found: 0.2 is 20 %. 40 runs find it in 95 of 100 cases where the errors of a run scatter by
            up to a fifth from version to version; in 1 of 100 cases the gate fails where nothing has changed.
        statistic
            "mean", "median", "p90", "p95" or "max" over runs.
        most
            What the statistic must not exceed, whatever was before.

        Returns
        -------
        Comparison
            The numbers behind it; None where the baseline was written.

        Raises
        ------
        AssertionError
            Where they have risen; where there is no baseline.
        """
        wrong = {name: value for name, value in errors.items() if not (np.isfinite(value) and value >= 0.0)}
        assert not wrong, f"errors must be finite numbers of at least 0: {dict(list(wrong.items())[:3])}"
        assert statistic in STATISTICS, f"statistic {statistic!r}: there are {', '.join(STATISTICS)}"
        value = float(STATISTICS[statistic](np.array(list(errors.values()))))
        assert most is None or value <= most, (
            f"the {statistic} of {len(errors)} errors is {value:.4g}, more than {most:g}"
        )
        if self.update:
            table = {"schema": SCHEMA, "errors": {name: float(error) for name, error in errors.items()}}
            self.path.parent.mkdir(parents=True, exist_ok=True)
            write_text(self.path, json.dumps(table, indent=1) + "\n")
            return None
        before = self._baseline()
        common = [name for name in errors if name in before]
        assert common, f"{self.path}: has none of these runs; write it again with --odomcorrupt-update"
        old, new = (np.array([table[name] for name in common]) for table in (before, errors))
        try:
            found = compare_paired(old, new, rise=rise, statistic=statistic)
        except OdomCorruptError as error:
            raise AssertionError(f"{self.path}: {error}") from error
        assert not found.rise, (
            f"the {statistic} of the errors rose by {_percent(found.statistic_ratio)}, of a typical run by "
            f"{_percent(found.ratio)} (95 % interval {_percent(found.low)} to {_percent(found.high)}; "
            f"{found.pairs} runs, p {found.p:.2g}). Where that is meant, accept it with --odomcorrupt-update."
        )
        return found

    def _baseline(self) -> dict[str, float]:
        assert self.path.exists(), f"{self.path}: there is no baseline yet; write it with --odomcorrupt-update"
        try:
            errors: dict[str, float] = json.loads(self.path.read_text(encoding="utf8"))["errors"]
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise AssertionError(f"{self.path}: is not a baseline; write it again with --odomcorrupt-update") from error
        return errors


def _percent(ratio: float) -> str:
    return f"{100.0 * (ratio - 1.0):.1f} %"
