"""Write the bags, pictures and figures of docs/tutorial-laser.md.

    python docs/make_tutorial_laser.py FOLDER

A robot whose wheels stand 4 % farther apart than its driver has it drives about an office, simulated wheel by wheel and
seen by a ray-cast laser; no truth is written. Needs the study and test extras.
"""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parent / "benchmarks")]

from laser.bag import write_bag  # noqa: E402 - after the path
from laser.drives import drive  # noqa: E402

from odomcorrupt.cli import run  # noqa: E402

ROBOT = {"parameters": {"e": 0.04}, "yaw_from": "encoders", "robot_seed": 3}
DRIVES = {"run.mcap": (501, 180.0), "other.mcap": (502, 120.0)}
IMAGES = HERE / "images"


def write_bags(folder: Path) -> None:
    """Write the bags of the page."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, (seed, duration_s) in DRIVES.items():
        write_bag(folder / name, drive(seed, "wheelbase", "office", duration_s=duration_s, route="loops", **ROBOT))


def main() -> None:
    """Make the bags, then run the commands of the page in its order."""
    folder = Path(sys.argv[1])
    write_bags(folder)
    at = {name: str(folder / name) for name in (*DRIVES, "robot.toml", "map.yaml", "corrected.mcap", "falls.png")}
    for words in (
        ["learn", at["run.mcap"], "--scan", "/scan", "--validate", at["other.mcap"], "-o", at["robot.toml"],
         "--plot", at["falls.png"], "--overwrite"],
        ["learn", at["run.mcap"], "--scan", "/scan", "--validate", at["other.mcap"], "-v"],
        ["map", at["run.mcap"], "--scan", "/scan", "--method", "laser", "-o", at["map.yaml"], "--overwrite"],
        ["correct", at["other.mcap"], at["corrected.mcap"], "--model", at["robot.toml"], "--overwrite"],
        ["export", at["robot.toml"], "--to", "nav2"],
    ):  # fmt: skip
        print("$ odomcorrupt", *(word.removeprefix(f"{folder}/") for word in words), flush=True)
        if run(words) != 0:
            sys.exit(1)
    shutil.copy(folder / "map.png", IMAGES / "laser_map.png")
    shutil.copy(folder / "falls.png", IMAGES / "laser_falls.png")


if __name__ == "__main__":
    main()
