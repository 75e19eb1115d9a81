"""The ordinary laboratory: what `learn` says of recordings as users have them, as a frozen protocol.

    python benchmarks/ordinary.py run RESULTS.jsonl [--only KIND] [--cases A:B] [--key amcl/3] [--jobs N] [--pilot]
    python benchmarks/ordinary.py page RESULTS.jsonl [-o PAGE.md]
    python benchmarks/ordinary.py write amcl/3 FOLDER [--pilot]

`run` makes each drive, asks the command line about it, and adds a line to RESULTS; a run that was cut goes on where it
stopped. `write` leaves the bags of one case in a folder. `ordinary/protocol.md` says what is measured and how it is
judged. Needs the study and test extras.
"""

from __future__ import annotations

import argparse
import os
import sys
from functools import partial
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
HERE = Path(__file__).parent
sys.path[:0] = [str(HERE)]

from laboratory.run import read_results, run  # noqa: E402 - after the path
from ordinary.ask import ask, write_case  # noqa: E402
from ordinary.cases import SITUATIONS, cases  # noqa: E402
from ordinary.page import page  # noqa: E402


def main() -> None:
    """Run a part of the cases, write the page, or write the bags of one case."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    commands = parser.add_subparsers(dest="command", required=True)
    runner = commands.add_parser("run")
    runner.add_argument("results", type=Path)
    runner.add_argument("--only", action="append", choices=tuple(SITUATIONS), help="only this situation (repeatable)")
    runner.add_argument("--cases", default=":", metavar="A:B", help="only the cases A to B-1 of each situation")
    runner.add_argument("--key", action="append", help="only this case, as amcl/3 (repeatable)")
    runner.add_argument("--jobs", type=int, default=1)
    runner.add_argument("--minutes", type=float, default=1e9, help="start no case after so long")
    runner.add_argument("--keep", default="", help="folder in which bags and models stay")
    writer = commands.add_parser("write")
    writer.add_argument("key", help="a case, as amcl/3")
    writer.add_argument("folder", type=Path)
    for part in (runner, writer):
        part.add_argument("--pilot", action="store_true", help="other seeds, to develop on")
    teller = commands.add_parser("page")
    teller.add_argument("results", type=Path)
    teller.add_argument("-o", "--output", type=Path)
    chosen = parser.parse_args()
    if chosen.command == "page":
        text = page(read_results(chosen.results))
        print(text) if chosen.output is None else chosen.output.write_text(text)
        return
    every = cases(pilot=chosen.pilot)
    if chosen.command == "write":
        case = next((case for case in every if case.key == chosen.key), None)
        if case is None:
            parser.error(f"no case {chosen.key}: situations are {', '.join(SITUATIONS)}")
        chosen.folder.mkdir(parents=True, exist_ok=True)
        _, _, options = write_case(case, chosen.folder)
        print(f"odomcorrupt learn {chosen.folder}/learned.mcap {' '.join(options)} -o {chosen.folder}/robot.toml")
        return
    low, _, high = chosen.cases.partition(":")
    numbers = range(int(low or 0), int(high or 10**9))
    wanted = [
        case for case in every
        if case.number in numbers and case.situation in (chosen.only or SITUATIONS)
        and case.key in (chosen.key or (case.key,))
    ]  # fmt: skip
    run(wanted, chosen.results, partial(ask, keep=chosen.keep), jobs=chosen.jobs, minutes=chosen.minutes)


if __name__ == "__main__":
    main()
