"""A run over a bag: its summary, its refusals, and what passes through unchanged."""

import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import replace
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from bagged import rows_of
from drives import model, silent

from odomcorrupt import cli
from odomcorrupt.corruption.run import Container, corrupt_bag
from odomcorrupt.corruption.summary import brief, holonomic_words
from odomcorrupt.corruption.transform import Options
from odomcorrupt.effects import effect_from_values
from odomcorrupt.model.noise_laws import Coefficients

FIXTURES = Path(__file__).parent.parent.parent / "fixtures"
BAGS = ["office.bag", "office.mcap", "office_ros2"]


def corrupt(source, target, chosen, seed=3, **container):
    return corrupt_bag(source, target, chosen, seed=seed, run=0, options=Options(), container=Container(**container))


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


def test_model_seed_and_run_are_stored_in_an_mcap(tmp_path):
    corrupt(FIXTURES / "office.mcap", tmp_path / "out.mcap", model(), seed=77)
    data = (tmp_path / "out.mcap").read_bytes()
    assert b"rot_trans = 0.03" in data
    assert b"77" in data


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


def test_the_summary_expects_no_noise_of_effects_and_no_place_of_a_lost_heading(tmp_path):
    gyro = effect_from_values("gyro_bias", {"bias": 0.001})
    text = summary(corrupt(FIXTURES / "office.mcap", tmp_path / "a.mcap", silent([gyro])), "")
    assert text.startswith("MOVED ")
    assert "(noise: " not in text
    wild = corrupt(FIXTURES / "office.mcap", tmp_path / "b.mcap", model(coefficients=Coefficients(5, 5, 5, 5)))
    assert "deg: the position is arbitrary)" in summary(wild, "")


def test_the_summary_counts_stamps_of_zero_and_messages_put_in_order_and_names_the_edges_there_are(tmp_path):
    outcome = corrupt(FIXTURES / "office.mcap", tmp_path / "out.mcap", model())
    assert (outcome.order.swapped, outcome.faults.zero_stamps) == (0, 0)
    outcome.order.swapped, outcome.faults.zero_stamps = 3, 7
    text = summary(outcome, "")
    assert "7 odometry stamps are zero: log times were used instead." in text
    assert "3 odometry messages were out of order: they were sorted." in text
    assert "TF odom -> base_link" in text
    assert "TF has" not in text
    elsewhere = replace(outcome, changes=replace(outcome.changes, edges={}), stayed={"map -> base_link": "/tf"})
    assert "no transform from odom (TF has map -> base_link)" in summary(elsewhere, "")


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


def run(*args, stdin=None):
    """Run the program, in a process of its own where a pipe is asked for."""
    words = [*map(str, args), *ZERO]
    if "-" in words:
        command = [sys.executable, "-m", "odomcorrupt", *words]
        return subprocess.run(command, input=stdin, capture_output=True, check=False)
    with redirect_stderr(StringIO()) as said, redirect_stdout(StringIO()):
        code = cli.run(words)
    return subprocess.CompletedProcess(words, code, b"", said.getvalue().encode())


@pytest.fixture
def bag(tmp_path):
    """Return a bag that our writer would not write so: its chunks are packed harder."""
    path = tmp_path / "in.mcap"
    assert run(FIXTURES / "office.mcap", path, "--compression", "zstd", "--level", "9").returncode == 0
    return path


def test_a_file_and_a_pipe_give_the_very_bytes_of_the_input(bag, tmp_path):
    content = bag.read_bytes()
    assert run(bag, tmp_path / "out.mcap").returncode == 0
    assert (tmp_path / "out.mcap").read_bytes() == content
    assert run(bag, "-").stdout == content
    assert run("-", "-", "--odom", "/odom", stdin=content).stdout == content
    assert run("-", tmp_path / "from_pipe.mcap", "--odom", "/odom", stdin=content).returncode == 0
    assert (tmp_path / "from_pipe.mcap").read_bytes() == content


def test_a_ros1_bag_stays_one_in_a_file_and_becomes_an_mcap_on_a_pipe(tmp_path):
    content = (FIXTURES / "office.bag").read_bytes()
    assert run("-", tmp_path / "out.bag", "--odom", "/odom", stdin=content).returncode == 0
    assert (tmp_path / "out.bag").read_bytes() == content
    on_pipe = run("-", "-", "--odom", "/odom", stdin=content)
    assert on_pipe.returncode == 0
    assert on_pipe.stdout == run(FIXTURES / "office.bag", "-").stdout
    assert on_pipe.stdout.startswith(b"\x89MCAP0")


def test_a_container_option_is_heeded(bag, tmp_path):
    assert run(bag, tmp_path / "out.mcap", "--compression", "none").returncode == 0
    content = bag.read_bytes()
    assert (tmp_path / "out.mcap").read_bytes() != content
    piped = run("-", "-", "--odom", "/odom", "--compression", "none", stdin=content)
    assert piped.stdout == (tmp_path / "out.mcap").read_bytes()
