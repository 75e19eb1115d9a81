"""One pass for many runs gives what many single calls give: the same bytes."""

import json
import shlex
import zlib
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest
from bagged import messages_in

from odomcorrupt.bags.chunk import Chunk
from odomcorrupt.bags.open import open_reader
from odomcorrupt.batching.sinks import read_tum
from odomcorrupt.cli import run
from odomcorrupt.corruption.transform import Options
from odomcorrupt.forecasting import read_clean_drive
from odomcorrupt.geometry.se2 import wrap
from odomcorrupt.model.motion_model import MotionModel
from odomcorrupt.model.presets import preset_named

BAGS = ["office.bag", "office.mcap", "office_ros2"]
MODEL = ["--alpha", "5deg", "0.02", "0.05", "0.01"]
MODEL += ["--effect", "wheel_scale:e=0.01", "--effect", "time_offset:offset=0.05"]


def bytes_of(path):
    """Return a bag's files by what they are, without the bag's own name."""
    files = sorted(path.iterdir()) if path.is_dir() else [path]
    return [(file.name if path.is_dir() else "", file.read_bytes()) for file in files]


def messages_of(path):
    """Return a bag's messages by topic, in their order: log time and bytes."""
    found = {}
    for topic, *message in messages_in(path):
        found.setdefault(topic, []).append(tuple(message))
    return found


def records(directory):
    """Return what the manifest of a batch says of each run."""
    return [json.loads(line) for line in (directory / "manifest.jsonl").read_text().splitlines()]


@pytest.mark.parametrize("name", BAGS)
def test_every_run_has_the_bytes_of_the_command_in_the_manifest(name, here):
    assert run(["batch", name, "runs", "--runs", "3", *MODEL, "--seed", "7"]) == 0
    for record in records(here / "runs"):
        assert run(shlex.split(record["command"])[1:]) == 0
        alone = here / shlex.split(record["command"])[2]
        assert bytes_of(alone) == bytes_of(here / "runs" / record["file"])


def test_small_portions_and_groups_give_the_same_bytes(here, monkeypatch):
    assert run(["batch", "office.mcap", "one", "--runs", "4", *MODEL, "--seed", "7"]) == 0
    monkeypatch.setattr("odomcorrupt.batching.patch_batch.PORTION_MESSAGES", 7)
    monkeypatch.setattr("odomcorrupt.batching.engine.GROUP", 3)
    assert run(["batch", "office.mcap", "two", "--runs", "4", *MODEL, "--seed", "7"]) == 0
    for k in range(4):
        name = f"run_{k:06d}.mcap"
        assert (here / "one" / name).read_bytes() == (here / "two" / name).read_bytes()


def test_random_effects_and_book_laws_survive_the_shared_pass(here):
    words = "--alpha 0.05 0.17 0.05 0.01 --law linear --step 0.25m,0.2rad --twist-noise 0.1 0.02 --covariance keep"
    model = [*words.split(), "--effect", "slip_burst:rate=0.1,slip=0.3"]
    assert run(["batch", "office.mcap", "runs", "--runs", "2", *model, "--seed", "3"]) == 0
    assert run(["office.mcap", "alone.mcap", *model, "--seed", "3", "--run", "1"]) == 0
    assert (here / "alone.mcap").read_bytes() == (here / "runs" / "run_000001.mcap").read_bytes()


@pytest.mark.parametrize("name", ["office.bag", "office.mcap"])
@pytest.mark.parametrize("codec", [None, "none"])
def test_split_has_the_messages_of_full_with_the_changed_ones_apart(name, codec, here):
    more = [] if codec is None else ["--compression", codec]
    assert run(["batch", name, "full", "--runs", "2", *MODEL, "--seed", "7"]) == 0
    assert run(["batch", name, "split", "--runs", "2", *MODEL, "--seed", "7", "--layout", "split", *more]) == 0
    for k in range(2):
        file = f"run_{k:06d}{Path(name).suffix}"
        assert messages_of(here / "split" / file) == messages_of(here / "full" / file)
    with patch.object(Chunk, "goes_on_with", lambda *_: False), open_reader(here / "split" / file) as reader:
        odom = {c.id for c in reader.channels.values() if c.topic == "/odom"}
        others = [set(block.table["channel"].tolist()) for block in reader.blocks() if len(block.table)]
    assert any(odom & one for one in others)
    assert all(len(one - odom) <= 1 for one in others if odom & one)  # /tf alone goes with it


@pytest.mark.parametrize("name", BAGS)
def test_an_overlay_has_the_changed_topics_alone_and_assembles_to_the_full_bytes(name, here, capsys):
    assert run(["batch", name, "full", "--runs", "2", *MODEL, "--seed", "7"]) == 0
    assert run(["batch", name, "over", "--runs", "2", *MODEL, "--seed", "7", "--output", "overlay"]) == 0
    whole = here / "full" / f"run_000001{Path(name).suffix}"
    part = messages_of(here / "over" / "run_000001.mcap")
    assert part == {topic: some for topic, some in messages_of(whole).items() if topic in {"/odom", "/tf"}}
    assert run(["assemble", "over/run_000001.mcap", "joined" + Path(name).suffix]) == 0
    assert f"in place of those of {name}" in capsys.readouterr().err
    assert bytes_of(here / f"joined{Path(name).suffix}") == bytes_of(whole)


def test_trajectories_are_the_paths_of_the_whole_bags(here):
    typed = ["--alpha", "0.05", "0.02", "0.05", "0.01", "--seed", "7", "--runs", "3"]
    assert run(["batch", "office.mcap", "full", *typed]) == 0
    assert run(["batch", "office.mcap", "paths", *typed, "--output", "trajectories"]) == 0
    whole = np.load(here / "paths" / "trajectories.npz")
    model = MotionModel(preset_named("typical").noise)
    for k in range(3):
        with open_reader(here / "full" / f"run_{k:06d}.mcap") as reader:
            drive = read_clean_drive(reader, model, Options())
        path = read_tum(here / "paths" / f"run_{k:06d}.tum")
        assert np.array_equal(path.stamps_ns, drive.stamps_ns)
        assert np.abs(path.xyt[:, :2] - drive.xyt[:, :2]).max() < 2e-9
        assert np.abs(wrap(path.xyt[:, 2] - drive.xyt[:, 2])).max() < 1e-9
        assert np.array_equal(whole["xyt"][k], path.xyt)
    assert np.array_equal(whole["runs"], [0, 1, 2])
    assert np.array_equal(whole["stamps_ns"], drive.stamps_ns)


def test_a_model_that_does_nothing_copies_the_bag(here):
    assert run(["batch", "office.mcap", "runs", "--runs", "1", "--seed", "1", "--sweep", "alpha-scale=0,1"]) == 0
    still, moved = (here / "runs" / f"alpha-scale={k}" / "run_000000.mcap" for k in (0, 1))
    assert still.read_bytes() == (here / "office.mcap").read_bytes()
    assert moved.read_bytes() != still.read_bytes()


OUTPUTS = [["full"], ["full", "--layout", "split"], ["full", "--compression", "none"], ["overlay"], ["trajectories"]]


@pytest.mark.parametrize(
    ("bag", "output"),
    [*(("office.mcap", one) for one in OUTPUTS), ("office.bag", ["full"]), ("office.bag", ["overlay"])],
)
def test_recorded_checksums_are_those_of_the_files_which_are_read_again_only_in_ros1(here, monkeypatch, bag, output):
    read = []
    monkeypatch.setattr(
        "odomcorrupt.batching.manifest.crc32", lambda data, crc=0: read.append(len(data)) or zlib.crc32(data, crc)
    )
    assert run(["batch", bag, "runs", "--runs", "2", "--seed", "7", *MODEL, "--output", *output]) == 0
    made = records(here / "runs")
    files = [here / "runs" / record["file"] for record in made]
    assert [record["crc32"] for record in made] == [zlib.crc32(file.read_bytes()) for file in files]
    again = bag == "office.bag" and output[0] == "full"
    assert sum(read) == (sum(file.stat().st_size for file in files) if again else 0)
