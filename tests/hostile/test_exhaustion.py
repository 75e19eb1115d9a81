"""Few file descriptors, or a full disk, end in one line that says so, and never in a process that waits."""

import resource
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

FIXTURES = Path(__file__).parents[2] / "fixtures"
OFFICE = FIXTURES / "office.mcap"


def call(*words, limit, most, stdin=subprocess.DEVNULL):
    """Return exit code and stderr of a command under a resource limit, which would cut cached bytecode short."""
    done = subprocess.run(
        [sys.executable, "-B", "-m", "odomcorrupt", *map(str, words)],
        stdin=stdin, capture_output=True, text=True, check=False, timeout=40,
        preexec_fn=lambda: resource.setrlimit(limit, (most, most)),
    )  # fmt: skip
    return done.returncode, done.stderr


@pytest.mark.parametrize("most", [12, 14, 16, 18])
def test_a_batch_with_few_descriptors_ends_and_says_why(most, tmp_path):
    words = ["batch", OFFICE, tmp_path / "runs", "--runs", "3", "--jobs", "2", "--seed", "1", "-q"]
    code, said = call(*words, limit=resource.RLIMIT_NOFILE, most=most)
    if code:
        assert code == 1
        assert said.startswith("odomcorrupt: ")
        assert "Too many open files" in said
        assert said.count("\n") == 1
    else:
        assert said == ""


@pytest.mark.parametrize("how", ["pipe recovered", "pipe learned", "cut database"])
def test_a_disk_that_is_full_is_named_as_such(how, tmp_path):
    cut = tmp_path / "cut.db3"
    shutil.copyfile(FIXTURES / "office_ros2" / "office_ros2.db3", cut)
    with cut.open("r+b") as stream:
        stream.truncate(cut.stat().st_size - 100)
    words = {
        "pipe recovered": ["-", tmp_path / "out.mcap", "--odom", "/odom", "--recover"],
        "pipe learned": ["learn", "-"],
        "cut database": ["info", cut, "--recover"],
    }[how]
    with OFFICE.open("rb") as stdin:
        code, said = call(*words, limit=resource.RLIMIT_FSIZE, most=100_000, stdin=stdin)
    assert code == 1
    assert said.count("\n") == 1
    assert "cannot be " in said
    assert "damaged" not in said
    assert "--help" not in said
    assert not list(tmp_path.glob("*out*"))
