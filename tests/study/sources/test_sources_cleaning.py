"""Cleaning on reading: stamps, resets, gaps, outliers, frozen trackers and derived headings, with their notes."""

import numpy as np
import pytest
from sourcebags import edges, topic, write
from sourcedrive import START_NS, Rows, odometry, truth

from odomcorrupt.errors import RecordingError
from odomcorrupt.geometry.se2 import between
from odomcorrupt.study.io import Source, read_runs
from odomcorrupt.study.io.jumps import reach_of, stretches
from odomcorrupt.study.io.raw_trajectory import Samples, order_of


@pytest.fixture
def read(tmp_path):
    """Write odometry and truth, read them again."""

    def call(moved=None, real=None, **more):
        first = topic(
            more.pop("name", "/odom"), "Odometry", odometry() if moved is None else moved, **more.pop("odom", {})
        )
        second = topic("/truth", "PoseStamped", truth() if real is None else real, **more.pop("truth", {}))
        return read_runs(Source(write(tmp_path / "run.mcap", first, second), **more))

    return call


def noted(recordings, words):
    notes = [note for recording in recordings for note in recording.notes if words in note]
    assert len(notes) == 1, [note for recording in recordings for note in recording.notes]
    return notes[0]


def test_a_clean_run_has_nothing_to_be_said_about(read):
    (recording,) = read()
    assert len(recording.notes) == 1


def test_swapped_and_repeated_stamps_are_sorted_and_counted(read):
    moved = odometry()
    arrived = np.arange(len(moved))
    arrived[[50, 51]] = [51, 50]
    arrived = np.insert(arrived, 200, [199, 199])
    logs = START_NS + np.arange(len(arrived)) * 10_000_000
    recordings = read(moved.only(arrived), odom={"log_ns": logs})
    assert np.array_equal(recordings[0].odometry.stamps_ns, moved.stamps_ns)
    np.testing.assert_allclose(recordings[0].odometry.xyt, moved.xyt, atol=1e-12)
    assert "1 stamps out of order sorted" in noted(recordings, "sorted")
    assert "2 poses with duplicate stamps" in noted(recordings, "duplicate stamps")


def test_without_any_stamp_log_times_are_taken_and_it_is_said(read):
    moved = odometry()
    recordings = read(moved, odom={"stamps": False, "log_ns": moved.stamps_ns + 5})
    assert np.array_equal(recordings[0].odometry.stamps_ns, moved.stamps_ns + 5)
    noted(recordings, "/odom: no stamps in the messages, log times taken")


def test_a_few_poses_without_stamp_or_number_are_left_out(read):
    real = truth()
    stamps, xyz = real.stamps_ns.copy(), real.xyz.copy()
    stamps[3], xyz[7] = 0, np.nan
    recordings = read(real=Rows(stamps, xyz, real.yaw), truth={"log_ns": real.stamps_ns})
    assert set(real.stamps_ns) - set(recordings[0].truth.stamps_ns) == {real.stamps_ns[3], real.stamps_ns[7]}
    noted(recordings, "1 poses without a stamp left out")
    noted(recordings, "1 positions that are not numbers left out")


def test_a_clock_that_is_set_back_keeps_the_longest_stretch_and_never_interleaves():
    first, second = np.arange(100) * 50_000_000 + START_NS, np.arange(300) * 50_000_000 + START_NS
    order = order_of(np.concatenate((first, second)), np.arange(400) + 1)
    assert np.array_equal(order.rows, np.arange(100, 400))
    assert np.array_equal(order.stamps_ns, second)
    assert order.notes == ("its clock is set back 1 times: the longest stretch kept, 100 poses left out",)


def test_one_late_message_is_no_clock_set_back():
    stamps = np.arange(100) * 50_000_000 + START_NS
    arrived = np.concatenate((stamps[:10], stamps[11:80], stamps[10:11], stamps[80:]))
    order = order_of(arrived, np.arange(100) + 1)
    assert np.array_equal(order.stamps_ns, stamps)
    assert order.notes == ("1 stamps out of order sorted",)


def test_a_date_that_is_learnt_late_keeps_the_longer_part():
    stamps = np.concatenate((np.arange(50) * 50_000_000 + 10**9, START_NS + np.arange(200) * 50_000_000))
    order = order_of(stamps, np.arange(250) + 1)
    assert np.array_equal(order.rows, np.arange(50, 250))
    assert order.notes == ("its stamps jump by more than an hour: 50 poses left out",)


def test_a_reset_of_the_odometry_makes_two_independent_runs(read):
    moved = odometry(60.0)
    half = len(moved) // 2
    again = between(moved.xyt[half], moved.xyt[half:])
    xyz, yaw = moved.xyz.copy(), moved.yaw.copy()
    xyz[half:, :2], yaw[half:] = again[:, :2], again[:, 2]
    recordings = read(Rows(moved.stamps_ns, xyz, yaw), truth(60.0))
    np.testing.assert_allclose(recordings[1].odometry.xyt, again, atol=1e-12)
    assert [len(r.odometry) for r in recordings] == [half, len(moved) - half]
    assert [r.name for r in recordings] == ["run.mcap part 1", "run.mcap part 2"]
    # one clock recorded both
    assert recordings[1].origin_ns == recordings[0].origin_ns == moved.stamps_ns[0]
    assert recordings[1].clock == recordings[0].clock != ""
    assert "1 reset (" in noted(recordings, "/odom: 1 reset")
    assert " at 30.0 s)" in noted(recordings, "/odom: 1 reset")
    noted(recordings, "2 independent stretches used, 60 s of 60 s")


def test_a_stretch_too_short_to_be_studied_is_left_out(read):
    moved = odometry(40.0)
    late = len(moved) - 100
    xyz = moved.xyz.copy()
    xyz[late:] += 3.0
    (recording,) = read(moved.having(xyz=xyz), truth(40.0))
    assert len(recording.odometry) == late
    assert recording.name == "run.mcap"
    noted([recording], "1 independent stretches used, 35 s of 40 s")


def test_gross_jumps_and_back_of_the_truth_are_left_out(read):
    real = truth()
    xyz, yaw = real.xyz.copy(), real.yaw.copy()
    xyz[100] += 0.8
    xyz[300:330] -= 5.0
    yaw[500] += np.pi
    recordings = read(real=Rows(real.stamps_ns, xyz, yaw))
    kept = np.delete(np.arange(len(real)), [100, *range(300, 330), 500])
    assert np.array_equal(recordings[0].truth.stamps_ns, real.stamps_ns[kept])
    noted(recordings, "/truth: 32 outliers (jumps there and back) left out")


@pytest.mark.parametrize("far", [1e5, 1e300, np.inf])
def test_one_wild_position_is_an_outlier_and_no_unit(read, far):
    real = truth()
    xyz = real.xyz.copy()
    xyz[321] = [far, -far, 0.0]
    (recording,) = read(real=real.having(xyz=xyz))
    assert np.array_equal(recording.truth.stamps_ns, np.delete(real.stamps_ns, 321))
    noted([recording], "/truth: 1 outliers" if far < 1e9 else "/truth: 1 positions that are not numbers")


def test_a_truth_that_jumps_for_good_is_cut_there(read):
    real = truth(40.0)
    xyz = real.xyz.copy()
    xyz[len(real) // 2 :] += [1.0, 0.0, 0.0]
    recordings = read(odometry(40.0), real.having(xyz=xyz))
    assert len(recordings) == 2
    assert "1 jump that lasts (1.0" in noted(recordings, "/truth: ")
    # wheels roll on from the start of the run: a flat spot of the second stretch is where it was in the first
    first, second = (one.odometry.stamps_ns for one in recordings)
    assert first[0] == second[0]
    assert 0 <= first[-1] - recordings[0].truth.stamps_ns[-1] <= 3_000_000_000
    assert second[-1] - first[-1] > 15_000_000_000


def test_fast_honest_motion_is_no_jump():
    """A robot that goes from rest to 2 m/s and spins at 3 rad/s, seen at 10 Hz with RTK's noise."""
    rng = np.random.default_rng(3)
    t = np.arange(0.0, 60.0, 0.1)
    speed, turn = np.where(t % 20 < 12, 2.0, 0.0), np.where(t % 15 < 2, 3.0, 0.0)
    yaw = np.cumsum(turn) * 0.1
    xy = np.cumsum(np.stack((speed * np.cos(yaw), speed * np.sin(yaw)), axis=1) * 0.1, axis=0)
    none = np.zeros(0)
    clean = Samples("", "", "", (t * 1e9).astype(np.int64), np.c_[xy, 0 * t], yaw, none.astype(np.int64), none)
    noisy = np.c_[xy + 0.02 * rng.standard_normal(xy.shape), 0 * t]
    seen = Samples("", "", "", clean.stamps_ns, noisy, yaw, clean.log_ns, none)
    for path in (clean, seen):
        cut = stretches(path, reach_of(clean, path))
        assert len(cut.rows) == 1
        assert cut.outliers == 0


def test_two_robots_on_one_topic_are_refused(read):
    real = truth()
    xyz = real.xyz.copy()
    xyz[::2] += 4.0
    with pytest.raises(RecordingError, match="several robots or publishers on one topic"):
        read(real=real.having(xyz=xyz))


def test_truth_inside_a_gap_of_the_odometry_is_left_out(read):
    moved, real = odometry(), truth()
    gap = (moved.stamps_ns > START_NS + 12_000_000_000) & (moved.stamps_ns < START_NS + 14_000_000_000)
    recordings = read(moved.only(~gap))
    first, last = moved.stamps_ns[~gap][[240, 241]]
    inside = (real.stamps_ns > first) & (real.stamps_ns < last)
    assert inside.sum() > 60
    assert np.array_equal(recordings[0].truth.stamps_ns, real.stamps_ns[~inside])
    noted(recordings, f"/odom: a gap of 2.0 s; {inside.sum()} poses of the truth inside left out")


def test_odometry_that_restarts_from_its_last_pose_is_cut_there(read):
    moved, real = odometry(60.0), truth(60.0)
    gap = (moved.stamps_ns > START_NS + 28_000_000_000) & (moved.stamps_ns < START_NS + 31_000_000_000)
    assert len(read(moved.only(~gap), real)) == 1
    before, after = np.flatnonzero(gap)[[0, -1]] + [-1, 1]
    xyz = moved.xyz.copy()
    xyz[after:] += xyz[before] - xyz[after]
    recordings = read(moved.having(xyz=xyz).only(~gap), real)
    assert len(recordings) == 2
    noted(recordings, "restarted after a gap of 3.0 s")


def test_a_tracker_that_repeats_its_last_pose_while_the_robot_moves_is_rejected(read):
    real = truth()
    xyz, yaw = real.xyz.copy(), real.yaw.copy()
    xyz[400:450], yaw[400:450] = xyz[399], yaw[399]
    recordings = read(real=Rows(real.stamps_ns, xyz, yaw))
    assert np.array_equal(recordings[0].truth.stamps_ns, np.delete(real.stamps_ns, range(400, 450)))
    noted(recordings, "/truth: 50 poses that repeat the one before while the robot moves left out")


def test_a_robot_that_stands_keeps_its_repeated_poses(read):
    moved, real = odometry(), truth(noise=0.0)

    def parked(rows):
        at = int(np.searchsorted(rows.stamps_ns, START_NS + 15_000_000_000))
        xyz, yaw = rows.xyz.copy(), rows.yaw.copy()
        xyz[at:], yaw[at:] = xyz[at], yaw[at]
        return rows.having(xyz=xyz, yaw=yaw)

    (recording,) = read(parked(moved), parked(real))
    # the first quarter of a second of the stop may count as motion
    assert len(recording.truth) > len(real) - 10


def test_headings_that_repeat_the_odometry_are_noticed(read):
    moved = odometry()
    recordings = read(moved, Rows(moved.stamps_ns, truth(rate_hz=20.0).xyz, moved.yaw + 0.7))
    assert "100% of its headings turn exactly as the odometry does" in noted(recordings, "of its headings")


def test_headings_that_never_change_are_no_headings(read):
    real = truth()
    recordings = read(real=real.having(yaw=0.0 * real.yaw))
    assert np.isnan(recordings[0].truth.xyt[:, 2]).all()
    noted(recordings, "its headings do not follow its own path: they never change")


def test_localisation_on_top_of_the_odometry_is_noticed(tmp_path):
    moved = odometry()
    shift = Rows(moved.stamps_ns[::40], 0.02 * np.sin(moved.xyz[::40]), 0.01 * np.sin(moved.yaw[::40]))
    held = Rows(moved.stamps_ns, np.repeat(shift.xyz, 40, axis=0), np.repeat(shift.yaw, 40))
    bag = write(
        tmp_path / "run.mcap",
        topic("/odom", "Odometry", moved),
        edges(moved, "odom", "base_link"),
        edges(held, "map", "odom"),
    )
    assert "localisation on top of it" in noted(read_runs(Source(bag, truth="/tf:map.base_link")), "of its steps")


@pytest.mark.parametrize(
    ("name", "odom", "sign"),
    [
        ("/odometry/filtered", {}, "its name"),
        ("/odom", {"frame": "map"}, "its frame is map"),
        ("/odom", {"variance": 0.1 * (1 + np.arange(600) % 100)}, "its covariance shrinks 5 times"),
    ],
)
def test_odometry_that_looks_like_a_filters_is_warned_of(read, name, odom, sign):
    said = noted(read(name=name, odom=odom), "looks like a filter's output")
    assert sign in said


def test_odometry_that_jumps_towards_the_truth_is_warned_of(read):
    """Wheels 8 % too large, put right by 5 to 15 cm every two seconds."""
    moved, real = odometry(scale=1.08), truth(rate_hz=20.0, noise=0.0, late_ns=0)
    error = moved.xyz - real.xyz
    xyz = moved.xyz - error[np.arange(len(moved)) // 40 * 40]
    said = noted(read(moved.having(xyz=xyz), real), "looks like a filter's output")
    assert "it jumps towards the truth 14 times" in said


def test_wheel_odometry_that_drifts_is_not_warned_of(read):
    (recording,) = read(odometry(scale=1.05, drift=0.01, noise=0.002), odom={"variance": np.linspace(0.0, 5.0, 600)})
    assert not [note for note in recording.notes if "filter" in note]


@pytest.mark.parametrize("course", [True, False])
def test_headings_that_point_to_where_a_robot_backs_up_are_none(read, course):
    """As those of a receiver with one antenna; a robot that really backs up keeps its headings."""
    t_s = np.arange(0.0, 60.0, 0.05)
    speed = np.where(np.sin(2.0 * np.pi * t_s / 12.0) > -0.5, 0.4, -0.4)
    yaw = 1.5 * np.sin(0.21 * t_s)
    xy = np.cumsum(0.05 * speed[:, None] * np.stack((np.cos(yaw), np.sin(yaw)), axis=1), axis=0)
    moved = Rows(START_NS + np.round(t_s * 1e9).astype(np.int64), np.column_stack((1.01 * xy, 0.0 * yaw)), yaw)
    said = np.unwrap(yaw + np.pi * (speed < 0.0)) if course else yaw
    noise = 0.002 * np.random.default_rng(1).standard_normal((len(t_s), 2))
    (recording,) = read(moved, Rows(moved.stamps_ns, np.column_stack((xy + noise, 0.0 * yaw)), said))
    assert recording.headed != course
    assert any("also when the robot backs up" in note for note in recording.notes) == course
