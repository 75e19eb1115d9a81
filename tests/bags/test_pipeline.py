"""Threads beside the one that computes: order, bounds, errors, and an end that waits for nothing."""

from __future__ import annotations

import sys
import threading
import time

import numpy as np
import pytest

from odomcorrupt.bags import pipeline
from odomcorrupt.bags.pipeline import OrderedResults, Workers, default_threads


@pytest.mark.parametrize("threads", [1, 2, 4])
def test_results_are_taken_in_the_order_in_which_calls_were_put(threads):
    rng = np.random.default_rng(1)
    waits_s = rng.uniform(0.0, 0.003, 100)
    taken = []
    with Workers(threads) as workers:
        results = OrderedResults(workers)
        for number, wait_s in enumerate(waits_s):

            def call(number=number, wait_s=wait_s):
                time.sleep(wait_s)
                return number

            results.put(call, taken.append, 1)
            if number % 10 == 5:
                results.put_behind(lambda number=number: taken.append(number + 0.5))
        results.finish()
    assert taken == sorted([*range(100), *(number + 0.5 for number in range(5, 100, 10))])


def test_no_more_waits_than_may(monkeypatch):
    monkeypatch.setattr(pipeline, "WAITING_BYTES", 10)
    made, taken = [], []
    with Workers(3) as workers:
        results = OrderedResults(workers)
        for number in range(100):
            results.put(lambda: made.append(None), taken.append, 1)
            assert number + 1 - len(taken) <= 10
        results.finish()
    assert len(made) == len(taken) == 100


def test_what_is_put_behind_does_not_wait_for_ever(monkeypatch):
    monkeypatch.setattr(pipeline, "WAITING_BYTES", 10)
    go, taken = threading.Event(), []
    with Workers(2) as workers:
        results = OrderedResults(workers)
        results.put(go.wait, taken.append, 1)
        threading.Timer(0.05, go.set).start()
        for number in range(100):
            results.put(lambda number=number: number, taken.append, 1, worth=False)
            assert number + 2 - len(taken) <= 10
        results.finish()
    assert taken == [True, *range(100)]


@pytest.mark.parametrize("threads", [1, 2])
def test_an_error_of_a_call_is_raised_in_its_turn(threads):
    taken = []

    def fail():
        raise ValueError("no such level")

    with Workers(threads) as workers:
        results = OrderedResults(workers)
        with pytest.raises(ValueError, match="no such level"):  # noqa: PT012 - at the latest at the end
            results.put(lambda: 1, taken.append, 1)
            results.put(fail, taken.append, 1)
            results.put(lambda: 3, taken.append, 1)
            results.finish()
    assert taken == [1]


def test_closing_drops_what_nobody_has_begun():
    begun, go = threading.Event(), threading.Event()
    made = []

    def first():
        begun.set()
        go.wait()

    before = threading.active_count()
    with Workers(2) as workers:
        workers.submit(first)
        for number in range(100):
            workers.submit(lambda number=number: made.append(number))
        begun.wait()
        threading.Timer(0.05, go.set).start()
    assert not made
    assert threading.active_count() <= before + 1  # the timer may live a moment longer


def test_one_thread_begins_no_other():
    before = threading.active_count()
    with Workers(1) as workers:
        assert workers.submit(lambda: 7).result() == 7
        assert threading.active_count() == before


def test_there_are_as_many_threads_as_cores_and_at_most_four(monkeypatch):
    for cores, threads in ((1, 1), (2, 2), (64, 4)):
        monkeypatch.setattr("os.sched_getaffinity", lambda _, cores=cores: set(range(cores)), raising=False)
        assert default_threads() == threads


def test_a_small_input_has_one_thread(tmp_path, monkeypatch):
    monkeypatch.setattr("os.sched_getaffinity", lambda _: {0, 1}, raising=False)
    for size, threads in ((1000, 1), (2 << 20, 2)):
        (tmp_path / "bag").write_bytes(bytes(size))
        assert default_threads(tmp_path / "bag") == threads


def test_python_switches_between_threads_as_it_does_without_workers():
    usual = sys.getswitchinterval()
    with Workers(2) as workers:
        workers.submit(lambda: None).result()
        assert sys.getswitchinterval() == usual
