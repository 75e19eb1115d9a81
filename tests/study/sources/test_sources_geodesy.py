"""Satellite fixes against published lengths of a degree and the closed formula's own symmetries."""

import numpy as np
import pytest
from sourcebags import topic, write
from sourcedrive import Rows, odometry, truth

from odomcorrupt.study.io import Source, read_runs
from odomcorrupt.study.io.geodesy import east_north_up


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


def test_fixes_that_claim_to_float_are_left_out_and_counted(tmp_path):
    moved, real = odometry(), truth()
    # a degree of latitude, and of longitude at 48 degrees, by the published lengths
    lla = np.column_stack((48.0 + real.xyz[:, 1] / 111_194.0, 8.0 + real.xyz[:, 0] / 74_625.0, 0.0 * real.yaw))
    floating = (np.arange(len(lla)) > 300) & (np.arange(len(lla)) < 500)
    lla[floating, 0] += 0.4 / 111_194.0
    fixes = topic("/fix", "NavSatFix", Rows(real.stamps_ns, lla, real.yaw), variance=np.where(floating, 0.18, 4e-4))
    (run,) = read_runs(Source(write(tmp_path / "run.mcap", topic("/odom", "Odometry", moved), fixes), truth="/fix"))
    assert any("199 of 990 fixes left out" in note for note in run.notes)
    assert not np.isin(run.truth.stamps_ns, real.stamps_ns[floating]).any()
