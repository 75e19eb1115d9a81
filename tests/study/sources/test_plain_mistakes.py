"""Plain mistakes of wiring, units, signs and axes, and truths of other drives, are named first, with their size."""

from contextlib import nullcontext
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from hidden import as_recording
from sourcedrive import START_NS, Rows, odometry, samples, truth
from wandering import noisy_path, recording, wander

from odomcorrupt.errors import RecordingError
from odomcorrupt.geometry.se2 import Increments, accumulate, compose, increments
from odomcorrupt.model.noise_laws import Coefficients
from odomcorrupt.report.findings import mistakes_first
from odomcorrupt.simulation import Segment, Tracker, simulate
from odomcorrupt.study.estimate.calibrate import fit_robot
from odomcorrupt.study.io.first_look import factors_of, first_look, mistakes_alone
from odomcorrupt.study.io.motion_windows import Look, Witness
from odomcorrupt.study.io.plausibility import check_together, cross_correlation
from odomcorrupt.study.io.reader import recordings_of
from odomcorrupt.study.io.recording import Mistake
from odomcorrupt.study.io.stamps import between_steps
from odomcorrupt.summary import Line, Summary

HZ = 50.0
SIGNS = {"left and right exchanged": (1, -1, -1), "forward is -x": (-1, -1, 1), "both wheels negated": (-1, -1, -1)}
SCALED = {"wheel radius": (1, 1, 1), "wheel separation": (0, 0, 1), "travel": (1, 1, 0)}


def driven(seed=1, seconds=120.0, *, reverse=True, left_only=False):
    """Return the motions (n, 3) of a drive with straights, curves, turns on the spot and reverse."""
    rng = np.random.default_rng(seed)
    rows = []
    while len(rows) < seconds * HZ:
        v, w = rng.uniform(0.15, 0.4), rng.choice([-1.0, 1.0]) * rng.uniform(0.3, 0.8)
        w = abs(w) if left_only else w
        kind = rng.choice([(v, 0.0, 0.0), (v, 0.0, w), (0.0, 0.0, w), (-v if reverse else v, 0.0, 0.0)])
        rows += [kind] * int(rng.uniform(1.5, 4.0) * HZ)
    smooth = np.ones(20) / 20.0
    rates = np.column_stack([np.convolve(x, smooth, mode="same") for x in np.array(rows).T])
    return rates / HZ


def trajectory(rows, name="/odom", *, headed=True, every=1, noise=0.0):
    """Return a trajectory of motions (n, 3)."""
    xyt = accumulate(np.zeros(3), Increments.of_rows(rows))[::every]
    xyt = xyt + noise * np.random.default_rng(7).standard_normal(xyt.shape)
    t_s = 1_700_000_000 + np.arange(len(rows) + 1)[::every] / HZ
    return samples(t_s, xyt[:, :2], xyt[:, 2] if headed else None, name=name)


def real(rows, *, headed=True):
    return trajectory(rows, "/truth", headed=headed, every=2, noise=1e-3)


def look_at(odometry, truth, *expected):
    """Return the first look at two trajectories, whose mistakes are those expected."""
    found = first_look(Look((odometry, truth)))
    assert [one.name for one in found.mistakes] == list(expected)
    return found


def rims(rows, left, right, track_m=0.2):
    """Return motions whose wheels, on a track, are functions of the true ones."""
    arm = track_m / 2.0 * rows[:, 2]
    one, other = left(rows[:, 0] - arm), right(rows[:, 0] + arm)
    return np.column_stack(((one + other) / 2.0, 0.0 * one, (other - one) / track_m))


@pytest.mark.parametrize("headed", [True, False])
@pytest.mark.parametrize("factor", [0.01, 0.303, 2.5, 57.3])
@pytest.mark.parametrize("name", SCALED)
def test_a_factor_is_named_and_found(name, factor, headed):
    rows, ratio = driven(), np.where(SCALED[name], factor, 1.0)
    found = look_at(trajectory(rows * ratio), real(rows, headed=headed), name)
    assert np.allclose(found.gains, 1.0 / ratio[[0, 2]], rtol=0.02)


@pytest.mark.parametrize("name", SIGNS)
@pytest.mark.parametrize("factor", [1.0, 0.1])
def test_signs_are_undone_and_factors_beside_them_found(name, factor):
    rows = driven()
    found = look_at(trajectory(rows * SIGNS[name] * factor), real(rows), name, *["wheel radius"] * (factor != 1.0))
    assert found.gains[0] == pytest.approx(1.0 / factor, rel=0.02)
    look_at(found.odometry, found.truth)


def with_headings(path, change):
    return replace(path, yaw_rad=change(path.yaw_rad, path.t_s))


def test_turns_that_come_late_are_undone():
    rows = driven(1, 90.0)
    delayed = with_headings(trajectory(rows), lambda yaw, t: np.interp(t - 1.5, t, yaw))
    steps = increments(delayed.trajectory().xyt).rows[:, 2]
    found = first_look(Look((trajectory(np.column_stack((rows[:, :2], steps))), real(rows))))
    assert "1.5 s later" in found.mistakes[0].sentence
    assert Look((found.odometry, found.truth)).correlations[2, 2] > 0.9


def test_an_arc_cosine_folds_headings():
    path = trajectory(rows := driven(2))
    with pytest.raises(RecordingError, match="an arc cosine"):
        look_at(with_headings(path, lambda yaw, _: np.arccos(np.cos(yaw))), real(rows))


def test_a_filter_across_the_wrap_turns_the_other_way_round():
    yaw = np.unwrap((path := trajectory(rows := driven(3))).yaw_rad)
    own, wrapped = [yaw[0]], np.arctan2(np.sin(yaw), np.cos(yaw))
    for step, compass in zip(np.diff(yaw), wrapped[1:], strict=True):
        own.append(0.98 * (own[-1] + step) + 0.02 * compass)
    found = first_look(Look((with_headings(path, lambda *_: np.array(own)), real(rows))))
    assert found.mistakes[0].name == "other way round"


@pytest.mark.parametrize("headed", [True, False])
@pytest.mark.parametrize(("along", "by"), [(0, 1.6), (1, 0.5)])
def test_a_truth_is_stretched_along_an_axis(along, by, headed):
    path = real(driven(4), headed=headed)
    stretched = replace(path, xyz=path.xyz * [by, 1.0, 1.0])
    if along:
        stretched = replace(path, xyz=path.xyz * [1.0, by, 1.0])
    found = first_look(Look((trajectory(driven(4)), stretched)))
    assert found.mistakes[0].name == "stretched"
    assert np.allclose(np.ptp(found.truth.xyz[:, :2], axis=0), np.ptp(path.xyz[:, :2], axis=0), rtol=0.05)


def test_wheels_and_a_steering_angle_that_are_clamped_are_a_limit():
    rows = driven(6)
    with pytest.raises(RecordingError, match=r"speeds of its wheels of at most 0\.2[45]"):
        look_at(trajectory(rims(rows, *(lambda u: np.clip(u, -5e-3, 5e-3),) * 2)), real(rows))
    rows = driven(6)
    rows[:, 0] = np.maximum(np.abs(rows[:, 0]), 0.2 / HZ)
    bend = np.clip(rows[:, 2] / rows[:, 0], -0.6, 0.6)
    with pytest.raises(RecordingError, match=r"turns per metre of at most 0\.6"):
        look_at(trajectory(np.column_stack((rows[:, :2], bend * rows[:, 0]))), real(rows))


def test_increments_of_eight_bits_that_wrap_are_an_overflow():
    rows, tick_m = driven(7), 0.25 / HZ / 127.0
    byte = lambda x: ((np.rint(x / tick_m) + 128) % 256 - 128) * tick_m  # noqa: E731
    found = first_look(Look((trajectory(rims(rows, byte, byte)), real(rows))))
    assert found.mistakes[0].name == "overflow"


@pytest.mark.parametrize("headed", [True, False])
def test_a_mirrored_truth_is_one_of_two_and_a_gyro_decides(headed):
    rows = driven()
    odometry, flipped = trajectory(rows), real(rows * [1, -1, -1], headed=headed)
    found = look_at(odometry, flipped, "left and right exchanged")
    assert "these data do not show" in found.mistakes[0].said
    gyro = Witness("/imu", odometry.stamps_ns, odometry.yaw_rad, independent=True)
    found = first_look(Look((odometry, flipped), lambda: [gyro]))
    assert "so /truth is wrong" in found.mistakes[0].said
    assert np.array_equal(found.odometry.xyz, odometry.xyz)


@pytest.mark.parametrize("headed", [True, False])
@pytest.mark.parametrize(
    ("gains", "words"),
    [
        ((-1.0, 1.0), "the left wheel counts the wrong way"), ((1.0, -1.0), "the right wheel counts the wrong way"),
        ((1.0, 0.0), "the right wheel counts nothing"), ((0.55, 1.0), "radius of the left wheel wrong"),
        ((1.0, 2.4), "radius of the right wheel wrong"),
    ],
)  # fmt: skip
def test_wheels_that_count_by_unequal_factors(gains, words, headed):
    rows = driven(3)
    pair = trajectory(rims(rows, lambda u: gains[0] * u, lambda u: gains[1] * u)), real(rows, headed=headed)
    if 0.0 in gains:
        with pytest.raises(RecordingError, match=words):
            first_look(Look(pair))
        return
    found = look_at(*pair, "wheel gains")
    assert words in found.mistakes[0].causes
    back = increments(found.odometry.trajectory().xyt).rows
    assert np.corrcoef(back[:, 2], rows[:, 2])[0, 1] > 0.99
    assert abs(np.corrcoef(back[:, 0], rows[:, 0])[0, 1]) > 0.99


@pytest.mark.parametrize("wheel", range(5))
def test_one_of_four_wheels_that_counts_the_wrong_way_and_two_that_are_exchanged(wheel):
    rows = driven(4)
    rows[:, 1] = driven(5)[: len(rows), 0]
    rolls = np.array(((1, -1, -0.3), (1, 1, 0.3), (1, 1, -0.3), (1, -1, 0.3)), dtype=float)
    counts = (rows @ rolls.T)[:, [1, 0, 2, 3] if wheel == 4 else range(4)] * np.where(np.arange(4) == wheel, -1.0, 1.0)
    found = look_at(trajectory(counts @ np.linalg.pinv(rolls).T), real(rows), "wheel gains")
    name = ("front left", "front right", "rear left", "rear right", "")[wheel]
    assert (f"the {name} wheel counts the wrong way" if name else "wheels are exchanged") in found.mistakes[0].causes
    back = increments(found.odometry.trajectory().xyt).rows
    assert np.allclose([np.corrcoef(back[:, k], rows[:, k])[0, 1] for k in range(3)], 1.0, atol=0.01)


@pytest.mark.parametrize("headed", [True, False])
@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (lambda rows: trajectory(rows * [1.0, 1.0, 100.0], every=4), "are lost; usual causes: wheel separation in"),
        (lambda rows: trajectory(rows * 100.0, every=4), "are lost; usual causes: wheel radius .* about 9. times"),
        (lambda rows: replace(trajectory(rows), yaw_rad=np.zeros(len(rows) + 1)), "they never change"),
        (lambda rows: trajectory(rows * [1.0, 1.0, 0.0]), "never turns, .* does"),
        (lambda rows: trajectory(rows * [1, 1, 0] + np.random.default_rng(1).normal(0.0 * rows, 1e-4) * [0, 0, 1]),
         "never"),
    ],
)  # fmt: skip
def test_turns_from_which_nothing_can_be_learned(wrong, said, headed):
    with pytest.raises(RecordingError, match=said):
        first_look(Look((wrong(driven(6)), real(driven(6), headed=headed))))


@pytest.mark.parametrize(("times", "first"), [(180.0 / np.pi, "degrees for"), (100.0, "wheel sep")])
def test_turns_by_more_than_half_a_turn_show_whether_they_are_degrees(times, first):
    with pytest.raises(RecordingError, match=f"are lost; usual causes: {first}"):
        first_look(Look((trajectory(driven(6) * [1.0, 1.0, times], every=4), real(driven(6)))))


def late(path, grown):
    kept = path.only(np.arange(round(len(path) / grown)))
    return kept.stamped(path.stamps_ns[0] + np.round((kept.stamps_ns - path.stamps_ns[0]) * grown).astype(np.int64))


@pytest.mark.parametrize(
    ("wrong", "name"),
    [
        (lambda rows: late(trajectory(rows), 1.1), "clock rate"),
        (lambda rows: replace(path := trajectory(rows), xyz=path.xyz + 4.0 * (path.t_s > 60.0)[:, None]), "resets"),
        (lambda rows: trajectory(rows * np.where(np.abs(rows) < 0.008, [1.0, 1.0, 0.0], 1.0)), "slow turns"),
        (lambda rows: trajectory(rims(rows, np.positive, lambda u: u * (np.arange(len(u)) % 1500 > 400))), "one head"),
        (lambda rows: trajectory(rows + (np.arange(len(rows)) % 1999 == 1998)[:, None] * [0, 0, np.pi]), "flips"),
    ],
)  # fmt: skip
def test_stamps_resets_and_parts_that_are_lost_are_named_and_left_out(wrong, name):
    assert first_look(Look((wrong(driven(6, 240.0)), real(driven(6, 240.0))))).mistakes[0].name.startswith(name)


def test_play_in_the_gears_is_no_overflow():
    rows = driven(6, 240.0) * [1, 1, 0]
    turned = np.diff(np.sign(rows[:, 0]), prepend=1.0) != 0.0
    look_at(trajectory(rows + 0.015 * turned[:, None] * np.sign(rows) * [1, 0, 0]), real(rows))


def test_a_tracked_point_beside_the_centre_does_not_drive_in_reverse():
    rows = driven(8, reverse=False)
    seen = trajectory(rows + 0.05 * rows[:, [2, 0, 1]] * [1.0, 0.0, 0.0], "/truth", every=2, noise=1e-3)
    look_at(trajectory(rows * 3.7), seen, "wheel radius")


@pytest.mark.parametrize("factor", [0.5, 1.1, 3.0, 1000.0])
@pytest.mark.parametrize("at", [0, 1], ids=["odometry", "truth"])
@pytest.mark.parametrize("logged", ["by a right clock", "by the wrong one", ""])
def test_a_clock_of_another_rate(factor, at, logged):
    rows = driven(9)
    pair = [replace(one, log_ns=one.stamps_ns if logged else one.log_ns) for one in (trajectory(rows), real(rows))]
    first = pair[at].stamps_ns[0]
    wrong = first + np.round((pair[at].stamps_ns - first) * factor).astype(np.int64)
    pair[at] = replace(pair[at], stamps_ns=wrong, log_ns=wrong if "wrong" in logged else pair[at].log_ns)
    assert len(between_steps(pair[at])) == 1
    found = look_at(*pair, "clock rate")
    assert found.odometry.span_s == pytest.approx(found.truth.span_s, rel=0.01)
    assert "right" not in logged or found.truth.span_s == pytest.approx(len(rows) / HZ, rel=0.01)


@pytest.mark.parametrize("until_s", [85.0, 130.0])
@pytest.mark.parametrize(("headed", "at"), [(True, 0), (False, 0), (True, 1)])
def test_one_that_stands_while_the_other_moves_is_left_out_there(headed, at, until_s):
    rows = driven(11)
    pair = [trajectory(rows), real(rows, headed=headed)]
    t_s = pair[at].t_s
    stuck = (t_s > 40.0) & (t_s < until_s)
    if at == 0:
        pair[0] = trajectory(rows * ~stuck[1:, None])
    else:
        held = np.where(stuck, np.argmax(stuck), np.arange(len(t_s)))
        pair[1] = replace(pair[1], xyz=pair[1].xyz[held], yaw_rad=pair[1].yaw_rad[held])
    found = look_at(*pair, "stands still")
    assert found.mistakes[0].said.startswith(pair[at].name)
    left_s = (found.odometry, found.truth)[at].t_s
    assert not np.any((left_s > 42.0) & (left_s < until_s - 2.0))
    assert np.sum(left_s < 38.0) + np.sum(left_s > until_s + 2.0) == np.sum(t_s < 38.0) + np.sum(t_s > until_s + 2.0)


@pytest.mark.parametrize("headed", [True, False])
@pytest.mark.parametrize("how", range(4), ids=["path goes on", "path bends", "wheel", "rate"])
@pytest.mark.parametrize(("from_s", "until_s"), [(20.0, 70.0), (70.0, 130.0)])
def test_a_heading_that_is_stuck_for_a_while_is_left_out_there(from_s, until_s, how, headed):
    path = trajectory(rows := driven(11))
    stuck = (path.t_s > from_s) & (path.t_s < until_s)
    held = replace(path, yaw_rad=np.where(stuck, path.yaw_rad[stuck][0], path.yaw_rad))
    dead = trajectory(rims(rows, np.positive, lambda u: u * ~stuck[1:]))
    last = trajectory(np.where(stuck[1:, None] & [False, False, True], 0.4 / HZ, rows))
    wrong = (held, trajectory(rows * np.where(stuck[1:, None], [1.0, 1.0, 0.0], 1.0)), dead, last)[how]
    left, seen, mistakes, *_ = look_at(wrong, real(rows, headed=headed), "one heading")
    assert ("m to the right, as about a wheel at rest" in mistakes[0].said) == (how == 2)
    assert not np.any((left.t_s > from_s + 4.0) & (left.t_s < until_s - 4.0))
    assert np.sum(left.t_s < from_s - 4.0) == np.sum(path.t_s < from_s - 4.0)
    assert seen.headed == headed


def test_straight_courses_beside_noisy_headings_are_no_stuck_heading():
    rows = driven(11)
    rows[1000:4000] = 0.3 / HZ, 0.0, 0.0
    seen = real(rows)
    look_at(trajectory(rows), replace(seen, yaw_rad=np.random.default_rng(3).normal(seen.yaw_rad, 0.1)))


@pytest.mark.parametrize(
    ("seed", "headed", "times", "at"),
    [
        *((1, True, *one) for one in ((57.3, 0.0), (57.3, 0.5), (57.3, 1.0), (0.0, 0.5), (0.5, 0.5), (2.0, 0.5))),
        *((seed, seed == 3, times, 0.5) for seed in (3, 6) for times in (57.3, 0.5)),
    ],
)
def test_steps_that_are_rotated_by_a_multiple_of_the_heading(seed, headed, times, at):
    path = trajectory(rows := driven(seed))
    course = times * (path.yaw_rad[:-1] * (1.0 - at) + path.yaw_rad[1:] * at)
    steps = np.column_stack((np.cos(course), np.sin(course), 0.0 * course)) * rows[:, :1]
    wrong = replace(path, xyz=np.cumsum(np.vstack((path.xyz[:1], steps)), axis=0))
    xyz = look_at(wrong, real(rows, headed=headed), "steps and headings").odometry.xyz
    assert np.abs(xyz - path.xyz).max() < 0.01


@pytest.mark.parametrize("headed", [True, False])
def test_encoders_without_direction_and_yaw_rates_without_sign_are_refused(headed):
    bent = driven(6) * [0.0, 1.0, 1.0] + [0.3 / HZ, 0.0, 0.0]
    with pytest.raises(RecordingError, match="/odom counts its turns to the right the other way"):
        first_look(Look((trajectory(np.abs(bent)), real(bent, headed=headed))))
    rows = driven() + np.array((0.0, 0.0, 0.2 / HZ))
    with pytest.raises(RecordingError, match="/odom counts its wheels in reverse forwards"):
        first_look(Look((trajectory(rims(rows, np.abs, np.abs)), real(rows))))
    for counts, side, track_m in product((np.abs, lambda u: np.maximum(u, 0.0)), (1, -1), (0.09, 0.3, 0.6) * headed):
        rows = driven(round(10 * track_m)) * [1.0, 1.0, 0.2 / track_m]
        wrong = trajectory(rims(rows, *(counts, np.positive)[::side], track_m))
        with pytest.raises(RecordingError, match=f"count.* its {['', 'left', 'right'][side]} wheel in reverse"):
            first_look(Look((wrong, real(rows))))


def test_turns_on_the_spot_that_are_not_counted_and_commands_that_are_not_followed():
    rows = driven(6)
    rows[2000:2600], rows[4000:4600] = (0.0, 0.0, 0.5 / HZ), (0.0, 0.0, -0.5 / HZ)
    wrong = trajectory(rows * np.where(rows[:, :1] == 0.0, [1.0, 1.0, 0.0], 1.0))
    assert "/odom has no turns at speeds below" in look_at(wrong, real(rows), "dead zone").mistakes[0].said
    with pytest.raises(RecordingError, match=r"the truth has speeds of at most 0\.(19|20).* commands"):
        first_look(Look((trajectory(rows), real(np.clip(rows, [-4e-3, 0.0, -1.0], [4e-3, 0.0, 1.0])))))


def test_travel_sideways_that_is_not_counted():
    rows = driven(14)
    with pytest.raises(RecordingError, match="/odom never moves sideways, unlike /truth"):
        first_look(Look((trajectory(rows), real(rows + np.roll(rows, len(rows) // 2, axis=0)[:, [1, 0, 1]]))))
    look_at(trajectory(rows), real(rows + 0.1 * rows[:, [1, 2, 1]]))


@pytest.mark.parametrize(("sign", "size"), [(-1.0, 1.0), (1.0, 0.5), (-1.0, 3.0)])
def test_travel_sideways_of_another_sign_or_size(sign, size):
    rows = np.roll(driven(14), len(driven(14)) // 2, axis=0)
    rows[:, 1] = driven(14)[:, 0]
    found = look_at(trajectory(rows * [1.0, sign * size, 1.0]), real(rows), "sideways")
    assert ("the other way than" in found.mistakes[0].said) == (sign < 0.0)
    look_at(found.odometry, found.truth)


@pytest.mark.parametrize("at", [0, 1], ids=["odometry", "truth"])
def test_stamps_in_milliseconds_or_of_whole_seconds(at):
    pair = [trajectory(driven(17)), real(driven(17))]
    here, there = pair[at].noted("stamps read as milliseconds"), pair[1 - at]
    assert look_at(*(here, there)[:: 1 - 2 * at], "stamps").mistakes[0].said.startswith(f"{here.name}: stamps read as")
    for step_ns in (2 * 10**8, 10**9, 10**10):
        whole = replace(pair[at], stamps_ns=pair[at].stamps_ns // step_ns * step_ns, log_ns=pair[at].stamps_ns)
        (run,) = recordings_of("run", *(whole, there)[:: 1 - 2 * at])
        assert [one.name for one in run.mistakes] == ["stamps"]
        assert np.array_equal((run.odometry, run.truth)[at].stamps_ns, pair[at].stamps_ns)


@pytest.mark.parametrize(("bits", "wheel_m"), [(8, 0.4), (16, 0.4), (16, 2.0), (8, 0.02)])
@pytest.mark.parametrize("steered", [False, True])
def test_overflows_are_counted_and_taken_out(bits, wheel_m, steered):
    rows, tick = driven(), wheel_m / 2**bits
    wheel, angle = rows[:, 0], 0.8 * np.sin(np.arange(len(rows)) / 400.0)

    def counted(u):
        counts = np.floor(np.cumsum(u) / tick)
        return np.diff((counts + 2 ** (bits - 1)) % 2**bits, prepend=2 ** (bits - 1)) * tick

    if steered and wheel_m > 0.1:  # the only wheel, whose travel and turns have the cosine and sine of its angle
        wrong, rows = (np.column_stack((u * np.cos(angle), 0 * u, u * np.sin(angle))) for u in (counted(wheel), wheel))
    else:
        wrong = rims(rows, counted, counted)
    found = look_at(trajectory(wrong), real(rows), "overflow")
    assert steered or f"a counter of {bits} bits" in found.mistakes[0].causes
    assert np.abs(increments(found.odometry.trajectory().xyt).rows - rows).max() < 0.02


@pytest.mark.parametrize("at", [0, 1], ids=["odometry", "truth"])
@pytest.mark.parametrize(
    ("name", "wrong"),
    [
        *(("steps and headings", lambda one, k=k: {"yaw_rad": one.yaw_rad * k})
          for k in (57.3, -57.3, 0.01745, 0.5, -1.0)),
        ("steps and headings", lambda one: {"yaw_rad": (2.0 * one.yaw_rad + np.pi) % (2.0 * np.pi) - np.pi}),
        ("steps and headings", lambda one: {"xyz": one.xyz * [1.0, -1.0, 1.0]}),
        ("flips", lambda one: {"yaw_rad": one.yaw_rad % np.pi}),
        ("flips", lambda one: {"yaw_rad": one.yaw_rad + np.pi * (np.abs(one.t_s - 50.0) < 3.0)}),
    ],
)  # fmt: skip
def test_headings_against_their_own_path(at, name, wrong):
    pair = [trajectory(driven()), real(driven())]
    pair[at] = replace(pair[at], **wrong(pair[at]))
    assert [one.name for one in mistakes_alone(pair[0])] == [name] * (at == 0)  # and none of a good one
    found = look_at(*pair, name)
    look_at(found.odometry, found.truth)


def test_slow_wheels_that_are_not_counted_and_the_travel_of_a_steered_wheel():
    rows = driven(6)
    slow = rims(rows, *(lambda u: np.where(np.abs(u) < 3e-3, 0.0, u),) * 2)
    found = look_at(trajectory(slow), real(rows), "dead zone")
    assert "speeds of its wheels below 0.1" in found.mistakes[0].said
    rows[:, 0] = np.maximum(np.abs(rows[:, 0]), 3e-3)
    wheel = np.column_stack((np.hypot(rows[:, 0], 0.5 * rows[:, 2]), rows[:, 1:]))
    with pytest.raises(RecordingError, match=r"travel of a steered wheel, 0\.5"):
        look_at(trajectory(wheel), real(rows))


def test_turns_in_reverse_of_the_other_sign():
    rows = driven(11)
    rows[4000:4600], rows[5000:5600] = (-0.3 / HZ, 0.0, 0.5 / HZ), (-0.3 / HZ, 0.0, -0.4 / HZ)
    with pytest.raises(RecordingError, match="counts its turns in reverse the other way"):
        look_at(trajectory(rows * np.where(rows[:, :1] < 0.0, [1.0, 1.0, -1.0], 1.0)), real(rows))


def test_headings_that_are_clamped_and_motion_that_is_lost_in_gaps():
    path, yaw = trajectory(rows := driven(6)), [0.0]
    for turn in rows[:, 2]:
        yaw.append(np.clip(yaw[-1] + turn, -np.pi, np.pi))
    with pytest.raises(RecordingError, match="its headings stay at a half or whole turn"):
        look_at(trajectory(np.column_stack((rows[:, :2], np.diff(yaw)))), real(rows))
    kept = np.append(True, np.random.default_rng(1).random(len(rows)) > 0.3)
    lossy = trajectory(rows[kept[1:]]).stamped(path.stamps_ns[kept])
    found = look_at(lossy, real(rows), "time step")
    assert np.hypot(*(found.odometry.xyz[-1] - path.xyz[-1])[:2]) < 2.0
    # stamps of arrival that come late now and then
    look_at(path.stamped(path.stamps_ns + 19_000_000 * (np.arange(len(path)) % 9 == 4)), real(rows))


@pytest.mark.parametrize("headed", [True, False])
def test_a_time_step_that_is_taken_for_constant(headed):
    path, number = trajectory(rows := driven()), np.arange(len(driven()))
    at = number[(number // 600 % 2 == 0) | (number % 3 == 0)]  # the loop takes three times as long now and then
    counted = trajectory(rows[at[1:]]).stamped(path.stamps_ns[at])
    found = look_at(counted, real(rows, headed=headed), "time step")
    assert "as for 20 ms, though they come every 20 to 60 ms" in found.mistakes[0].said
    assert np.hypot(*(found.odometry.xyz[-1] - path.xyz[at[-1]])[:2]) < 1.0
    look_at(path.only(np.isin(np.arange(len(path)), at)), real(rows, headed=headed))  # poses lose nothing


def test_two_publishers_on_one_topic():
    path = trajectory(rows := driven())
    second = np.arange(len(path)) % 3 == 2
    with pytest.raises(RecordingError, match=r"67% of its poses jump by 2\.24 m and back within 8 messages"):
        look_at(replace(path, xyz=path.xyz + second[:, None] * [2.0, -1.0, 0.0]), real(rows))


def test_a_filter_of_all_motions_is_no_dead_zone_nor_factor():
    rows, lagging = driven(3), []
    for row in rows:
        lagging.append((lagging[-1] if lagging else np.zeros(3)) * (1.0 - 0.02 / 1.6) + row * 0.02 / 1.6)
    look = Look((trajectory(np.array(lagging)), real(rows)))
    assert look.lags_s[0] == (0.0, 0.0)
    assert look.lags_s[1][0] == 1.6
    look_at(*look.paths)


def test_an_omni_robot_whose_yaw_rate_is_converted_twice_has_a_right_truth():
    rows = driven(4)
    rows[:, 1] = np.roll(rows[:, 0], 150)
    look_at(trajectory(rows * [1.0, 1.0, np.pi / 180.0]), real(rows), "wheel separation")


def test_a_steering_angle_that_is_off_is_no_wheel():
    rows = driven(5) * [1.0, 0.0, 0.0]
    turns = np.convolve(np.random.default_rng(1).normal(0.0, 0.05, len(rows)), np.ones(100) / 10.0, "same")
    rows[:, 2] = np.abs(rows[:, 0]) * turns
    look = Look((trajectory(rows + rows[:, :1] * [0.0, 0.0, 0.14]), real(rows)))
    assert "wheel gains" not in [one.name for one in first_look(look).mistakes]


def test_a_localisation_that_waits_for_motion_has_one_clock():
    n = np.arange(400)  # after a stop of 3 s the next pose comes a whole step or nearly none farther
    t_s = 1_700_000_000.0 + np.cumsum(np.where(n % 40 == 36, 3.0, 0.4))
    step = np.where(n % 80 == 36, 0.02, 0.2)
    path = samples(t_s, np.column_stack((np.cumsum(step), 0.0 * n)), 0.0 * n, name="/map")
    assert len(between_steps(path)) == 1


def test_a_clock_that_is_late_beside_positions_of_turns_on_the_spot():
    rng, rows = np.random.default_rng(2), []
    while len(rows) < 250.0 * HZ:
        rows += [(rng.uniform(0.2, 0.6), 0.0, 0.0)] * int(rng.uniform(2.0, 12.0) * HZ)
        rows += [(0.0, 0.0, np.pi / 4.0)] * int(2.0 * HZ)
    rows = np.array(rows)
    late = real(rows / HZ, headed=False)
    with pytest.raises(RecordingError, match=r"its clock is 18\.0 s ahead of the odometry's"):
        look_at(trajectory(rows / HZ), late.stamped(late.stamps_ns + 18_000_000_000))


@pytest.mark.parametrize("at", [0, 1])
def test_inverse_poses(at):
    pair = [trajectory(rows := driven()), real(rows)]
    one = pair[at]
    xy = -(one.xyz[:, :2] @ [1.0, 1j]) * np.exp(-1j * one.yaw_rad)
    pair[at] = replace(one, xyz=np.column_stack((xy.real, xy.imag, 0.0 * one.yaw_rad)), yaw_rad=-one.yaw_rad)
    look_at(*pair, "inverse")


@pytest.mark.parametrize("at", ["beginning", "end"])
def test_steps_along_one_end_of_their_turn(at):
    rows = driven()[:5900].reshape(-1, 25, 3).sum(axis=1)
    yaw = accumulate(np.zeros(3), Increments.of_rows(rows))[:, 2]
    course = yaw[:-1] if at == "beginning" else yaw[1:]
    xy = np.cumsum((rows[:, 0] * np.cos(course), rows[:, 0] * np.sin(course)), axis=1).T
    path = samples(1_700_000_000.0 + np.arange(1, len(rows) + 1) / 2.0, xy, yaw[1:], name="/odom")
    arcs, _, (mistake,), *_ = look_at(path, real(driven()), "Euler steps")
    assert f"at the step's {at}" in mistake.said
    assert [mistake] == mistakes_alone(path)
    assert np.allclose(increments(arcs.trajectory().xyt).rows, rows[1:], atol=1e-9)
    assert not mistakes_alone(arcs)


@pytest.mark.parametrize(("order", "plane"), [([1, 2, 0], "x-z"), ([2, 0, 1], "y-z")])
def test_another_plane(order, plane):
    seen = real(driven(), headed=False)
    found = look_at(trajectory(driven()), replace(seen, xyz=seen.xyz[:, order]), "plane")
    assert plane in found.mistakes[0].said


@pytest.mark.parametrize(
    ("yaw", "named"), [(lambda a: np.pi * (np.cos(a) < 0), ["headings of the truth"]), (np.zeros_like, [])]
)
def test_an_attitude_about_another_axis_and_none_leave_positions(yaw, named):
    seen = real(driven())
    assert not look_at(trajectory(driven()), replace(seen, yaw_rad=yaw(seen.yaw_rad)), *named).truth.headed


@pytest.mark.parametrize("headed", [True, False])
@pytest.mark.parametrize(("at", "metre"), [(0, 1000.0), (1, 100.0), (1, 1000.0)])
def test_a_unit_of_lengths_is_undone_and_no_part_of_the_model(at, metre, headed):
    pair = [trajectory(driven()), real(driven(), headed=headed)]
    path = pair[at]
    pair[at] = replace(path, xyz=path.xyz * metre)
    found = look_at(*pair, "unit of lengths")
    assert {100.0: "centi", 1000.0: "milli"}[metre] + "metres for metres" in found.mistakes[0].causes
    assert found.gains == (1.0, 1.0)
    assert np.allclose((found.odometry, found.truth)[at].xyz, path.xyz)


@pytest.mark.parametrize("headed", [True, False])
@pytest.mark.parametrize("step_m", [5e-4, 7e-4, 1e-3])
def test_increments_that_are_cut_to_whole_steps_and_ticks_that_are_not(step_m, headed):
    ticks = rims(rows := driven(16), *(lambda u: step_m * np.diff(np.floor(np.cumsum(u) / step_m), prepend=0.0),) * 2)
    look_at(trajectory(ticks), real(rows, headed=headed))
    cut = rims(rows, *(lambda u: step_m * np.trunc(u / step_m),) * 2)
    found = look_at(trajectory(cut), real(rows, headed=headed), "whole steps")
    assert f"increments are whole steps of {1e3 * step_m:.3g} mm" in found.mistakes[0].said
    far_m = [np.abs(x).sum() for x in (rows[:, 0], cut[:, 0], increments(found.odometry.trajectory().xyt).ds_m)]
    assert abs(far_m[2] - far_m[0]) < 0.2 * (far_m[0] - far_m[1])
    gyro = trajectory(np.column_stack((cut[:, 0], rows[:, 1:])))  # whose headings stay as they are
    assert np.allclose(look_at(gyro, real(rows, headed=headed), "whole steps").odometry.yaw_rad, gyro.yaw_rad)


@pytest.mark.parametrize("at", [0, 1], ids=["odometry", "truth"])
@pytest.mark.parametrize(
    ("angle", "omni"), [*((angle, False) for angle in (-150, -90, -45, 60, 90, 135)), (-45, True), (90, True)]
)
def test_axes_that_are_turned_by_any_angle(omni, angle, at):
    rows = driven(4) + omni * np.roll(driven(5), 900, axis=0)[: len(driven(4)), [1, 0, 1]]
    pair = [trajectory(rows), real(rows)]
    pair[at] = replace(pair[at], yaw_rad=pair[at].yaw_rad - np.radians(angle))
    found = look_at(*pair, "turned axes")
    assert omni or f"{pair[at].name} drives {abs(angle)} deg to the {'rl'[angle > 0]}" in found.mistakes[0].said
    look_at(found.odometry, found.truth)


@pytest.mark.parametrize("seed", range(3))
def test_a_truth_in_degrees_that_wraps_many_times_between_poses_has_that_cause(seed):
    seen = real(rows := driven(seed) * [1.0, 1.0, 2.0])
    wrong = replace(seen, yaw_rad=(np.degrees(seen.yaw_rad) + np.pi) % (2.0 * np.pi) - np.pi)
    (mistake,) = look_at(trajectory(rows), wrong, "steps and headings").mistakes
    assert "degrees, not radians" in mistake.causes


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("headed", [True, False])
@pytest.mark.parametrize("how", [{}, {"reverse": False}, {"left_only": True}], ids=["hand", "ahead", "left"])
def test_nothing_is_claimed_of_small_errors(seed, headed, how):
    rows = driven(seed, 60.0, **how)
    slip = 1.0 + 0.03 * np.random.default_rng(seed).standard_normal(rows.shape)
    assert look_at(trajectory(rows * slip * [1.06, 1.0, 0.9]), real(rows, headed=headed)).gains == (1.0, 1.0)


@pytest.mark.parametrize("error", [(0.0083, -0.013, 0.0), (-0.005, 0.0, -0.007)])
def test_nothing_is_claimed_of_one_steady_motion(error):
    steady = np.array((0.11, 0.0, 0.004) if error[0] < 0.0 else (-0.017, 0.15, 0.2))
    wave = (1.0 + 0.3 * np.sin(np.arange(3000)[:, None] / HZ)) / HZ
    look_at(trajectory(steady * wave), real((steady + error) * wave))


@pytest.mark.parametrize("w", [0.0, 1.0])
def test_quaternions_without_w_are_refused(read, w):
    moved = written(odometry(60.0), lambda quat: quat * [1.0, 1.0, 1.0, 0.0] + [0.0, 0.0, 0.0, w])
    with pytest.raises(RecordingError, match=r"run.mcap: /odom: its orientations are no unit quaternions \(w is 0"):
        read(moved, truth(60.0))


@pytest.mark.parametrize("gain", [1 / 40.0, 100.0])
def test_the_recording_keeps_its_odometry_and_has_the_factor_as_an_effect(read, gain):
    moved = odometry(60.0)
    scaled = moved.having(xyz=moved.xyz / gain)
    (run,) = read(scaled, truth(60.0))
    assert np.allclose(np.diff(run.odometry.xyt[:, :2], axis=0), np.diff(scaled.xyz[:, :2], axis=0), atol=1e-9)
    for (factor,) in (factors_of([run]), fit_robot([run], (), law_name="diffusion").model.effects):
        assert (factor.name, factor.e) == ("wheel_scale", pytest.approx(gain / 1.02 - 1.0, abs=0.05 * gain))
    assert "turns agree" in run.mistakes[0].said


@pytest.mark.parametrize("turned", [14.0, 0.07])
def test_the_model_of_a_fit_has_the_factor(turned):
    """Breaks where sensitivities are those of the truth's speeds, although the odometry's are many times as large."""
    moved, seen = trajectory(driven(13) * [1.0, 1.0, turned]), real(driven(13))
    runs = recordings_of("run", moved, seen)
    (wheelbase,) = fit_robot(runs, (), law_name="diffusion").model.effects
    assert wheelbase.e == pytest.approx(turned - 1.0, rel=0.02)


def test_what_is_complete_but_for_a_mistake_is_not_called_complete():
    nothing = Summary((Line("COMPLETE", "no known effect explains more than chance"),))
    first = mistakes_first(nothing, [Mistake("wheel separation", "turns", "track", "change it")])
    assert [line.label for line in first.lines] == ["MISTAKE", "causes", "change", "otherwise"]
    assert mistakes_first(nothing, ()) == nothing


def written(rows, change):
    """Return rows whose quaternions (n, 4) are written as a function of the right ones."""

    class Written(Rows):
        quat = property(lambda self: change(Rows.quat.fget(self)))

    return Written(rows.stamps_ns, rows.xyz, rows.yaw)


def wheels_and_filter(rate_hz=25.0, lag_ns=4_000_000):
    """Odometry with ticks, and a filter of its speed and of a gyro's heading."""
    fine = odometry(60.0, rate_hz=25.0)
    steps = np.linalg.norm(np.diff(fine.xyz[:, :2], axis=0), axis=1)
    gone = np.round(np.concatenate(([0.0], np.cumsum(steps))) / 1.2e-4) * 1.2e-4
    moved = along(fine, gone, fine.yaw)
    t = np.arange(0.0, 59.9, 1.0 / rate_hz)
    own, stamps_ns = (fine.stamps_ns - START_NS) * 1e-9, START_NS + (t * 1e9).astype(np.int64) + lag_ns
    shape = Rows(stamps_ns, np.zeros((len(t), 3)), 0.96 * np.interp(t, own, fine.yaw))
    return moved, along(shape, np.interp(t, own, gone), shape.yaw)


def along(rows, gone, yaw):
    steps = np.column_stack((np.diff(gone), 0.0 * gone[1:], np.diff(yaw)))
    xyt = accumulate(np.array((0.0, 0.0, yaw[0])), Increments.of_rows(steps))
    return Rows(rows.stamps_ns, np.column_stack((xyt[:, :2], 0.0 * yaw)), yaw)


@pytest.mark.parametrize("rate_hz", [25.0, 30.0])
def test_a_filter_of_the_wheels_speed_is_no_truth(read, rate_hz):
    with pytest.raises(RecordingError, match="repeats the travel of /odom"):
        read(*wheels_and_filter(rate_hz))


def test_a_truth_that_differs_by_a_millimetre_is_one(read):
    moved, real = wheels_and_filter()
    noise = 1e-3 * np.random.default_rng(1).standard_normal(real.xyz.shape)
    (run,) = read(moved, real.having(xyz=real.xyz + noise))
    assert not run.alerts


@pytest.mark.parametrize("topic_", ["/odom", "/truth"])
def test_quaternions_in_the_order_w_x_y_z(read, topic_):
    moved, real = odometry(), truth()
    first = [written(r, lambda quat: np.roll(quat, 1, axis=1)) for r in (moved, real)]
    with pytest.raises(RecordingError, match=f"{topic_}: its quaternions roll while they never turn"):
        read(*((first[0], real) if topic_ == "/odom" else (moved, first[1])))


def test_a_sensor_upside_down_is_read(read):
    assert read(odometry(), written(truth(), lambda quat: quat[:, [3, 2, 0, 1]]))


def of(path, name="/odom", *, headed=True):
    return samples(path.stamps_ns, path.xyt[:, :2], path.xyt[:, 2] if headed else None, name=name)


def check(odometry, truth, *, headed=True):
    """Check two trajectories over the time that they share, which they start together."""
    late = of(truth, "/truth", headed=headed)
    late = late.stamped(late.stamps_ns - late.stamps_ns[0] + odometry.stamps_ns[0])
    end = min(odometry.stamps_ns[-1], late.stamps_ns[-1])
    here = of(odometry)
    check_together(here.only(here.stamps_ns <= end), late.only(late.stamps_ns <= end))


@pytest.fixture(scope="module")
def drives():
    return [as_recording(simulate(seed, None, duration_s=240.0)) for seed in (41, 42, 43, 44)]


@pytest.mark.parametrize("headed", [True, False])
def test_the_truth_of_another_drive_is_refused(drives, headed):
    for one, other in product(drives, drives):
        refused = pytest.raises(RecordingError, match="/truth: does not move as /odom does")
        with nullcontext() if one is other else refused:
            check(one.odometry, other.truth, headed=headed)


def test_a_truth_that_is_silent_for_a_minute_is_compared_where_it_is_seen(drives):
    # a straight line across the gap would be a speed of its own: an hour of RTK with long float episodes was refused
    drive, truth = drives[0], drives[0].truth
    seconds = (truth.stamps_ns - truth.stamps_ns[0]) * 1e-9
    seen = truth.only((seconds < 40.0) | ((seconds > 100.0) & (seconds < 130.0)) | (seconds > 190.0))
    check(drive.odometry, seen, headed=False)
    alike = cross_correlation(drive.odometry, seen, 10.0)
    assert alike.speed.max() > cross_correlation(drive.odometry, truth, 10.0).speed.max() - 0.02


STEADY = {"straight": (0.4, 0.0), "circle": (0.4, 0.3), "crawl": (0.03, 0.0), "spin": (0.0, 0.5)}
WORST = Tracker(rate_hz=5.0, noise_m=0.05, noise_rad=0.05, dropouts_per_min=4.0, dropout_mean_s=3.0, wander_m=0.05)


@pytest.mark.parametrize("headed", [True, False])
@pytest.mark.parametrize("route", [*STEADY, "shuttle", "slalom"])
def test_dull_drives_with_a_bad_truth_are_accepted(route, headed):
    way = (Segment(*STEADY[route], 60.0),) if route in STEADY else route
    seen = as_recording(simulate(45, None, duration_s=60.0, route=way, truth=WORST, drive_type="skid"))
    check(seen.odometry, seen.truth, headed=headed)


@pytest.mark.parametrize("headed", [True, False])
def test_odometry_that_is_hardly_any_is_accepted(headed):
    """Metres and radians off after a few metres: white noise of every step, and slip of a third."""
    steps = wander(46, 240.0)
    noisy = recording(steps, noisy_path(steps, Coefficients(0.5, 0.5, 0.3, 0.3), 46), seed=46)
    check(noisy.odometry, noisy.truth, headed=headed)


def test_another_frame_and_a_late_clock_are_no_other_drive(drives):
    truth = of(drives[0].truth, "/truth")
    turned = compose(np.array([30.0, -7.0, 2.0]), drives[0].truth.xyt)
    moved = truth.only(slice(None)).stamped(truth.stamps_ns + 2_500_000_000)
    moved = of(type(drives[0].truth)(moved.stamps_ns, turned), "/truth")
    check_together(of(drives[0].odometry), moved)
