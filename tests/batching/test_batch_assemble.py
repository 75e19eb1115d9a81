"""Overlays are put back into the bag they were made from, and into no other."""

import shutil
from pathlib import Path

import pytest

from odomcorrupt.cli import run

NOISE = ("--alpha", "0.05", "0.02", "0.05", "0.01", "--seed", "7")


@pytest.fixture
def runs(here):
    """Make overlays of the office, and whole bags to compare with."""
    assert run(["batch", "in.mcap", "runs", "--runs", "1", "--output", "overlay", *NOISE]) == 0
    assert run(["in.mcap", "whole.mcap", *NOISE]) == 0
    return next(Path("runs").glob("run_*"))


def refused(capsys, *words):
    capsys.readouterr()
    assert run(["assemble", *map(str, words)]) == 1
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert not Path("out.mcap").exists()
    return said


def test_an_input_that_is_gone_or_another_is_reported(runs, capsys):
    shutil.move("in.mcap", "moved.mcap")
    assert "the batch's input is not there; name it with --input" in refused(capsys, runs, "out.mcap")
    shutil.copy("whole.mcap", "in.mcap")
    assert "has changed since the batch was made from it" in refused(capsys, runs, "out.mcap")
    assert run(["assemble", str(runs), "out.mcap", "--input", "moved.mcap"]) == 0


def test_an_overlay_does_not_go_into_a_bag_of_other_topics(runs, capsys):
    said = refused(capsys, "whole.mcap", "out.mcap", "--input", runs)
    assert "has topics that" in said
    assert "name the input it was made from" in said
