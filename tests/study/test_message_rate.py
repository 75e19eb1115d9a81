"""Odometry at a high message rate is thinned, with the same motion between the poses that remain."""

from dataclasses import replace

import numpy as np
import pytest
from wandering import noisy_path, recording, wander

from odomcorrupt.geometry.se2 import Increments, accumulate
from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.model.motion_model import Noise, Step
from odomcorrupt.model.noise_laws import Coefficients
from odomcorrupt.study.io.message_rate import thinned

TRACK_M = 0.36


def drive():
    """Return a drive with odometry at 50 Hz."""
    steps = wander(5, 60.0)
    run = recording(steps, noisy_path(steps, Coefficients(0.05, 0.02, 0.02, 0.01), 5), seed=5)
    return replace(run, track_m=TRACK_M)


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
    run = at_rate(drive(), factor)
    (few,) = thinned([run])
    np.testing.assert_array_equal(few.odometry.xyt, run.odometry.xyt[::every])
    np.testing.assert_array_equal(few.odometry.stamps_ns, run.odometry.stamps_ns[::every])
    assert (few is run) == (every == 1)
    assert few.notes == (*run.notes, *([f"odometry at {50 * factor} Hz: one pose of {every} is used"] * (every > 1)))


def test_stretches_of_one_run_still_share_its_odometry():
    run = at_rate(drive(), 4)
    one, other = thinned([run, replace(run, name="second stretch")])
    assert one.odometry is other.odometry


def test_steps_of_speed_are_kept_because_each_message_lost_a_part_of_one():
    fast = at_rate(drive(), 4)
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
    run = at_rate(drive(), 4)
    steps = np.diff(run.odometry.xyt, axis=0)
    steps[np.random.default_rng(1).uniform(size=len(steps)) < 0.05] = 0.0
    xyt = np.concatenate((run.odometry.xyt[:1], run.odometry.xyt[0] + np.cumsum(steps, axis=0)))
    lossy = replace(run, odometry=Trajectory(run.odometry.stamps_ns, xyt))
    assert thinned([lossy]) == [lossy]


@pytest.mark.parametrize(
    ("noise", "per_message"),
    [
        (Noise("diffusion", Coefficients(0.1, 0.1, 0.1, 0.1)), False),
        (Noise("diffusion", Coefficients(0.1, 0.1, 0.1, 0.1, rot_time=0.01)), False),
        (Noise("diffusion", Coefficients(0.1, 0.1, 0.1, 0.1, white_omega=0.01)), True),
        (Noise("quadratic", Coefficients(0.1, 0.1, 0.1, 0.1)), True),
        (Noise("quadratic", Coefficients(0.0, 0.0, 0.0, 0.0)), False),
        (Noise("quadratic", Coefficients(0.1, 0.1, 0.1, 0.1), Step.parse("0.25m,0.2rad")), False),
    ],
)
def test_noise_of_every_message_depends_on_the_rate(noise, per_message):
    assert noise.per_message is per_message
