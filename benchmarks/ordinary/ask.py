"""Run of each case through the public command line: learn a model, then use it with every command."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import tomllib
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ordinary.bags import read_odometry, write_bag
from ordinary.drives import Drive, drive, error_10s, expected, flaw_of
from ordinary.machine import Odometry
from ordinary.platforms import PLATFORMS
from ordinary.truths import composed

if TYPE_CHECKING:
    from ordinary.cases import Case

__all__ = ["ask", "write_case"]

LONGEST_S = 900
RUNS = 20
LEFT_OUT = ("comparison", "candidates", "detectable", "next_drive")
"""Keys of the answer that are not stored in the results."""


def ask(case: Case, keep: str = "") -> dict[str, Any]:
    """Return the results of a case; its files are kept in the folder `keep`, if given."""
    if keep:
        folder = Path(keep) / case.key.replace("/", "_")
        folder.mkdir(parents=True, exist_ok=True)
        return _asked(case, folder)
    with tempfile.TemporaryDirectory(prefix="ordinary") as temporary:
        return _asked(case, Path(temporary))


def write_case(case: Case, folder: Path) -> tuple[Drive, Drive, list[str]]:
    """Write learned.mcap, judged.mcap and clean.mcap (exact odometry); return drives and options."""
    learned, judged = drive(case), drive(case, judged=True)
    write_bag(folder / "learned.mcap", learned.odometry, learned.truth.messages)
    write_bag(folder / "judged.mcap", judged.odometry, judged.truth.messages)
    times = judged.odometry.time_s
    poses = judged.body.at(times)
    speeds = np.column_stack([np.interp(times, judged.body.time_s, row) for row in (judged.body.v, judged.body.w)])
    write_bag(folder / "clean.mcap", Odometry(times, times, poses, speeds), [])
    options = ["--odom", "/odom", "--truth", learned.truth.option]
    platform = PLATFORMS[case.how.platform]
    if case.how.track and platform.drive == "differential":
        options += ["--track", str(platform.track_m)]
    return learned, judged, options


def _asked(case: Case, folder: Path) -> dict[str, Any]:
    learned, judged, options = write_case(case, folder)
    model = folder / "robot.toml"
    row: dict[str, Any] = {"flaw": flaw_of(case), "expected": asdict(expected(case)), "event": learned.body.event}
    said = _called(["learn", str(folder / "learned.mcap"), *options, "-o", str(model), "--json", "--overwrite"])
    row["command"] = f"odomcorrupt learn learned.mcap {' '.join(options)} -o robot.toml --json"
    if said.returncode or not model.exists():
        return row | {"learn": _why(said)}
    answer = json.loads(said.stdout)
    row["answer"] = {key: _short(value) for key, value in answer.items() if key not in LEFT_OUT}
    row["model"] = model.read_text()
    row["uses"], row["after_m"] = _used(folder, judged, learned, options)
    return row


def _used(folder: Path, judged: Drive, learned: Drive, options: list[str]) -> tuple[dict[str, str], float | None]:
    """Return the error message of each use of the model ("" for none), and the held-out error after correction (m)."""
    model, clean, out = folder / "robot.toml", str(folder / "clean.mcap"), folder / "corrected.mcap"
    places = _start(model, judged, learned)
    uses = {
        "correct": ["correct", str(folder / "judged.mcap"), str(out), "--model", str(model), "--odom-topic", "/odom",
                    "--overwrite", *places],
        "compare": ["compare", str(folder / "judged.mcap"), str(model), *options, "--json"],
        "corrupt": [clean, str(folder / "noisy.mcap"), "--model", str(model), "--seed", "1", "--overwrite"],
        "batch": ["batch", clean, str(folder / "runs"), "--model", str(model), "--runs", str(RUNS), "--seed", "2",
                  "--output", "trajectories"],
    }  # fmt: skip
    complaints = {name: _why(done) if (done := _called(words)).returncode else "" for name, words in uses.items()}
    after = None if complaints["correct"] else _after(judged, out, tomllib.loads(model.read_text()))
    return complaints, after


def _start(model: Path, judged: Drive, learned: Drive) -> list[str]:
    """Return options with the start of the judged drive in the frame of the learned truth, if the model has a place."""
    text = model.read_text()
    places = any(word in text for word in ("region_slip", "slope", "hard_iron")) or any(
        f" {letter} " in line or f"({letter}" in line
        for line in text.splitlines() if line.startswith("expression") for letter in ("x", "y", "theta")
    )  # fmt: skip
    if not places:
        return []
    x, y, theta = judged.exact(judged.odometry.time_s[:1])[0]
    if learned.truth.sigma_rad is None:  # fixes are relative to the first one of the learned recording
        first = learned.truth.messages[0].stamp_s[:1]
        x, y = np.array([x, y]) - learned.exact(first)[0, :2]
    return ["--start", f"{x:.4f},{y:.4f},{theta:.4f}"]


def _after(judged: Drive, corrected: Path, model: dict[str, Any]) -> float:
    """Return the 10 s error (m) of corrected odometry, with the clock, lever arm and mounting of [setup] applied."""
    stamps, xyt = read_odometry(corrected)
    setup = model.get("setup", {})
    clocks = setup.get("clock", [])
    if clocks:
        rate = float(clocks[0].get("clock_skew", 0.0))
        stamps = (stamps - float(clocks[0].get("time_offset", 0.0))) / (1.0 + rate)
    mark = np.zeros(3)
    for effect in setup.get("effect", []):
        if effect["name"] == "lever_arm":
            mark[:2] = _number(effect.get("x", 0.0)), _number(effect.get("y", 0.0))
        if effect["name"] == "mount_yaw":
            mark[2] = _number(effect.get("yaw", 0.0))
    return error_10s(judged, stamps, composed(xyt, mark))


def _number(value: Any) -> float:
    if isinstance(value, dict):
        value = value["value"]
    return float(value.split("+-")[0]) if isinstance(value, str) else float(value)


def _called(words: list[str]) -> subprocess.CompletedProcess[str]:
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "1"}
    try:
        return subprocess.run(
            [sys.executable, "-m", "odomcorrupt", *words], capture_output=True, text=True, timeout=LONGEST_S,
            check=False, env=environment,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return subprocess.CompletedProcess(words, 124, "", f"took longer than {LONGEST_S} s")


def _why(done: subprocess.CompletedProcess[str]) -> str:
    lines = done.stderr.strip().splitlines()
    return f"exit {done.returncode}: {lines[-1] if lines else 'nothing said'}"


def _short(value: Any) -> Any:
    """Return an answer without its long curves."""
    if isinstance(value, dict):
        return {key: _short(inner) for key, inner in value.items() if key not in ("centres", "curve", "detail")}
    return [_short(inner) for inner in value] if isinstance(value, list) else value
