"""Kill at random moments: `python tests/hostile/crash.py --kills 1000`.

A rewrite that is killed (-9) leaves its output whole or absent, a batch that is killed goes on where it was, and what
comes of both is what an undisturbed run makes, byte by byte. Processes are forks of this one, so that a kill finds
them at work and not at imports.
"""

# ruff: noqa: T201 - a script that prints

import argparse
import contextlib
import os
import random
import shutil
import signal
import sys
import tempfile
import time
from functools import partial
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

from smallbags import make_small_bags

from odomcorrupt.cli import run

TYPED = ("--alpha", "0.05", "0.02", "0.05", "0.01", "--seed", "7")
RUNS = 12


def _forked(words: list[str]) -> int:
    """Begin a command in a fork; return its process id."""
    child = os.fork()
    if child == 0:
        code = 99
        with contextlib.suppress(BaseException):
            null = os.open(os.devnull, os.O_WRONLY)
            os.dup2(null, 2)
            code = run(words)
        os._exit(code)
    return child


def _timed(words: list[str]) -> float:
    """Return how long a command takes, seconds."""
    begun = time.monotonic()
    _, status = os.waitpid(_forked(words), 0)
    if os.waitstatus_to_exitcode(status) != 0:
        sys.exit(f"{words} fails undisturbed")
    return time.monotonic() - begun


def _killed(words: list[str], after_s: float) -> bool:
    """Kill a command after some seconds; return whether the kill found it alive."""
    child = _forked(words)
    time.sleep(after_s)
    os.kill(child, signal.SIGKILL)
    _, status = os.waitpid(child, 0)
    return os.waitstatus_to_exitcode(status) == -signal.SIGKILL


def _content(path: Path) -> dict[str, bytes]:
    files = [path] if path.is_file() else sorted(path.rglob("*"))
    return {one.name: one.read_bytes() for one in files if one.is_file()}


def rewrites(room: Path, kills: int, dice: random.Random) -> str:
    """Kill rewrites of every format; return what came of it."""
    (room / "bags").mkdir()
    bags = make_small_bags(room / "bags")
    kinds = ("mcap zstd", "ros1 lz4", "sqlite3 file", "sqlite3 directory")
    alive = whole = 0
    for kind in kinds:
        source = bags[kind].path
        target = room / "out" / source.name
        target.parent.mkdir(exist_ok=True)
        words = [str(source), str(target), *TYPED]
        run(words)
        expected = _content(target)
        shutil.rmtree(target) if target.is_dir() else target.unlink()
        seconds = _timed(words)
        for _ in range(kills // len(kinds)):
            shutil.rmtree(target.parent)
            target.parent.mkdir()
            alive += _killed(words, dice.uniform(0.0, 1.1 * seconds))
            if target.exists():
                whole += 1
                if _content(target) != expected:
                    sys.exit(f"{kind}: an output that is not whole")
            others = [one for one in target.parent.iterdir() if one != target]
            if any(not (one.name.startswith(".") and ".partial" in one.name) for one in others):
                sys.exit(f"{kind}: left {others}")
        shutil.rmtree(target.parent)
    return f"{kills} rewrites, {alive} killed at work: {whole} outputs whole, the others absent"


def batches(room: Path, kills: int, dice: random.Random, minutes: float = 1e9) -> str:
    """Kill batches again and again until they are through, or the time is; return what came of it."""
    until = time.monotonic() + 60 * minutes
    source = make_small_bags(room / "more")["mcap zstd"].path if (room / "more").mkdir() is None else room
    words = ["batch", str(source), str(room / "runs"), "--runs", str(RUNS), *TYPED]
    seconds = _timed([*words[:2], str(room / "whole"), *words[3:]])
    expected = {name: data for name, data in _content(room / "whole").items() if name.startswith("run_")}
    alive = done = tried = 0
    while tried < kills and time.monotonic() < until:
        tried += 1
        alive += _killed(words, dice.uniform(0.0, 1.3 * seconds))
        made = {name: data for name, data in _content(room / "runs").items() if name.startswith("run_")}
        if any(data != expected[name] for name, data in made.items()):
            sys.exit("batch: a run that is not whole")
        if len(made) == RUNS:
            _timed(words)
            done += 1
            if _content(room / "runs").get("manifest.jsonl", b"").count(b"\n") != RUNS:
                sys.exit("batch: a manifest that does not tell of all runs")
            if left := list((room / "runs").rglob(".*.partial*")):
                sys.exit(f"batch: left {left}")
            shutil.rmtree(room / "runs")
    if (room / "runs").exists():
        _timed(words)
        done += 1
    return f"{tried} kills of batches of {RUNS}, {alive} at work: {done} batches came to their end, all files the same"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kills", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--part", choices=("rewrites", "batches"), help="only one of them")
    parser.add_argument("--minutes", type=float, default=1e9, help="for batches")
    given = parser.parse_args()
    begun = time.monotonic()
    parts = {"rewrites": rewrites, "batches": partial(batches, minutes=given.minutes)}
    for part in [given.part] if given.part else parts:
        with tempfile.TemporaryDirectory() as room:
            print(parts[part](Path(room), given.kills, random.Random(given.seed)), flush=True)  # noqa: S311 - moments
    print(f"{time.monotonic() - begun:.0f} s")


if __name__ == "__main__":
    main()
