"""Runs of a batch are those of single calls, byte for byte, with every option and on a cluster."""

import importlib.util
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import time
import zlib
from dataclasses import replace
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest
from bagged import messages_in
from mcap.reader import make_reader
from mcap.writer import Writer

import odomcorrupt
import odomcorrupt as oc
from odomcorrupt.api.batch import Spread
from odomcorrupt.bags.chunk import Chunk
from odomcorrupt.bags.open import open_reader
from odomcorrupt.batching.sinks import read_tum
from odomcorrupt.cli import run
from odomcorrupt.corruption.transform import Options
from odomcorrupt.forecasting import read_clean_drive
from odomcorrupt.geometry.se2 import wrap
from odomcorrupt.model.motion_model import MotionModel
from odomcorrupt.model.presets import preset_named
from recordings import FIXTURES
from terminal import on_a_terminal

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


RUNS = 48

absent = pytest.mark.skipif(
    importlib.util.find_spec("distributed") is None,
    reason='dask is not installed: pip install ".[dask]" to have this tested',
)


def start(*words, cwd):
    env = os.environ | {"PYTHONPATH": str(Path(odomcorrupt.__file__).parent.parent)}
    return subprocess.Popen(
        [sys.executable, "-m", *words], cwd=cwd, env=env, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )


def wait_for(what, seconds=60.0):
    deadline = time.monotonic() + seconds
    while not (found := what()):
        assert time.monotonic() < deadline, "waited in vain"
        time.sleep(0.01)
    return found


@pytest.fixture
def cluster(tmp_path):
    """Yield the scheduler's address, and its two workers."""
    file = tmp_path / "scheduler.json"
    processes = [
        start("dask", "scheduler", "--host", "127.0.0.1", "--port", "0", "--scheduler-file", file.name,
              "--dashboard-address", "127.0.0.1:0", "--no-dashboard", cwd=tmp_path)
    ]  # fmt: skip
    try:
        wait_for(file.exists)
        time.sleep(0.2)
        address = json.loads(file.read_text())["address"]
        words = ("dask", "worker", address, "--nthreads", "1", "--nworkers", "1", "--no-nanny", "--no-dashboard")
        processes += [start(*words, "--name", name, cwd=tmp_path) for name in ("first", "second")]
        yield address, processes[1:]
    finally:
        for process in processes:
            process.kill()
            process.wait()


@absent
@pytest.mark.slow
def test_a_worker_killed_half_way_changes_no_byte(cluster, here):
    typed = ["--runs", str(RUNS), "--alpha", "0.05", "0.02", "0.05", "0.01", "--seed", "7"]
    address, workers = cluster
    ready = "import sys; from distributed import Client; Client(sys.argv[1]).wait_for_workers(2, timeout=60)"
    subprocess.run([sys.executable, "-c", ready, address], check=True, capture_output=True)
    batch = start("odomcorrupt", "batch", "in.mcap", "far", *typed, "--dask", address, cwd=here)
    wait_for(lambda: len(list(here.glob("far/run_*"))) >= RUNS // 4)
    parts_before = {path.name for path in here.glob("far/.parts/*.jsonl")}
    workers[0].kill()
    made = len(list(here.glob("far/run_*")))
    assert batch.wait(timeout=120) == 0
    assert made < RUNS, "the worker was killed too late to matter"
    assert len(parts_before) == 2, "both workers had work"
    assert run(["batch", "in.mcap", "near", *typed]) == 0
    near, far = (
        {path.name: path.read_bytes() for path in (here / name).iterdir() if path.is_file()} for name in ("near", "far")
    )
    assert set(near) == {*(f"run_{k:06d}.mcap" for k in range(RUNS)), "manifest.jsonl", "batch.json", "model.toml",
                         "clean.tum"}  # fmt: skip
    assert {name: data for name, data in far.items() if not name.startswith(".")} == near


def test_without_dask_the_extra_is_named(here, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "distributed", None)
    assert run(["batch", "in.mcap", "runs", "--runs", "1", "--seed", "1", "--dask", "tcp://127.0.0.1:1"]) == 1
    assert 'pip install ".[dask]"' in capsys.readouterr().err


NOISE = ["--alpha", "5deg", "0.02", "0.05", "0.01", "--seed", "7"]
OPTIONS = {
    "effects": MODEL[5:],
    "truth": ["--keep-truth", "/odom_true"],
    "localisation": ["--keep-localisation"],
    "correction": ["--tf", "correction", "--new-odom-frame", "odom0"],
    "all": ["--keep-truth", "/odom_true", "--tf", "correction", "--new-odom-frame", "odom0", "--recover"],
}


@pytest.mark.parametrize(
    ("name", "options"),
    [
        *((name, options) for name in BAGS for options in ("effects", "all")),
        *zip(BAGS, ("truth", "localisation", "correction"), strict=True),
    ],
)
def test_options_of_corruption_give_the_bytes_of_the_command_in_the_manifest(name, options, here, monkeypatch):
    monkeypatch.setattr("odomcorrupt.batching.patch_batch.PORTION_MESSAGES", 300)
    assert run(["batch", name, "runs", "--runs", "2", *NOISE, *OPTIONS[options]]) == 0
    for record in records(here / "runs"):
        words = shlex.split(record["command"])[1:]
        assert set(OPTIONS[options]) <= set(words)
        assert run(words) == 0
        assert bytes_of(here / words[1]) == bytes_of(here / "runs" / record["file"])
    made, before = messages_of(here / "runs" / record["file"]), messages_of(here / name)
    if "--keep-truth" in OPTIONS[options]:
        assert made["/odom_true"] == before["/odom"]
    if "correction" in OPTIONS[options]:
        assert made["/odom"] == before["/odom"]
        assert len(made["/tf"]) == len(before["/tf"]) + len(before["/odom"])


@pytest.mark.parametrize("name", ["office.mcap", "office.bag"])
@pytest.mark.parametrize("options", ["truth", "correction"])
def test_split_has_the_messages_of_full_with_what_is_added(name, options, here):
    for layout in ("same", "split"):
        assert run(["batch", name, layout, "--runs", "2", *NOISE, *OPTIONS[options], "--layout", layout]) == 0
    file = f"run_000001{Path(name).suffix}"
    apart, whole = messages_of(here / "split" / file), messages_of(here / "same" / file)
    assert apart.keys() == whole.keys()
    for topic, messages in whole.items():
        assert sorted(apart[topic]) == sorted(messages)


def halves(directory):
    """Make a ROS 2 bag of two MCAP files of the office."""
    directory.mkdir()
    with (FIXTURES / "office.mcap").open("rb") as stream:
        messages = list(make_reader(stream).iter_messages())
    middle = len(messages) // 2
    for number, some in enumerate((messages[:middle], messages[middle:])):
        with (directory / f"half_{number}.mcap").open("wb") as stream:
            writer = Writer(stream, chunk_size=1 << 14)
            writer.start("ros2")
            ids = {}
            for schema, channel, message in some:
                if channel.topic not in ids:
                    known = writer.register_schema(schema.name, schema.encoding, schema.data)
                    # ids that differ from file to file
                    if number and not ids:
                        writer.register_channel("/first", channel.message_encoding, known)
                    ids[channel.topic] = writer.register_channel(channel.topic, channel.message_encoding, known)
                writer.add_message(ids[channel.topic], message.log_time, message.data, message.publish_time)
            writer.finish()


@pytest.mark.slow
@pytest.mark.parametrize("options", [[], OPTIONS["all"]])
def test_split_parts_every_file_of_a_directory(options, here):
    halves(here / "two")
    for layout in ("same", "split"):
        assert run(["batch", "two", layout, "--runs", "2", *NOISE, *options, "--layout", layout]) == 0
    assert run(["two", "alone", *NOISE, *options, "--run", "1"]) == 0
    assert bytes_of(here / "alone") == bytes_of(here / "same" / "run_000001")
    for file in ("half_0.mcap", "half_1.mcap"):
        apart, whole = (messages_of(here / layout / "run_000001" / file) for layout in ("split", "same"))
        assert {topic: sorted(one) for topic, one in apart.items()} == {t: sorted(one) for t, one in whole.items()}
    half = here / "split" / "run_000001" / "half_1.mcap"
    with patch.object(Chunk, "goes_on_with", lambda *_: False), open_reader(half) as reader:
        odom = {c.id for c in reader.channels.values() if c.topic == "/odom"}
        topics = {c.id: c.topic for c in reader.channels.values()}
        held = [set(block.table["channel"].tolist()) for block in reader.blocks() if len(block.table)]
    assert {topics[one] for some in held if some & odom for one in some} <= {"/odom", "/tf", "/odom_true"}


def test_split_of_sqlite3_is_refused_and_says_why(here, capsys):
    assert run(["batch", "office_ros2", "runs", "--runs", "1", *NOISE, "--layout", "split"]) == 1
    assert "sqlite3 has no chunks" in capsys.readouterr().err
    assert not (here / "runs").exists()


@pytest.mark.parametrize("flag", [["--keep-truth", "/true"], OPTIONS["correction"]])
@pytest.mark.parametrize("output", ["overlay", "trajectories"])
def test_what_adds_messages_is_refused_where_only_changes_are_written(flag, output, here, capsys):
    assert run(["batch", "office.mcap", "runs", "--runs", "1", *NOISE, *flag, "--output", output]) == 2
    assert "adds messages" in capsys.readouterr().err
    assert not (here / "runs").exists()


@pytest.mark.parametrize("output", ["full", "overlay"])
def test_damaged_bag_is_recovered_for_every_run_and_what_is_lost_is_reported(output, here, invoke):
    whole = (FIXTURES / "office.mcap").read_bytes()
    (here / "cut.mcap").write_bytes(whole[: len(whole) // 2])
    words = ["batch", "cut.mcap", "runs", "--runs", "2", *NOISE, "--output", output]
    assert run(words) == 1
    assert "\nlost   " in invoke([*words, "--recover", "-v"], 3).err
    assert run(["cut.mcap", "alone.mcap", *NOISE, "--run", "1", "--recover"]) == 3
    made = here / "runs" / "run_000001.mcap"
    if output == "overlay":
        assert run(["assemble", str(made), "joined.mcap", "--recover"]) == 0
        made = here / "joined.mcap"
    assert made.read_bytes() == (here / "alone.mcap").read_bytes()
    assert all(record["losses"] for record in records(here / "runs"))
    assert "--recover" in shlex.split(records(here / "runs")[0]["command"])


def test_models_and_inputs_that_are_swept_have_directories_whose_commands_make_their_bytes(here, capsys):
    for name, scale in (("a", "0.01"), ("b", "0.02")):
        (here / f"{name}.toml").write_text(
            "schema = 1\n[noise]\nrot_rot = 0.03\nrot_trans = 0.02\ntrans_trans = 0.02\ntrans_rot = 0.0\n"
            f'[[effect]]\nname = "wheel_scale"\ne = {scale}\n'
        )
    sweep = ["--sweep", "model=a.toml,b.toml", "--sweep", "alpha-scale=0.5,1", "--seed", "3"]
    assert run(["batch", "office.mcap", "office.bag", "runs", "--runs", "2", *sweep]) == 1
    assert "two of them are called office" in capsys.readouterr().err
    assert not (here / "runs").exists()
    (here / "other.bag").symlink_to(FIXTURES / "office.bag")
    assert run(["batch", "office.mcap", "other.bag", "runs", "--runs", "2", *sweep]) == 0
    points = sorted((here / "runs").glob("*/*"))
    assert [one.relative_to(here / "runs").as_posix() for one in points] == [
        f"{bag}/model={model},alpha-scale={scale}"
        for bag in ("office", "other") for model in "ab" for scale in ("0.5", "1")
    ]  # fmt: skip
    seen = set()
    for point in points:
        record = records(point)[1]
        words = shlex.split(record["command"])[1:]
        assert run([*words, "--overwrite"]) == 0
        made = (point / record["file"]).read_bytes()
        assert (here / words[1]).read_bytes() == made
        seen.add(made)
    assert len(seen) == len(points)


def test_a_sweep_says_the_drift_of_each_point_and_its_next_command_works(here, invoke):
    words = ["batch", "office.mcap", "runs", "--runs", "2", "--output", "trajectories", *NOISE]
    *_, low, high, following = invoke([*words, "--sweep", "alpha-scale=0.5,2"]).err.splitlines()
    for line, name in ((low, "alpha-scale=0.5"), (high, "alpha-scale=2")):
        drift = [one["drift"]["end_drawn_m"] for one in records(here / "runs" / name)]
        rms_m = (sum(value**2 for value in drift) / len(drift)) ** 0.5
        assert line.endswith(f"of 25.05 m: {name}")
        assert f"{rms_m:.3g} m, " in line
    assert run(shlex.split(following)[2:]) == 0


@pytest.mark.slow
def test_a_spread_differs_from_the_prediction_by_chance_as_rarely_as_it_says(here):
    """19 of 20 groups of 20 runs are said to be as predicted."""
    oc.batch("office.mcap", "runs", model="typical", runs=400, seed=5, output="trajectories")
    report = oc.spread("runs").result
    errors = np.array([one["errors"][-1] for one in records(here / "runs")])[:, 1:3].reshape(20, 20, 2)
    ratios = np.linalg.norm(errors.std(axis=1, ddof=1), axis=1)

    def verdict(runs, ratio):
        last = replace(report.rows[-1], position_m=float(ratio))
        return Spread(replace(report, runs=runs, rows=(last,))).summary().lines[0].label

    assert 17 <= [verdict(20, one) for one in ratios].count("AS PREDICTED") <= 20
    assert verdict(report.runs, 1.2 * ratios.mean()) == "WIDER"


@pytest.mark.parametrize("jobs", ["1", "2"])
def test_terminal_sees_runs_grow_within_a_pass(jobs, tmp_path):
    program = (
        "import odomcorrupt.batching.engine as pulse, time; pulse.PAUSE_S = 0.0\n"
        "import sys; from odomcorrupt.cli import run; sys.exit(run(sys.argv[1:]))\n"
    )
    script = tmp_path / "slow.py"
    # a worker that is spawned imports the script again, with the shorter pause
    script.write_text(program.replace("import sys;", "if __name__ == '__main__':\n  import sys;"))
    words = ["batch", str(FIXTURES / "office.mcap"), str(tmp_path / "runs"), "--runs", "8", "--seed", "1"]
    said = on_a_terminal(80, str(script), *words, "--jobs", jobs, "--alpha", "0.1", "0.1", "0.1", "0.1")
    lines = re.findall(r"(\d+) of 8 runs[^\r]*", said)
    assert "s of the bag" in said
    assert "8 runs made now" in said
    counts = [int(line) for line in lines]
    assert counts == sorted(counts)
    assert counts[-1] == 8


ALPHA = ("--alpha", "0.05", "0.02", "0.05", "0.01", "--seed", "7")


@pytest.fixture
def runs(here):
    """Make overlays of the office, and whole bags to compare with."""
    assert run(["batch", "in.mcap", "runs", "--runs", "1", "--output", "overlay", *ALPHA]) == 0
    assert run(["in.mcap", "whole.mcap", *ALPHA]) == 0
    return next(Path("runs").glob("run_*"))


def refused(invoke, *words):
    said = invoke(["assemble", *words], 1).err
    assert said.count("\n") == 1
    assert not Path("out.mcap").exists()
    return said


def test_an_input_that_is_gone_or_another_is_reported(runs, invoke):
    shutil.move("in.mcap", "moved.mcap")
    assert "the batch's input is not there; name it with --input" in refused(invoke, runs, "out.mcap")
    shutil.copy("whole.mcap", "in.mcap")
    assert "has changed since the batch was made from it" in refused(invoke, runs, "out.mcap")
    assert run(["assemble", str(runs), "out.mcap", "--input", "moved.mcap"]) == 0


def test_an_overlay_does_not_go_into_a_bag_of_other_topics(runs, invoke):
    said = refused(invoke, "whole.mcap", "out.mcap", "--input", runs)
    assert "has topics that" in said
    assert "name the input it was made from" in said
