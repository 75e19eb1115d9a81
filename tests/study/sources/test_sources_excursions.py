"""Excursions of the truth (lost localisation, swapped markers) end; displacements of a robot that was moved remain."""

from dataclasses import replace

import numpy as np
import pytest

from odomcorrupt.study.io.jumps import without_excursions, without_outliers
from odomcorrupt.study.io.raw_trajectory import Samples

NOWHERE = np.zeros(0)


def samples(t_s, xy, yaw, *, localised):
    return Samples(
        "run: /x", "/x", "map", np.round(t_s * 1e9).astype(np.int64), np.column_stack((xy, np.zeros(len(xy)))), yaw,
        NOWHERE.astype(np.int64), NOWHERE, localised=localised,
    )  # fmt: skip


def drive(jump_s, lasts_s, *, scale=1.0, gain=1.0):
    """Return odometry and a localisation that is 25 cm off from a time on, for some seconds, and which poses are."""
    t_s = np.arange(0.0, 240.0, 0.02)
    turn = 0.4 * np.sign(np.sin(2.0 * np.pi * t_s / 40.0))
    paths = []
    for length, gained in ((scale, gain), (1.0, 1.0)):
        yaw = np.cumsum(turn * 0.02) * gained
        paths.append((np.cumsum(0.4 * 0.02 * length * np.stack((np.cos(yaw), np.sin(yaw)), axis=1), axis=0), yaw))
    rows = slice(10, None, 25)
    rng = np.random.default_rng(1)
    at = t_s[rows]
    out = (at >= jump_s) & (at < jump_s + lasts_s)
    xy = paths[1][0][rows] + rng.normal(0.0, 0.02, (len(at), 2)) + out[:, None] * (0.22, -0.12)
    odometry = samples(t_s, *paths[0], localised=False)
    return odometry, samples(at, xy, paths[1][1][rows] + rng.normal(0.0, 0.008, len(at)), localised=True), out


@pytest.mark.parametrize(("scale", "gain"), [(1.0, 1.0), (1.012, 1.0), (1.0, 1.02)])
def test_an_excursion_is_left_out_whole_and_nothing_else(scale, gain):
    odometry, truth, out = drive(95.0, 6.0, scale=scale, gain=gain)
    left = without_excursions(odometry, truth)
    np.testing.assert_array_equal(left.stamps_ns, truth.stamps_ns[~out])
    assert "an excursion that comes back, 12 poses, left out (0.2" in left.notes[-1]


def test_what_stays_is_no_excursion():
    odometry, truth, _ = drive(95.0, 1e9)
    assert without_excursions(odometry, truth) is truth


def test_a_robot_that_was_moved_is_no_excursion_if_poses_become_more_frequent():
    odometry, truth, out = drive(95.0, 1e9)
    kept = out | (np.arange(len(out)) % 4 == 0)
    assert len(without_excursions(odometry, truth.only(kept, ""))) == kept.sum()


def tracked(turned_rad, begin_s=95.0, end_s=96.5, *, hidden_s=0.0):
    """Return odometry, a tracker at 50 Hz that is turned for a time and hidden before, and which poses are."""
    odometry, _, _ = drive(1e9, 0.0)
    at = odometry.seconds_since(int(odometry.stamps_ns[0]))
    seen = (at < begin_s - hidden_s) | (at >= begin_s)
    out = ((at >= begin_s) & (at < end_s))[seen]
    yaw = odometry.yaw_rad + np.random.default_rng(1).normal(0.0, 6e-4, len(at))
    return odometry, samples(at[seen], odometry.xyz[seen, :2], yaw[seen] + turned_rad * out, localised=False), out


@pytest.mark.parametrize("degrees", [17.0, 90.0, -90.0, 180.0])
@pytest.mark.parametrize("hidden_s", [0.0, 2.0])
def test_markers_that_are_swapped_for_a_moment_are_left_out(degrees, hidden_s):
    odometry, truth, out = tracked(np.radians(degrees), hidden_s=hidden_s)
    left = without_outliers(without_excursions(odometry, truth))
    np.testing.assert_array_equal(left.stamps_ns, truth.stamps_ns[~out])


def test_markers_that_stay_swapped_are_no_excursion():
    odometry, truth, _ = tracked(np.radians(90.0), end_s=1e9)
    assert without_excursions(odometry, truth) is truth


def test_what_a_robot_may_have_done_is_no_excursion_of_a_tracker():
    odometry, truth, _ = drive(95.0, 6.0)
    slow = replace(truth, localised=False)
    assert without_excursions(odometry, slow) is slow
