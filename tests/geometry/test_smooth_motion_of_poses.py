"""Slopes of line fits: motion where there is motion, and none at rest."""

import numpy as np
import pytest

from odomcorrupt.geometry.motion import is_rough, slopes


def test_a_robot_at_rest_far_from_where_it_started_and_long_after_has_no_speed_at_all():
    t_s = np.arange(0.0, 3600.0, 0.1)
    way = np.interp(t_s, (0.0, 1000.0, 1500.0, 2500.0, 3600.0), (0.0, 700.0, 700.0, 1400.0, 1400.0))
    values = np.stack((way, -0.3 * way, 0.01 * way), axis=1)
    speed = slopes(t_s, values, t_s, 0.2)
    resting = (t_s > 1001.0) & (t_s < 1499.0) | (t_s > 2501.0)
    assert not speed[resting].any()
    moving = (t_s > 1.0) & (t_s < 999.0) | (t_s > 1501.0) & (t_s < 2499.0)
    np.testing.assert_allclose(speed[moving], np.tile((0.7, -0.21, 0.007), (moving.sum(), 1)), atol=1e-6)


def test_slopes_are_those_of_least_squares_lines():
    rng = np.random.default_rng(5)
    t_s = np.sort(rng.uniform(0.0, 10.0, 200))
    values = rng.normal(size=(200, 2))
    at_s = np.array([2.0, 5.0, 8.0])
    for at, found in zip(at_s, slopes(t_s, values, at_s, 1.0), strict=True):
        inside = np.abs(t_s - at) <= 0.5
        np.testing.assert_allclose(found, np.polyfit(t_s[inside], values[inside], 1)[0], rtol=1e-6)


@pytest.mark.parametrize("rate_hz", [10.0, 30.0, 100.0])
def test_ticks_make_odometry_rough_and_neither_driving_nor_steps_of_speed_do(rate_hz):
    t_s = np.arange(0.0, 60.0, 1.0 / rate_hz)
    way = t_s - np.sin(t_s)
    stepped = np.cumsum((1.0 - np.cos(t_s)) * np.where(np.sin(t_s) > 0.8, 0.94, 1.0)) / rate_hz
    ticked = np.floor(way / 2e-3) * 2e-3
    dt_s = np.diff(t_s)
    speeds = [np.outer(np.diff(x) / dt_s, (1.0, 0.0, 0.0)) for x in (way, stepped, ticked, 0.0 * way)]
    assert [is_rough(speed, dt_s) for speed in speeds] == [False, False, True, False]
