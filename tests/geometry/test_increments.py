"""Increments, and motion as turn, drive, turn."""

import numpy as np
import pytest

from odomcorrupt.geometry.se2 import BEARING_MIN_M, Increments, accumulate, compose, increments, rot_trans_rot, wrap

RNG = np.random.default_rng(2)


def one(ds, dl=0.0, dtheta=0.0):
    parts = rot_trans_rot(Increments(np.array([ds]), np.array([dl]), np.array([dtheta])))
    return float(parts.rot1_rad[0]), float(parts.trans_m[0]), float(parts.rot2_rad[0])


def test_increments_accumulate_to_the_poses_they_came_from():
    poses = np.cumsum(RNG.normal(0, 0.3, (500, 3)), axis=0)
    back = accumulate(poses[0], increments(poses))
    assert back == pytest.approx(poses, abs=1e-10)


def test_accumulation_cut_anywhere_gives_the_same_bits():
    steps = Increments(*RNG.normal(0, 0.1, (3, 400)))
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
    steps = Increments(RNG.normal(0, 0.5, 300), RNG.normal(0, 0.2, 300), RNG.uniform(-1.5, 1.5, 300))
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
