"""What the coverage-guided fuzzer tries, and what it asks of it: see `coverage_fuzz.py`, which starts it."""

import argparse
import importlib
import json
import resource
import shutil
import sys
import time
import traceback
from collections import Counter
from pathlib import Path

import atheris
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "hostile"))

INSTRUMENTED = [
    "odomcorrupt.bags", "odomcorrupt.batching.manifest", "odomcorrupt.model.model_file",
    "odomcorrupt.effects.expression",
    "odomcorrupt.mapping.occupancy_grid", "odomcorrupt.study.io.text", "odomcorrupt.inspection",
]  # fmt: skip
"""What reads, or tells of what was read; to count the branches of the rest would only take time."""

WRITERS = ("mcap.writer", "ros1.writer", "rosbag2.sqlite_writer", "rosbag2.writer")
"""Modules that are imported when they are needed."""

with atheris.instrument_imports(include=INSTRUMENTED):
    for name in WRITERS:
        importlib.import_module(f"odomcorrupt.bags.{name}")
    from mutations import mutated
    from smallbags import make_small_bags
    from texts import TEXTS, TextTrial
    from trials import MODEL, FoundError, judged, others, rest_is_kept

    from odomcorrupt.bags.open import open_reader
    from odomcorrupt.batching.manifest import read_beginning, read_records
    from odomcorrupt.corruption.run import Container, corrupt_bag
    from odomcorrupt.corruption.transform import Options
    from odomcorrupt.inspection import scan_bag, summarise, summary_text

YAML, BOOK, BEGINNING = "metadata.yaml", "manifest.jsonl", "batch.json"
RECORD = {"run": 0, "file": "run_000000.mcap", "size": 4, "crc32": 1, "seed": 7, "errors": [[1.0, 0.1, 0.2, 0.3]]}
BEGUN = {
    "version": "0", "input": {"path": "a", "hash": "b"}, "model": {"text": "", "hash": "c"}, "robots": [], "seed": 7,
    "output": ["full", "as it was"], "options": ["", ""],
}  # fmt: skip
REPORT_S = 2.0


class Harness:
    """Tries inputs: one byte that says of what kind the rest is, and the rest."""

    def __init__(self, room: Path, keep: Path, report: Path) -> None:
        (room / "bags").mkdir()
        self.bags = make_small_bags(room / "bags", 0.3)
        self.kinds = [*self.bags, *TEXTS, YAML, BOOK, BEGINNING]
        self.counts: Counter[str] = Counter()
        self.found: list[str] = []
        self._room, self._keep, self._report = room, keep, report
        self._texts = TextTrial(room)
        self._next_s = 0.0
        self.seeds = [bytes([number]) + self._seed(kind) for number, kind in enumerate(self.kinds)]

    def _seed(self, kind: str) -> bytes:
        if kind in self.bags:
            return self._file(kind).read_bytes()
        if kind == YAML:
            return (self.bags["sqlite3 directory"].path / YAML).read_bytes()
        return {**TEXTS, BOOK: json.dumps(RECORD).encode(), BEGINNING: json.dumps(BEGUN).encode()}[kind]

    def _file(self, kind: str) -> Path:
        path = self.bags[kind].path
        return next(one for one in sorted(path.iterdir()) if one.suffix != ".yaml") if path.is_dir() else path

    def mutate(self, data: bytes, size: int, seed: int) -> bytes:
        """Return an input changed: as libFuzzer does, or as somebody who knows the formats, with true checksums."""
        rng = np.random.default_rng(seed)
        if len(data) < 2 or rng.random() < 0.4:
            return bytes(atheris.Mutate(data, size))
        other = self.seeds[int(rng.integers(len(self.seeds)))][1:]
        if rng.random() < 0.4:
            # one change of a sound input: most of these are accepted, and judged
            data = self.seeds[int(rng.integers(len(self.seeds)))]
        try:
            return (data[:1] + mutated(data[1:], other, rng)[1])[:size]
        except Exception:  # noqa: BLE001 - the tool that knows the formats gives up in its own ways
            # too damaged to have a structure
            return bytes(atheris.Mutate(data, size))

    def __call__(self, data: bytes) -> None:
        """Try an input."""
        if not data:
            return
        kind = self.kinds[data[0] % len(self.kinds)]
        self.counts["tried"] += 1
        self.counts[f"tried: {kind}"] += 1
        try:
            self._try(kind, data[1:])
        except FoundError as error:
            self._note(kind, data, error)
        if time.monotonic() >= self._next_s:
            self._next_s = time.monotonic() + REPORT_S
            self.write_report()

    def _note(self, kind: str, data: bytes, error: BaseException) -> None:
        cause = "".join(traceback.format_exception(error.__cause__)[-2:]) if error.__cause__ else ""
        told = f"{kind}: {error} {cause}".strip()
        self.counts["found"] += 1
        if len(self.found) < 200:
            (self._keep / f"{len(self.found):03d}").write_bytes(data)
            self.found.append(told[:1500])
        self.write_report()

    def write_report(self) -> None:
        """Write what was tried and found so far, and the most memory that was taken."""
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024
        values = {"counts": dict(sorted(self.counts.items())), "peak_mb": peak, "found": self.found}
        self._report.write_text(json.dumps(values, indent=1))

    def _try(self, kind: str, data: bytes) -> None:
        place = self._room / "trial"
        shutil.rmtree(place, ignore_errors=True)
        place.mkdir()
        if kind in self.bags or kind == YAML:
            self._try_bag(kind, data, place)
        elif kind in TEXTS:
            self.counts["refused" if self._texts.use(kind, data, np.random.default_rng(0)) else "read"] += 1
        else:
            (place / kind).write_bytes(data)
            (place / "run_000000.mcap").write_bytes(b"abcd")
            got = judged(read_records, place) if kind == BOOK else judged(read_beginning, place)
            self.counts["refused" if isinstance(got, Exception) else "read"] += 1

    def _try_bag(self, kind: str, data: bytes, place: Path) -> None:
        small = self.bags["sqlite3 directory" if kind == YAML else kind].path
        path, out = place / small.name, place / f"out{small.suffix}"
        if small.is_dir():
            shutil.copytree(small, path)
            (path / (YAML if kind == YAML else self._file(kind).name)).write_bytes(data)
        else:
            path.write_bytes(data)
        way = len(data) % 8
        if way == 0:
            got = judged(_described, path)
        elif way == 1:
            got = judged(_recovered, path)
        else:
            got = judged(_rewritten, path, out)
        if isinstance(got, Exception):
            self.counts["refused"] += 1
            if out.exists() or any(".partial" in one.name for one in place.iterdir()):
                raise FoundError(f"was refused ({got}) and left something")
        elif way > 1:
            known = others(path) is not None
            self.counts["rewritten, judged" if known else "rewritten, no other reader takes the input"] += 1
            if not rest_is_kept(path, out):
                raise FoundError("what another reader gets beside odometry and TF is not what it was")
        else:
            self.counts["described or recovered"] += 1


def _described(path: Path) -> None:
    with open_reader(path) as reader:
        seen = scan_bag(reader)
    summary_text(summarise(seen, odom_topic=None, odom_frame=None, base_frame=None))


def _recovered(path: Path) -> None:
    with open_reader(path, recover=True) as reader:
        for _ in reader.blocks():
            pass


def _rewritten(path: Path, out: Path) -> None:
    corrupt_bag(path, out, MODEL, seed=1, run=0, options=Options(), container=Container())


def fuzz(given: argparse.Namespace, room: Path) -> None:
    """Fuzz until the time is over; the program ends with it."""
    harness = Harness(room, given.keep, given.report)
    if given.again:
        harness(given.again.read_bytes())
        harness.write_report()
        return
    corpus = room / "corpus"
    corpus.mkdir()
    for number, seed in enumerate(harness.seeds):
        (corpus / f"{number:02d}").write_bytes(seed)
    bounds = ["-timeout=0", "-rss_limit_mb=0", "-max_len=200000", "-len_control=0", "-verbosity=0"]
    words = [sys.argv[0], str(corpus), *bounds, f"-max_total_time={given.seconds}", f"-seed={given.seed}"]
    atheris.Setup(words, harness, custom_mutator=harness.mutate)
    atheris.Fuzz()


def main() -> None:
    """Be the process that libFuzzer ends."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=int, required=True)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--keep", type=Path, required=True)
    parser.add_argument("--report", type=Path, required=True)
    parser.add_argument("--room", type=Path, required=True)
    parser.add_argument("--again", type=Path)
    given = parser.parse_args()
    fuzz(given, given.room)


if __name__ == "__main__":
    main()
