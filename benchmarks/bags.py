"""How long a bag takes to be corrupted, beside copying it and beside the loops that people write: CPU and wall.

    python benchmarks/bags.py                        # 150 s of a robot with a camera, 600 MB raw, 3 rounds
    python benchmarks/bags.py --seconds 30 --rounds 5     # smaller bags: start-up is a larger part of it
    python benchmarks/bags.py --only "odom mcap zstd" --threads 1
    python benchmarks/bags.py --slope --only "camera mcap none"    # seconds per GB, apart from the start
    python benchmarks/bags.py --cpp ./loop_cpp    # beside the C++ MCAP library, too; loop_cpp.cpp says how to compile
    sudo python benchmarks/bags.py --first        # on a machine that has other work: measured processes come first

It makes the bags, then runs `odomcorrupt`, `cp`, a rosbags loop, an mcap loop and, where they are installed, a loop
over ROS 1's own rosbag and one with the C++ MCAP library, one after the other in every round, and takes the CPU
seconds (user + system) and the wall time of whole processes. Medians are printed, and ratios beside the goals. Bags
without a camera are 8 times as long, 120 000 messages at 150 s; the long one 133 times, 2 million: there the loops in
Python take minutes and are left out.
A round that is not counted comes first: it compiles modules, ours as well as theirs, as installing them does. Before
every process the bag is copied, memory beside it is written to, and both are given back: on a virtual machine whoever
first touches memory that the host had taken back pays for it, with up to 2 s for 600 MB, and that would be chance.
Linear algebra has one thread, for all.
Needs the test extra; writes into a folder of its own, and takes it away.
"""

from __future__ import annotations

import argparse
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from bag_files import WRITERS

HERE = Path(__file__).parent
TIMES = {"camera": 1, "odom": 8, "long": 400 / 3}
"""How many times as long as the one with a camera a bag is."""

SIZES = (1.0, 3.0, 10.0)
"""How many times as long the bags of --slope are."""

_BESIDE_BYTES = 300 << 20
"""What a process needs beside an output as large as its input; without a camera the output is larger."""


@dataclass(frozen=True)
class Case:
    """A bag, whom it is measured beside, and the goals: our time as a part of theirs, CPU and wall, if any."""

    name: str
    goals: dict[str, tuple[float | None, float | None]]

    @property
    def kind(self) -> str:
        """What is in it: of a robot with a camera, or odometry and TF alone."""
        return "camera" if self.length == "camera" else "odom"

    @property
    def length(self) -> str:
        """One of TIMES."""
        return self.name.split()[0]

    @property
    def format(self) -> str:
        """One of mcap, ros1, sqlite3."""
        return self.name.split()[1]

    @property
    def codec(self) -> str:
        """Of its chunks."""
        return self.name.split()[2]

    def file(self, folder: Path, what: str) -> Path:
        """Return where one of its bags is; the loops read the codec from the name."""
        suffix = {"mcap": ".mcap", "ros1": ".bag", "sqlite3": ""}[self.format]
        return folder / f"{self.name.replace(' ', '_')}_{what}{suffix}"


CASES = (
    Case("camera mcap zstd", {"cpp": (1.15, 0.8), "rosbags": (0.27, None), "mcap": (None, None)}),
    Case("camera mcap none", {"cpp": (1.2, None), "cp": (None, 1.6), "rosbags": (0.27, None)}),
    Case("camera mcap lz4", {"cpp": (1.5, None), "mcap": (None, None)}),
    Case("camera ros1 lz4", {"rosbags": (0.35, 0.25), "ros1": (0.22, None)}),
    Case("camera sqlite3 none", {"cp": (2.0, 2.0), "rosbags": (0.26, None)}),
    Case("long mcap zstd", {"cpp": (1.4, 1.0)}),
    Case("odom mcap zstd", {"rosbags": (0.09, 0.06), "cpp": (None, None), "mcap": (0.03, None)}),
    Case("odom ros1 lz4", {"rosbags": (0.09, 0.06), "ros1": (0.066, None)}),
)


@dataclass(frozen=True)
class Spent:
    """What a process took, seconds."""

    cpu_s: float
    wall_s: float


def ros1_python() -> str | None:
    """Return a Python that has ROS 1's rosbag, None without one."""
    python = shutil.which("python3", path="/usr/bin")
    asked = [python, "-c", "import rosbag"]
    if python is None or subprocess.run(asked, capture_output=True, check=False).returncode:  # type: ignore[list-item]
        return None
    return python


def commands(case: Case, source: Path, target: Path, given: argparse.Namespace) -> dict[str, list[str]]:
    """Return what is measured: each rewrites or copies source to target."""
    cpp, threads = given.cpp, [] if given.threads is None else ["--threads", str(given.threads)]
    out = {
        "cp": ["cp", "-r", str(source), str(target)],
        "odomcorrupt": [sys.executable, "-m", "odomcorrupt", str(source), str(target), "--seed", "1", *threads],
    }
    out |= {
        name: [sys.executable, str(HERE / f"loop_{name}.py"), str(source), str(target)]
        for name in case.goals
        if name not in ("cp", "cpp")
    }
    if "cpp" in case.goals and cpp is not None:
        out["cpp"] = [str(cpp.absolute()), str(source), str(target)]
    python = ros1_python()
    if "ros1" in out and python is None:
        del out["ros1"]
    elif "ros1" in out:
        out["ros1"][0] = str(python)
    return out


def environment(folder: Path) -> dict[str, str]:
    """Return that of the measured processes."""
    out = {key: value for key, value in os.environ.items() if key != "PYTHONDONTWRITEBYTECODE"}
    return out | {"OPENBLAS_NUM_THREADS": "1", "PYTHONPYCACHEPREFIX": str(folder / "compiled")}


def spent(command: list[str], env: dict[str, str]) -> Spent:
    """Run a process to its end and return what it took."""
    begun_s = time.perf_counter()
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, env=env)
    said = process.stderr.read() if process.stderr is not None else b""
    _, status, usage = os.wait4(process.pid, 0)
    wall_s = time.perf_counter() - begun_s
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        sys.exit(f"{' '.join(command)}: {said.decode()}")
    return Spent(usage.ru_utime + usage.ru_stime, wall_s)


def warm_up(source: Path, target: Path) -> None:
    """Have the input in memory, and as much free memory as a process and its output need."""
    (shutil.copytree if source.is_dir() else shutil.copyfile)(source, target)
    touched = b"1" * _BESIDE_BYTES
    del touched
    discard(target)


def discard(path: Path) -> None:
    """Remove an output, file or directory."""
    if path.is_dir():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


@dataclass
class Measured:
    """A bag, and what each command took with it in each round.

    size : MB
    """

    size: float
    taken: dict[str, list[Spent]]


def measure(case: Case, folder: Path, given: argparse.Namespace, lengths: tuple[float, ...] = (1.0,)) -> list[Measured]:
    """Return what each command took with bags of these lengths, all of them in each round."""
    bags: list[tuple[Path, Path, dict[str, list[str]]]] = []
    found: list[Measured] = []
    for times in lengths:
        source, target = case.file(folder, f"in_{times:g}"), case.file(folder, f"out_{times:g}")
        WRITERS[case.format](source, case.kind, case.codec, times * given.seconds * TIMES[case.length])
        files = source.iterdir() if source.is_dir() else [source]
        bags.append((source, target, commands(case, source, target, given)))
        found.append(Measured(sum(file.stat().st_size for file in files) / 1e6, {name: [] for name in bags[-1][2]}))
    first = ["chrt", "--rr", "10"] if given.first else []
    for number in range(1 + given.rounds):
        for (source, target, measured), one in zip(bags, found, strict=True):
            for name, command in measured.items():
                warm_up(source, target)
                took = spent([*first, *command], environment(folder))
                one.taken[name] += [took] if number else []  # the first round compiles
                discard(target)
        print(f"{case.name}: round {number} of {given.rounds}", file=sys.stderr, flush=True)
    for source, *_ in bags:
        discard(source)
    return found


def slopes(case: Case, folder: Path, given: argparse.Namespace) -> str:
    """Return a row for each command: wall and CPU time of no bytes, and of each GB, by a line through three sizes."""
    found = measure(case, folder, given, SIZES)
    sizes, rounds = [one.size * 1e-3 for one in found], [one.taken for one in found]
    rows, per_gb = [], {}
    for name in rounds[0]:
        for what in ("wall_s", "cpu_s"):
            # a line for each round, whose commands and sizes were interleaved
            lines = [
                statistics.linear_regression(sizes, [getattr(taken[name][number], what) for taken in rounds])
                for number in range(given.rounds)
            ]
            slopes, starts = [line.slope for line in lines], [line.intercept for line in lines]
            per_gb[name, what] = statistics.median(slopes)
            ratio = per_gb[name, what] / per_gb.get(("cp", what), per_gb[name, what])
            rows.append(
                f"| {case.name} | {name} | {what[:-2]} | {statistics.median(starts):.2f} | "
                f"{statistics.median(slopes):.2f} ({min(slopes):.2f} to {max(slopes):.2f}) | {ratio:.2f} |"
            )
    return "\n".join(rows)


def _median(taken: list[Spent]) -> Spent:
    return Spent(statistics.median(one.cpu_s for one in taken), statistics.median(one.wall_s for one in taken))


def _ratio(name: str, ours: Spent, theirs: Spent, goals: tuple[float | None, float | None]) -> str:
    """Return our CPU and wall time as parts of theirs, with goals in brackets."""
    parts = (ours.cpu_s / theirs.cpu_s, ours.wall_s / theirs.wall_s)
    shown = [f"{part:.2g}" + ("" if goal is None else f" ({goal:g})") for part, goal in zip(parts, goals, strict=True)]
    return f"{name} {shown[0]}, {shown[1]}"


def main() -> None:
    """Print a Markdown table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=150.0, help="of recording with a camera, 4 MB each")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--only", action="append", choices=[case.name for case in CASES])
    parser.add_argument("--folder", type=Path, help="where to write the bags")
    parser.add_argument("--threads", type=int, help="of odomcorrupt")
    parser.add_argument("--first", action="store_true", help="run what is measured before all else (chrt)")
    parser.add_argument("--cpp", type=Path, help="loop_cpp, compiled")
    parser.add_argument("--slope", action="store_true", help="bags of 1, 3 and 10 times the length: cost of a GB")
    given = parser.parse_args()
    if given.folder is not None and not given.folder.is_dir():
        sys.exit(f"{given.folder}: is not a directory; create it first")
    if given.slope:
        print(
            "| bag | command | time | of no bytes, s | per GB, s (least to most) | of cp's |\n|---|---|---|---|---|---|"
        )
        with tempfile.TemporaryDirectory(dir=given.folder) as folder:
            for case in CASES:
                if not given.only or case.name in given.only:
                    print(slopes(case, Path(folder), given), flush=True)
        return
    print(
        "| bag | MB | odomcorrupt: CPU, wall s | cp | CPU and wall as parts of those of (goal) |\n|---|---|---|---|---|"
    )
    with tempfile.TemporaryDirectory(dir=given.folder) as folder:
        for case in CASES:
            if given.only and case.name not in given.only:
                continue
            (one,) = measure(case, Path(folder), given)
            took = {name: _median(rounds) for name, rounds in one.taken.items()}
            ours, copied = took["odomcorrupt"], took["cp"]
            ratios = [_ratio(name, ours, took[name], goal) for name, goal in case.goals.items() if name in took]
            print(
                f"| {case.name} | {one.size:.0f} | {ours.cpu_s:.2f}, {ours.wall_s:.2f} | {copied.cpu_s:.2f}, "
                f"{copied.wall_s:.2f} | {'; '.join(ratios)} |",
                flush=True,
            )
    print(f"\nLoad of the machine, 1, 5 and 15 minutes: {', '.join(f'{load:.1f}' for load in os.getloadavg())}")


if __name__ == "__main__":
    main()
