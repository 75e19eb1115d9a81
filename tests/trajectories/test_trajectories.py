"""Integration of odometry, and particles along a drive."""

import csv
import json
import math
import re
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
from bagged import messages_in, rows_of

import odomcorrupt as oc
from odomcorrupt.cli import run
from odomcorrupt.errors import ModelError, RecordingError
from odomcorrupt.sampling.samples import places_along, sample_particles
from odomcorrupt.trajectories import Drive, Rule, integrate, noisy_twists, read_drive, read_poses
from recordings import RECORDINGS


def textbook(start, twist, t, rule):
    """One step after the other, with scalars."""
    poses = [tuple(start)]
    for (vx, vy, omega), before, after in zip(twist, t, t[1:], strict=False):
        x, y, theta = poses[-1]
        dt = after - before
        if rule == "exact" and omega:
            # the centre of the circle stays where it is
            turned = theta + omega * dt
            x += (vx * (math.sin(turned) - math.sin(theta)) + vy * (math.cos(turned) - math.cos(theta))) / omega
            y += (vx * (math.cos(theta) - math.cos(turned)) + vy * (math.sin(turned) - math.sin(theta))) / omega
        else:
            along = theta + (omega * dt / 2 if rule == "midpoint" else 0)
            x += dt * (vx * math.cos(along) - vy * math.sin(along))
            y += dt * (vx * math.sin(along) + vy * math.cos(along))
        poses.append((x, y, theta + omega * dt))
    return poses


@pytest.mark.parametrize("rule", get_args(Rule))
def test_rule_is_the_textbook_loop(rule):
    rng = np.random.default_rng(2)
    twist, t = rng.normal(size=(40, 3)), np.cumsum(rng.uniform(0, 0.5, 40))
    start = np.array([1.0, -2.0, 0.7])
    np.testing.assert_allclose(integrate(start, twist, t, rule), textbook(start, twist, t, rule), atol=1e-12)


def test_exact_closes_a_circle_in_any_number_of_steps():
    for n in (3, 7, 100):
        t = np.linspace(0, 2 * math.pi, n + 1)
        end = integrate(np.zeros(3), np.tile([1.0, 0.0, 1.0], (n + 1, 1)), t, "exact")[-1]
        np.testing.assert_allclose(end, [0, 0, 2 * math.pi], atol=1e-12)


def test_hold_says_which_interval_a_twist_is_for():
    twist, t = np.array([[1.0, 0, 0], [2.0, 0, 0], [4.0, 0, 0]]), np.array([0.0, 1.0, 2.0])
    assert integrate(np.zeros(3), twist, t, "exact", hold="next")[-1, 0] == 3.0
    assert integrate(np.zeros(3), twist, t, "exact", hold="previous")[-1, 0] == 6.0


def test_unknown_rule_is_named():
    with pytest.raises(ModelError, match="simpson"):
        integrate(np.zeros(3), np.zeros((2, 3)), np.arange(2.0), "simpson")


def test_noisy_run_does_not_depend_on_its_company():
    twist = np.zeros((30, 3))
    many = noisy_twists(twist, 0.2, 0.04, seed=3, runs=range(8))
    alone = noisy_twists(twist, 0.2, 0.04, seed=3, runs=range(5, 6))
    np.testing.assert_array_equal(many[5], alone[0])
    assert not np.array_equal(many[4], many[5])


def test_noise_on_twists_drifts_as_white_noise_does():
    """Heading after n steps: sd omega dt sqrt(n); along a straight drive: sd v dt sqrt(n)."""
    n, dt = 400, 0.01
    twists = noisy_twists(np.tile([1.0, 0, 0], (n + 1, 1)), 0.2, 0.04, seed=1, runs=range(2000))
    ends = integrate(np.zeros(3), twists, np.arange(n + 1) * dt, "exact")[:, -1]
    assert ends[:, 2].std() == pytest.approx(0.04 * dt * math.sqrt(n), rel=0.06)
    assert ends[:, 0].std() == pytest.approx(0.2 * dt * math.sqrt(n), rel=0.06)


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
    return [one for one in messages_in(path) if one[0] not in ("/odom", "/tf", "/tf_static")]


@pytest.mark.slow
def test_transform_says_what_the_odometry_says(tmp_path):
    out = tmp_path / "out.mcap"
    assert run(["integrate", str(OFFICE), str(out), "--twist-noise", "1", "1", "--seed", "2"]) == 0
    drive = read_drive(out, None)
    xy = rows_of(out, "/tf", (drive.frame_id, drive.child_frame_id)).xyt[:, :2]
    away = np.abs(xy[:, None] - drive.xyt[None, :, :2]).sum(axis=2).min(axis=1)
    original = read_drive(OFFICE, None)
    assert np.abs(drive.xyt[:, :2] - original.xyt[:, :2]).max() > 0.05
    assert np.median(away) < 1e-6


def test_truth_of_a_wrong_type_is_named(capsys):
    assert run(["integrate", str(OFFICE), "--truth", "/tf"]) == 1
    assert "TFMessage" in capsys.readouterr().err


@pytest.mark.recordings
def test_truth_is_read_in_its_own_frame():
    truth = read_poses(GAZEBO, "ground_truth")
    assert len(truth) > 10_000


NOISE = oc.Noise(alpha=(0.05, 0.02, 0.05, 0.01))


def straight(length, n=500):
    xyt = np.zeros((n, 3))
    xyt[:, 0] = np.linspace(0, length, n)
    return Drive("/odom", "odom", "base", np.arange(n) * 10**8, xyt, np.zeros((n, 3)))


def test_run_of_the_cloud_is_the_path_that_corruption_writes(tmp_path):
    noisy = tmp_path / "noisy.mcap"
    arguments = ["--alpha", "0.05", "0.02", "0.05", "0.01", "--seed", "9"]
    assert run([str(OFFICE), str(noisy), *arguments, "--run", "3"]) == 0
    cloud = oc.sample_along(OFFICE, NOISE, seed=9, runs=4, every_m=7.0).result
    np.testing.assert_allclose(cloud.xyt[3, -1, :2], read_drive(noisy, None).xyt[-1, :2], atol=1e-9)


@pytest.mark.slow
def test_cloud_spreads_as_the_law_says():
    """On a straight drive: along by sqrt(distance), heading by sqrt(distance), across by distance^1.5."""
    drive = straight(16.0)
    cloud = sample_particles(drive, oc.Model(NOISE).motion_model, places_along(drive, 4.0), seed=1, runs=3000)
    np.testing.assert_allclose(cloud.distance_m, [4, 8, 12, 16], atol=0.05)
    spread = cloud.xyt.std(axis=0)
    d = cloud.distance_m
    np.testing.assert_allclose(spread[:, 2], 0.02 * np.sqrt(d), rtol=0.06)
    np.testing.assert_allclose(spread[:, 0], 0.05 * np.sqrt(d), rtol=0.06)
    np.testing.assert_allclose(spread[:, 1], 0.02 * np.sqrt(d**3 / 3), rtol=0.06)


def test_parked_robot_has_no_cloud():
    with pytest.raises(RecordingError, match="does not move"):
        places_along(straight(0.0), 1.0)


def test_last_place_is_the_end_and_no_place_is_near_it():
    drive = straight(10.1)
    np.testing.assert_allclose(drive.distance_m[places_along(drive, 5.0)], [5, 10.1], atol=0.05)


def test_command_writes_every_run(tmp_path, capsys):
    names = [tmp_path / f"cloud.{end}" for end in ("csv", "json", "png")]
    for name in names:
        assert run(["sample", str(OFFICE), "-n", "6", "--every", "10", "--seed", "1", "-o", str(name)]) == 0
        assert f"wrote {name}" in capsys.readouterr().err
    assert names[2].read_bytes().startswith(b"\x89PNG")
    with names[0].open() as file:
        rows = list(csv.DictReader(file))
    places = json.loads(names[1].read_text())["places"]
    assert len(rows) == 6 * len(places)
    last = [float(row["x_m"]) for row in rows if float(row["distance_m"]) == places[-1]["distance_m"]]
    assert np.mean(last) == pytest.approx(places[-1]["mean_xyt"][0])
