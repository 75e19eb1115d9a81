"""A run over a bag: its options, summary and refusals, what passes through, and the same with any number of threads."""

import os
import resource
import signal
import subprocess
import sys
import threading
import time
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import replace
from io import StringIO
from operator import itemgetter

import numpy as np
import pytest
from bagged import ODOM, TF, odometry, robot, rows_of, transforms, write_mcap
from drives import model, office, silent
from mcap.writer import CompressionType, Writer

from odomcorrupt.bags.block import Channel
from odomcorrupt.bags.messages import gather_stamps_ns, locate
from odomcorrupt.bags.open import open_reader
from odomcorrupt.cli import run
from odomcorrupt.corruption.run import Container, corrupt_bag
from odomcorrupt.corruption.summary import brief, holonomic_words
from odomcorrupt.corruption.transform import Options
from odomcorrupt.effects import effect_from_values
from odomcorrupt.errors import BagError
from odomcorrupt.geometry.se2 import compose
from odomcorrupt.model.noise_laws import Coefficients
from recordings import FIXTURES

BAGS = ["office.bag", "office.mcap", "office_ros2"]


def corrupt(source, target, chosen):
    return corrupt_bag(source, target, chosen, seed=3, run=0, options=Options(), container=Container())


def bytes_of(path):
    files = sorted(path.iterdir()) if path.is_dir() else [path]
    return {file.relative_to(path).as_posix(): file.read_bytes() for file in files}


@pytest.mark.parametrize("name", BAGS)
def test_a_silent_model_copies_the_bag(name, tmp_path):
    corrupt(
        FIXTURES / name,
        tmp_path / name,
        silent([effect_from_values("wheelbase", {}), effect_from_values("time_offset", {})]),
    )
    assert bytes_of(tmp_path / name) == bytes_of(FIXTURES / name)


def summary(outcome, origin):
    return brief(outcome, origin, "out.mcap").full()


def test_the_summary_tells_counts_drift_and_oddities(tmp_path):
    outcome = corrupt(FIXTURES / "office.mcap", tmp_path / "out.mcap", model("linear", Coefficients(*[0.1] * 4)))
    text = summary(outcome, "typed")
    assert "/odom 3000, TF odom -> base_link 3000, computed from the poses of /odom" in text
    assert "/odom (25.05 m in 59.98 s)" in text
    assert text.startswith(f"MOVED     {outcome.drift.end_drawn_m:.3g} m, ")
    (noisy, clean) = (rows_of(path).xyt for path in (tmp_path / "out.mcap", FIXTURES / "office.mcap"))
    assert np.hypot(*(noisy - clean)[-1, :2]) == pytest.approx(outcome.drift.end_drawn_m, abs=1e-9)
    assert f"at this bag's {outcome.drift.rate_hz:.3g} Hz" in text
    outcome.changes.held = 4
    assert "held for 4 of these" in summary(outcome, "")
    assert "TF has" not in text
    elsewhere = replace(outcome, changes=replace(outcome.changes, edges={}), stayed={"map -> base_link": "/tf"})
    assert "no transform from odom (TF has map -> base_link)" in summary(elsewhere, "")


def test_the_summary_expects_no_noise_of_effects_and_no_place_of_a_lost_heading(tmp_path):
    gyro = effect_from_values("gyro_bias", {"bias": 0.001})
    text = summary(corrupt(FIXTURES / "office.mcap", tmp_path / "a.mcap", silent([gyro])), "")
    assert text.startswith("MOVED ")
    assert "(noise: " not in text
    wild = corrupt(FIXTURES / "office.mcap", tmp_path / "b.mcap", model(coefficients=Coefficients(5, 5, 5, 5)))
    assert "deg: the position is arbitrary)" in summary(wild, "")


@pytest.mark.parametrize(
    ("law", "sideways_m", "said"),
    [("linear", 4.0, "The robot moves sideways (4 m of 10 m), which the law linear does not model; --law omni does."),
    ("linear", 0.5, ""), ("omni", 4.0, ""),
    ("omni", 0.0, "The law omni is for robots that move sideways, but this one does not; leave --law out.")]
)  # fmt: skip
def test_a_law_that_does_not_fit_the_robot_is_warned_of(law, sideways_m, said):
    assert " ".join(holonomic_words(model(law), sideways_m, 10.0)) == said


def test_a_silent_summary_promises_no_drift(tmp_path):
    text = summary(corrupt(FIXTURES / "office.mcap", tmp_path / "out.mcap", silent()), "")
    assert text.startswith("UNCHANGED ")
    assert "per 10 m" not in text


ZERO = ("--alpha", "0", "0", "0", "0")


def outcome_of(*args, stdin=None):
    """Run the program, in a process of its own where a pipe is asked for."""
    words = [*map(str, args), *ZERO]
    if "-" in words:
        command = [sys.executable, "-m", "odomcorrupt", *words]
        return subprocess.run(command, input=stdin, capture_output=True, check=False)
    with redirect_stderr(StringIO()) as said, redirect_stdout(StringIO()):
        code = run(words)
    return subprocess.CompletedProcess(words, code, b"", said.getvalue().encode())


@pytest.fixture
def bag(tmp_path):
    """Return a bag that our writer would not write so: its chunks are packed harder."""
    path = tmp_path / "in.mcap"
    assert outcome_of(FIXTURES / "office.mcap", path, "--compression", "zstd", "--level", "9").returncode == 0
    return path


def test_a_file_and_a_pipe_give_the_very_bytes_of_the_input(bag, tmp_path):
    content = bag.read_bytes()
    assert outcome_of(bag, tmp_path / "out.mcap").returncode == 0
    assert (tmp_path / "out.mcap").read_bytes() == content
    assert outcome_of(bag, "-").stdout == content
    assert outcome_of("-", "-", "--odom", "/odom", stdin=content).stdout == content
    assert outcome_of("-", tmp_path / "from_pipe.mcap", "--odom", "/odom", stdin=content).returncode == 0
    assert (tmp_path / "from_pipe.mcap").read_bytes() == content


def test_a_ros1_bag_stays_one_in_a_file_and_becomes_an_mcap_on_a_pipe(tmp_path):
    content = (FIXTURES / "office.bag").read_bytes()
    assert outcome_of("-", tmp_path / "out.bag", "--odom", "/odom", stdin=content).returncode == 0
    assert (tmp_path / "out.bag").read_bytes() == content
    on_pipe = outcome_of("-", "-", "--odom", "/odom", stdin=content)
    assert on_pipe.returncode == 0
    assert on_pipe.stdout == outcome_of(FIXTURES / "office.bag", "-").stdout
    assert on_pipe.stdout.startswith(b"\x89MCAP0")


def test_a_container_option_is_heeded(bag, tmp_path):
    assert outcome_of(bag, tmp_path / "out.mcap", "--compression", "none").returncode == 0
    content = bag.read_bytes()
    assert (tmp_path / "out.mcap").read_bytes() != content
    piped = outcome_of("-", "-", "--odom", "/odom", "--compression", "none", stdin=content)
    assert piped.stdout == (tmp_path / "out.mcap").read_bytes()


OFFICE = str(FIXTURES / "office.mcap")


@pytest.fixture
def corrupted(tmp_path, capsys):
    def call(*args):
        target = tmp_path / "out.mcap"
        code = run([OFFICE, str(target), "-v", "--seed", "1", "--overwrite", *args])
        return code, capsys.readouterr().err, target

    return call


def test_effects_of_single_wheels_take_the_track_from_the_command_line_or_the_file(corrupted, tmp_path):
    code, said, target = corrupted("--effect", "quantization:step=0.01")
    assert (code, target.exists()) == (1, False)
    assert "give it in metres with --track" in said
    code, said, target = corrupted("--effect", "quantization:step=0.01", "--track", "0.4")
    assert code == 0
    assert "quantization (step 0.01 m)" in said
    by_option = target.read_bytes()
    file = tmp_path / "robot.toml"
    words = "rot_rot = 0\nrot_trans = 0\ntrans_trans = 0\ntrans_rot = 0"
    effect = '[[effect]]\nname = "quantization"\nstep = 0.01'
    file.write_text(f"schema = 1\n[noise]\n{words}\n{effect}\n[robot]\ntrack = 0.9\n")
    assert corrupted("--model", str(file), "--track", "0.4")[2].read_bytes() == by_option
    assert corrupted("--model", str(file))[2].read_bytes() != by_option


def test_a_drive_faster_than_a_learned_model_covers_is_corrupted_and_reported(corrupted, tmp_path):
    model = tmp_path / "model.toml"
    text = (
        'schema = 1\n[noise]\nlaw = "diffusion"\nrot_rot = 0\nrot_trans = 0\ntrans_trans = 0\ntrans_rot = 0\n'
        '[[effect]]\nname = "spins"\nexpression = "along += v * (k * max(abs(v) - 0.6, 0))"\nk = -2.0\n'
    )
    model.write_text(text)
    assert corrupted("--model", str(model))[0] == 1
    model.write_text(text + '[source]\nrecordings = ["a.mcap"]\n')
    code, said, _ = corrupted("--model", str(model))
    assert code == 0
    assert "% faster than the model's highest valid speed: the relative error is kept constant." in said


def edges_of(path):
    with open_reader(path) as reader:
        channel = next(c for c in reader.channels.values() if c.topic == "/tf")
        return [
            (item.frame_id, item.child_frame_id, int(stamp))
            for block in reader.blocks()
            for layout in locate(block, channel)
            for item in layout.items
            for stamp in gather_stamps_ns(block, layout, item)
        ]


def test_the_localisation_of_the_true_odometry_is_said_and_can_be_left_out(tmp_path, capsys, invoke):
    messages = robot(*office(10.0, 10.0))
    amcl = Channel(9, "/amcl_pose", "geometry_msgs/msg/PoseWithCovarianceStamped", "cdr")
    source = write_mcap(tmp_path / "in.mcap", [(amcl, messages[0][1], b"\0\1\0\0"), *messages])
    target, batched = tmp_path / "out.mcap", ["--seed", "1", "--runs", "2"]
    for words in (
        [str(source), str(target), "--seed", "1", "-v"],
        ["batch", str(source), str(tmp_path / "b"), *batched, "-v"],
    ):
        said = " ".join("".join(invoke(words)).split())
        assert "recorded localisation stays, and is of the true odometry: leave it out with " in said
        assert words[0] != "batch" or " RMS at the end of " in said
        assert "--exclude-topic /tf:map.odom --exclude-topic /amcl_pose and localise again, or move TF with " in said
    brief = invoke([source, target, "--seed", "1", "--overwrite"]).err
    assert "seed      1, run 0" in brief
    assert "--exclude-topic /tf:map.odom --exclude-topic /amcl_pose\n" in brief
    assert "--exclude-topic /tf:map.odom --exclude-topic /amcl_pose" in invoke(["info", source]).out
    left_out = ["--exclude-topic", "/amcl_pose", "--exclude-topic", "/tf:map.odom"]
    assert "stays" not in invoke(["batch", source, tmp_path / "c", *batched, *left_out]).out
    moved = [edge for edge in edges_of(target) if edge[:2] == ("odom", "base_link")]
    for words in (["/tf:map.odom"], ["tf:map.odom", "/tf:base_link.laser"]):
        exclude = [word for one in words for word in ("--exclude-topic", one)]
        assert "--exclude-topic /tf:" not in invoke([source, target, "--seed", "1", "-v", "--overwrite", *exclude]).err
        kept = {("odom", "base_link"), *([("base_link", "laser")] if len(words) == 1 else [])}
        assert {edge[:2] for edge in edges_of(target)} == kept
        assert [edge for edge in edges_of(target) if edge[:2] == ("odom", "base_link")] == moved
    for words in ([str(source), str(tmp_path / "d.mcap")], ["batch", str(source), str(tmp_path / "d"), *batched]):
        assert run([*words, "--exclude-topic", "/tf:map.odom", "--exclude-topic", "/tf:odom.map"]) == 1
        assert "/tf:odom.map: the input has no such edge (it has /tf:base_link.laser, /tf:" in capsys.readouterr().err
        assert not [*tmp_path.glob("d/run*"), *tmp_path.glob("d.mcap")]
    assert run([str(source), str(target), "--overwrite", "--exclude-topic", "/odom:map.odom"]) == 1
    assert "an edge of TF as in /tf:map.odom" in " ".join(capsys.readouterr().err.split())


def test_a_correction_is_published_once_for_each_stamp(tmp_path):
    t, poses = office(5.0, 10.0)
    twice = [(ODOM, int(s) + late, odometry(s, p)) for s, p in zip(t, poses, strict=True) for late in (0, 1000)]
    source, target = write_mcap(tmp_path / "in.mcap", twice), tmp_path / "out.mcap"
    assert run([str(source), str(target), "--seed", "1", "--tf", "correction", "--new-odom-frame", "odom1"]) == 0
    assert edges_of(target) == [("odom1", "odom", int(s)) for s in t]


def test_two_publishers_are_refused_with_the_way_out(tmp_path, invoke):
    t, poses = office(10.0, 10.0)
    beside = compose(np.array([0.3, 0.1, 0.09]), poses)
    both = [(ODOM, int(s), odometry(s, p)) for s, p in zip(t, poses, strict=True)]
    both += [(ODOM, int(s) + 21_000_000, odometry(s + 21_000_000, p)) for s, p in zip(t, beside, strict=True)]
    source, target = write_mcap(tmp_path / "in.mcap", sorted(both, key=itemgetter(1))), tmp_path / "out.mcap"
    assert "two publishers alternate" in (said := invoke([source, target, "--seed", "1"], 1).err)
    assert "sideways" not in said
    assert not target.exists()
    both[len(t) :] = [
        (Channel(late, "/tf", TF.msgtype, "cdr"), int(s) + late, transforms((int(s) + late, "odom", "base_link", p)))
        for path, late in ((poses, 10), (beside, 21_000_000))  # in channels of their own, as of two nodes in ROS 1
        for s, p in zip(t, path, strict=True)
    ]
    write_mcap(source, sorted(both, key=itemgetter(1)))
    for words in ([str(source), str(target), "--seed", "1"], ["info", "-v", str(source)]):
        assert "TF odom -> base_link: two publishers alternate" in " ".join("".join(invoke(words)).split())


COMMAND = [sys.executable, "-m", "odomcorrupt"]


def corrupt_with(source, target, threads, **container):
    corrupt_bag(
        source, target, model(), seed=3, run=0, options=Options(), container=Container(threads=threads, **container)
    )
    return bytes_of(target)


@pytest.fixture(scope="module")
def long(tmp_path_factory):
    """Return a bag of 60 MB: the fixture's messages, and others between them that do not compress."""
    path = tmp_path_factory.mktemp("long") / "long.mcap"
    rng = np.random.default_rng(1)
    with path.open("wb") as stream, open_reader(FIXTURES / "office.mcap") as reader:
        writer = Writer(stream, chunk_size=1 << 20, compression=CompressionType.ZSTD)
        writer.start("ros2", "test")
        ids = {}
        for channel in reader.channels.values():
            definition = reader.definition(channel)
            schema = writer.register_schema(definition.name, definition.encoding, definition.text)
            ids[channel.id] = writer.register_channel(channel.topic, channel.encoding, schema)
        noise = writer.register_channel("/noise", "raw", 0)
        number = 0
        for block in reader.blocks():
            for channel, log_ns, offset, length in block.table.tolist():
                data = block.data[offset : offset + length].tobytes()
                writer.add_message(ids[channel], log_ns, data, log_ns)
                number += 1
                if number % 20 == 0:
                    writer.add_message(noise, log_ns, rng.bytes(50_000), log_ns)
        writer.finish()
    assert path.stat().st_size > 20 << 20
    return path


@pytest.mark.parametrize("name", ["office.bag", "office.mcap", "office_ros2"])
@pytest.mark.parametrize("compression", [None, "none", "lz4"])
def test_the_bytes_of_every_format_are_the_same(name, compression, tmp_path):
    if name == "office_ros2" and compression == "lz4":
        pytest.skip("sqlite3 has no compression")
    made = [
        corrupt_with(FIXTURES / name, tmp_path / str(n) / name, n, compression=compression) for n in _rooms(tmp_path)
    ]
    assert made[0] == made[1] == made[2]


def _rooms(tmp_path):
    for threads in (1, 2, 5):
        (tmp_path / str(threads)).mkdir()
        yield threads


@pytest.mark.parametrize("compression", [None, "none"])
def test_the_bytes_of_a_long_bag_are_the_same_from_a_pipe_too(long, compression, tmp_path):
    made = [corrupt_with(long, tmp_path / str(n) / "out.mcap", n, compression=compression) for n in _rooms(tmp_path)]
    assert made[0] == made[1] == made[2]
    more = [] if compression is None else ["--compression", compression]
    with long.open("rb") as source, (tmp_path / "piped.mcap").open("wb") as target:
        words = [*COMMAND, "-", "-", "--odom-topic", "/odom", "--seed", "3", "--threads", "3", *more]
        subprocess.run(words, stdin=source, stdout=target, check=True, stderr=subprocess.DEVNULL)
    words = [str(long), str(tmp_path / "alone.mcap"), "--seed", "3", "--threads", "1", *more]
    assert run(words) == 0
    assert (tmp_path / "piped.mcap").read_bytes() == (tmp_path / "alone.mcap").read_bytes()


@pytest.mark.parametrize("place", [0.3, 0.9])
def test_damage_is_reported_in_the_same_words_and_nothing_stays(long, place, tmp_path):
    data = bytearray(long.read_bytes())
    at = int(len(data) * place)
    data[at : at + 100] = bytes(100)
    (tmp_path / "damaged.mcap").write_bytes(data)
    messages = set()
    for threads in (1, 2, 4):
        with pytest.raises(BagError) as caught:
            corrupt_with(tmp_path / "damaged.mcap", tmp_path / "out.mcap", threads)
        messages.add(str(caught.value))
    assert len(messages) == 1
    assert [file.name for file in tmp_path.iterdir()] == ["damaged.mcap"]
    assert threading.active_count() == 1


def test_what_is_lost_of_a_damaged_bag_is_the_same(long, tmp_path):
    data = bytearray(long.read_bytes())
    at = len(data) // 2
    data[at : at + 100] = bytes(100)
    (tmp_path / "damaged.mcap").write_bytes(data)
    made = [corrupt_with(tmp_path / "damaged.mcap", tmp_path / f"{n}.mcap", n, recover=True) for n in (1, 3)]
    assert [*made[0].values()] == [*made[1].values()]


def _limited():
    resource.setrlimit(resource.RLIMIT_FSIZE, (10 << 20, 10 << 20))
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)


@pytest.mark.parametrize("threads", ["1", "3"])
def test_a_full_disk_ends_everything_with_one_line_and_nothing_stays(long, threads, tmp_path):
    words = [*COMMAND, long, tmp_path / "out.mcap", "--seed", "1", "--threads", threads]
    done = subprocess.run(words, capture_output=True, text=True, preexec_fn=_limited, timeout=60, check=False)
    assert done.returncode == 1
    assert done.stderr.count("\n") == 1
    assert "cannot be written: File too large" in done.stderr
    assert not list(tmp_path.iterdir())


@pytest.mark.usefixtures("interruptible")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_ends_everything_at_once_though_a_pipe_waits(long, number, tmp_path):
    out = tmp_path / "out.mcap"
    words = [*COMMAND, "-", str(out), "--odom-topic", "/odom", "--seed", "1", "--threads", "3"]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        process.stdin.write(long.read_bytes()[: 20 << 20])
        process.stdin.flush()
        _wait_for(lambda: list(tmp_path.iterdir()))
        time.sleep(0.3)
        process.send_signal(number)
        begun = time.monotonic()
        assert process.wait(20) in (130, 128 + number)
        assert time.monotonic() - begun < 10
        assert process.stderr.read().strip().count(b"\n") == 0  # behind the ^C of a terminal
    assert not list(tmp_path.iterdir())


@pytest.mark.usefixtures("interruptible")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_ends_everything_though_nobody_reads_what_is_written(long, number, tmp_path):
    words = [*COMMAND, str(long), "-", "--seed", "1", "--threads", "3"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        os.read(process.stdout.fileno(), 1000)
        time.sleep(0.3)
        process.send_signal(number)
        assert process.wait(20) in (130, 128 + number)


def _wait_for(condition):
    end = time.monotonic() + 20
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)
