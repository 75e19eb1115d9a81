"""Room for chunks: side by side, everyone's own, and used again."""

import numpy as np

from odomcorrupt.bags.budget import ARENA_BYTES, BufferPool


def test_what_is_given_lies_side_by_side_and_is_not_shared():
    pool = BufferPool()
    one, other = pool.place(1000), pool.place(500)
    one[:], other[:] = 1, 2
    assert one.base is other.base
    assert one.size == 1000
    assert np.all(one == 1)
    assert np.all(other == 2)
    assert other.__array_interface__["data"][0] == one.__array_interface__["data"][0] + 1000


def test_a_buffer_is_used_again_when_nobody_holds_it():
    pool = BufferPool()
    one = pool.place(ARENA_BYTES)
    where = one.__array_interface__["data"][0]
    view = one[10:20]
    del one
    assert pool.place(ARENA_BYTES).__array_interface__["data"][0] != where
    del view
    held = [pool.place(ARENA_BYTES) for _ in range(2)]
    assert where in {block.__array_interface__["data"][0] for block in held}


def test_what_is_larger_than_a_shelf_stands_alone():
    pool = BufferPool()
    small = pool.place(10)
    large = pool.place(ARENA_BYTES + 1)
    large[:] = 3
    assert large.size == ARENA_BYTES + 1
    assert large.base is None
    assert pool.place(10).base is small.base
