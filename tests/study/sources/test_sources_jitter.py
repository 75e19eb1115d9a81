"""Stamps of arrival are detected; irregularly sampled poses and stamps with small jitter are not."""

import numpy as np
import pytest

from odomcorrupt.study.io.raw_trajectory import Samples
from odomcorrupt.study.io.stamps import jitter_warnings, stamp_jitter_s


def path(taken_s, stamped_s, noise_m=0.0005):
    """Return poses along a bend, taken at one time and stamped with another."""
    noise = np.random.default_rng(1).standard_normal((len(taken_s), 3)) * noise_m
    way = 0.5 * taken_s + 0.1 * np.sin(taken_s)
    xyz = np.stack((10.0 * np.sin(way / 10.0), 10.0 * np.cos(way / 10.0), 0.0 * way), axis=1) + noise
    stamps_ns = (stamped_s * 1e9).astype(np.int64)
    nothing = np.zeros(0)
    return Samples("run.bag: /mocap", "/mocap", "", stamps_ns, xyz, way / 10.0, nothing.astype(np.int64), nothing)


REGULAR = np.arange(6000) / 50.0
ODD = REGULAR + np.random.default_rng(2).uniform(0.0, 0.015, len(REGULAR))


@pytest.mark.parametrize(
    ("taken", "stamped", "noticed"),
    [
        (REGULAR, ODD, True),
        (ODD, ODD, False),
        (REGULAR, REGULAR, False),
        (REGULAR, REGULAR + 1e-4 * np.sin(np.arange(6000)), False),
    ],
    ids=["arrival", "taken at odd times", "regular", "hardly off"],
)
def test_stamps_that_poses_know_nothing_of_are_noticed(taken, stamped, noticed):
    seen = path(taken, stamped)
    said = jitter_warnings(seen, stamp_jitter_s(seen, path(REGULAR, REGULAR)))
    assert bool(said) == noticed
    if noticed:
        assert said[0].startswith("/mocap: its stamps are off by about 4.")


def test_poses_that_are_published_whenever_the_robot_has_come_so_far_are_stamped_right():
    t_s = np.arange(0.0, 900.0, 0.02)
    way_m = np.cumsum(0.3 + 0.2 * np.sin(0.7 * t_s) + 0.08 * np.sin(0.13 * t_s)) * 0.02

    def straight(at_s):
        xyz = np.column_stack((np.interp(at_s, t_s, way_m), 0.0 * at_s, 0.0 * at_s))
        none = np.zeros(0)
        return Samples("run.bag: /pose", "/pose", "", (at_s * 1e9).astype(np.int64), xyz, 0.0 * at_s, none, none)

    triggered = straight(np.interp(np.arange(0.5, way_m[-1], 0.5), way_m, t_s))
    assert not stamp_jitter_s(triggered, straight(t_s))


def test_noise_of_poses_with_lost_frames_is_no_jitter_beside_stamps_that_do():
    """Noise makes steps longer, those of single intervals more than those across lost frames."""
    camera_s = (np.arange(9000) / 30.0)[np.random.default_rng(3).random(9000) > 0.03]
    camera, arrival = path(camera_s, camera_s, noise_m=0.02), path(REGULAR, ODD)
    assert not stamp_jitter_s(camera, path(REGULAR, REGULAR))
    assert stamp_jitter_s(arrival, camera)
