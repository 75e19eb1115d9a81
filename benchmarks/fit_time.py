"""CPU seconds of a fit and of a search by length of the drive: simulated office drives at 50 Hz, one thread.

    python benchmarks/fit_time.py [--minutes 10 30 60] [--repeat 3] [--recording run.mcap ...]

The base fit is `fit` without effects: clocks, set-up, noise, the truth's noise, intervals and correlations; every law
is `fit --law all`; `learn` is the whole search. The robot has wheels of unequal size. Reading is told apart. The
smallest of the repeats counts: whatever else runs only adds to it.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from odomcorrupt.simulation import simulate, write_mcap
from odomcorrupt.study.estimate.calibrate import fit_every_law, fit_robot
from odomcorrupt.study.io import Source, read_runs
from odomcorrupt.study.select.stepwise import learn

if TYPE_CHECKING:
    from collections.abc import Callable


def cpu_s(work: Callable[[], object], repeat: int) -> float:
    """Return the least CPU seconds that some work took."""
    taken = []
    for _ in range(repeat):
        start = time.process_time()
        work()
        taken.append(time.process_time() - start)
    return min(taken)


def measured(path: Path, repeat: int) -> str:
    """Return a row of the table."""
    runs = read_runs(Source(path))
    steps = sum(len(run.odometry) - 1 for run in runs)
    times = [
        cpu_s(work, repeat)
        for work in (
            lambda: read_runs(Source(path)),
            lambda: fit_robot(runs, [], law_name="diffusion"),
            lambda: fit_every_law(runs, []),
            lambda: learn(runs),
        )
    ]
    return f"| {path.stem} | {steps} | " + " | ".join(f"{t:.2f}" for t in times) + " |"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, nargs="*", default=[10.0, 30.0, 60.0])
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--recording", type=Path, nargs="*", default=[])
    given = parser.parse_args()
    print("| drive | steps | reading | base fit | every law | learn |\n|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        for minutes in given.minutes:
            bag = Path(folder) / f"{minutes:g} min.mcap"
            write_mcap(simulate(1, "unequal_wheels", duration_s=60.0 * minutes), bag)
            print(measured(bag, given.repeat), flush=True)
    for path in given.recording:
        print(measured(path, given.repeat), flush=True)
    print(f"load {os.getloadavg()[0]:.1f}", file=sys.stderr)


if __name__ == "__main__":
    main()
