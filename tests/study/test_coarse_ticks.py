"""Lost increments and coarse ticks are distinguished: a zero between increments of many ticks is a loss."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from wandering import recording, wander

from odomcorrupt.effects.lost_increments import losses
from odomcorrupt.geometry.increments import Increments, accumulate, increments
from odomcorrupt.geometry.motion import motion_of
from odomcorrupt.study.io.encoders import encoder_effects, hides_losses, restore_lost

TRACK_M = 0.35


def counted(tick_m, *, lost=0.0, late=0.0, seed=5):
    """Return a recording whose wheels count ticks, with increments lost for good, or reported one later."""
    rng = np.random.default_rng(seed)
    steps = wander(seed, 300.0)
    sides = [steps.ds_m + s * TRACK_M / 2.0 * steps.dtheta_rad for s in (1.0, -1.0)]
    right, left = (tick_m * np.diff(np.floor(np.cumsum(np.concatenate(([0.3 * tick_m], u))) / tick_m)) for u in sides)
    gone = rng.uniform(size=len(right)) < lost
    behind = np.flatnonzero(rng.uniform(size=len(right) - 1) < late)
    for u in (right, left):
        u[gone] = 0.0
        u[behind + 1] += u[behind]
        u[behind] = 0.0
    reported = Increments((right + left) / 2.0, np.zeros_like(right), (right - left) / TRACK_M)
    run = recording(steps, accumulate(np.zeros(3), reported))
    return replace(run, track_m=TRACK_M), gone


def effects_of(run):
    return {effect.name: effect for effect in encoder_effects(run)}


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


@pytest.mark.parametrize("tick_m", [1e-4, 2e-3, 5e-3, 2e-2, 3e-2])
def test_ticks_alone_lose_nothing(tick_m):
    assert "lost_increments" not in effects_of(counted(tick_m)[0])


@pytest.mark.parametrize("tick_m", [1e-4, 2e-3])
def test_counts_that_come_late_are_not_lost(tick_m):
    assert "lost_increments" not in effects_of(counted(tick_m, late=0.01)[0])


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
