"""Corruption with `--map`, as a user runs it."""

import io
import json
import sys
from pathlib import Path

import numpy as np
import pytest

from odomcorrupt.cli import run
from odomcorrupt.mapping.occupancy_grid import OCCUPIED, Grid, format_map, free_space, read_map
from odomcorrupt.trajectories import read_drive

FIXTURES = Path(__file__).parents[2] / "fixtures"
OFFICE = FIXTURES / "office.mcap"
ALPHA = ["--alpha", "0.1", "0.1", "0.1", "0.1"]


@pytest.fixture
def corridor(tmp_path):
    """Walls 0.4 m to both sides of the office's own path."""
    xy = read_drive(OFFICE, "/odom").xyt[:, :2]
    low = np.floor(xy.min(axis=0) - 1.0)
    columns, rows = (np.ceil((xy.max(axis=0) + 1.0 - low) / 0.1)).astype(int)
    middle = low + 0.1 * (np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1) + 0.5)
    gap = np.full((rows, columns), np.inf)
    for place in xy[::5]:
        gap = np.minimum(gap, np.hypot(*np.moveaxis(middle - place, -1, 0)))
    image, text = format_map(Grid((gap > 0.4).astype(np.uint8) * OCCUPIED, 0.1, np.append(low, 0.0)), "map.pgm")
    (tmp_path / "map.pgm").write_bytes(image)
    (tmp_path / "map.yaml").write_text(text)
    return tmp_path / "map.yaml"


def feed(monkeypatch, path):
    class Pipe:
        buffer = io.BytesIO(path.read_bytes())

        def isatty(self):
            return False

    monkeypatch.setattr(sys, "stdin", Pipe())


@pytest.mark.slow
def test_file_and_pipe_give_the_same_bytes_and_the_map_is_noted_in_them(corridor, tmp_path, capsys, monkeypatch):
    words = ["--seed", "7", *ALPHA, "--odom-topic", "/odom", "--map", str(corridor), "--map-pose", "0,0,0"]
    assert run([str(OFFICE), str(tmp_path / "a.mcap"), *words, "--robot-radius", "0"]) == 0
    said = capsys.readouterr().err
    assert int(said.split("Map: ")[1].split(" of ")[0]) > 100
    feed(monkeypatch, OFFICE)
    assert run(["-", str(tmp_path / "b.mcap"), *words, "--robot-radius", "0"]) == 0
    data = (tmp_path / "a.mcap").read_bytes()
    assert data == (tmp_path / "b.mcap").read_bytes()
    assert b"endpoint, 100 tries, odom at 0.0,0.0,0.0, blocked cells" in data
    assert str(tmp_path).encode() not in data


def test_without_noise_the_file_is_copied(corridor, tmp_path):
    words = [str(OFFICE), str(tmp_path / "a.mcap"), "--alpha", "0", "0", "0", "0", "--seed", "1"]
    assert run([*words, "--map", str(corridor), "--map-pose", "0,0,0"]) == 0
    assert (tmp_path / "a.mcap").read_bytes() == OFFICE.read_bytes()


@pytest.mark.parametrize(
    ("more", "code", "word"),
    [
        (["--map", "MAP"], 1, "TF has nothing between 'map' and 'odom'"),
        (["--map", "/map"], 1, "no nav_msgs/OccupancyGrid on /map"),
        (["--map", "MAP", "--map-pose", "0,0,0", "--effect", "wheel_scale:e=0.02"], 1, "wheel_scale is not noise"),
        (["--map", "MAP", "--map-pose", "0,0,0", "--keep-localisation"], 2, "leave out one"),
        (["--map", "MAP", "--map-pose", "90,0,0"], 1, "the drive begins at"),
        (["--map-pose", "0,0,0"], 2, "needs a map; name it with --map"),
        (["--map-check", "path"], 2, "needs a map; name it with --map"),
        (["--robot-radius", "0.1"], 2, "needs a map; name it with --map"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line_and_leaves_nothing(more, code, word, corridor, tmp_path, capsys):
    words = [str(corridor) if one == "MAP" else one for one in more]
    before = set(tmp_path.iterdir())
    assert run([str(OFFICE), str(tmp_path / "out.mcap"), *ALPHA, "--seed", "1", *words]) == code
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1
    assert word in lines[0]
    assert set(tmp_path.iterdir()) == before


def test_pipe_needs_a_map_file_and_a_pose(corridor, tmp_path, capsys, monkeypatch):
    for where in (["--map", str(corridor)], ["--map", "/map", "--map-pose", "0,0,0"]):
        feed(monkeypatch, OFFICE)
        assert run(["-", str(tmp_path / "out.mcap"), "--odom-topic", "/odom", "--seed", "1", *where]) == 2
        assert "INPUT is a pipe and read once" in capsys.readouterr().err


@pytest.mark.slow
def test_batches_and_pipes_draw_whole_paths_where_single_increments_are_stuck(corridor, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    short = FIXTURES / "office_ros2"
    # few tries are what narrow places do: an increment is given up soon
    words = [*ALPHA, "--seed", "7", "--map", str(corridor), "--map-pose", "0,0,0", "--robot-radius", "0"]
    words += ["--max-tries", "2", "--odom-topic", "/odom"]
    assert run(["batch", str(short), "runs", "--runs", "3", "--to", "mcap", "-q", *words]) == 0
    whole = 0
    for number in range(3):
        single = tmp_path / f"single{number}.mcap"
        capsys.readouterr()
        assert run([str(short), str(single), "--run", str(number), "-v", *words]) == 0
        whole += "one of 64 paths, resampled" in capsys.readouterr().err
        assert single.read_bytes() == (tmp_path / "runs" / f"run_{number:06d}.mcap").read_bytes()
    assert whole > 0
    assert run([str(short), "plain.mcap", "--effect", "wheel_scale:e=0", "-q"]) == 0
    feed(monkeypatch, tmp_path / "plain.mcap")
    assert run(["-", "piped.mcap", "--run", "1", "-q", *words]) == 0
    moved = [read_drive(tmp_path / name, "/odom").xyt for name in ("piped.mcap", "single1.mcap")]
    np.testing.assert_array_equal(*moved)


@pytest.mark.slow
def test_a_fleet_keeps_to_the_map_and_its_commands_name_it(corridor, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name, size in (("a.toml", 0.08), ("b.toml", 0.12)):
        noise = "\n".join(f"{one} = {size}" for one in ("rot_rot", "rot_trans", "trans_trans", "trans_rot"))
        Path(name).write_text(f'schema = 1\n[noise]\nlaw = "diffusion"\n{noise}\n')
    words = ["--map", str(corridor), "--map-pose", "0,0,0", "--robot-radius", "0"]
    fleet = ["--fleet", "a.toml", "--fleet", "b.toml"]
    assert run(["batch", str(OFFICE), "runs", "--runs", "2", "--seed", "7", "-q", *fleet, *words]) == 0
    walls = free_space(read_map(corridor), 0.0, unknown="free", map_from_odom=np.zeros(3))
    for line in (tmp_path / "runs" / "manifest.jsonl").read_text().splitlines():
        record = json.loads(line)
        assert "--map" in record["command"]
        assert walls.free(read_drive(tmp_path / "runs" / record["file"], "/odom").xyt[:, :2]).all()
