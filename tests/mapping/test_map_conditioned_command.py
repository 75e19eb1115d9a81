import csv

import numpy as np
import pytest

from odomcorrupt.cli import run
from odomcorrupt.commands._options import POSE
from odomcorrupt.mapping.conditioned import read_map_from_odom
from odomcorrupt.mapping.occupancy_grid import free_space, read_map
from odomcorrupt.trajectories import read_drive
from recordings import RECORDINGS

GAZEBO, MAPS = RECORDINGS / "real" / "rob521_gazebo.mcap", RECORDINGS / "bags" / "maps"
OLIN = RECORDINGS / "bags" / "olin_tb4"
TURTLEBOT = RECORDINGS / "bags" / "evo" / "nav2_turtlebot.mcap"


def ends(path):
    with path.open() as file:
        return np.array([[float(row["x_m"]), float(row["y_m"])] for row in csv.DictReader(file)])


@pytest.mark.slow
@pytest.mark.recordings
@pytest.mark.parametrize("command", ["sample", "corrupt"])
@pytest.mark.parametrize(
    ("bag", "yaml", "pose", "seed"),
    [
        (GAZEBO, MAPS / "rob521_gazebo.yaml", "0,0,0", 3),
        (TURTLEBOT, MAPS / "depot.yaml", None, 7),  # TF says where odom is
        # found by laying its scans onto its map
        (OLIN / "macfirst_floor_take_2", OLIN / "maps" / "mac_1st_floor_final.yaml", "-0.25,0.12,4deg", 7),
    ],
)
def test_no_pose_is_in_a_wall_with_the_map_and_some_are_without(command, bag, yaml, pose, seed, tmp_path, capsys):
    where = [] if pose is None else ["--map-pose", pose]
    found = read_map_from_odom(bag, "map", "odom") if pose is None else np.array(POSE.convert(pose, None, None))
    walls = free_space(read_map(yaml), 0.0, unknown="free", map_from_odom=found)
    with_map = ["--map", str(yaml), *where, "--robot-radius", "0.1", "--unknown", "free"]
    for name, more in (("with", with_map), ("without", [])):
        out = tmp_path / f"{name}{'.csv' if command == 'sample' else bag.suffix}"
        words = {
            "sample": ["sample", str(bag), "-n", "40", "--every", "0.5", "--seed", "3", "-o", str(out)],
            "corrupt": [str(bag), str(out), "--seed", str(seed)],
        }[command]
        assert run([*words, "--alpha", *["0.1"] * 4, *more]) == 0
        assert ("drawn again" in capsys.readouterr().err) is (name == "with")
        free = walls.free(ends(out) if command == "sample" else read_drive(out, "/odom").xyt[:, :2])
        assert free.all() is np.bool_(name == "with")


@pytest.mark.recordings
def test_lecture_star_is_not_reached_by_a_path(tmp_path):
    arguments = ["sample", "--start", "4,1,20deg", "--end", "6,1.3,0", "--alpha", "0.3", "0.4", "0.2", "0.1"]
    arguments += ["--map", str(MAPS / "rob521_gazebo.yaml"), "--unknown", "free", "--seed", "2", "-o"]
    behind = {}
    for check in ("endpoint", "path"):
        assert run([*arguments, str(tmp_path / f"{check}.csv"), "--map-check", check]) == 0
        xy = ends(tmp_path / f"{check}.csv")
        # over the wall that ends at x = 5, further right than any straight way through the gap leads
        behind[check] = int(((xy[:, 1] > 2.1) & (xy[:, 0] > 5.5)).sum())
    assert behind["endpoint"] > 20
    assert behind["path"] == 0


@pytest.mark.parametrize(
    ("arguments", "code", "word"),
    [(["--map", "/map"], 2, ".yaml"), (["--map-pose", "0,0,0"], 2, "--map"), (["--map", "gone.yaml"], 1, "gone.yaml")],
)
def test_map_that_is_not_there_is_reported_in_one_line(arguments, code, word, capsys):
    assert run(["sample", "--seed", "1", *arguments]) == code
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1
    assert word in lines[0]
