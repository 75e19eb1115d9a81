"""A sqlite3 file is copied by a thread while its messages are read: the same bytes, and the same ends."""

import errno
import os
import shutil
import threading
import time

import pytest
from oracles import OFFICE, OFFICE_DB

from odomcorrupt.bags.rosbag2 import sqlite_writer
from odomcorrupt.corruption.run import Container, corrupt_bag
from odomcorrupt.corruption.transform import Options
from odomcorrupt.errors import BagError
from odomcorrupt.model.motion_model import MotionModel, Noise
from odomcorrupt.model.noise_laws import Coefficients

MODEL = MotionModel(Noise("diffusion", Coefficients(0.05, 0.02, 0.05, 0.01)))


def corrupt(source, target, threads, **options):
    corrupt_bag(source, target, MODEL, seed=7, run=0, options=Options(**options), container=Container(threads=threads))
    return (target if target.is_file() else target / OFFICE_DB.name).read_bytes()


@pytest.mark.parametrize("source", [OFFICE, OFFICE_DB], ids=["directory", "file"])
@pytest.mark.parametrize("held", [0, 16 << 20])
@pytest.mark.parametrize("options", [{}, {"keep_truth": "/odom_true"}], ids=["", "keeping truth"])
@pytest.mark.parametrize("slow", [False, True])
def test_the_thread_changes_no_byte(source, held, options, slow, tmp_path, monkeypatch):
    monkeypatch.setattr(sqlite_writer, "_HELD_BYTES", held)
    one = corrupt(source, tmp_path / f"one{source.suffix}", 1, **options)
    if slow:
        copy = os.copy_file_range
        monkeypatch.setattr("os.copy_file_range", lambda *words: (time.sleep(0.1), copy(*words))[1])
    assert corrupt(source, tmp_path / f"two{source.suffix}", 2, **options) == one
    assert threading.active_count() == 1


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("source", [OFFICE, OFFICE_DB], ids=["directory", "file"])
def test_a_copy_that_fails_is_a_line_and_leaves_nothing(source, threads, tmp_path, monkeypatch):
    def full(*_words):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("os.copy_file_range", full)
    monkeypatch.setattr(shutil, "copyfile", full)
    with pytest.raises(BagError, match="cannot be written: No space left on device"):
        corrupt(source, tmp_path / f"out{source.suffix}", threads)
    assert list(tmp_path.iterdir()) == []
    assert threading.active_count() == 1


def test_without_such_a_call_the_copy_is_made_in_python(tmp_path, monkeypatch):
    one = corrupt(OFFICE_DB, tmp_path / "one.db3", 2)
    monkeypatch.delattr("os.copy_file_range")
    assert corrupt(OFFICE_DB, tmp_path / "two.db3", 2) == one


def test_an_interrupt_ends_the_copy_too(tmp_path, monkeypatch):
    def endless(*_words):
        time.sleep(0.01)
        return 1

    def interrupted(*_words):
        raise KeyboardInterrupt

    monkeypatch.setattr("os.copy_file_range", endless)
    monkeypatch.setattr("odomcorrupt.corruption.transform.Transform.blocks", interrupted)
    with pytest.raises(KeyboardInterrupt):
        corrupt(OFFICE_DB, tmp_path / "out.db3", 2)
    assert list(tmp_path.iterdir()) == []
    assert threading.active_count() == 1
