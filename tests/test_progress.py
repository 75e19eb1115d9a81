"""The line that says how far a bag has got."""

from __future__ import annotations

import sys

import numpy as np

from odomcorrupt.bags.block import TABLE, Block
from odomcorrupt.commands import _progress


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
