"""Own loop: a perfect simulation is corrupted with a model of each effect, and the model is learned again from it.

    python -m benchmarks.own_loop [--seed 1] [--size 3] [--effects wheelbase ...] [--simulators gazebo ...] [-o JSON]

A robot is driven by hand in a room for four minutes, and its odometry is the truth with the stamps of three simulators:
poses by Euler steps at 100 Hz with 2.2 ms of jitter, rounded to steps of 1 ms; even steps of 16 ms; 50 Hz with stamps
of single precision beside a truth of 30 Hz. `Model.corrupt_path` adds little noise and an effect, whose amplitudes are
`--size` times usual; `learn` compares the result with the truth. An answer is right if the effect, or one with the same
f, is among the sure names (confidence from 0.9), "cannot tell" if there is no sure name, wrong if all sure names are
other ones, and has an extra if one of them is. Without an effect (`none`) it is right if there is no sure name.
"""

from __future__ import annotations

import argparse
import collections
import json
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

import odomcorrupt as oc
from benchmarks.laboratory.cases import same_class
from benchmarks.plain_mistakes import ORIGIN_S, Robot, drive
from odomcorrupt.effects import effect_from_values, registry
from odomcorrupt.effects.effect import parameters
from odomcorrupt.geometry.se2 import Increments, accumulate

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from odomcorrupt.effects.effect import Effect

SURE = 0.9
NOISE = oc.Noise(alpha=(0.005, 0.017, 0.005, 0.001))
OF = {"steering": "tricycle", "sideways": "omni", "rear_axle": "tricycle"}
"""Drive types that show the effects whose names begin so; all others are shown by a differential drive."""
SKIPPED = ("region_slip", "slip_event", "latency", "odometry_stop", "push", "time_offset", "clock_skew", "lever_arm",
           "mount_yaw")  # fmt: skip
"""Effects of one place or moment, and of the measurement rather than of the robot."""


def gazebo(robot: Robot, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return odometry and truth (n, 4) with jittering and repeated stamps of whole steps; odometry by Euler steps."""
    truth = accumulate(np.zeros(3), Increments.of_rows(robot.steps))[1:]
    ahead = truth[:-1, 2]
    steps = np.hypot(robot.steps[1:, 0], robot.steps[1:, 1])[:, None] * np.column_stack((np.cos(ahead), np.sin(ahead)))
    steps *= np.sign(robot.steps[1:, :1])
    euler = np.column_stack((np.vstack((np.zeros(2), np.cumsum(steps, axis=0))), truth[:, 2]))
    stamps = np.sort(np.round(robot.t_s + rng.normal(0.0, 0.0022, len(robot.t_s)), 3))
    seen = np.column_stack([np.interp(stamps, robot.t_s, x) for x in (euler if robot.kind != "omni" else truth).T])
    return np.column_stack((stamps, seen)), np.column_stack((robot.t_s, truth))


def webots(robot: Robot, _rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return odometry and truth (n, 4) at even steps of 16 ms."""
    both = _at(robot, np.arange(0.0, robot.t_s[-1], 0.016))
    return both, both


def mujoco(robot: Robot, _rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return odometry at 50 Hz with stamps of single precision, and truth (n, 4) at 30 Hz."""
    odometry, truth = (_at(robot, np.arange(0.0, robot.t_s[-1], 1.0 / hz)) for hz in (50.0, 30.0))
    odometry[:, 0] = (odometry[:, 0] + 1000.0).astype(np.float32).astype(np.float64) - 1000.0
    return odometry, truth


SIMULATORS: dict[str, Callable[[Robot, np.random.Generator], tuple[np.ndarray, np.ndarray]]] = {
    "gazebo": gazebo, "webots": webots, "mujoco": mujoco,
}  # fmt: skip


def _at(robot: Robot, t_s: np.ndarray) -> np.ndarray:
    xyt = accumulate(np.zeros(3), Increments.of_rows(robot.steps))[1:]
    return np.column_stack((t_s, *(np.interp(t_s, robot.t_s, x) for x in xyt.T)))


def usual(name: str, times: float) -> Effect:
    """Return an effect whose parameters have their usual sizes, and its amplitudes so many times these, if possible."""
    sizes = {p.name: min(p.typical * (times if p.amplitude else 1.0), p.high) for p in parameters(registry()[name])}
    return effect_from_values(name, sizes)


def learned(odometry: np.ndarray, truth: np.ndarray, effect: Effect | None, seed: int, kind: str) -> oc.Learned:
    """Return what is learned of odometry (n, 4) that is corrupted with an effect, and a truth (n, 4)."""
    model = oc.Model(NOISE, effects=[effect] if effect else [], track_m=0.3)
    # of equal stamps, the library keeps the first
    odometry = odometry[np.concatenate(([True], np.diff(odometry[:, 0]) > 0.0))]
    noisy = model.corrupt_path(odometry[:, 0], odometry[:, 1:], seed=seed)[0]
    with tempfile.TemporaryDirectory() as folder:
        paths = [Path(folder) / f"{role}.csv" for role in ("odometry", "truth")]
        for path, (t_s, xyt) in zip(paths, ((odometry[:, 0], noisy), (truth[:, 0], truth[:, 1:])), strict=True):
            table = np.column_stack((t_s + ORIGIN_S, xyt))
            np.savetxt(path, table, fmt="%.9f", delimiter=",", header="t,x,y,yaw", comments="")
        drive_type = {"tricycle": "tricycle", "omni": "omni"}.get(kind, "differential")
        track = {"track_m": 0.3} if kind == "differential" else {}
        return oc.learn(oc.read_recordings(paths[0], truth_bag=paths[1], drive_type=drive_type, **track))


def verdict(found: oc.Learned, name: str) -> tuple[str, list[str]]:
    """Return the class of an answer, and its sure systematic names."""
    alike = same_class(name)  # a lever arm of the recording is an error of the robot of the same f
    named = [one for one in found.found if one["kind"] != "setup" or same_class(one["effect"]) == alike]
    sure = [one["effect"] for one in named if (one["confidence"] or 0.0) >= SURE]
    wrong = [one for one in sure if same_class(one) != alike]
    if not sure:
        return "cannot tell" if name else "right", sure
    if len(wrong) == len(sure):
        return "wrong", sure
    return "extra" if wrong else "right", sure


def cases(given: argparse.Namespace) -> Iterator[tuple[str, str, np.ndarray, np.ndarray, str]]:
    """Return simulator, effect, odometry, truth and drive type of each case."""
    every = sorted(name for name, kind in registry().items() if name not in SKIPPED)
    for number, name in enumerate(["", *(given.effects or every)]):
        kind = next((kind for begin, kind in OF.items() if name.startswith(begin)), "differential")
        for simulator, recorded in SIMULATORS.items():
            if given.simulators and simulator not in given.simulators:
                continue
            seed = 1000 * given.seed + 10 * number + list(SIMULATORS).index(simulator)
            robot = drive(seed, kind, 240.0)
            yield simulator, name, *recorded(robot, np.random.default_rng(seed)), kind


def main() -> None:
    """Print a line a case, and a table of the classes by simulator."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--size", type=float, default=3.0, help="amplitudes, in usual sizes")
    parser.add_argument("--effects", nargs="+", metavar="EFFECT")
    parser.add_argument("--simulators", nargs="+", choices=SIMULATORS)
    parser.add_argument("-o", "--output", type=Path, help="JSON file of all answers")
    given = parser.parse_args()
    count: dict[str, collections.Counter[str]] = collections.defaultdict(collections.Counter)
    rows = []
    for simulator, name, odometry, truth, kind in cases(given):
        begun = time.process_time()
        effect = usual(name, given.size) if name else None
        try:
            answer, sure = verdict(found := learned(odometry, truth, effect, given.seed, kind), name)
            said = str(found).splitlines()[0]
        except oc.OdomCorruptError as why:
            answer, sure, said = "refused", [], str(why)
        count[simulator][answer] += 1
        spent_s = round(time.process_time() - begun, 1)
        rows.append({"simulator": simulator, "effect": name, "answer": answer, "sure": sure, "cpu_s": spent_s})
        print(f"{answer:12}{simulator:8}{name or 'none':22}{spent_s:6} s  {said}", flush=True)
    for simulator, counted in count.items():
        print(simulator, dict(counted))
    if given.output:
        given.output.write_text(json.dumps(rows, indent=0) + "\n")


if __name__ == "__main__":
    main()
