import re
from pathlib import Path

import numpy as np
import pytest

from odomcorrupt.bags.messages import gather, locate
from odomcorrupt.bags.open import open_reader
from odomcorrupt.cli import run
from odomcorrupt.trajectories import integrate, read_drive, read_poses
from recordings import RECORDINGS

GAZEBO = RECORDINGS / "real" / "rob521_gazebo.mcap"
OFFICE = Path(__file__).parents[2] / "fixtures" / "office.mcap"


@pytest.mark.recordings
def test_euler_is_within_two_centimetres_of_the_truth(tmp_path, capsys):
    picture = tmp_path / "errors.png"
    assert run(["integrate", str(GAZEBO), "--integrate", "euler", "--plot", str(picture)]) == 0
    metres, radians = re.search(r"/ground_truth: at most ([\d.]+) m and ([\d.]+) rad", capsys.readouterr().out).groups()
    assert float(metres) < 0.02
    assert float(radians) < 0.026
    assert picture.stat().st_size > 10_000


@pytest.mark.slow
@pytest.mark.recordings
def test_hundred_noisy_runs_surround_the_truth(tmp_path, capsys):
    arguments = ["--twist-noise", "0.2", "0.04", "--runs", "100", "--seed", "1", "--plot", str(tmp_path / "runs.png")]
    assert run(["integrate", "-v", str(GAZEBO), "--integrate", "euler", *arguments]) == 0
    said = capsys.readouterr().out
    # white noise of 0.04 rad/s over 12956 intervals of 10 or 20 ms
    heading = float(re.search(r"([\d.]+) rad away", said)[1])
    drive = read_drive(GAZEBO, None)
    expected = 0.04 * np.sqrt((np.diff(drive.t_s) ** 2).sum())
    assert heading == pytest.approx(expected, rel=0.25)


def test_output_holds_the_integrated_path_and_nothing_else_changed(tmp_path):
    out = tmp_path / "out.mcap"
    assert run(["integrate", str(OFFICE), str(out), "--integrate", "midpoint", "--odom-topic", "/odom"]) == 0
    before, after = read_drive(OFFICE, "/odom"), read_drive(out, "/odom")
    expected = integrate(before.xyt[0], before.twist, before.t_s, "midpoint")
    np.testing.assert_allclose(after.xyt[:, :2], expected[:, :2], atol=1e-9)
    np.testing.assert_allclose(np.exp(1j * after.xyt[:, 2]), np.exp(1j * expected[:, 2]), atol=1e-9)
    np.testing.assert_array_equal(after.twist, before.twist)
    assert others(out) == others(OFFICE)


def others(path):
    """Every message but odometry and transforms: topic, log time, bytes."""
    with open_reader(path) as reader:
        return [
            (channel.topic, int(row["log_ns"]), block.data[row["offset"] : row["offset"] + row["length"]].tobytes())
            for block in reader.blocks()
            for row in block.table
            if (channel := reader.channels[int(row["channel"])]).msgtype not in MOVED
        ]


MOVED = {"nav_msgs/msg/Odometry", "tf2_msgs/msg/TFMessage"}


@pytest.mark.slow
def test_transform_says_what_the_odometry_says(tmp_path):
    out = tmp_path / "out.mcap"
    assert run(["integrate", str(OFFICE), str(out), "--twist-noise", "1", "1", "--seed", "2"]) == 0
    drive = read_drive(out, None)
    found = []
    with open_reader(out) as reader:
        for block in reader.blocks():
            for channel in reader.channels.values():
                if channel.topic == "/tf":
                    for layout in locate(block, channel):
                        found += [
                            gather(block, layout, item, "position")[:, :2]
                            for item in layout.items
                            if (item.frame_id, item.child_frame_id) == (drive.frame_id, drive.child_frame_id)
                        ]
    xy = np.concatenate(found)
    away = np.abs(xy[:, None] - drive.xyt[None, :, :2]).sum(axis=2).min(axis=1)
    original = read_drive(OFFICE, None)
    assert np.abs(drive.xyt[:, :2] - original.xyt[:, :2]).max() > 0.05
    assert np.median(away) < 1e-6


def test_pipe_and_idle_runs_are_refused(capsys):
    assert run(["integrate", "-", "x.mcap"]) == 1
    assert "pipe" in capsys.readouterr().err
    assert run(["integrate", str(OFFICE), "--runs", "5"]) == 2
    assert "--twist-noise" in capsys.readouterr().err


def test_truth_of_a_wrong_type_is_named(capsys):
    assert run(["integrate", str(OFFICE), "--truth", "/tf"]) == 1
    assert "TFMessage" in capsys.readouterr().err


@pytest.mark.recordings
def test_truth_is_read_in_its_own_frame():
    truth = read_poses(GAZEBO, "ground_truth")
    assert len(truth) > 10_000
