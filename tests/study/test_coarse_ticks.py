"""Lost increments and coarse ticks are distinguished: a zero between increments of many ticks is a loss."""

from dataclasses import replace

import numpy as np
import pytest
from wandering import recording, wander

from odomcorrupt.effects import effect_from_values
from odomcorrupt.effects.counts import losses, wheel_losses
from odomcorrupt.geometry.motion import motion_of
from odomcorrupt.geometry.se2 import Increments, accumulate, increments
from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.study.io.encoders import encoder_effects, hides_losses, restore_lost
from odomcorrupt.study.io.recording import Recording

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


def test_restored_travel_is_what_was_lost():
    whole, _ = counted(2e-3)
    run, _ = counted(2e-3, lost=0.015)
    back = restore_lost(run, encoder_effects(run))
    travel = [float(np.abs(increments(r.odometry.xyt).ds_m).sum()) for r in (whole, run, back)]
    assert travel[1] < 0.99 * travel[0]
    assert travel[2] == pytest.approx(travel[0], rel=0.002)


@pytest.mark.parametrize("known_m", [TRACK_M, None, 1.05 * TRACK_M])
@pytest.mark.parametrize("wheel", ["right", "left"])
def test_losses_of_one_wheel_are_found_and_restored_whether_the_drivers_track_is_known_or_not(wheel, known_m):
    """Breaks where only zeros of both wheels count: one wheel's then are a scale error and unequal wheels."""
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


@pytest.mark.parametrize("tick_m", [1e-4, 2e-3, 5e-3, 2e-2, 3e-2])
def test_ticks_alone_lose_nothing(tick_m):
    assert "lost_increments" not in effects_of(counted(tick_m)[0])


@pytest.mark.parametrize("tick_m", [1e-4, 2e-3])
def test_counts_that_come_late_are_not_lost(tick_m):
    assert "lost_increments" not in effects_of(counted(tick_m, late=0.01)[0])


@pytest.mark.parametrize("tick_m", [1e-4, 2e-3])
def test_counts_of_one_wheel_that_come_late_are_not_lost(tick_m):
    assert not losses_named(counted(tick_m, late=0.01, late_by=(0.0, 1.0))[0])


def test_turns_about_a_wheel_are_no_losses():
    """The wheel stands for a second, and its neighbouring increments are those of a braking wheel."""
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
    """A wheel whose speed fluctuates about the limit is reported as zero now and then, and never above it."""
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


@pytest.mark.parametrize("tick_m", [None, 2e-3])
def test_a_few_cruising_speeds_are_no_lattice_and_ticks_on_such_a_drive_are(tick_m):
    """Increments at one cruising speed are one observation, though four of these may be nearly multiples of a step."""
    rng = np.random.default_rng(11)
    plateaus = np.array([0.01633, 0.01959, 0.01742, 0.01306])  # near 15, 18, 16 and 12 times 1.0886 mm
    legs, last = [], 0.0
    for leg in range(40):
        speed = plateaus[leg % 4]
        ramp = np.cumsum(np.full(3, (speed - last) / 4.0) + rng.normal(0.0, 2e-4, 3)) + last
        legs += [ramp, np.full(int(rng.uniform(30, 60)), speed)]
        last = speed
    along = np.concatenate(legs)
    if tick_m is not None:
        along = tick_m * np.diff(np.floor(np.cumsum(np.append(0.0, along)) / tick_m))
    steps = Increments(along, np.zeros_like(along), np.zeros_like(along))
    run = recording(steps, accumulate(np.zeros(3), steps))
    found = effects_of(run).get("quantization")
    # without a track, a tick of the robot's travel is taken for that of one wheel of two
    assert (found is None) if tick_m is None else found.step == pytest.approx(2.0 * tick_m, rel=0.01)


def test_one_cruising_speed_over_one_and_two_sampling_intervals_is_no_lattice_of_ticks():
    """Breaks if increments that differ by their durations alone count as evidence for ticks."""
    rng = np.random.default_rng(8)
    dt_s = 0.01 * rng.choice([1, 2], 6000, p=[0.8, 0.2])
    speed = np.full(6000, 0.2)
    speed[::500] = 0.0
    xyt = np.zeros((6001, 3))
    xyt[1:, 0] = np.cumsum(speed * dt_s)
    path = Trajectory(np.concatenate(([0], np.cumsum(np.round(dt_s * 1e9).astype(np.int64)))), xyt)
    assert encoder_effects(Recording("exact", path, path, 0)) == []
