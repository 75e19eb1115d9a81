"""Run cases in parallel; each result is a line of a file, written as soon as it is available."""

from __future__ import annotations

import json
import multiprocessing
import time
import traceback
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from laboratory.advice.cases import AdviceCase
    from laboratory.cases import Case

    AnyCase = Case | AdviceCase

__all__ = ["read_results", "run"]


def read_results(path: Path) -> list[dict[str, Any]]:
    """Return the results in a file, without truncated lines; the last one of repeated cases."""
    found = {}
    for line in path.read_text().splitlines() if path.exists() else ():
        try:
            row = json.loads(line)
        except json.JSONDecodeError:
            continue
        found[row["key"]] = row
    return list(found.values())


def run(
    cases: Sequence[AnyCase], results: Path, ask: Callable[[Any], dict[str, Any]], *, jobs: int, minutes: float
) -> None:
    """Run the cases that are not in the results yet; start none after `minutes`."""
    done = {row["key"] for row in read_results(results)}
    left = [(case, ask) for case in cases if case.key not in done]
    end = time.monotonic() + 60.0 * minutes
    results.parent.mkdir(parents=True, exist_ok=True)
    print(f"{len(done)} done, {len(left)} to do", flush=True)
    with multiprocessing.get_context("fork").Pool(jobs, maxtasksperchild=20) as pool, results.open("a") as file:
        waiting = iter(left)
        running: list[Any] = []
        while True:
            while len(running) < jobs and time.monotonic() < end and (work := next(waiting, None)) is not None:
                running.append(pool.apply_async(_one, work))
            if not running:
                return
            for finished in [r for r in running if r.ready()]:
                running.remove(finished)
                row = finished.get()
                file.write(json.dumps(row) + "\n")
                file.flush()
                print(row["key"], f"{row['cpu_s']:.1f} s", row.get("failed", ""), flush=True)
            time.sleep(0.05)


def _one(case: AnyCase, ask: Callable[[Any], dict[str, Any]]) -> dict[str, Any]:
    begun = time.process_time()
    row: dict[str, Any] = {"key": case.key, "case": {s: getattr(case, s) for s in case.__slots__}}
    try:
        row |= ask(case)
    except Exception:  # noqa: BLE001 - a case that breaks is a result, too
        row["failed"] = traceback.format_exc(limit=-3)
    return row | {"cpu_s": time.process_time() - begun}
