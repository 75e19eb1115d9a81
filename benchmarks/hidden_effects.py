"""The hidden-effect laboratory: what `learn` finds where the answer is known, as a frozen protocol.

    python benchmarks/hidden_effects.py run results.jsonl [--arm single] [--seeds 0:20] [--jobs 2] [--minutes 50]
    python benchmarks/hidden_effects.py advice results.jsonl [--kind open] [--seeds 0:20] [--jobs 1] [--pilot]
    python benchmarks/hidden_effects.py summary results.jsonl [--page docs/hidden_effects.md]

`laboratory/protocol.md` says what is measured and how it is judged; it is frozen before a run. Results are added to the
file case by case, and a run that was cut goes on where it stopped. Needs the study and test extras.
"""

from __future__ import annotations

import argparse
import os
import sys
from functools import partial
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # cases run side by side, one core each
HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parent / "tests" / "study"), str(HERE.parent / "tests" / "study" / "sources")]
sys.path[:0] = [str(HERE.parent / "tests")]

from laboratory.advice.cases import TIMES, advice_cases  # noqa: E402 - after the path
from laboratory.advice.follow import follow  # noqa: E402
from laboratory.ask import ask  # noqa: E402
from laboratory.cases import ARMS, cases  # noqa: E402
from laboratory.page import page  # noqa: E402
from laboratory.run import read_results, run  # noqa: E402


def main() -> None:
    """Run a part of the cases, or write the page."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    commands = parser.add_subparsers(dest="command", required=True)
    runner = commands.add_parser("run")
    adviser = commands.add_parser("advice", help="follow advised drives: an arm with a file of results of its own")
    runner.add_argument("--arm", action="append", choices=ARMS, help="only these (repeatable)")
    adviser.add_argument("--kind", action="append", choices=tuple(TIMES), help="only these (repeatable)")
    for part in (runner, adviser):
        part.add_argument("results", type=Path)
        part.add_argument("--seeds", default=":", metavar="A:B", help="only the cases A to B-1 of each arm")
        part.add_argument("--jobs", type=int, default=2)
        part.add_argument("--minutes", type=float, default=1e9, help="start no case after so long")
        part.add_argument("--pilot", action="store_true", help="other seeds, to try the script on")
    runner.add_argument("--real", type=Path, default=HERE.parent.parent / "shared" / "data" / "real")
    writer = commands.add_parser("summary")
    writer.add_argument("results", type=Path)
    writer.add_argument("--page", type=Path)
    writer.add_argument("--advice", type=Path, default=HERE / "laboratory" / "results" / "advice.jsonl")
    chosen = parser.parse_args()
    if chosen.command == "summary":
        text = page(read_results(chosen.results), read_results(chosen.advice))
        print(text) if chosen.page is None else chosen.page.write_text(text)
        return
    low, _, high = chosen.seeds.partition(":")
    numbers = range(int(low or 0), int(high or 10**9))
    if chosen.command == "advice":
        robots = [
            c for c in advice_cases(pilot=chosen.pilot) if c.kind in (chosen.kind or TIMES) and c.number in numbers
        ]
        run(robots, chosen.results, follow, jobs=chosen.jobs, minutes=chosen.minutes)
        return
    wanted = [c for c in cases(pilot=chosen.pilot) if c.arm in (chosen.arm or ARMS) and c.number in numbers]
    asked = partial(ask, real=str(chosen.real))
    run(wanted, chosen.results, asked, jobs=chosen.jobs, minutes=chosen.minutes)


if __name__ == "__main__":
    main()
