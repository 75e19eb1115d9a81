"""Damage everything that is read, at random, and try it: `python tests/hostile/fuzz.py --cases 100000 --seed 1`.

A case is a seed: `--only BAG --case N` tries a single one again. Prints how many of what were tried and what came of
them; stops at the first promise that is broken, unless told to go on.
"""

# ruff: noqa: T201 - a script that prints

from __future__ import annotations

import argparse
import itertools
import resource
import sys
import tempfile
import time
import traceback
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))

from intact import chunk_counts, untouched
from mutations import mutated
from smallbags import Small, make_small_bags
from texts import TEXTS, TextTrial
from trials import ACTIONS, BagTrial, FoundError

if TYPE_CHECKING:
    from collections.abc import Callable


class Fuzz:
    """Tries cases: kind by kind in turn, each from a seed of its own."""

    def __init__(self, room: Path, seed: int) -> None:
        self.seed = seed
        (room / "bags").mkdir()
        (room / "trials").mkdir()
        self.bags: dict[str, Small] = make_small_bags(room / "bags")
        self.kinds = [*self.bags, *TEXTS]
        self.files = [file for small in self.bags.values() for file in _files(small.path)]
        self.bag_trial = BagTrial(room / "trials")
        self.text_trial = TextTrial(room / "trials")
        self.tried: Counter[str] = Counter()

    @property
    def counts(self) -> Counter[str]:
        """How many cases of each kind were tried, and what came of them, by action."""
        return self.tried + self.bag_trial.outcomes + self.text_trial.outcomes

    def case(self, kind: str, number: int) -> None:
        rng = np.random.default_rng([self.seed, self.kinds.index(kind), number])
        self.tried[kind] += 1
        if kind in TEXTS:
            self.text_trial.run(kind, rng)
            return
        small = self.bags[kind]
        files = _files(small.path)
        file = files[int(rng.integers(len(files)))]
        other = self.files[int(rng.integers(len(self.files)))]
        way, data = mutated(file.read_bytes(), other.read_bytes(), rng)
        place = self.bag_trial.lay(small.path, file.name if small.path.is_dir() else None, data)
        chunks = chunk_counts(file) if file == small.path else []
        # a chunk of another bag may claim the messages behind it where nothing is in chunks
        foreign = kind == "mcap unchunked" and way in ("graft", "splice")
        left = 0 if foreign else untouched(chunks, file.read_bytes(), data)
        self.bag_trial.run(place, small.count, way, ACTIONS[int(rng.integers(len(ACTIONS)))], left)


def _files(path: Path) -> list[Path]:
    return sorted(path.iterdir()) if path.is_dir() else [path]


def script(doc: str, make: Callable[[Path, int], Fuzz]) -> int:
    """Be a script that tries cases of what `make` returns for a folder and a seed, and prints what came of them."""
    parser = argparse.ArgumentParser(description=doc.splitlines()[0])
    parser.add_argument("--cases", type=int, default=10_000)
    parser.add_argument("--begin", type=int, default=0, help="go on with this case of each kind")
    parser.add_argument("--hours", type=float, default=1e9, help="stop after so long")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", help="one kind")
    parser.add_argument("--case", type=int, help="one case of it")
    parser.add_argument("--go-on", action="store_true", help="tell of what is found and go on")
    parser.add_argument("--room", type=Path, help="where to work, best in memory [default: as for temporary files]")
    given = parser.parse_args()
    begun, found = time.monotonic(), []
    with tempfile.TemporaryDirectory(dir=given.room) as room:
        tempfile.tempdir = room
        fuzz = make(Path(room), given.seed)
        kinds = [given.only] if given.only else fuzz.kinds
        numbers = [given.case] if given.case is not None else range(given.begin, given.cases // len(kinds) + 1)
        for number, kind in itertools.product(numbers, kinds):
            if time.monotonic() - begun > given.hours * 3600 or (found and not given.go_on):
                print(f"go on with --begin {number}")
                break
            try:
                fuzz.case(kind, number)
            except FoundError as error:
                cause = "".join(traceback.format_exception(error.__cause__)[-3:]) if error.__cause__ else ""
                found.append(f"--seed {given.seed} --only '{kind}' --case {number}: {error}")
                print(f"{found[-1]}\n{cause}", flush=True)
        peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024
        print(f"seed {given.seed}, {time.monotonic() - begun:.0f} s, {peak_mb} MB, {len(found)} promises broken")
        print("\n".join(f"{what} {count}" for what, count in sorted(fuzz.counts.items())))
    return int(bool(found))


if __name__ == "__main__":
    sys.exit(script(__doc__, Fuzz))
