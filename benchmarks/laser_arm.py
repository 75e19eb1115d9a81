"""The laboratory's laser arm: the same drives taught by motion capture and by a ray-cast laser.

    python benchmarks/laser_arm.py run results.jsonl [--arm single] [--jobs 1] [--minutes 50] [--pilot]
    python benchmarks/laser_arm.py summary results.jsonl
    python benchmarks/laser_arm.py cost

`laser/protocol.md` says what is measured; it is frozen before a run. Needs the study and test extras.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import tempfile
from functools import partial
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parent / "tests" / "study"), str(HERE.parent / "tests")]

from laboratory.run import read_results, run  # noqa: E402 - after the path
from laser.ask import ask  # noqa: E402
from laser.bag import write_bag  # noqa: E402
from laser.cases import LENGTHS, laser_cases  # noqa: E402
from laser.drives import drive  # noqa: E402
from laser.gyro_tables import gyro_tables  # noqa: E402
from laser.tables import tables  # noqa: E402


def main() -> None:
    """Run a part of the cases, or print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    commands = parser.add_subparsers(dest="command", required=True)
    runner = commands.add_parser("run")
    runner.add_argument("results", type=Path)
    runner.add_argument("--arm", action="append", choices=tuple(LENGTHS), help="only these (repeatable)")
    runner.add_argument("--jobs", type=int, default=1)
    runner.add_argument("--minutes", type=float, default=1e9, help="start no case after so long")
    runner.add_argument("--pilot", action="store_true", help="other seeds, to try the script on")
    runner.add_argument("--gyro-walk", type=float, help="of its bias, rad/s/sqrt(s); default: drawn")
    commands.add_parser("summary").add_argument("results", type=Path)
    commands.add_parser("cost", help="CPU time and memory of learn: 15 min in a room at 10 Hz")
    chosen = parser.parse_args()
    if chosen.command == "cost":
        print(cost())
        return
    if chosen.command == "summary":
        rows = read_results(chosen.results)
        gyro = [row for row in rows if row["case"]["arm"] == "gyro"]
        others = [row for row in rows if row["case"]["arm"] != "gyro"]
        print("\n\n".join(table(some) for table, some in ((tables, others), (gyro_tables, gyro)) if some))
        return
    wanted = [c for c in laser_cases(pilot=chosen.pilot) if c.arm in (chosen.arm or LENGTHS)]
    run(wanted, chosen.results, partial(ask, gyro_walk=chosen.gyro_walk), jobs=chosen.jobs, minutes=chosen.minutes)


def cost() -> str:
    """Return what all of `learn` takes on 15 min of scans, 360 beams at 10 Hz, as a process of its own."""
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder, "run.mcap")
        seen = drive(79_900, ["unequal_wheels"], "room", laser="quick", duration_s=900.0, route="office")
        write_bag(bag, seen, sweep_s=0.1, beams=360)
        words = ["learn", str(bag), "--scan", "/scan", "--track", str(seen.run.track_m)]
        done = subprocess.run([sys.executable, "-m", "odomcorrupt", *words], capture_output=True, text=True, check=True)
        used = resource.getrusage(resource.RUSAGE_CHILDREN)
    took = f"{used.ru_utime + used.ru_stime:.1f} CPU s (goal 60), {used.ru_maxrss / 1e3:.0f} MB (goal 500)"
    return f"{took}\n{done.stdout}"


if __name__ == "__main__":
    main()
