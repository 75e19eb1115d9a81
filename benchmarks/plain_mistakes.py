"""Sweep of plain mistakes: factors, signs, axes, units, counters and headings, planted at the wheels or in the truth.

    python -m benchmarks.plain_mistakes [--seed 1] [--count 300] [--learn 0]

Shares no formula with the table that it tests: a robot is driven by hand in a room, its wheels are counted, and one
driver or a publisher with one mistake makes odometry or truth of them. A mistake counts as said first if the first row
of the table that is found is the right one; as wrong and sure if another one is, or if a control has any. With --learn
the whole of `learn` is run on so many of them, and models that raise the held-out error are counted.
"""

from __future__ import annotations

import argparse
import collections
import json
import re
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np

from odomcorrupt.errors import RecordingError
from odomcorrupt.study.io import Source, read_runs
from odomcorrupt.study.io.first_look import PATTERNS

HZ, ORIGIN_S = 100.0, 1_700_000_000
FACTORS = (1 / 100, 1 / 57.3, 1 / 10, 1 / 4, 1 / 3.3, 0.45, 2.0, 2.5, 3.28, 4.0, 10.0, 39.4, 57.3, 100.0)


class Robot(NamedTuple):
    """A drive: times (n,), true motions (n, 3) per step forwards, to the left and about z, and the drive type."""

    t_s: np.ndarray
    steps: np.ndarray
    kind: str
    track_m: float
    rng: np.random.Generator


class Case(NamedTuple):
    """Odometry and truth as (times, x, y, yaw), the planted mistake, and the rows that name it; () for a control."""

    odometry: np.ndarray
    truth: np.ndarray
    planted: str
    right: tuple[str, ...]


def drive(seed: int, kind: str, seconds: float) -> Robot:
    """Return somebody's drive in a room: straights, curves, turns on the spot, reverse, sideways if it can."""
    rng = np.random.default_rng(seed)
    track = float(rng.uniform(0.15, 0.6))
    top, turn = rng.uniform(0.2, 0.8), rng.uniform(0.4, 1.0)
    want = np.zeros((int(seconds * HZ), 3))
    at = int(HZ)
    while at < len(want):
        n, speed = int(rng.uniform(1.0, 4.0) * HZ), top * rng.uniform(0.4, 1.0)
        bend = rng.choice([-1, 1]) * turn * rng.uniform(0.3, 1.0)
        act = rng.random()
        if act < 0.1:
            motion = (0.0, 0.0, 0.0)
        elif act < 0.25:
            motion = (-0.6 * speed, 0.0, 0.5 * bend if kind == "tricycle" else 0.0)
        elif act < 0.5:
            motion = (speed, 0.0, bend) if kind == "tricycle" else (0.0, 0.0, bend)
        elif act < 0.6 and kind == "omni":
            motion = (0.0, speed * rng.choice([-1, 1]), 0.0)
        elif act < 0.75:
            motion = (speed, 0.0, 0.0)
        else:
            motion = (speed, 0.0, bend)
        want[at : at + n] = motion
        at += n
    smooth = np.ones(int(0.4 * HZ)) / int(0.4 * HZ)
    rates = np.column_stack([np.convolve(x, smooth, mode="same") for x in want.T])
    return Robot(np.arange(len(want)) / HZ, rates / HZ, kind, track, rng)


def path(steps: np.ndarray) -> np.ndarray:
    """Return poses (n, 3) along steps (n, 3)."""
    yaw = np.cumsum(steps[:, 2])
    middle = yaw - steps[:, 2] / 2.0
    x = np.cumsum(steps[:, 0] * np.cos(middle) - steps[:, 1] * np.sin(middle))
    y = np.cumsum(steps[:, 0] * np.sin(middle) + steps[:, 1] * np.cos(middle))
    return np.column_stack((x, y, yaw))


def counted(robot: Robot) -> np.ndarray:
    """Return the counted motion (n, 3): slip on each wheel, ticks of 0.1 mm; steered and omni robots count the body."""
    slip = 0.002 * np.sqrt(np.abs(robot.steps)) * robot.rng.standard_normal(robot.steps.shape)
    if robot.kind != "differential":
        return robot.steps + slip
    arm = robot.steps[:, 2] * robot.track_m / 2.0
    wheels = [
        np.floor(np.cumsum(robot.steps[:, 0] + side * arm + slip[:, i]) / 1e-4) * 1e-4 for i, side in ((0, -1), (1, 1))
    ]
    left, right = (np.diff(w, prepend=w[0]) for w in wheels)
    return np.column_stack(((left + right) / 2.0, 0.0 * left, (right - left) / robot.track_m))


def plant(seed: int, seconds: float = 100.0) -> Case:  # noqa: C901, PLR0912, PLR0915 - one branch a mistake
    """Return a drive with one plain mistake, or a control."""
    rng = np.random.default_rng(seed + 10_000)
    kind = str(rng.choice(["differential", "differential", "tricycle", "omni"]))
    robot = drive(seed, kind, seconds)
    own, real = counted(robot), path(robot.steps)
    headed = rng.random() < 0.75
    k = float(rng.choice(FACTORS))
    wheels = kind == "differential"
    kinds = [
        "control",
        "radius",
        "track",
        "travel",
        "exchanged",
        "negated",
        "backwards",
        "truth unit",
        "truth mirrored",
        "truth upright",
        "truth degrees",
        "truth frozen",
        "y ahead",
    ]
    kinds += ["encoder", "no direction", "overflow"] if wheels else []
    what = str(rng.choice(kinds))
    if what in ("negated", "backwards", "no direction", "y ahead", "encoder", "truth degrees", "truth frozen"):
        headed = True
    right: tuple[str, ...] = ()
    if what == "radius":
        own, right = own * k, ("wheel radius", "turns too far")
        own[:, 2] = own[:, 2]
    elif what == "track":
        own, right = own * [1.0, 1.0, k], ("wheel separation", "turns too far")
    elif what == "travel":
        own, right = own * [k, k, 1.0], ("travel",)
    elif what == "exchanged":
        own, right = own * [1.0, -1.0, -1.0], ("left and right exchanged",)
    elif what == "negated":
        own, right = -own, ("both wheels negated",)
    elif what == "backwards":
        own, right = own * [-1.0, -1.0, 1.0], ("forward is -x",)
    elif what == "y ahead":
        side = rng.choice([-1.0, 1.0])
        own, right = np.column_stack((-side * own[:, 1], side * own[:, 0], own[:, 2])), ("turned axes",)
    elif what == "encoder":
        flipped = rng.choice([-1.0, 1.0])
        ahead, turned = own[:, 0], own[:, 2] * robot.track_m / 2.0
        own = np.column_stack((flipped * turned, 0.0 * ahead, flipped * ahead * 2.0 / robot.track_m))
        right = ("wheel gains",)
    elif what == "no direction":
        arm = own[:, 2] * robot.track_m / 2.0
        left, rightw = np.abs(own[:, 0] - arm), np.abs(own[:, 0] + arm)
        own, right = (
            np.column_stack(((left + rightw) / 2.0, 0.0 * left, (rightw - left) / robot.track_m)),
            ("sign",),
        )
    elif what == "overflow":
        bits = int(rng.choice([12, 13, 16]))
        arm = own[:, 2] * robot.track_m / 2.0
        angle = [np.cumsum(own[:, 0] + side * arm) for side in (-1.0, 1.0)]
        tick = 1e-4 * 4096 / 2**bits
        half = 2 ** (bits - 1) * tick
        left, rightw = (np.diff(np.mod(a + half, 2 * half), prepend=half) for a in angle)
        own, right = (
            np.column_stack(((left + rightw) / 2.0, 0.0 * left, (rightw - left) / robot.track_m)),
            ("overflow",),
        )
    pose, moved = real + np.array([0.7, -0.4, 0.0]), path(own)
    xyz = np.column_stack((pose[:, :2], 0.0 * pose[:, 0]))
    yaw = pose[:, 2]
    if what == "truth unit":
        unit, right = float(rng.choice([100.0, 1000.0])), ("unit of lengths", "speed", "travel")
        xyz *= unit
    elif what == "truth mirrored":
        xyz, yaw, right = xyz * [1.0, -1.0, 1.0], -yaw, ("left and right exchanged",)
    elif what == "truth upright":
        xyz, right, headed = xyz[:, [1, 2, 0]], ("plane",), False
    elif what == "truth degrees":
        yaw, right = np.degrees(yaw), ("steps and headings",)
    elif what == "truth frozen":
        yaw = 0.0 * yaw  # as of satellites: its positions alone are used
    rate = float(rng.choice([50.0, 20.0, 10.0] if headed else [20.0, 10.0, 5.0]))
    rows = np.arange(0, len(robot.t_s), int(HZ / rate))
    scale = 100.0 if what == "truth unit" else 1.0
    xyz = xyz[rows] + 0.001 * scale * rng.standard_normal((len(rows), 3)) * [1.0, 1.0, what == "truth upright"]
    yaw = yaw[rows] + (
        0.003 * (57.3 if what == "truth degrees" else 1.0) * rng.standard_normal(len(rows))
        if what != "truth frozen"
        else 0.0
    )
    truth = np.column_stack((robot.t_s[rows], xyz, yaw if headed else np.full(len(rows), np.nan)))
    every = np.arange(0, len(robot.t_s), int(rng.choice([2, 2, 4])))
    return Case(
        np.column_stack((robot.t_s[every], moved[every])),
        truth,
        f"{what} {kind} x{k:.3g} {'poses' if headed else 'positions'}",
        right,
    )


def written(case: Case, folder: Path) -> tuple[Path, Path]:
    """Write odometry and truth as CSV files."""
    first, second = folder / "odometry.csv", folder / "truth.csv"
    lines = [f"{ORIGIN_S + t:.6f},{x:.9f},{y:.9f},{yaw:.9f}" for t, x, y, yaw in case.odometry]
    first.write_text("\n".join(["t,x,y,yaw", *lines]))
    headed = bool(np.isfinite(case.truth[0, 4]))
    lines = [
        f"{ORIGIN_S + r[0]:.6f},{r[1]:.6f},{r[2]:.6f},{r[3]:.6f}" + (f",{r[4]:.6f}" if headed else "")
        for r in case.truth
    ]
    second.write_text("\n".join(["t,x,y,z,yaw" if headed else "t,x,y,z", *lines]))
    return first, second


def found_in(first: Path, second: Path) -> tuple[tuple[str, ...], str]:
    """Return the rows of the table that are found, in order, and the sentence of a refusal."""
    try:
        (run, *_) = read_runs(Source(first, truth_path=second))
    except RecordingError as error:
        said = str(error)
        words = ((p.name, f"usual causes: {p.causes}".split("{")[0], re.split(r"\{\w+\}", p.seen)) for p in PATTERNS)
        return tuple(name for name, causes, seen in words if causes in said and max(seen, key=len) in said), said
    return tuple(one.name for one in run.mistakes), ""


def main() -> int:
    """Run the sweep and print its table."""
    ask = argparse.ArgumentParser(description=__doc__)
    ask.add_argument("--seed", type=int, default=1)
    ask.add_argument("--count", type=int, default=300)
    ask.add_argument("--learn", type=int, default=0)
    options = ask.parse_args()
    table: dict[str, collections.Counter[str]] = collections.defaultdict(collections.Counter)
    worse = learned = 0
    for i in range(options.count):
        seed = options.seed * 100_000 + i
        case = plant(seed)
        with tempfile.TemporaryDirectory() as folder:
            first, second = written(case, Path(folder))
            names, said = found_in(first, second)
            if i < options.learn:
                learned += 1
                worse += _is_worse(first, second, Path(folder) / "model.toml")
        if not case.right:
            outcome = "right first" if not names and not said else "wrong"
        else:
            outcome = "right first" if names and names[0] in case.right else "wrong" if names or said else "not said"
        if outcome != "right first":
            print(f"{outcome}: seed {seed}, {case.planted}: {names} {said[:200]}", flush=True)
        table[case.planted.split(" differential")[0].split(" tricycle")[0].split(" omni")[0]][outcome] += 1
    total: collections.Counter[str] = collections.Counter()
    for what, row in sorted(table.items()):
        total += row
        print(f"{what:16} {row['right first']:4} right first, {row['not said']:3} not said, {row['wrong']:3} wrong")
    print(f"{'all':16} {total['right first']:4} right first, {total['not said']:3} not said, {total['wrong']:3} wrong")
    if learned:
        print(f"learn: {worse} of {learned} written models raise the 10 s error")
    return total["wrong"] > 0 or worse > 0


def _is_worse(first: Path, second: Path, model: Path) -> bool:
    """Return whether `learn` writes a model that raises the 10 s error on the recording by more than a tenth."""
    words = ["--truth-bag", str(second)]
    run = [sys.executable, "-m", "odomcorrupt"]
    done = subprocess.run(
        [*run, "learn", str(first), *words, "-o", str(model)], capture_output=True, text=True, check=False
    )
    head = " / ".join(done.stdout.splitlines()[:9])
    print(f"  learn exit {done.returncode}: {head or done.stderr[-200:]}", flush=True)
    if not model.exists():
        return False
    judged = subprocess.run(
        [*run, "compare", str(first), *words, str(model), "--json"], capture_output=True, text=True, check=False
    )
    values = json.loads(judged.stdout)
    return values["models"][-1]["ten_second_error_m"] > 1.1 * values["raw_error_m"] if "models" in values else False


if __name__ == "__main__":
    sys.exit(main())
