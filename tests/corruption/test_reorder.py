"""Odometry put in order, cut into stretches."""

from itertools import pairwise

import numpy as np
import pytest

from odomcorrupt.corruption.reorder import Arrivals, TimeOrder

S = 10**9


def arrivals(stamps_s, times_s):
    stamps = np.round(np.array(stamps_s) * S).astype(np.int64)
    return Arrivals(stamps, np.round(np.array(times_s) * S).astype(np.int64), np.column_stack([stamps / S] * 3))


def run(new, cuts):
    """Feed messages in pieces; return the stretches, each as sorted stamps in seconds."""
    order, stretches = TimeOrder(), [[]]
    edges = [0, *cuts, len(new)]
    for start, stop in pairwise(edges):
        piece = new.take(slice(start, stop))
        for ended in order.add(piece):
            stretches[-1].append(ended)
            stretches.append([])
        if len(piece):
            stretches[-1].append(order.release(int(piece.time_ns[-1])))
    stretches[-1].append(order.flush())
    return [np.concatenate([part.stamps_ns for part in parts]) / S for parts in stretches], order


def test_nothing_is_released_that_a_later_message_may_precede():
    order = TimeOrder()
    order.add(arrivals([0.0, 0.4, 0.9], [0.0, 0.4, 0.9]))
    assert len(order.release(round(0.99 * S))) == 0
    order.add(arrivals([1.5], [1.5]))
    assert order.release(round(1.5 * S)).stamps_ns.tolist() == [0, 4 * S // 10]
    assert order.release(round(1.95 * S)).stamps_ns.tolist() == [9 * S // 10]


@pytest.mark.parametrize("seed", range(6))
def test_cuts_do_not_change_what_is_decided(seed):
    rng = np.random.default_rng(seed)
    times = np.cumsum(rng.exponential(0.1, 300))
    stamps = times - rng.choice([0.0, 0.0, 0.3, 0.9, 1.4, 40.0], 300, p=[0.4, 0.4, 0.1, 0.05, 0.045, 0.005])
    new = arrivals(stamps, times)
    whole, order = run(new, [])
    for _ in range(5):
        cuts = np.sort(rng.choice(299, 40, replace=False) + 1)
        pieces, again = run(new, cuts.tolist())
        assert len(pieces) == len(whole)
        assert all(np.array_equal(a, b) for a, b in zip(pieces, whole, strict=True))
        assert (again.late, again.restarts) == (order.late, order.restarts)


@pytest.mark.parametrize("cuts", [[], [20], [21], [20, 21], [5, 19, 20, 21, 22, 40]])
def test_one_stamp_far_in_the_future_is_left_out_and_time_goes_on(cuts):
    t = np.arange(50) / 10
    stamps = t.copy()
    stamps[20] += 1e6
    stamps[[30, 31]] = stamps[[31, 30]]
    (out,), order = run(arrivals(stamps, t), cuts)
    assert np.array_equal(out, np.delete(t, 20))
    assert (order.late, order.leaps, order.restarts) == (0, 1, 0)


@pytest.mark.parametrize("cuts", [[], [21], [20, 21]])
def test_a_leap_that_nothing_follows_for_a_second_is_accepted(cuts):
    t = np.concatenate((np.arange(21) / 10, np.arange(35, 50) / 10))
    stamps = t.copy()
    stamps[20] += 50.0
    stretches, order = run(arrivals(stamps, t), cuts)
    assert [len(s) for s in stretches] == [21, 15]
    assert (order.leaps, order.restarts) == (0, 1)
