"""The line that says how far a bag has got."""

from __future__ import annotations

import contextlib
import os
import pty
import re
import subprocess
import sys
import termios
from pathlib import Path

import numpy as np

from odomcorrupt.bags.block import TABLE, Block
from odomcorrupt.commands import _progress

OFFICE = str(Path(__file__).parents[1] / "fixtures" / "office.mcap")


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
    master, slave = pty.openpty()
    termios.tcsetwinsize(slave, (24, 60))
    streams = dict.fromkeys(("stdin", "stdout", "stderr"), slave)
    done = subprocess.run(
        [sys.executable, "-m", "odomcorrupt", OFFICE, str(tmp_path / "out.mcap"), "--seed", "1"],
        **streams, check=False,
        env={name: value for name, value in os.environ.items() if name != "COLUMNS"},
    )  # fmt: skip
    os.close(slave)
    said = b""
    with contextlib.suppress(OSError):
        while piece := os.read(master, 65536):
            said += piece
    os.close(master)
    assert done.returncode == 0
    assert b"\r\x1b[K" in said
    lines = said.rsplit(b"\x1b[K", 1)[1].decode().splitlines()
    assert lines[0].startswith("\x1b[32mMOVED")
    plain = [re.sub(r"\x1b\[\d+m", "", line) for line in lines if str(tmp_path) not in line]
    assert 50 < max(map(len, plain)) <= 60
