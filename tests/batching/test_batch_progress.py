"""How a batch tells how far it has got, on a terminal."""

from __future__ import annotations

import os
import pty
import re
import subprocess
import sys
import time
from pathlib import Path

import pytest

from odomcorrupt.bags.open import open_reader
from odomcorrupt.batching.runner import Watched
from odomcorrupt.commands._progress import left_words

FIXTURES = Path(__file__).parent.parent.parent / "fixtures"


@pytest.mark.parametrize("name", ["office.mcap", "office.bag", "office_ros2"])
def test_pass_tells_its_part_in_ascending_order(name, monkeypatch):
    monkeypatch.setattr("odomcorrupt.batching.runner.PAUSE_S", 0.0)
    beats = []
    with open_reader(FIXTURES / name) as reader:
        watched = Watched(reader, lambda part, past_s: beats.append((part, past_s)))
        assert watched.channels is reader.channels
        assert sum(len(block.table) for block in watched.blocks()) > 2000
    parts, seconds = zip(*beats, strict=True)
    assert seconds == tuple(sorted(seconds))
    assert seconds[-1] > 10.0
    if name == "office_ros2":
        assert set(parts) == {None}
    else:
        assert parts == tuple(sorted(parts))
        assert 0.9 < parts[-1] <= 1.0


def test_half_a_pass_counts_for_rate_and_time_left():
    assert left_words(3.5, 10, 7.0) == "3 of 10 runs, 0.5 a second, 13 s left"
    assert left_words(0.0, 10, 7.0) == "0 of 10 runs"


@pytest.mark.parametrize("jobs", ["1", "2"])
def test_terminal_sees_runs_grow_within_a_pass(jobs, tmp_path):
    program = (
        "import odomcorrupt.batching.runner as pulse, time; pulse.PAUSE_S = 0.0\n"
        "import sys; from odomcorrupt.cli import run; sys.exit(run(sys.argv[1:]))\n"
    )
    script = tmp_path / "slow.py"
    # a worker that is spawned imports the script anew, and with it the shorter pause
    script.write_text(program.replace("import sys;", "if __name__ == '__main__':\n  import sys;"))
    ours, theirs = pty.openpty()
    words = ["batch", str(FIXTURES / "office.mcap"), str(tmp_path / "runs"), "--runs", "8", "--seed", "1"]
    child = subprocess.Popen(
        [sys.executable, str(script), *words, "--jobs", jobs, "--alpha", "0.1", "0.1", "0.1", "0.1"],
        stderr=theirs, stdin=subprocess.DEVNULL,
    )  # fmt: skip
    os.close(theirs)
    said = b""
    ends = time.monotonic() + 60.0
    while time.monotonic() < ends:
        try:
            piece = os.read(ours, 4096)
        except OSError:
            break
        if not piece:
            break
        said += piece
    os.close(ours)
    assert child.wait(10) == 0
    lines = re.findall(rb"(\d+) of 8 runs[^\r]*", said)
    assert b"s of the bag" in said
    assert b"8 runs made now" in said
    counts = [int(line) for line in lines]
    assert counts == sorted(counts)
    assert counts[-1] == 8
