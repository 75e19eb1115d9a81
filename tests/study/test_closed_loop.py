"""A driver who steers by the truth: turns that respond to noise are not taken for an odometry error."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from wandering import recording, wander

from odomcorrupt.geometry.increments import Increments, accumulate
from odomcorrupt.study.estimate.config import choose_approach
from odomcorrupt.study.estimate.gauss_newton import fit
from odomcorrupt.study.select.closed_loop import may_be_steering, score_of_corrections
from odomcorrupt.study.select.decisions import DECISIONS
from odomcorrupt.study.select.dependence import dependences
from odomcorrupt.study.select.score import score_columns
from odomcorrupt.study.select.stepwise import learn
from odomcorrupt.study.terms.basis import BasisFunction
from odomcorrupt.study.terms.channels import Action
from odomcorrupt.study.terms.term import BasisTerm

GAIN = BasisTerm(BasisFunction("speed", "k * 1", (lambda m: np.ones(len(m)),)), Action("yaw", "omega"))


def kept_on_a_line(seed: int, seconds: float = 600.0):
    """Return a drive at two speeds along one line, by somebody who takes its turns back in two seconds."""
    rng = np.random.default_rng(seed)
    n = int(seconds * 50.0)
    way = np.where(np.arange(n) // 1000 % 2, 0.006, 0.016)
    kicks = 0.02 * np.sqrt(way) * rng.standard_normal(n)
    heading, turned, true = 0.0, np.zeros(n), np.zeros(n)
    for i in range(n):
        turned[i] = -0.01 * heading
        true[i] = turned[i] + kicks[i]
        heading += true[i]
    zero = np.zeros(n)
    odometry = accumulate(np.zeros(3), Increments(way, zero, turned))
    return recording(Increments(way, zero, true), odometry, truth_mm=1.0, truth_rad=0.001, seed=seed)


def gain_of(run):
    fitted = fit([run], approach=replace(choose_approach([run]), spacing_s=2.0))
    columns = GAIN.columns(fitted.problem)
    (score,) = score_columns(fitted, [columns])
    return fitted, columns, score


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_turns_that_answer_to_the_noise_look_like_a_gain_and_are_distinguished_from_one(seed):
    fitted, columns, score = gain_of(kept_on_a_line(seed))
    assert score.p < 1e-6
    assert score.estimate[0] == pytest.approx(-1.0, abs=0.2)
    assert may_be_steering(fitted, columns, score.estimate)
    assert not may_be_steering(fitted, columns, -score.estimate)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [4, 8])
def test_nothing_is_learned_from_a_driver_who_steers_back(seed):
    learned = learn([kept_on_a_line(seed)])
    assert learned.added == ()
    assert learned.unknown == ()


def test_a_true_gain_of_a_robot_that_turns_is_no_steering():
    steps = wander(6, 300.0)
    odometry = accumulate(np.zeros(3), replace(steps, dtheta_rad=steps.dtheta_rad * 1.02))
    fitted, columns, score = gain_of(recording(steps, odometry, seed=6))
    assert score.estimate[0] == pytest.approx(-0.02, abs=0.005)
    assert not may_be_steering(fitted, columns, score.estimate)


def steered_by_truth(seed: int, *, gain: float, lag: float = 0.0, seconds: float = 300.0):
    """Return a drive with a turn every 30 s that a controller with the true heading follows, a share `gain` per second.

    lag : true turn that is missing per metre and yaw acceleration, rad per m and rad/s^2
    """
    rng = np.random.default_rng(seed)
    n, dt = int(seconds * 25.0), 0.04
    way = np.full(n, 0.8 * dt)
    wanted = np.cumsum(np.where(np.arange(n) % 750 < 50, 0.5, 0.0) * dt)
    kicks = 0.01 * np.sqrt(way) * rng.standard_normal(n)
    rate, heading, turned, true = 0.0, 0.0, np.zeros(n), np.zeros(n)
    for i in range(n):
        asked = np.clip(gain * (wanted[i] - heading), -0.6, 0.6)
        change = np.clip(asked - rate, -2.0 * dt, 2.0 * dt)
        rate += change
        turned[i] = rate * dt
        true[i] = turned[i] + kicks[i] - lag * way[i] * change / dt
        heading += true[i]
    zero = np.zeros(n)
    odometry = accumulate(np.zeros(3), Increments(way, zero, turned))
    return recording(Increments(way, zero, true), odometry, truth_mm=3.0, truth_rad=0.002, seed=seed)


def on_yaw_acceleration(run):
    """Return the dependence of the yaw error on the yaw acceleration, if any."""
    found = dependences(fit([run], approach=choose_approach([run])), [], DECISIONS)
    return [one for one in found if (one.channel, one.regressor) == ("yaw", "yaw_acceleration")]


@pytest.mark.parametrize("gain", [1.0, 3.0])
def test_accelerations_that_answer_to_the_noise_are_no_dependence(gain):
    assert on_yaw_acceleration(steered_by_truth(1, gain=gain)) == []


def test_corrections_explain_no_score_of_the_opposite_sign():
    run = steered_by_truth(1, gain=1.0)
    fitted = fit([run], approach=choose_approach([run]))
    term = BasisTerm(
        BasisFunction("yaw_acceleration", "k * 1", (lambda m: np.clip(m.alpha, -0.03, 0.03),)), Action("yaw", "abs(v)")
    )
    columns = term.columns(fitted.problem)
    imitated = score_of_corrections(fitted, lambda seen: term.columns(replace(fitted.problem, motions=tuple(seen))))
    plain, fed_back, opposite = (
        score_columns(fitted, [columns], imitated=[each])[0].statistic for each in (None, imitated, -imitated)
    )
    assert plain > 50.0
    assert fed_back < 7.0
    assert opposite == pytest.approx(plain)
