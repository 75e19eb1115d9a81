"""Room for chunks: side by side, everyone's own, and used again."""

import numpy as np

from odomcorrupt.bags.buffer_pool import SHELF_BYTES, BufferPool


def test_what_is_given_lies_side_by_side_and_is_not_shared():
    shelf = BufferPool()
    one, other = shelf.place(1000), shelf.place(500)
    one[:], other[:] = 1, 2
    assert one.base is other.base
    assert one.size == 1000
    assert np.all(one == 1)
    assert np.all(other == 2)
    assert other.__array_interface__["data"][0] == one.__array_interface__["data"][0] + 1000


def test_a_buffer_is_used_again_when_nobody_holds_it():
    shelf = BufferPool()
    one = shelf.place(SHELF_BYTES)
    where = one.__array_interface__["data"][0]
    view = one[10:20]
    del one
    assert shelf.place(SHELF_BYTES).__array_interface__["data"][0] != where
    del view
    held = [shelf.place(SHELF_BYTES) for _ in range(2)]
    assert where in {block.__array_interface__["data"][0] for block in held}


def test_what_is_larger_than_a_shelf_stands_alone():
    shelf = BufferPool()
    small = shelf.place(10)
    large = shelf.place(SHELF_BYTES + 1)
    large[:] = 3
    assert large.size == SHELF_BYTES + 1
    assert large.base is None
    assert shelf.place(10).base is small.base
