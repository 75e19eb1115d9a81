"""Cleaning on reading and its notes: stamps, clocks, resets, gaps, outliers, frozen trackers, derived headings."""

import re
from dataclasses import replace

import numpy as np
import pytest
from sourcebags import edges, topic, write
from sourcedrive import START_NS, Rows, odometry, samples, truth

from odomcorrupt.geometry.se2 import between, wrap
from odomcorrupt.geometry.trajectory import resolution_s
from odomcorrupt.simulation import simulate, write_mcap
from odomcorrupt.study.io import Source, read_runs
from odomcorrupt.study.io.jumps import reach_of, stretches, without_excursions, without_outliers
from odomcorrupt.study.io.raw_trajectory import order_of
from odomcorrupt.study.io.stamps import clock_steps, even_stamps, jitter_warnings, stamp_jitter_s


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
    noted(recordings, "log times taken; usual causes: stamps in whole seconds")


def test_a_few_poses_without_stamp_or_number_are_left_out(read):
    real = truth()
    stamps, xyz = real.stamps_ns.copy(), real.xyz.copy()
    stamps[3], xyz[7] = 0, np.nan
    recordings = read(real=Rows(stamps, xyz, real.yaw), seen={"log_ns": real.stamps_ns})
    assert set(real.stamps_ns) - set(recordings[0].truth.stamps_ns) == {real.stamps_ns[3], real.stamps_ns[7]}
    noted(recordings, "1 poses without a stamp left out")
    noted(recordings, "1 positions that are not numbers left out")


EARLY, LATE = np.arange(50) * 50_000_000 + 10**9, START_NS + np.arange(200) * 50_000_000


@pytest.mark.parametrize(
    ("before", "note"),
    [
        (LATE[:100], "its clock is set back 1 times: the longest stretch kept, 100 poses left out"),
        (EARLY, "its stamps jump by more than an hour: 50 poses left out"),
    ],
    ids=["a clock that is set back", "a date that is learnt late"],
)
def test_the_longest_stretch_of_a_clock_is_kept_and_stretches_never_interleave(before, note):
    order = order_of(np.concatenate((before, LATE)), np.arange(len(before) + 200) + 1)
    assert np.array_equal(order.rows, np.arange(200) + len(before))
    assert np.array_equal(order.stamps_ns, LATE)
    assert order.notes == (note,)


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
    rng = np.random.default_rng(3)
    t = np.arange(0.0, 60.0, 0.1)
    speed, turn = np.where(t % 20 < 12, 2.0, 0.0), np.where(t % 15 < 2, 3.0, 0.0)
    yaw = np.cumsum(turn) * 0.1
    xy = np.cumsum(np.stack((speed * np.cos(yaw), speed * np.sin(yaw)), axis=1) * 0.1, axis=0)
    clean = samples(t, xy, yaw)
    seen = replace(clean, xyz=clean.xyz + 0.02 * np.column_stack((rng.standard_normal(xy.shape), 0.0 * t)))
    for path in (clean, seen):
        cut = stretches(path, reach_of(clean, path))
        assert len(cut.rows) == 1
        assert cut.outliers == 0


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


def test_wheel_odometry_that_drifts_is_not_warned_of(read):
    (recording,) = read(odometry(scale=1.05, drift=0.01, noise=0.002), odom={"variance": np.linspace(0.0, 5.0, 600)})
    assert not [note for note in recording.notes if "filter" in note]


@pytest.mark.parametrize("course", [True, False])
def test_headings_that_point_to_where_a_robot_backs_up_are_none(read, course):
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


def test_headings_of_a_robot_that_drives_sideways_are_headings(read):
    t_s = np.arange(0.0, 60.0, 0.05)
    # their axes differ by a small angle: the odometry goes back by a little where the truth goes ahead by as little
    steps = [0.05 * (v + 0.06 * np.sin(0.5 * t_s) + 0.3j) * np.exp(0.2j * t_s) for v in (0.0, 0.08)]
    stamps_ns = START_NS + np.round(t_s * 1e9).astype(np.int64)
    paths = [np.column_stack((np.cumsum(s.real), np.cumsum(s.imag), 0.0 * t_s)) for s in steps]
    (recording,) = read(*(Rows(stamps_ns, path, 0.2 * t_s) for path in paths))
    assert recording.headed


@pytest.fixture(scope="module")
def office():
    return simulate(31, None, duration_s=60.0)


def read_again(folder, run):
    write_mcap(run, folder / "run.mcap")
    return read_runs(Source(folder / "run.mcap", track_m=run.track_m))


def spoilt(run, rows, error_xyt):
    """The run with errors (k, 3) on some poses of its truth."""
    xyt = run.truth_xyt.copy()
    xyt[rows] += error_xyt
    xyt[:, 2] = wrap(xyt[:, 2])
    return replace(run, truth_xyt=xyt)


def left_out(run, recordings):
    """Rows of the truth that no recording has, those at the ends aside."""
    kept = np.concatenate([r.truth.stamps_ns for r in recordings])
    return set(np.flatnonzero(~np.isin(run.truth_stamps_ns, kept)))


@pytest.mark.parametrize("parts", [(0, 0, 0.5), (0.5, 0.5, 0)])
def test_swapped_markers_are_left_out_and_their_neighbours_are_kept(tmp_path, office, parts):
    rng = np.random.default_rng(5)
    rows = np.flatnonzero(rng.random(len(office.truth_xyt)) < 0.005)
    error = rng.normal(size=(len(rows), 3)) * parts
    (recording,) = read_again(tmp_path, spoilt(office, rows, error))
    out = left_out(office, [recording])
    assert out <= set(rows)
    # by less than that a pose may be off by noise
    off = np.maximum(np.linalg.norm(error[:, :2], axis=1), np.abs(error[:, 2]))
    assert set(rows[off > 0.12]) <= out
    (note,) = (note for note in recording.notes if "outliers" in note)
    assert f"{len(out)} outliers (jumps there and back) left out" in note


def fixes(seed, spikes_m, *, lasting_m=0.0):
    """Return 60 s of fixes at 10 Hz of a robot at 0.6 m/s, each off by 0.1 m, with spikes and a jump that lasts."""
    rng = np.random.default_rng(seed)
    t_s = np.arange(600) / 10.0
    xyz = np.column_stack((0.6 * t_s, np.zeros((600, 2)))) + rng.normal(size=(600, 3)) * (0.1, 0.1, 0.0)
    rows = np.linspace(20, 580, len(spikes_m), dtype=int)
    xyz[rows, 1] += spikes_m
    xyz[300:, 1] += lasting_m
    return rows, samples(t_s, xyz, name="/uwb", frame="map")


SPEEDS = np.array([0.6, 0.0])


@pytest.mark.parametrize("seed", range(4))
def test_no_fix_that_is_off_cuts_the_run_however_far_it_is_off(seed):
    rows, path = fixes(seed, np.linspace(1.0, 3.5, 29))
    reach = replace(reach_of(path, path), rate=4.0 * SPEEDS, top=SPEEDS)
    found = stretches(path, reach)
    assert len(found.rows) == 1
    assert set(np.delete(np.arange(600), found.rows[0])) >= set(rows[5:])
    assert found.outliers <= len(rows)


@pytest.mark.parametrize("lasting_m", [-4.0, 4.0])
def test_a_jump_of_fixes_that_lasts_cuts_the_run_there(lasting_m):
    _, path = fixes(1, [], lasting_m=lasting_m)
    found = stretches(path, replace(reach_of(path, path), rate=4.0 * SPEEDS, top=SPEEDS))
    assert [list(rows[[0, -1]]) for rows in found.rows] == [[0, 299], [300, 599]]
    assert not found.outliers


def test_a_map_that_is_turned_for_good_still_cuts_the_run(tmp_path, office):
    rows = np.arange(len(office.truth_xyt) // 2, len(office.truth_xyt))
    recordings = read_again(tmp_path, spoilt(office, rows, [0.0, 0.0, 0.8]))
    assert len(recordings) == 2
    assert not left_out(office, recordings)


def test_a_tracker_with_bad_moments_is_accepted(tmp_path, office):
    rng = np.random.default_rng(7)
    bad = np.flatnonzero(np.arange(len(office.truth_xyt)) % 1000 < 500)
    noise = rng.normal(size=(len(bad), 3)) * [0.01, 0.01, 0.02]
    (recording,) = read_again(tmp_path, spoilt(office, bad, noise))
    assert not left_out(office, [recording])


def excursion(jump_s, lasts_s, *, scale=1.0, gain=1.0, localised=True):
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
    odometry = samples(t_s, *paths[0])
    return odometry, samples(at, xy, paths[1][1][rows] + rng.normal(0.0, 0.008, len(at)), localised=localised), out


@pytest.mark.parametrize(("scale", "gain"), [(1.0, 1.0), (1.012, 1.0), (1.0, 1.02)])
def test_an_excursion_is_left_out_whole_and_nothing_else(scale, gain):
    odometry, truth, out = excursion(95.0, 6.0, scale=scale, gain=gain)
    left = without_excursions(odometry, truth)
    np.testing.assert_array_equal(left.stamps_ns, truth.stamps_ns[~out])
    assert "an excursion that comes back, 12 poses, left out (0.2" in left.notes[-1]


def test_a_robot_that_was_moved_is_no_excursion_if_poses_become_more_frequent():
    odometry, truth, out = excursion(95.0, 1e9)
    kept = out | (np.arange(len(out)) % 4 == 0)
    assert len(without_excursions(odometry, truth.only(kept, ""))) == kept.sum()


def tracked(turned_rad, begin_s=95.0, end_s=96.5, *, hidden_s=0.0):
    """Return odometry, a tracker at 50 Hz that is turned for a time and hidden before, and which poses are."""
    odometry, _, _ = excursion(1e9, 0.0)
    at = odometry.seconds_since(int(odometry.stamps_ns[0]))
    seen = (at < begin_s - hidden_s) | (at >= begin_s)
    out = ((at >= begin_s) & (at < end_s))[seen]
    yaw = odometry.yaw_rad + np.random.default_rng(1).normal(0.0, 6e-4, len(at))
    return odometry, samples(at[seen], odometry.xyz[seen], yaw[seen] + turned_rad * out), out


@pytest.mark.parametrize("degrees", [17.0, 90.0, -90.0, 180.0])
@pytest.mark.parametrize("hidden_s", [0.0, 2.0])
def test_markers_that_are_swapped_for_a_moment_are_left_out(degrees, hidden_s):
    odometry, truth, out = tracked(np.radians(degrees), hidden_s=hidden_s)
    left = without_outliers(without_excursions(odometry, truth))
    np.testing.assert_array_equal(left.stamps_ns, truth.stamps_ns[~out])


@pytest.mark.parametrize(
    ("odometry", "truth", "_out"),
    [excursion(95.0, 1e9), tracked(np.radians(90.0), end_s=1e9), excursion(95.0, 6.0, localised=False)],
    ids=["a place that stays", "markers that stay swapped", "what a robot with a tracker may have done"],
)
def test_what_stays_or_is_possible_is_no_excursion(odometry, truth, _out):
    assert without_excursions(odometry, truth) is truth


def poses(t_s, log_s=None):
    """Return poses along a line, stamped at times (n,) and recorded at others."""
    stamps_ns = START_NS // 10**9 * 10**9 + np.round(t_s * 1e9).astype(np.int64)
    logs = {} if log_s is None else {"log_ns": START_NS + np.round(log_s * 1e9).astype(np.int64)}
    return samples(stamps_ns, t_s[:, None], 0.0 * t_s, frame="odom", **logs)


def along(line, way_m):
    """Return a line's poses with other positions (n,), m, along the x axis."""
    return replace(line, xyz=np.column_stack((way_m, 0.0 * way_m, 0.0 * way_m)))


RATE_30 = 0.0123 + np.arange(3000) / 29.97
RATE_50 = 0.0123 + np.arange(3000) / 50.0
TIMER_50 = (np.arange(1, 3001) / 50.0)[np.random.default_rng(2).random(3000) >= 0.05]
UNEVEN = np.cumsum(np.random.default_rng(4).uniform(0.01, 0.03, 3000))


@pytest.mark.parametrize(
    ("t_s", "rounded_s", "found_s"),
    [
        (RATE_30, 0.001, 0.001), (RATE_30, 0.01, 0.01), (UNEVEN, 0.01, 0.01), (RATE_30, 1e-9, 0.0),
        (RATE_50, 1e-9, 0.0), (RATE_50, 0.01, 0.0), (TIMER_50, 1e-9, 0.0), (np.arange(1, 3001) / 80.0, 0.01, 0.01),
        (np.arange(1, 3001) / 40.0, 0.02, 0.02),
    ],
    ids=[
        "30 Hz to 1 ms", "30 Hz to 10 ms", "uneven to 10 ms", "exact", "exact 50 Hz", "50 Hz in ticks",
        "50 Hz with losses", "80 Hz to 10 ms", "40 Hz to 20 ms",
    ],
)  # fmt: skip
def test_what_stamps_are_rounded_to_is_seen_where_intervals_vary_on_it(t_s, rounded_s, found_s):
    assert resolution_s(poses(np.floor(t_s / rounded_s) * rounded_s).stamps_ns) == pytest.approx(found_s)


# a 50 Hz timer that jitters across the steps of rounding to half of its period
JITTER_50 = 0.02 * np.arange(1, 3001) + np.random.default_rng(3).normal(0.0, 2e-4, 3000)


@pytest.mark.parametrize(("regular_s", "rounded_s"), [(RATE_30, 0.001), (RATE_30, 0.01), (JITTER_50, 0.01)])
def test_rounded_stamps_of_a_regular_publisher_are_spaced_evenly(regular_s, rounded_s):
    true_s = regular_s[np.random.default_rng(1).random(len(regular_s)) >= 0.02]
    even = even_stamps(poses(np.floor(true_s / rounded_s) * rounded_s))
    off_s = even.seconds_since(START_NS // 10**9 * 10**9) - true_s
    assert np.std(off_s) < 0.06 * rounded_s
    assert np.mean(off_s) == pytest.approx(-rounded_s / 2.0, abs=0.1 * rounded_s)
    assert "cannot be seen; they were spaced evenly" in even.notes[0]


def test_rounding_shows_in_stamps_that_were_floats_of_seconds_since_1970():
    # their steps of 238 ns put them beside the multiples
    whole = poses(np.floor(RATE_30 / 0.01) * 0.01)
    as_floats = (whole.stamps_ns.astype(np.float64) * 1e-9 * 1e9).astype(np.int64) // 128 * 128
    assert np.mean(as_floats % 10_000_000 == 0) < 0.9
    even = even_stamps(whole.stamped(as_floats))
    assert "rounded to 10 ms" in even.notes[0]
    assert np.abs(even.stamps_ns - even_stamps(whole).stamps_ns).max() < 1_000


def arrived(t_s, seed=2):
    return np.maximum.accumulate(t_s + np.random.default_rng(seed).exponential(0.004, len(t_s)))


@pytest.mark.parametrize("by_s", [0.15, -0.08, 0.03, 2.0, 90.0])
def test_a_clock_that_is_set_while_recording_is_found_to_the_sample(by_s):
    stamped = RATE_50 + by_s * (np.arange(3000) >= 1200)
    (step,) = clock_steps(poses(stamped, arrived(RATE_50)))
    assert step.row == 1200
    assert step.by_s == pytest.approx(by_s, abs=0.01)


@pytest.mark.parametrize("case", ["lost", "late", "slow network", "skewed", "both clocks", "blocked"])
def test_what_is_lost_or_late_is_no_step_of_a_clock(case):
    kept = np.ones(3000, dtype=bool)
    log_s, stamped = arrived(RATE_50), RATE_50.copy()
    if case == "lost":
        kept[1200:1212] = False
    if case == "late":
        log_s[1200:1204] = log_s[1204]
    if case == "slow network":
        log_s[1200:] += 0.12
    if case == "skewed":
        stamped = stamped * 1.001
    if case == "both clocks":
        log_s[1200:] += 0.15
        stamped[1200:] += 0.15
    if case == "blocked":  # a recorder that stops for 5 s, keeps the first 70 to 150 messages and loses the others
        for held in (70, 100, 150):
            log_s[1200:1450] = log_s[1450]
            kept[1200 + held : 1450] = False
            assert clock_steps(poses(stamped[kept], log_s[kept])) == []
            kept[:] = True
        return
    assert clock_steps(poses(stamped[kept], log_s[kept])) == []


@pytest.mark.parametrize("logged", [False, True], ids=["no log times", "log times are the stamps"])
def test_without_log_times_a_clock_steps_where_a_moving_robot_goes_on_as_if_no_time_had_passed(logged):
    stepped = along(poses(RATE_50 + 2.0 * (np.arange(3000) >= 1200)), RATE_50)
    (step,) = clock_steps(replace(stepped, log_ns=stepped.stamps_ns) if logged else stepped)
    assert (step.row, step.by_s) == (1200, pytest.approx(2.0, abs=1e-6))


@pytest.mark.parametrize("case", ["lost", "rest", "stops and starts"])
def test_without_log_times_lost_messages_and_a_robot_at_rest_are_no_step_of_a_clock(case):
    t_s = RATE_50 + 2.0 * (np.arange(3000) >= 1200)
    slows = np.cumsum(np.minimum(np.abs(RATE_50 - RATE_50[1200]), 1.0)) / 50.0
    way = {"lost": t_s, "rest": 0.0 * t_s, "stops and starts": slows}[case]
    assert clock_steps(along(poses(t_s), way)) == []


def test_a_localisation_that_waits_for_motion_has_no_steps_of_its_clock():
    for intervals_s, name in (([0.3, 0.4, 0.5, 0.9], "/odom"), ([0.35, 0.4, 0.45], "/amcl_pose")):
        interval_s = np.random.default_rng(3).choice(intervals_s, 500)
        interval_s[[100, 300]] = 3.1
        at_s = np.cumsum(interval_s)
        assert clock_steps(replace(along(poses(at_s), np.arange(500.0)), name=name)) == []


@pytest.mark.parametrize(("stepping", "by_s"), [("/odom", 0.18), ("/odom", 2.0), ("/truth", 2.0), ("/truth", -0.5)])
def test_what_lies_before_and_after_a_step_is_recorded_by_clocks_of_its_own(read, stepping, by_s):
    rows = {"/odom": odometry(60.0), "/truth": truth(60.0)}
    steady = rows[stepping]
    row = round(len(steady) / 2.4)
    rows[stepping] = replace(steady, stamps_ns=steady.stamps_ns + round(by_s * 1e9) * (np.arange(len(steady)) >= row))
    logs = {name: rows[name].stamps_ns if name != stepping else steady.stamps_ns + 1_000_000 for name in rows}
    before, after = read(rows["/odom"], rows["/truth"], odom={"log_ns": logs["/odom"]}, seen={"log_ns": logs["/truth"]})
    assert (before.name, after.name) == ("run.mcap, clock 1", "run.mcap, clock 2")
    assert before.clock == after.clock == ""
    parts = [len(r.odometry if stepping == "/odom" else r.truth) for r in (before, after)]
    assert parts == [row, len(steady) - row]
    (step,) = [note for note in before.notes if "its clock was set while recording" in note]
    assert float(re.search(r"\((\S+) s at 2[45]\.\d s\)", step)[1]) == pytest.approx(by_s, abs=0.01)


def test_what_a_clock_that_is_far_off_has_stamped_is_left_out_with_a_note(read):
    moved, real = odometry(60.0), truth(60.0)
    stepped = replace(moved, stamps_ns=moved.stamps_ns + 600 * 10**9 * (np.arange(len(moved)) >= 700))
    (run,) = read(stepped, real, odom={"log_ns": moved.stamps_ns + 1_000_000})
    assert len(run.odometry) == 700
    assert any("500 poses between steps of its clock left out" in n and "no time in common" in n for n in run.notes)


def test_an_offset_that_rounding_hides_is_in_the_error_of_a_clock(read):
    moved = odometry(60.0, rate_hz=29.97)
    cut = moved.having(stamps_ns=moved.stamps_ns // 10_000_000 * 10_000_000)
    (run,) = read(cut, truth(60.0))
    assert run.stamp_error_s == pytest.approx(0.01 / np.sqrt(12.0))


def path(taken_s, stamped_s, noise_m=0.0005):
    """Return poses along a bend, taken at one time and stamped with another."""
    noise = np.random.default_rng(1).standard_normal((len(taken_s), 3)) * noise_m
    way = 0.5 * taken_s + 0.1 * np.sin(taken_s)
    xyz = np.stack((10.0 * np.sin(way / 10.0), 10.0 * np.cos(way / 10.0), 0.0 * way), axis=1) + noise
    return samples(stamped_s, xyz, way / 10.0, name="/mocap")


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
        return samples(at_s, np.interp(at_s, t_s, way_m)[:, None], 0.0 * at_s)

    triggered = straight(np.interp(np.arange(0.5, way_m[-1], 0.5), way_m, t_s))
    assert not stamp_jitter_s(triggered, straight(t_s))


def test_noise_of_poses_with_lost_frames_is_no_jitter_beside_stamps_that_do():
    camera_s = (np.arange(9000) / 30.0)[np.random.default_rng(3).random(9000) > 0.03]
    camera, arrival = path(camera_s, camera_s, noise_m=0.02), path(REGULAR, ODD)
    assert not stamp_jitter_s(camera, path(REGULAR, REGULAR))
    assert stamp_jitter_s(arrival, camera)
