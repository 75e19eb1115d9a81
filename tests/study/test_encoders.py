"""Ticks, lost increments, steps of speed and high rates are read from the odometry alone."""

from dataclasses import replace

import numpy as np
import pytest
from wandering import RATE_HZ, drive, recording, wander

from odomcorrupt.correction.undo import undo_effects
from odomcorrupt.effects import effect_from_values, registry
from odomcorrupt.effects.counts import losses, wheel_losses
from odomcorrupt.effects.effect import choices
from odomcorrupt.geometry.motion import motion_of, speed_steps
from odomcorrupt.geometry.se2 import Increments, accumulate, increments
from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.model.motion_model import Noise, Step
from odomcorrupt.model.noise_laws import Coefficients
from odomcorrupt.study.estimate.config import choose_approach
from odomcorrupt.study.estimate.gauss_newton import fit
from odomcorrupt.study.io.encoders import encoder_effects, hides_losses, restore_lost, speeds_in_steps, thinned, tick_of
from odomcorrupt.study.io.recording import Recording
from odomcorrupt.study.select.candidates import score_terms
from odomcorrupt.study.select.decisions import DECISIONS
from odomcorrupt.study.select.dictionary import Dictionary
from odomcorrupt.study.select.shape_search import ShapeSearch
from odomcorrupt.study.terms.term import LibraryTerm

TRACK_M = 0.35


def counted(tick_m, *, lost=0.0, late=0.0, lost_by=(1.0, 1.0), late_by=(1.0, 1.0), seed=5):
    """Return a recording whose wheels count ticks, with increments lost for good, or reported one later.

    lost_by, late_by : (right, left) 1 for the wheels whose increments these are
    """
    rng = np.random.default_rng(seed)
    steps = wander(seed, 300.0)
    sides = [steps.ds_m + s * TRACK_M / 2.0 * steps.dtheta_rad for s in (1.0, -1.0)]
    right, left = (tick_m * np.diff(np.floor(np.cumsum(np.concatenate(([0.3 * tick_m], u))) / tick_m)) for u in sides)
    gone = rng.uniform(size=len(right)) < lost
    behind = np.flatnonzero(rng.uniform(size=len(right) - 1) < late)
    for u, loses, delays in zip((right, left), lost_by, late_by, strict=True):
        if loses:
            u[gone] = 0.0
        if delays:
            u[behind + 1] += u[behind]
            u[behind] = 0.0
    reported = Increments((right + left) / 2.0, np.zeros_like(right), (right - left) / TRACK_M)
    run = recording(steps, accumulate(np.zeros(3), reported))
    return replace(run, track_m=TRACK_M), gone


def effects_of(run):
    return {effect.name: effect for effect in encoder_effects(run)}


def losses_named(run):
    return {effect.wheel: effect for effect in encoder_effects(run) if effect.name == "lost_increments"}


def heading_error(run, whole):
    """Return the largest difference of heading, rad."""
    return np.abs(run.odometry.xyt[:, 2] - whole.odometry.xyt[:, 2]).max()


@pytest.mark.parametrize("tick_m", [1e-4, 2e-3])
def test_lost_increments_are_found_at_their_rate_whatever_a_tick_is(tick_m):
    run, gone = counted(tick_m, lost=0.015)
    fraction = effects_of(run)["lost_increments"].fraction
    # binomial: 15 000 increments of which most move
    assert fraction == pytest.approx(0.015, abs=3.0 * np.sqrt(0.015 / 10_000))
    seen = losses(motion_of(run.odometry_s, run.odometry.xyt, track_m=TRACK_M)).lost
    assert np.mean(gone[seen]) > 0.98
    assert ("quantization" in effects_of(run)) == (tick_m > 1e-3)


@pytest.mark.parametrize("known_m", [TRACK_M, None, 1.05 * TRACK_M])
@pytest.mark.parametrize("wheel", ["right", "left"])
def test_losses_of_one_wheel_are_found_and_restored_whether_the_drivers_track_is_known_or_not(wheel, known_m):
    whole, _ = counted(4e-4)
    run, gone = counted(4e-4, lost=0.03, lost_by=(wheel == "right", wheel == "left"))
    run = replace(run, track_m=known_m)
    found = losses_named(run)
    assert list(found) == [wheel]
    assert found[wheel].fraction == pytest.approx(0.03, abs=3.0 * np.sqrt(0.03 / 10_000))
    assert found[wheel].track == (pytest.approx(TRACK_M, rel=1e-6) if known_m is None else 0.0)
    seen = wheel_losses(motion_of(run.odometry_s, run.odometry.xyt), known_m)
    assert np.mean(gone[getattr(seen, wheel).lost]) > 0.98
    assert heading_error(restore_lost(run, encoder_effects(run)), whole) < 0.05 * heading_error(run, whole)


def test_independent_losses_of_both_wheels_are_named_once_for_each():
    run, _ = counted(4e-4, lost=0.04, lost_by=(1.0, 0.0))
    steps = increments(run.odometry.xyt)
    effect = effect_from_values("lost_increments", {"fraction": 0.01, "wheel": "left"})
    fewer = effect.recorded(
        np.column_stack((steps.ds_m, steps.dl_m, steps.dtheta_rad)),
        run.odometry_s[1:],
        TRACK_M,
        np.random.default_rng(8),
    ).steps
    xyt = accumulate(np.zeros(3), Increments(*fewer.T))
    found = losses_named(replace(run, odometry=Trajectory(run.odometry.stamps_ns, xyt)))
    assert found["right"].fraction == pytest.approx(0.04, abs=0.006)
    assert found["left"].fraction == pytest.approx(0.01, abs=0.003)


@pytest.mark.parametrize(
    ("tick_m", "late"),
    [*((tick_m, {}) for tick_m in (1e-4, 2e-3, 5e-3, 2e-2, 3e-2)),
     *((tick_m, {"late": 0.01, "late_by": by}) for tick_m in (1e-4, 2e-3) for by in ((1.0, 1.0), (0.0, 1.0)))],
)  # fmt: skip
def test_ticks_and_counts_of_both_wheels_or_of_one_that_come_late_are_not_lost(tick_m, late):
    assert not losses_named(counted(tick_m, **late)[0])


def test_turns_about_a_wheel_are_no_losses():
    rng = np.random.default_rng(4)
    legs = []
    for _ in range(80):
        ramp = np.concatenate((np.linspace(1.0, 0.0, 5), np.zeros(rng.integers(1, 40)), np.linspace(0.0, 1.0, 5)))
        legs += [np.ones(rng.integers(20, 60)), ramp]
    inner = 0.01 * np.concatenate(legs)
    outer = np.full_like(inner, 0.01)
    steps = Increments((inner + outer) / 2.0, np.zeros_like(inner), (outer - inner) / TRACK_M)
    run = recording(steps, accumulate(np.zeros(3), steps))
    assert not losses_named(replace(run, track_m=TRACK_M))
    assert not losses_named(run)


@pytest.mark.parametrize("cut_mps", [0.1, 0.3])
def test_wheels_whose_low_speeds_are_cut_off_lose_no_increments(cut_mps):
    rng = np.random.default_rng(6)
    steps = wander(6, 300.0)
    sides = [steps.ds_m + s * TRACK_M / 2.0 * steps.dtheta_rad + rng.normal(0.0, 2e-4, len(steps)) for s in (1.0, -1.0)]
    right, left = (np.where(np.abs(u) < 0.02 * cut_mps, 0.0, u) for u in sides)
    reported = Increments((right + left) / 2.0, np.zeros_like(right), (right - left) / TRACK_M)
    run = replace(recording(steps, accumulate(np.zeros(3), reported)), track_m=TRACK_M)
    shown = wheel_losses(motion_of(run.odometry_s, run.odometry.xyt), TRACK_M)
    assert min(shown.alone) > 20
    assert not {"right", "left"} & set(losses_named(run))


def test_only_ticks_that_hardly_move_an_increment_hide_losses():
    assert hides_losses(counted(2e-2, lost=0.015)[0])
    assert not hides_losses(counted(2e-3, lost=0.015)[0])
    assert not hides_losses(counted(1e-4)[0])


def test_one_cruising_speed_over_one_and_two_sampling_intervals_is_no_lattice_of_ticks():
    rng = np.random.default_rng(8)
    dt_s = 0.01 * rng.choice([1, 2], 6000, p=[0.8, 0.2])
    speed = np.full(6000, 0.2)
    speed[::500] = 0.0
    xyt = np.zeros((6001, 3))
    xyt[1:, 0] = np.cumsum(speed * dt_s)
    path = Trajectory(np.concatenate(([0], np.cumsum(np.round(dt_s * 1e9).astype(np.int64)))), xyt)
    assert encoder_effects(Recording("exact", path, path, 0)) == []


STEPS_TRACK_M, DT_S = 0.36, 0.02


def in_steps(travel, turn):
    steps = wander(3, 120.0)
    run = recording(steps, accumulate(np.zeros(3), steps), seed=3)
    xyt = accumulate(np.zeros(3), Increments(travel, np.zeros_like(travel), turn))
    return run.__class__(run.name, Trajectory(run.odometry.stamps_ns, xyt), run.truth, run.origin_ns, STEPS_TRACK_M)


def speeds():
    steps = wander(3, 120.0)
    return steps.ds_m / DT_S, steps.dtheta_rad / DT_S


def test_truncated_speeds_are_no_ticks():
    v, omega = speeds()
    run = in_steps(0.04 * np.trunc(v / 0.04) * DT_S, 0.06 * np.trunc(omega / 0.06) * DT_S)
    assert speeds_in_steps(run)
    assert tick_of(run) is None
    assert not any(effect.name == "quantization" for effect in encoder_effects(run))


def test_ticks_of_two_wheels_are_no_steps_of_speed():
    v, omega = speeds()
    tick_m = 0.002
    right, left = (np.cumsum(v + side * omega * STEPS_TRACK_M / 2.0) * DT_S for side in (1.0, -1.0))
    right, left = (np.diff(np.floor(way / tick_m) * tick_m, prepend=0.0) for way in (right, left))
    run = in_steps(0.5 * (right + left), (right - left) / STEPS_TRACK_M)
    assert not speeds_in_steps(run)
    assert tick_of(run) == pytest.approx(tick_m, rel=0.01)


def slow():
    """Return a drive with odometry at 50 Hz."""
    return replace(drive(5, 60.0, Coefficients(0.05, 0.02, 0.02, 0.01)), track_m=STEPS_TRACK_M)


def at_rate(run, factor):
    """Return the drive with `factor` times as many poses, whose path is the same at every one of them."""
    stamps, xyt = run.odometry.stamps_ns, run.odometry.xyt
    last = (len(stamps) - 1) * factor
    at = np.arange(last + 1) / factor
    fine_ns = stamps[0] + np.round(np.interp(at, np.arange(len(stamps)), (stamps - stamps[0]).astype(float)))
    fine = np.stack([np.interp(at, np.arange(len(stamps)), column) for column in xyt.T], axis=1)
    return replace(run, odometry=Trajectory(fine_ns.astype(np.int64), fine))


@pytest.mark.parametrize(("factor", "every"), [(1, 1), (2, 2), (3, 3), (4, 4), (20, 20)])
def test_fifty_to_a_hundred_hertz_remain(factor, every):
    run = at_rate(slow(), factor)
    (few,) = thinned([run])
    np.testing.assert_array_equal(few.odometry.xyt, run.odometry.xyt[::every])
    np.testing.assert_array_equal(few.odometry.stamps_ns, run.odometry.stamps_ns[::every])
    assert (few is run) == (every == 1)
    assert few.notes == (*run.notes, *([f"odometry at {50 * factor} Hz: one pose of {every} is used"] * (every > 1)))


def test_steps_of_speed_are_kept_because_each_message_lost_a_part_of_one():
    fast = at_rate(slow(), 4)
    dt_s = np.diff(fast.odometry.stamps_ns) * 1e-9
    steps = wander(5, 15.0)
    v, omega = steps.ds_m / 0.02, steps.dtheta_rad / 0.02
    count = min(len(v), len(dt_s))
    travel, turn = (0.04 * np.trunc(v / 0.04) * 0.005)[:count], (0.06 * np.trunc(omega / 0.06) * 0.005)[:count]
    xyt = accumulate(np.zeros(3), Increments(travel, np.zeros(count), turn))
    run = replace(fast, odometry=Trajectory(fast.odometry.stamps_ns[: count + 1], xyt))
    assert thinned([run]) == [run]
    # without a track the steps may be those of ticks
    assert len(thinned([replace(run, track_m=None)])[0].odometry) == len(run.odometry.xyt[::4])


def test_lost_messages_are_kept_because_each_is_restored():
    run = at_rate(slow(), 4)
    steps = np.diff(run.odometry.xyt, axis=0)
    steps[np.random.default_rng(1).uniform(size=len(steps)) < 0.05] = 0.0
    xyt = np.concatenate((run.odometry.xyt[:1], run.odometry.xyt[0] + np.cumsum(steps, axis=0)))
    lossy = replace(run, odometry=Trajectory(run.odometry.stamps_ns, xyt))
    assert thinned([lossy]) == [lossy]


@pytest.mark.parametrize(
    ("noise", "per_message"),
    [(Noise("diffusion", Coefficients(0.1, 0.1, 0.1, 0.1)), False),
     (Noise("diffusion", Coefficients(0.1, 0.1, 0.1, 0.1, rot_time=0.01)), False),
     (Noise("diffusion", Coefficients(0.1, 0.1, 0.1, 0.1, white_omega=0.01)), True),
     (Noise("quadratic", Coefficients(0.1, 0.1, 0.1, 0.1)), True),
     (Noise("quadratic", Coefficients(0.0, 0.0, 0.0, 0.0)), False),
     (Noise("quadratic", Coefficients(0.1, 0.1, 0.1, 0.1), Step.parse("0.25m,0.2rad")), False)],
)  # fmt: skip
def test_noise_of_every_message_depends_on_the_rate(noise, per_message):
    assert noise.per_message is per_message


BASE_M, STEP_MPS, TURN_RPS, TICK_MPS = 0.3, 0.031, 0.083, 0.0175
SIZES = {"step": STEP_MPS, "turn": TURN_RPS}
QUIET = Coefficients(0.006, 0.006, 0.004, 0.002)


def truncated(steps, **values):
    """Return the odometry (n + 1, 3) of a drive whose velocities are truncated."""
    effect = effect_from_values("truncated_velocity", values)
    rows = np.stack((steps.ds_m, steps.dl_m, steps.dtheta_rad), axis=1)
    t_s = np.arange(1, len(steps) + 1) / RATE_HZ
    made = effect.recorded(rows, t_s, BASE_M, None).steps
    return accumulate(np.zeros(3), Increments(*np.ascontiguousarray(made.T)))


def steps_shown(xyt, t_s, track_m=BASE_M):
    motion = motion_of(t_s, xyt)
    return speed_steps(motion.v, motion.omega, motion.dt_s, track_m)


@pytest.mark.parametrize("off_s", [0.0, 2e-4], ids=["even stamps", "uneven stamps"])
def test_odometry_shows_its_steps_by_flickering_between_them(off_s):
    xyt = truncated(wander(3, 60.0), **SIZES, tick=TICK_MPS)
    t_s = np.arange(len(xyt)) / RATE_HZ + np.random.default_rng(1).normal(0.0, off_s, len(xyt))
    assert steps_shown(xyt, t_s) == pytest.approx((STEP_MPS, TURN_RPS), rel=1e-3)


def test_odometry_without_ticks_before_the_truncation_or_with_nothing_but_ticks_shows_none():
    steps = wander(3, 60.0)
    t_s = np.arange(len(steps) + 1) / RATE_HZ
    assert steps_shown(accumulate(np.zeros(3), steps), t_s) is None
    # without ticks, a speed between two steps is reported as the lower one all the time
    assert steps_shown(truncated(steps, **SIZES), t_s) is None
    # whole ticks of both wheels lose nothing
    tick_m = 0.0004
    rims = [steps.ds_m + side * 0.5 * BASE_M * steps.dtheta_rad for side in (1.0, -1.0)]
    right, left = (np.diff(np.floor(np.cumsum(rim) / tick_m), prepend=0.0) * tick_m for rim in rims)
    counted = Increments((right + left) / 2.0, steps.dl_m, (right - left) / BASE_M)
    assert steps_shown(accumulate(np.zeros(3), counted), t_s) is None


def rms_heading_error(steps, xyt, **values):
    """Return the root mean square error, rad, of the corrected headings after ten seconds."""
    t_s = np.arange(len(xyt)) / RATE_HZ
    corrected = xyt + undo_effects((effect_from_values("truncated_velocity", values),), t_s, xyt, BASE_M).error_xyt
    off = corrected[:, 2] - accumulate(np.zeros(3), steps)[:, 2]
    late = round(10.0 * RATE_HZ)
    return float(np.sqrt(np.mean((off[late:] - off[:-late]) ** 2)))


def test_correction_reads_slow_turns_from_single_steps_among_zeros():
    steps = Increments(np.full(3000, 0.004), np.zeros(3000), np.full(3000, 0.9 * TURN_RPS / RATE_HZ))
    xyt = truncated(steps, **SIZES, tick=TICK_MPS)
    assert np.mean(np.diff(xyt[:, 2]) == 0.0) > 0.5
    assert rms_heading_error(steps, xyt, **SIZES) < 0.35 * rms_heading_error(steps, xyt, step=STEP_MPS, turn=0.0)


def found(steps, xyt):
    """Return the effect that is included on a recording."""
    made = replace(recording(steps, xyt, seed=4), track_m=BASE_M)
    start = fit([made], approach=choose_approach([made]))
    family = LibraryTerm.family(registry()["truncated_velocity"], start.problem.motions)
    search = ShapeSearch(start, DECISIONS)
    best = search.maximise(search.located(family)[0])
    forms = [best, *best.with_words(tuple(choices(best.start)))]
    scores = score_terms(start, forms, Dictionary(DECISIONS))
    fits = [start.refit((score.estimated,), weights_of=start) for score in scores]
    (effect,) = max(fits, key=lambda one: one.log_likelihood).refit().effects
    return effect


@pytest.mark.parametrize("rounding", ["zero", "down"])
def test_the_side_of_rounding_is_found(rounding):
    steps = wander(4, 240.0)
    effect = found(steps, truncated(steps, **SIZES, rounding=rounding))
    assert (effect.rounding, effect.tick) == (rounding, 0.0)
    assert (effect.step, effect.turn) == pytest.approx((STEP_MPS, TURN_RPS), rel=0.25)
