"""The assertion of the plugin: errors of runs against those of an earlier version, paired by seed."""

from __future__ import annotations

import json
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.errors import OdomCorruptError
from odomcorrupt.result_files import write_file
from odomcorrupt.scoring.gate import STATISTICS, Comparison, compare_paired, paired_sentence, quantity, worst_of

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
        self,
        errors: Mapping[str, float],
        *,
        rise: float = 0.2,
        statistic: str = "p90",
        most: float | None = None,
        crashes: int = 0,
        unit: str = "m",
    ) -> Comparison | None:
        """Assert that errors have not risen.

        Parameters
        ----------
        errors
            One number of at least 0 for each run, by its name (`CorruptedBag.name`); infinity for a run without a
            result.
        rise
            Rise to find: 0.2 is 20 %. 40 runs find it in 95 of 100 cases where the errors of a run scatter by up to a
            fifth from version to version; in 1 of 100 cases the gate fails where nothing has changed.
        statistic
            "mean", "median", "p90", "p95" or "max" over runs; infinite if too many runs have no result.
        most
            Upper bound of the statistic, regardless of the baseline.
        crashes
            Number of runs that may have no result although they have one in the baseline.
        unit
            Unit of the errors, for messages: "m", "rad" (shown as degrees), or "" for none.

        Returns
        -------
        Comparison
            The numbers behind it; None where the baseline was written.

        Raises
        ------
        AssertionError
            If they have risen, a run crashed that did not, or there is no baseline.
        """
        __tracebackhide__ = True
        wrong = {name: value for name, value in errors.items() if not value >= 0.0}
        _require(not wrong, f"errors must be numbers of at least 0: {dict(list(wrong.items())[:3])}")
        _require(statistic in STATISTICS, f"statistic {statistic!r}: there are {', '.join(STATISTICS)}")
        value = float(STATISTICS[statistic](np.array(list(errors.values()))))
        metric = f"errors_{unit}" if unit else "errors"
        shown = partial(quantity, metric)
        above = f"the {statistic} of {len(errors)} errors is {shown(value)}, more than {shown(most or 0.0)}"
        worst = sorted(errors.items(), key=lambda one: -one[1])[:5]
        _require(most is None or value <= most, "\n".join([above, *(f"  {n}: {shown(e)}" for n, e in worst)]))
        if self.update:
            table = {"schema": SCHEMA, "errors": {name: float(error) for name, error in errors.items()}}
            self.path.parent.mkdir(parents=True, exist_ok=True)
            write_file(self.path, json.dumps(table, indent=1) + "\n")
            return None
        before = self._baseline()
        common = [name for name in errors if name in before]
        _require(bool(common), f"{self.path}: has none of these runs; write it again with --odomcorrupt-update")
        crashed = [name for name in common if np.isinf(errors[name]) and np.isfinite(before[name])]
        said = f"{len(crashed)} of {len(common)} runs have no result that had one ({crashes} allowed)"
        _require(
            len(crashed) <= crashes, "\n".join([said, *(f"  {n}: {shown(before[n])} -> no result" for n in crashed)])
        )
        old, new = (np.array([table[name] for name in common]) for table in (before, errors))
        try:
            found = compare_paired(old, new, rise=rise, statistic=statistic)
        except OdomCorruptError as error:
            raise AssertionError(f"{self.path}: {error}") from None
        said = f"the {paired_sentence(found, metric, statistic, old, new, rise=rise)}"
        rows = [f"  {common[i]}: {shown(old[i])} -> {shown(new[i])}" for i in worst_of(old, new)]
        _require(not found.rise, "\n".join([said, *rows, "If that is intended, accept it with --odomcorrupt-update."]))
        return found

    def _baseline(self) -> dict[str, float]:
        __tracebackhide__ = True
        _require(self.path.exists(), f"{self.path}: there is no baseline yet; write it with --odomcorrupt-update")
        try:
            errors: dict[str, float] = json.loads(self.path.read_text(encoding="utf8"))["errors"]
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise AssertionError(f"{self.path}: is not a baseline; write it again with --odomcorrupt-update") from error
        return errors


def _require(true: bool, message: str) -> None:  # noqa: FBT001 - a condition, as of assert
    __tracebackhide__ = True
    if not true:
        raise AssertionError(message)
