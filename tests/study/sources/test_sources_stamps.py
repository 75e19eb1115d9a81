"""Stamps: rounding, jitter of arrival, and steps of clocks."""

import re
from dataclasses import replace

import numpy as np
import pytest
from sourcedrive import START_NS, odometry, samples, truth

from odomcorrupt.geometry.trajectory import resolution_s
from odomcorrupt.study.io.stamps import clock_steps, even_stamps, jitter_warnings, stamp_jitter_s


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
