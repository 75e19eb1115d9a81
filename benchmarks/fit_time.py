"""CPU and wall seconds and memory of fits and of `learn`, by length of the drive and by cause, beside the goals.

    python benchmarks/fit_time.py [--minutes 10 30 60] [--causes [NAME ...]] [--recording run.mcap ...] [--repeat 1]

Drives are simulated office drives at 50 Hz. By length the robot has wheels of unequal size: the base fit is `fit`
without effects (clocks, set-up, noise, the truth's noise, intervals and correlations), every law is `fit --law all`,
the search is that of `learn`. By cause there is one drive of 10 min each, all causes by default: median and 90th
percentile of the searches are printed with the goal. Each recording has a process of its own and one thread, for
its peak memory; the smallest CPU time of the repeats counts, because whatever else runs only adds to it.
"""

from __future__ import annotations

import argparse
import os
import resource
import sys
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from odomcorrupt.simulation import CAUSES, OUTSIDE, simulate, write_mcap
from odomcorrupt.study.estimate.calibrate import fit_every_law, fit_robot
from odomcorrupt.study.io import Source, read_runs
from odomcorrupt.study.pipeline import learn_robot
from odomcorrupt.study.select.selection import learn

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

GOAL_S = 5.0
"""CPU seconds that nine tenths of the searches of drives of 10 min take at most."""
PER_MINUTE_S, MOST_MB = 1.0, 500.0
"""CPU seconds of all of `learn` for a minute of any recording, and its memory."""
WORKS = ("reading", "base fit", "every law", "search", "learn")


class Cost(NamedTuple):
    """Minutes of a recording, CPU and wall seconds of each work, and the most memory, MB."""

    minutes: float
    cpu_s: tuple[float, ...]
    wall_s: tuple[float, ...]
    peak_mb: float


def cost(path: Path, works: Sequence[str], repeat: int) -> Cost:
    """Return what works on a recording take."""
    runs = read_runs(Source(path))
    all_works: dict[str, Callable[[], object]] = {
        "reading": lambda: read_runs(Source(path)),
        "base fit": lambda: fit_robot(runs, [], law_name="diffusion"),
        "every law": lambda: fit_every_law(runs, []),
        "search": lambda: learn(runs),
        "learn": lambda: learn_robot(runs),
    }
    least = []
    for name in works:
        taken = []
        for _ in range(repeat):
            cpu, wall = time.process_time(), time.perf_counter()
            all_works[name]()
            taken.append((time.process_time() - cpu, time.perf_counter() - wall))
        least.append(min(taken))
    stamps = [run.odometry.stamps_ns for run in runs]
    minutes = (max(int(s[-1]) for s in stamps) - min(int(s[0]) for s in stamps)) * 1e-9 / 60.0
    peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    return Cost(minutes, tuple(c for c, _ in least), tuple(w for _, w in least), peak_mb)


def row(path: Path, works: Sequence[str], repeat: int) -> Cost:
    """Print a recording's row of the table, and return its cost; a process of its own measures it."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as own:
        found = own.submit(cost, path, works, repeat).result()
    cells = " | ".join(f"{c:.1f}, {w:.1f}" for c, w in zip(found.cpu_s, found.wall_s, strict=True))
    print(f"| {path.stem} | {found.minutes:.1f} | {cells} | {found.peak_mb:.0f} |", flush=True)
    return found


def head(works: Sequence[str]) -> None:
    """Print the head of a table."""
    print("\n| drive | minutes | " + " | ".join(f"{work}: CPU, wall s" for work in works) + " | MB |")
    print("|---" * (len(works) + 3) + "|")


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, nargs="*", default=[10.0, 30.0, 60.0])
    parser.add_argument("--causes", nargs="*", default=[*CAUSES, *OUTSIDE])
    parser.add_argument("--recording", type=Path, nargs="*", default=[])
    parser.add_argument("--repeat", type=int, default=1)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        if given.minutes:
            head(WORKS)
        for minutes in given.minutes:
            bag = Path(folder) / f"{minutes:g} min.mcap"
            write_mcap(simulate(1, "unequal_wheels", duration_s=60.0 * minutes), bag)
            row(bag, WORKS, given.repeat)
        if given.causes:
            head(["search"])
        searches = []
        for seed, cause in enumerate(given.causes):
            bag = Path(folder) / f"{cause}.mcap"
            write_mcap(simulate(seed, cause, duration_s=600.0), bag)
            searches.append(row(bag, ["search"], given.repeat).cpu_s[0])
            bag.unlink()
        if searches:
            median, high = np.percentile(searches, (50, 90))
            print(f"{len(searches)} searches: median {median:.1f}, 90th percentile {high:.1f} CPU s, goal {GOAL_S:g}")
    if given.recording:
        head(["learn"])
    for path in given.recording:
        found = row(path, ["learn"], given.repeat)
        each = found.cpu_s[0] / found.minutes
        print(f"{each:.1f} CPU s a minute, goal {PER_MINUTE_S:g}; {found.peak_mb:.0f} MB, goal {MOST_MB:.0f}")
    print(f"load {os.getloadavg()[0]:.1f}", file=sys.stderr)


if __name__ == "__main__":
    main()
