"""Satellite fixes against published lengths of a degree and symmetries of the closed formula."""

import numpy as np
import pytest

from odomcorrupt.geometry.se2 import compose
from odomcorrupt.study.io.fixes import east_north_up, frame_of, origin_of


@pytest.mark.parametrize(
    ("latitude", "north_m", "east_m"),
    [
        # length of a degree of latitude and longitude on WGS 84, National Geospatial-Intelligence Agency tables
        (0.0, 110_574.3, 111_319.5),
        (30.0, 110_852.4, 96_486.3),
        (45.0, 111_131.7, 78_846.8),
        (60.0, 111_412.2, 55_800.0),
    ],
)
def test_small_steps_have_the_published_length_of_a_degree(latitude, north_m, east_m):
    small = 1e-3
    fixes = np.array([[latitude, 8.0, 0.0], [latitude + small, 8.0, 0.0], [latitude, 8.0 + small, 0.0]])
    plane = east_north_up(fixes)
    assert plane[1, 1] / small == pytest.approx(north_m, rel=2e-5)
    assert plane[2, 0] / small == pytest.approx(east_m, rel=2e-5)
    assert abs(plane[1, 0]) < 1e-6
    assert abs(plane[2, 1]) < 1e-2


def test_the_poles_are_as_far_from_the_centre_as_wgs84_says():
    """From the equator the pole lies one polar radius up north, and one equatorial radius down."""
    pole = east_north_up(np.array([[0.0, 0.0, 0.0], [90.0, 0.0, 0.0]]))[1]
    np.testing.assert_allclose(pole, [0.0, 6_356_752.314245, -6_378_137.0], atol=1e-5)


def test_height_is_up_and_a_missing_one_does_no_harm():
    plane = east_north_up(np.array([[50.0, 8.0, 100.0], [50.0, 8.0, 130.0]]))
    np.testing.assert_allclose(plane[1], [0.0, 0.0, 30.0], atol=1e-6)
    assert np.isfinite(east_north_up(np.array([[50.0, 8.0, np.nan], [50.1, 8.0, np.nan]]))).all()


def test_frames_of_two_origins_agree_on_where_a_fix_lies():
    """Half a kilometre apart, a rigid shift is the exact mapping of the two planes to a tenth of a millimetre."""
    fixes = np.array([[48.1, 11.5, 520.0], [48.1031, 11.5064, 525.0], [48.1002, 11.5011, 519.0]])
    other = np.array([48.1043, 11.4946, 500.0])
    both = east_north_up(np.concatenate((other[None], fixes)))[1:]
    moved = compose(
        frame_of(origin_of(fixes[0]), origin_of(other)), np.column_stack((east_north_up(fixes)[:, :2], [0] * 3))
    )
    np.testing.assert_allclose(moved[:, :2], both[:, :2], atol=2e-3)
    back = compose(frame_of(origin_of(other), origin_of(fixes[0])), frame_of(origin_of(fixes[0]), origin_of(other)))
    np.testing.assert_allclose(back, 0.0, atol=2e-3)
