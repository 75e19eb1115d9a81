"""Composition, increments and interpolation of planar poses, and the motion derived from them."""

import numpy as np
import pytest

from odomcorrupt.geometry.motion import is_rough, slopes
from odomcorrupt.geometry.se2 import (
    BEARING_MIN_M,
    Increments,
    accumulate,
    between,
    compose,
    increments,
    interpolate,
    inverse,
    rot_trans_rot,
    rotate,
    wrap,
    yaw_from_quaternion,
)

RNG = np.random.default_rng(1)
A = RNG.uniform(-5, 5, (200, 3))
B = RNG.uniform(-5, 5, (200, 3))


def matrix(pose):
    x, y, t = pose
    return np.array([[np.cos(t), -np.sin(t), x], [np.sin(t), np.cos(t), y], [0, 0, 1]])


def same(pose, m):
    assert matrix(pose) == pytest.approx(m, abs=1e-12)


def test_composition_inverse_and_difference_are_those_of_matrices():
    for a, b, ab, back, seen in zip(A, B, compose(A, B), inverse(A), between(A, B), strict=True):
        same(ab, matrix(a) @ matrix(b))
        same(back, np.linalg.inv(matrix(a)))
        same(seen, np.linalg.inv(matrix(a)) @ matrix(b))


def test_headings_stay_unwrapped():
    assert compose(np.array([0, 0, 3.0]), np.array([0, 0, 3.0]))[2] == 6.0
    assert between(np.array([0, 0, -3.0]), np.array([0, 0, 9.0]))[2] == 12.0


def test_wrap_folds_into_half_open_pi():
    angles = np.array([0.0, 1.0, np.pi, -np.pi, 3 * np.pi, 7.0, -7.0, 1e-17])
    folded = wrap(angles)
    assert np.all((folded >= -np.pi) & (folded < np.pi))
    assert np.cos(folded) == pytest.approx(np.cos(angles))
    assert np.sin(folded) == pytest.approx(np.sin(angles), abs=1e-12)
    small = RNG.uniform(-3.0, 3.0, 100)
    assert np.array_equal(wrap(small), small)


def test_interpolation_is_the_arc_of_constant_twist():
    """Going a third of the way three times is going there: the geodesic of the group, not of its coordinates."""
    step = interpolate(A, B, np.full(200, 1 / 3))
    turn = wrap(B[:, 2] - A[:, 2])
    end = compose(compose(step, between(A, step)), between(A, step))
    assert end[:, :2] == pytest.approx(B[:, :2], abs=1e-9)
    assert end[:, 2] == pytest.approx(A[:, 2] + turn, abs=1e-9)


def test_interpolation_meets_its_ends():
    assert np.array_equal(interpolate(A, B, np.zeros(200)), A)
    end = interpolate(A, B, np.ones(200))
    assert end[:, :2] == pytest.approx(B[:, :2], abs=1e-12)
    assert wrap(end[:, 2] - B[:, 2]) == pytest.approx(np.zeros(200), abs=1e-12)


def test_interpolation_between_equal_poses_is_exact():
    assert np.array_equal(interpolate(A, A, RNG.uniform(0, 1, 200)), A)


@pytest.mark.parametrize("scale", [1.0, 0.3, -2.0])
def test_yaw_of_a_quaternion_does_not_mind_roll_pitch_or_length(scale):
    yaw, pitch, roll = RNG.uniform(-3, 3, 100), RNG.uniform(-1.4, 1.4, 100), RNG.uniform(-3, 3, 100)

    def about(axis, angle):
        q = np.zeros((100, 4))
        q[:, axis], q[:, 3] = np.sin(angle / 2), np.cos(angle / 2)
        return q

    def times(p, q):
        (a, b, c, w), (d, e, f, v) = p.T, q.T
        return np.stack((w * d + a * v + b * f - c * e, w * e - a * f + b * v + c * d, w * f + a * e - b * d + c * v,
                         w * v - a * d - b * e - c * f), axis=1)  # fmt: skip

    q = times(times(about(2, yaw), about(1, pitch)), about(0, roll))
    assert yaw_from_quaternion(scale * q) == pytest.approx(yaw, abs=1e-9)


def test_rotation_gives_the_same_bits_for_strided_and_dense_angles():
    wide = RNG.uniform(-9, 9, (1001, 3))
    xy = RNG.uniform(-5, 5, (1001, 2))
    assert np.array_equal(rotate(xy, wide[:, 2]), rotate(xy, wide[:, 2].copy()))
    one_by_one = np.concatenate([rotate(xy[i : i + 1], wide[i : i + 1, 2]) for i in range(1001)])
    assert np.array_equal(rotate(xy, wide[:, 2]), one_by_one)


DRAWS = np.random.default_rng(2)


def one(ds, dl=0.0, dtheta=0.0):
    parts = rot_trans_rot(Increments(np.array([ds]), np.array([dl]), np.array([dtheta])))
    return float(parts.rot1_rad[0]), float(parts.trans_m[0]), float(parts.rot2_rad[0])


def test_increments_accumulate_to_the_poses_they_came_from():
    poses = np.cumsum(DRAWS.normal(0, 0.3, (500, 3)), axis=0)
    back = accumulate(poses[0], increments(poses))
    assert back == pytest.approx(poses, abs=1e-10)


def test_accumulation_cut_anywhere_gives_the_same_bits():
    steps = Increments(*DRAWS.normal(0, 0.1, (3, 400)))
    whole = accumulate(np.array([1.0, 2.0, 3.0]), steps)
    pose, pieces = np.array([1.0, 2.0, 3.0]), []
    for cut in np.split(np.arange(400), [3, 4, 190, 333]):
        part = accumulate(pose, Increments(steps.ds_m[cut], steps.dl_m[cut], steps.dtheta_rad[cut]))
        pose = part[-1]
        pieces.append(part[1:])
    assert np.array_equal(np.concatenate(pieces), whole[1:])


def test_an_arc_is_a_chord_at_mid_heading_and_backwards_is_negative():
    forwards = increments(np.array([[0, 0, 0], [np.sin(0.4), 1 - np.cos(0.4), 0.4]]))
    assert forwards.ds_m[0] == pytest.approx(2 * np.sin(0.2))
    assert forwards.dl_m[0] == pytest.approx(0.0, abs=1e-15)
    back = increments(np.array([[0, 0, 2.0], [-0.1 * np.cos(2.0), -0.1 * np.sin(2.0), 2.0]]))
    assert back.ds_m[0] == pytest.approx(-0.1)


def test_turns_are_wrapped():
    steps = increments(np.array([[0, 0, 3.1], [0, 0, -3.1]]))
    assert steps.dtheta_rad[0] == pytest.approx(2 * np.pi - 6.2)


def test_turn_drive_turn_goes_where_the_increment_goes():
    steps = Increments(DRAWS.normal(0, 0.5, 300), DRAWS.normal(0, 0.2, 300), DRAWS.uniform(-1.5, 1.5, 300))
    far = np.hypot(steps.ds_m, steps.dl_m) >= BEARING_MIN_M
    parts = rot_trans_rot(steps)
    zero = np.zeros(300)
    pose = compose(np.stack((zero, zero, parts.rot1_rad), 1), np.stack((parts.trans_m, zero, parts.rot2_rad), 1))
    expected = np.array([accumulate(np.zeros(3), Increments(a, b, c))[1] for a, b, c in zip(
        steps.ds_m[:, None], steps.dl_m[:, None], steps.dtheta_rad[:, None], strict=True)])  # fmt: skip
    assert far.sum() > 200
    assert pose[far, :2] == pytest.approx(expected[far, :2], abs=1e-12)
    assert wrap(pose[far, 2] - expected[far, 2]) == pytest.approx(np.zeros(far.sum()), abs=1e-12)


@pytest.mark.parametrize("length", [0.005, 0.3])
def test_reversing_has_a_negative_translation_and_no_half_turn(length):
    rot1, trans, rot2 = one(-length, 0.0, 0.02)
    assert trans == pytest.approx(-length)
    assert (rot1, rot2) == pytest.approx((0.01, 0.01))


def test_short_steps_split_the_turn_evenly_whatever_their_bearing():
    below = BEARING_MIN_M * 0.99
    assert one(0.0, below, 0.3) == pytest.approx((0.15, below, 0.15))
    rot1, trans, rot2 = one(0.0, BEARING_MIN_M * 1.01, 0.0)
    assert (abs(rot1), trans) == pytest.approx((np.pi / 2, BEARING_MIN_M * 1.01))
    assert rot2 == pytest.approx(-rot1)


def test_standing_still_is_zero():
    assert one(0.0) == (0.0, 0.0, 0.0)


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
