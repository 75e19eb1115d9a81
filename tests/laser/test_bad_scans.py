"""Scans with something wrong about them: found out and put right, or refused in one line."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
import raycaster

from odomcorrupt.cli import run
from odomcorrupt.errors import OdomCorruptError
from odomcorrupt.geometry.se2 import between, compose
from odomcorrupt.laser.calibrate import calibrate
from odomcorrupt.laser.mapping import largest_part, laser_brief, laser_maps
from odomcorrupt.laser.scans import read_sweeps
from odomcorrupt.study.io import Source, read_runs
from odomcorrupt.study.io.laser_truth import alerts_of, end_seen, laser_run, truth_of
from odomcorrupt.study.io.reader import read_odometry
from odomcorrupt.study.select.selection import learn


def read(path, scan=None):
    (recording,) = read_runs(Source(path, scan=scan))
    return recording, " | ".join([*recording.notes, *recording.alerts])


def turned_too_far(recording):
    """By what factor odometry turns more than the laser, between nodes a second or so apart."""
    truth, odometry = recording.truth, recording.odometry
    t_s = truth.seconds_since(recording.origin_ns)[::5]
    inside = (t_s > 1.0) & (t_s < recording.odometry_s[-1] - 1.0)
    ours = np.diff(odometry.at(t_s[inside], recording.origin_ns)[:, 2])
    theirs = np.diff(truth.at(t_s[inside], recording.origin_ns)[:, 2])
    return float(ours @ theirs / (theirs @ theirs))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("faults", "said"),
    [
        ({"mount": (0.1, 0.05, np.pi / 2)}, "pose estimated as"),
        ({"mount": (0.1, 0.0, np.pi / 2), "stated": (0.1, 0.0, 0.0)}, "turned by 90 deg from its pose in TF"),
        ({"flipped": True}, "mounted upside down"),
        ({"rate_hz": 1.0, "stated": (0.1, 0.0, 0.0)}, "one sweep in 1.0 s"),
        ({"jitter_s": 0.05, "stated": (0.1, 0.0, 0.0)}, "stamped on arrival"),
        ({"cloud": True, "stated": (0.1, 0.0, 0.0), "sweep_s": 0.001}, "a horizontal slice"),
        ({"backwards": True, "sweep_s": 0.19, "stated": (0.1, 0.0, 0.0)}, "times within a sweep run the wrong way"),
    ],
    ids=["no TF, 90 deg", "wrong TF", "upside down", "1 Hz", "arrival stamps", "cloud", "clockwise"],
)
def test_what_is_wrong_is_found_out_and_turns_are_measured_all_the_same(tmp_path, faults, said):
    topic = "/points" if "cloud" in faults else None
    recording, notes = read(raycaster.drive(tmp_path / "run.mcap", **faults), topic)
    assert said in notes
    assert turned_too_far(recording) == pytest.approx(1.02, abs=0.01)


@pytest.mark.slow
def test_the_track_is_learned_from_scans_stamped_on_arrival_and_so_is_their_mean_delay(tmp_path):
    (recording,) = read_runs(Source(raycaster.drive(tmp_path / "run.mcap", jitter_s=0.05, stated=(0.1, 0.0, 0.0))))
    found = learn([recording]).fit
    (track,) = (effect for effect in found.effects if effect.kind != "setup")
    assert track.name == "wheelbase"
    assert track.e == pytest.approx(0.02, abs=0.003)
    # the mean of |N(0, 50 ms)| is 40 ms
    assert found.problem.clocks[0].offset_s == pytest.approx(-0.04, abs=0.005)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("spin", "stated", "mount"),
    [
        ("while driving", (0.1, 0.0, 0.0), (0.1, 0.0, 0.0)),
        ("while driving", None, (0.1, 0.0, 0.0)),
        ("on the spot", (0.1, 0.0, 0.0), (0.1, 0.0, 0.0)),
        ("on the spot", None, (0.0, 0.0, 0.0)),
    ],
)
def test_steady_turning_gives_the_turns_but_no_lag_and_no_mounting_of_its_own(tmp_path, spin, stated, mount):
    path = raycaster.drive(tmp_path / "run.mcap", spin=spin, sweep_s=0.19, stated=stated)
    odometry, _ = read_odometry(Source(path))
    sweeps = read_sweeps(path, "run", "/scan", "base_link")
    motion = calibrate(sweeps, odometry, int(odometry.stamps_ns[0])).motion
    assert motion.lag_s == pytest.approx(0.0, abs=0.005)
    assert motion.mount == pytest.approx(mount, abs=0.02)
    recording, notes = read(path)
    assert "in TF" not in notes
    assert "against odometry" not in notes
    assert ("does not show its pose" in notes) == (spin == "on the spot" and stated is None)
    assert turned_too_far(recording) == pytest.approx(1.02, abs=0.01)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("sweep_s", "said"), [(0.0, "treated as simultaneous"), (0.19, "a turn takes 0.19 s (counter-clockwise)")]
)
def test_scan_time_without_increment_counts_where_sweeps_fit_better_by_it(tmp_path, sweep_s, said):
    path = raycaster.drive(tmp_path / "run.mcap", sweep_s=sweep_s, scan_time_s=0.19, stated=(0.1, 0.0, 0.0))
    odometry, _ = read_odometry(Source(path))
    found = calibrate(read_sweeps(path, "run", "/scan", "base_link"), odometry, int(odometry.stamps_ns[0]))
    (note,) = (text for text in found.said if "scan_time" in text)
    assert said in note
    assert found.motion.lag_s == pytest.approx(0.0, abs=0.01)
    assert max(np.ptp(sweep.after_s) for sweep in found.sweeps.sweeps) == pytest.approx(sweep_s, abs=0.01)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("faults", "words"),
    [
        ({"corridor": True, "stated": (0.1, 0.0, 0.0)}, "a corridor hides travel"),
        ({"blind": True, "stated": (0.1, 0.0, 0.0)}, "180 of 180 bearings see the robot itself"),
    ],
)
def test_scans_that_show_no_motion_are_refused_in_one_line(tmp_path, faults, words):
    with pytest.raises(OdomCorruptError, match=words) as refused:
        read(raycaster.drive(tmp_path / "run.mcap", **faults))
    assert "\n" not in str(refused.value)


def test_of_two_lasers_one_has_to_be_named(tmp_path, capsys):
    path = raycaster.drive(tmp_path / "run.mcap", twice=True, rate_hz=2.0)
    assert run(["learn", str(path)]) == 1
    assert "--scan /scan or --scan /scan_rear" in capsys.readouterr().err
    assert run(["learn", str(path), "--scan", "/scan_front"]) == 1
    said = capsys.readouterr().err
    assert "/scan_rear" in said
    assert "--scan" in said


@pytest.mark.slow
def test_beside_a_laser_a_gyro_says_where_the_heading_comes_from_and_the_laser_is_the_truth(tmp_path):
    recording, notes = read(raycaster.drive(tmp_path / "run.mcap", stated=(0.1, 0.0, 0.0), gyro=True))
    assert recording.matched
    assert "the laser on /scan" in notes
    assert "/imu/data: yaw is about its z axis" in notes
    assert recording.heading_source != "gyro"
    assert turned_too_far(recording) == pytest.approx(1.02, abs=0.01)


def test_a_laser_is_left_out_on_demand_and_the_refusal_of_a_corridor_says_how(tmp_path):
    path = raycaster.drive(tmp_path / "run.mcap", corridor=True, stated=(0.1, 0.0, 0.0), gyro=True, rate_hz=2.0)
    with pytest.raises(OdomCorruptError, match="scan none leaves the laser out"):
        read(path)
    recording, _ = read(path, "none")
    assert not recording.positioned


def test_a_map_in_two_parts_is_drawn_of_the_larger_one_and_scans_that_are_missing_are_said(tmp_path, capsys):
    path = raycaster.drive(tmp_path / "run.mcap", stated=(0.1, 0.0, 0.0), rate_hz=2.0, missing_s=(20.0, 24.0))
    assert run(["info", str(path), "--json"]) == 0
    topics = {topic["topic"]: topic for topic in json.loads(capsys.readouterr().out)["topics"]}
    assert topics["/scan"]["longest_gap_s"] == pytest.approx(4.5)
    matched = laser_run(path, "run", None, "/scan")
    assert any("no scans for 4.5 s from 19.7 s on" in note for part in truth_of(matched) for note in part.notes)
    assert largest_part(matched)[1] == ""
    later = matched.path.t_s > 22.0
    cut = replace(matched, path=replace(matched.path, part=later.astype(np.int64)))
    kept, said = largest_part(cut)
    assert kept.path.t_s.max() < 22.0
    assert "2 parts that no scan connects: the map covers 0-20 s only; left out: 24-" in said
    drawn = laser_maps(cut, np.zeros((len(matched.odometry), 3)), 0.2)
    assert drawn.parts == said
    assert drawn.placed.startswith(f"{len(kept.path)} of ")
    assert [line.label for line in laser_brief(drawn).lines[:3]] == ["MATCHED", "parts", "walls"]
    # the odometry without noise makes the map of the odometry
    np.testing.assert_array_equal(drawn.maps[1].grid.cells, drawn.maps[2].grid.cells)
    (alert,) = alerts_of(cut)
    assert "s scans do not connect" in alert
    assert "was not moved" in alert
    # an odometry that lacks a turn of 20 deg during the gap
    motion = cut.calibration.motion
    xyt = motion.odometry.xyt.copy()
    last = int(np.searchsorted(motion.odometry.seconds_since(motion.origin_ns), 22.0))
    turned = compose(np.array([0.0, 0.0, -np.radians(20.0)]), between(xyt[last], xyt[last:]))
    xyt[last:] = compose(xyt[last], turned)
    motion = replace(motion, odometry=replace(motion.odometry, xyt=xyt))
    (alert,) = alerts_of(replace(cut, calibration=replace(cut.calibration, motion=motion)))
    moved = re.search(r"the robot was moved by (\d+) deg", alert)
    assert moved is not None
    assert float(moved[1]) == pytest.approx(20.0, abs=4.0)


pytestmark = pytest.mark.slow


@pytest.mark.parametrize("mount", [(0.1, 0.0, 0.0), (-0.05, 0.12, np.pi / 2)], ids=["ahead", "turned"])
def test_where_a_drive_ended_is_seen_by_its_scans(tmp_path, mount):
    _, poses, _, _ = raycaster.there_and_back(*raycaster.path()[2:])
    real = between(poses[0], poses[-1])
    assert np.hypot(*real[:2]) > 0.15
    bag = raycaster.drive(tmp_path / "run.mcap", mount=mount, stated=mount, returns=True, off=1.05)
    found = end_seen(bag, "run", None, "/scan")
    assert found == pytest.approx(real, abs=0.01)


def test_a_drive_that_ends_elsewhere_is_refused_in_one_line(tmp_path, capsys):
    bag = raycaster.drive(tmp_path / "run.mcap", stated=(0.1, 0.0, 0.0))
    assert run(["fit", str(bag), "--returns", "--scan", "/scan"]) == 1
    said = capsys.readouterr().err.strip()
    assert "--end" in said
    assert run(["fit", str(bag), "--end", "1,0,0", "--scan", "/scan"]) == 2
