"""The line that says how far a bag has got."""

import re
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from odomcorrupt.bags.block import TABLE, Block
from odomcorrupt.commands import _progress
from odomcorrupt.study.work import Work
from terminal import on_a_terminal

FIXTURES = Path(__file__).parents[1] / "fixtures"
OFFICE = str(FIXTURES / "office.mcap")


def block(log_s):
    table = np.array([(1, int(log_s * 1e9), 0, 0)], dtype=TABLE)
    return Block(np.zeros(3_000_000, dtype=np.uint8), table)


def test_a_terminal_gets_seconds_and_megabytes_and_wiped(monkeypatch, capsys):
    monkeypatch.setattr(_progress, "PAUSE_S", 0.0)
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    with _progress.Progress() as progress:
        progress(block(100.0))
        progress(block(112.4))
    captured = capsys.readouterr()
    assert not captured.out
    assert captured.err.endswith("\r\x1b[K12 s of the bag, 6 MB\r\x1b[K")


def test_what_is_no_terminal_gets_nothing(monkeypatch, capsys):
    monkeypatch.setattr(_progress, "PAUSE_S", 0.0)
    with _progress.Progress() as progress:
        progress(block(100.0))
    assert capsys.readouterr().err == ""


def test_progress_is_reported_on_terminals_only_and_wiped_away(tmp_path):
    """Run under a pseudo-terminal of 60 columns: the last thing on it is the folded summary."""
    said = on_a_terminal(60, "-m", "odomcorrupt", OFFICE, str(tmp_path / "out.mcap"), "--seed", "1")
    assert "\r\x1b[K" in said
    lines = said.rsplit("\x1b[K", 1)[1].splitlines()
    assert lines[0].startswith("\x1b[32mMOVED")
    plain = [re.sub(r"\x1b\[\d+m", "", line) for line in lines if str(tmp_path) not in line]
    assert 50 < max(map(len, plain)) <= 60


def test_what_reading_took_is_no_estimate_of_what_follows_it(monkeypatch):
    now_s = 100.0
    monkeypatch.setattr(_progress.time, "monotonic", lambda: now_s)
    stages, said = _progress.Stages(), []
    monkeypatch.setattr(stages, "_say", said.append)
    ticks = iter([False, True])
    monkeypatch.setattr(stages._ended, "wait", lambda _: next(ticks))
    stages.reading("matching scans", 0.5)
    now_s = 160.0
    stages("search", 0.0)
    now_s = 170.0
    stages("fit", 0.25)
    now_s = 174.0
    stages._tick()
    assert said == ["fit, 74 s, 43 % done, about 26 s left"]


@pytest.mark.slow
def test_a_search_says_its_stage_the_share_done_and_the_time_left():
    """The share never falls, never reaches the end before it, and takes several values."""
    recordings = [str(FIXTURES / name) for name in ("mystery.mcap", "mystery_other.mcap")]
    *lines, verdict = on_a_terminal(
        100, "-m", "odomcorrupt", "learn", recordings[0], "--validate", recordings[1]
    ).split("\r\x1b[K")
    seconds = [int(found[1]) for line in lines if (found := re.search(r", (\d+) s\b", line))]
    shares = [int(found[1]) for line in lines if (found := re.search(r"(\d+) % done", line))]
    assert seconds == sorted(seconds)
    assert shares == sorted(shares)
    assert 0 < shares[0] < shares[-1] < 100
    assert len(set(shares)) >= 3
    # a stage that is shorter than a tick is not shown
    assert any(re.search(r"search, step \d+: \w+", line) for line in lines)
    assert any(re.search(r"% done, about \d+ s left", line) for line in lines)
    assert "MISSING" in verdict


@pytest.mark.parametrize("steps", [1, 2, 6, 40])
def test_the_share_done_never_falls_and_stays_below_one_however_long_the_search(steps):
    said = []
    work = Work(lambda stage, share: said.append((stage, share)), following=2.0)
    work.begin_clocks()
    for _ in range(steps):
        work.begin_step()
        work.within_step("refits")
    work.begin("comparison", 2.0, 0.0)
    shares = [share for _, share in said]
    assert shares[0] == 0.0
    assert len(set(shares)) > steps
    assert all(0.0 <= later - before < 0.5 for before, later in pairwise(shares))
    assert said[-1] == ("comparison", pytest.approx((1.0 + steps) / (3.0 + steps)))
    assert said[-2][0] == f"search, step {steps}: refits"
