"""A random process must show in both halves of a drive; events and remainders of an effect are none."""

from dataclasses import replace

import numpy as np
import pytest
from wandering import RATE_HZ, noisy_path, recording, wander

from odomcorrupt.geometry.se2 import Increments, accumulate
from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.model.noise_laws import Coefficients
from odomcorrupt.study.estimate.config import choose_approach
from odomcorrupt.study.estimate.gauss_newton import fit
from odomcorrupt.study.select.decisions import DECISIONS
from odomcorrupt.study.select.random_effects import random_coefficients

QUIET = Coefficients(0.004, 0.004, 0.002, 0.001)


def processes_of(run):
    """Return the random coefficients that a recording shows, and the fit."""
    fitted = fit([run], approach=choose_approach([run]))
    return [one.effect for one in random_coefficients(fitted, DECISIONS)], fitted


def turned(yaw_rate, seed=3):
    """Return a recording of a robot that turned at this rate (n,) rad/s besides, unknown to its odometry."""
    steps = wander(seed, len(yaw_rate) / RATE_HZ)
    run = recording(steps, noisy_path(steps, QUIET, seed), seed=seed)
    true = accumulate(np.zeros(3), Increments(steps.ds_m, steps.dl_m, steps.dtheta_rad + yaw_rate / RATE_HZ))
    noise = np.random.default_rng(seed).normal(0.0, [0.002, 0.002, 0.003], true.shape)
    return replace(run, truth=Trajectory(run.odometry.stamps_ns, true + noise))


@pytest.mark.parametrize(("begin_s", "end_s", "rate"), [(144.0, 146.4, 0.5), (72.0, 86.4, 0.04), (44.0, 84.0, 0.008)])
def test_what_happened_once_is_no_bias_that_walks(begin_s, end_s, rate):
    """A lift that takes 2 s, a bend of 14 s, a bias for 40 s: one half of the drive knows nothing of it."""
    t_s = np.arange(12_000) / RATE_HZ
    rate = np.where((t_s > begin_s) & (t_s < end_s), rate, 0.0)
    assert processes_of(turned(rate))[0] == []


def test_a_bias_that_walks_all_the_time_is_found():
    walk = np.cumsum(np.random.default_rng(4).normal(0.0, 2e-3 / np.sqrt(RATE_HZ), 12_000))
    assert [found.name for found in processes_of(turned(walk))[0]] == ["gyro_bias_walk"]


@pytest.mark.parametrize("seed", [14, 34])
def test_a_bias_that_hardly_walks_in_one_half_by_chance_is_found(seed):
    """Breaks where the half that shows less has to gain: a walk has few degrees of freedom in two minutes."""
    walk = np.cumsum(np.random.default_rng(seed).normal(0.0, 6e-4 / np.sqrt(RATE_HZ), 12_000))
    found, *others = processes_of(turned(walk, seed))[0]
    assert found.name == "gyro_bias_walk"
    assert {(other.name, other.channel) for other in others} <= {("gauss_markov", "wheels")}  # the same, but for rests
    assert found.density == pytest.approx(6e-4, rel=0.25)
