"""Maps by scan matching: the same from Python as from the command line, and of the largest part alone."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import raycaster

import odomcorrupt as oc
from odomcorrupt.cli import run
from odomcorrupt.laser.mapping import laser_brief, laser_maps, laser_text
from odomcorrupt.study.io.laser_truth import laser_run


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    """Return a bag of odometry and scans in a room."""
    return raycaster.drive(tmp_path_factory.mktemp("laser") / "run.mcap", stated=(0.1, 0.0, 0.0), rate_hz=2.0)


@pytest.mark.slow
def test_maps_by_the_laser_are_those_of_the_command_line(bag, tmp_path, capsys):
    words = ["map", str(bag), "--method", "laser", "--seed", "2", "-o", str(tmp_path / "b.yaml"), "--json"]
    assert run(words) == 0
    values = json.loads(capsys.readouterr().out)
    stages = []
    done = oc.draw_maps(bag, method="laser", seed=2, watch=lambda stage, _: stages.append(stage))
    assert done.to_dict() == values
    assert stages[0] == "matching scans"
    files = done.save(tmp_path / "a.yaml")
    done.plot(tmp_path / "a.png")
    assert [file.name for file in files] == ["a.yaml", "a.pgm", "a.tum"]
    for file in (*files, tmp_path / "a.png"):
        own = file.read_bytes().replace(b"image: a", b"image: b")
        assert own == (tmp_path / f"b{file.suffix}").read_bytes()
    assert done.method == "laser"
    assert len(done.trajectory) == len((tmp_path / "a.tum").read_text().splitlines())
    assert done.summary().headline == f"MATCHED {done.matched.placed}"


def test_a_part_that_the_map_does_not_cover_is_stated(bag):
    whole = laser_run(bag, "run", None, None)
    cut = replace(whole, path=replace(whole.path, part=(whole.path.t_s > 22.0).astype(np.int64)))
    drawn = laser_maps(cut, np.zeros((len(whole.odometry), 3)), 0.2)
    assert drawn.parts.startswith("2 parts that no scan connects: the map covers 0-22 s only")
    assert drawn.placed.startswith(f"{np.count_nonzero(whole.path.t_s <= 22.0)} of ")
    assert [line.label for line in laser_brief(drawn, ()).lines[:3]] == ["MATCHED", "parts", "walls"]
    assert drawn.parts in laser_text(drawn).splitlines()
    # the odometry without noise makes the map of the odometry
    np.testing.assert_array_equal(drawn.maps[1].grid.cells, drawn.maps[2].grid.cells)
