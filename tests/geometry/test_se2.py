"""SE(2) against 3 x 3 matrices."""

import numpy as np
import pytest

from odomcorrupt.geometry.se2 import between, compose, interpolate, inverse, rotate, wrap, yaw_from_quaternion

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
