"""Fuzz everything that is read, guided by coverage (atheris): `python benchmarks/coverage_fuzz.py --seconds 3600`.

The property is stronger than "no traceback": where a bag is rewritten, what an independent reader gets from it beside
odometry and TF (messages, times, attachments, metadata) is what it gets from the input. A refusal is one line of the
project's own error, within 512 MB and 20 s. Prints what was tried and what was found as JSON; inputs that broke a
promise are kept in --keep, and `--again FILE` tries one of them.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path


def main() -> int:
    """Start the fuzzer in a process of its own, which libFuzzer ends, and print its report."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=int, default=60)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--keep", type=Path, help="folder for inputs that broke a promise")
    parser.add_argument("--again", type=Path, help="one of these inputs")
    parser.add_argument("--room", type=Path, help="where to work, best in memory [default: as for temporary files]")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=given.room) as made:
        room, report = Path(made), Path(made) / "report.json"
        keep = given.keep or room / "kept"
        keep.mkdir(exist_ok=True, parents=True)
        words = [sys.executable, str(Path(__file__).with_name("coverage_harness.py")), "--room", str(room)]
        words += ["--report", str(report), "--keep", str(keep), "--seconds", str(given.seconds)]
        words += ["--seed", str(given.seed), *(["--again", str(given.again)] if given.again else [])]
        begun = time.monotonic()
        try:
            done = subprocess.run(words, check=False, capture_output=True, text=True, timeout=given.seconds + 120)
            fault = done.stderr[-1500:] if done.returncode else ""
        except subprocess.TimeoutExpired:
            fault = "it did not end when it was to"
        if not report.exists():
            print(fault, file=sys.stderr)
            return 2
        values = json.loads(report.read_text()) | {"seconds": round(time.monotonic() - begun)}
        values["found"] += [f"the fuzzer: {fault}"] * bool(fault)
    print(json.dumps(values, indent=1))
    return int(bool(values["found"]))


if __name__ == "__main__":
    sys.exit(main())
