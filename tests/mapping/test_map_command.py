from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from odomcorrupt.cli import run
from odomcorrupt.corruption.path import NoisyPath
from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.mapping.messages import mount_at
from odomcorrupt.mapping.occupancy_grid import OCCUPIED, read_map
from odomcorrupt.mapping.scan_map import place, read_rays, slow_rays, wall_thickness
from odomcorrupt.model.motion_model import MotionModel
from odomcorrupt.model.presets import preset_named
from odomcorrupt.trajectories import read_drive, read_poses
from recordings import RECORDINGS

GAZEBO = RECORDINGS / "real" / "rob521_gazebo.mcap"
OLIN = RECORDINGS / "bags" / "olin_tb4" / "macfirst_floor_take_2"
OFFICE = Path(__file__).parents[2] / "fixtures" / "office.mcap"


@pytest.mark.recordings
def test_rays_placed_by_the_truth_end_in_the_walls_of_the_real_map():
    truth = read_poses(GAZEBO, "/ground_truth")
    rays = slow_rays(read_rays(GAZEBO, "/scan", "base_link", None), read_drive(GAZEBO, None), 0.1).rays
    ends = place(rays, truth).to_xy[::50]
    real = read_map(RECORDINGS / "bags" / "maps" / "rob521_gazebo.yaml")
    near = np.zeros(len(ends), dtype=bool)
    for dx in (-0.05, 0.0, 0.05):
        for dy in (-0.05, 0.0, 0.05):
            near |= real.states(ends + np.array([dx, dy])) == OCCUPIED
    assert near.mean() > 0.98


@pytest.mark.recordings
def test_walls_thicken_with_distance_through_noisy_odometry_and_stay_crisp_through_the_truth():
    drive, truth = read_drive(GAZEBO, None), read_poses(GAZEBO, "/ground_truth")
    slow = slow_rays(read_rays(GAZEBO, "/scan", "base_link", None), drive, 0.1)
    some = np.arange(len(slow.rays)) % 7 == 0
    rays = replace(slow.rays, stamps_ns=slow.rays.stamps_ns[some], to_xy=slow.rays.to_xy[some])
    travelled = slow.travelled_m[some]
    # the first rooms, all rooms but the start seen again, everything
    marks = travelled.max() * np.array([1 / 6, 1 / 2, 1.0])

    def thickness(path):
        ends = place(rays, path).to_xy
        return np.array([wall_thickness(ends[travelled <= mark], cell_m=0.04) for mark in marks])

    clean = thickness(drive.trajectory)
    np.testing.assert_allclose(thickness(truth), clean, atol=5e-4)
    model = MotionModel(preset_named("typical").noise)
    added = []
    for run_number in range(10):
        error = NoisyPath(model, 1, run_number).feed(drive.stamps_ns, drive.xyt).error_xyt
        added.append(thickness(Trajectory(drive.stamps_ns, drive.xyt + error)) ** 2 - clean**2)
    grown = np.sqrt(np.mean(added, axis=0))
    assert grown[0] < grown[1] < grown[2]
    assert grown[2] > clean[2]


@pytest.mark.slow
@pytest.mark.recordings
def test_turtlebot_recorded_as_sqlite_is_mapped(tmp_path):
    out = tmp_path / "olin.png"
    assert run(["map", str(OLIN), "-o", str(out), "--seed", "1", "--resolution", "0.1"]) == 0
    names = sorted(p.name for p in tmp_path.iterdir())
    assert names == ["olin.png", "olin_clean.pgm", "olin_clean.yaml", "olin_noisy.pgm", "olin_noisy.yaml"]
    assert (read_map(tmp_path / "olin_clean.yaml").cells == OCCUPIED).sum() > 300


def test_zero_noise_makes_the_same_map_and_a_name_with_a_dot_is_that_of_both(tmp_path):
    options = ["--alpha", "0", "0", "0", "0", "--seed", "1", "--resolution", "0.2"]
    assert run(["map", str(OFFICE), "-o", str(tmp_path / "m.v2.png"), *options]) == 0
    names = sorted(p.name for p in tmp_path.iterdir())
    assert names == ["m.v2.png", "m.v2_clean.pgm", "m.v2_clean.yaml", "m.v2_noisy.pgm", "m.v2_noisy.yaml"]
    assert read_map(tmp_path / "m.v2_noisy.yaml").resolution_m == 0.2
    assert (tmp_path / "m.v2_clean.pgm").read_bytes() == (tmp_path / "m.v2_noisy.pgm").read_bytes()


def test_laser_pose_replaces_tf():
    drive = read_drive(OFFICE, None)
    by_tf = read_rays(OFFICE, None, drive.child_frame_id, None)
    by_hand = read_rays(OFFICE, None, "nowhere", mount_at(np.array([*by_tf.from_xy, 0.0])))
    np.testing.assert_allclose(by_hand.to_xy, by_tf.to_xy, atol=1e-9)
    turned = read_rays(OFFICE, None, "nowhere", mount_at(np.array([0.0, 0.0, np.pi / 2])))
    np.testing.assert_allclose(turned.to_xy[:, 1], by_tf.to_xy[:, 0] - by_tf.from_xy[0], atol=1e-9)


@pytest.mark.parametrize(
    ("arguments", "word"),
    [(["--scan", "/nope"], "/scan"), (["--resolution", "0.0001"], "--resolution"), (["--truth", "/imu"], "Imu")],
)
def test_what_cannot_be_mapped_is_reported_in_one_line(arguments, word, capsys):
    assert run(["map", str(OFFICE), "--seed", "1", *arguments]) == 1
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1
    assert word in lines[0]
