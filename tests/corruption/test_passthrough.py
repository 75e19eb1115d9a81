"""Zero parameters: the bag as it is, through files and pipes alike."""

import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path

import pytest

from odomcorrupt import cli

FIXTURES = Path(__file__).parents[2] / "fixtures"
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
