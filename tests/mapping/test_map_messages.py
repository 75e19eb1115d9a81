import numpy as np
import pytest
from packed import ROS1, ROS2, grid, scan

from odomcorrupt.errors import BagError
from odomcorrupt.mapping.messages import read_grid, read_scan


@pytest.mark.parametrize(("store", "encoding"), [(ROS2, "cdr"), (ROS1, "ros1")])
def test_scan_of_another_writer_is_read(store, encoding):
    for frame in ("laser", "a", "base_scan_link"):  # strings of all alignments
        read = read_scan(scan([1.0, np.inf, 2.5], store, frame=frame), "/scan", encoding)
        assert (read.stamp_ns, read.frame_id) == (5_000_000_007, frame)
        assert (read.angle_min, read.angle_step, read.range_max_m) == (-0.5, 0.25, 10.0)
        assert read.time_step_s == pytest.approx(1e-3)
        assert read.ranges_m.tolist() == [1.0, np.inf, 2.5]


@pytest.mark.parametrize(("store", "encoding"), [(ROS2, "cdr"), (ROS1, "ros1")])
def test_grid_of_another_writer_is_read(store, encoding):
    cells = np.array([[0, 100, -1], [50, 0, 0]])
    read = read_grid(grid(cells, store), "/map", encoding)
    np.testing.assert_array_equal(read.cells, cells)
    np.testing.assert_allclose(read.origin_xyt, [1.0, -2.0, 0.4])
    assert read.resolution_m == pytest.approx(0.05)


@pytest.mark.parametrize(
    ("make", "read"), [(lambda: scan([1.0] * 5), read_scan), (lambda: grid(np.zeros((3, 3))), read_grid)]
)
def test_cut_message_is_an_error_at_every_byte(make, read):
    whole = make()
    end = len(whole) - (12 if read is read_scan else 0)  # intensities are never looked at
    for size in range(end):
        with pytest.raises(BagError):
            read(whole[:size], "/topic", "cdr")


def test_claimed_size_is_held_against_the_bytes():
    whole = bytearray(grid(np.zeros((3, 3))))
    at = whole.index((3).to_bytes(4, "little") + (3).to_bytes(4, "little"))
    whole[at : at + 4] = (2**31).to_bytes(4, "little")
    with pytest.raises(BagError, match="carries 9"):
        read_grid(bytes(whole), "/map", "cdr")


def test_other_encodings_are_named():
    with pytest.raises(BagError, match="json"):
        read_scan(b"{}", "/scan", "json")
