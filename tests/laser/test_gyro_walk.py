"""The random walk of the bias of a gyro that is the only truth: its level is estimated, and it is not named."""

from dataclasses import replace

import laserbags
import numpy as np
import pytest

import odomcorrupt as oc
from odomcorrupt.simulation import Tracker, simulate
from odomcorrupt.study.estimate.config import choose_approach
from odomcorrupt.study.estimate.problem import pose_problem
from odomcorrupt.study.estimate.truth_bias import bias_steps, with_bias_walks
from odomcorrupt.study.io import Source, read_runs

EXACT = Tracker(rate_hz=100.0, sampling_jitter_s=0.0, noise_m=0.0, noise_rad=0.0, dropouts_per_min=0.0)
BIAS, NOISE = 0.01, 0.003


def bag(path, seed, walk, cause=None, **options):
    """Write the bag of a robot with wheels and a gyro whose bias walks (rad/s/sqrt(s))."""
    simulated = simulate(seed, cause, truth=EXACT, yaw_from="encoders", **options)
    stamps, rng = simulated.truth_stamps_ns, np.random.default_rng(seed)
    rate = np.gradient(np.unwrap(simulated.truth_xyt[:, 2]), stamps * 1e-9)
    bias = BIAS + walk * np.cumsum(rng.normal(size=len(stamps))) / np.sqrt(EXACT.rate_hz)
    yaw = rate + bias + NOISE * rng.normal(size=len(stamps))
    rates = np.column_stack((np.zeros((len(yaw), 2)), yaw))
    return laserbags.write(
        path, laserbags.odometry(simulated.odom_stamps_ns, simulated.odom_xyt), laserbags.imu(stamps, rates)
    )


@pytest.mark.slow
@pytest.mark.parametrize("walk", [5e-5, 5e-4])
def test_the_level_of_the_walk_is_estimated_to_a_factor_of_two(tmp_path, walk):
    runs = list(read_runs(Source(bag(tmp_path / "run.mcap", 5, walk, duration_s=180.0))))
    (found,) = with_bias_walks(runs, choose_approach(runs))
    assert 0.5 * walk < found.turn_bias_walk < 2.0 * walk


def test_each_drive_has_a_bias_and_a_walk_of_its_own(tmp_path):
    (run,) = read_runs(Source(bag(tmp_path / "run.mcap", 5, 1e-4, duration_s=60.0)))
    other = replace(run, name="other", positioned=True)
    problem = pose_problem([run, run, other], approach=choose_approach([run]))
    start, steps = bias_steps(problem)
    assert start.shape[2] == 2
    for column in np.concatenate((start, steps), axis=2).transpose(2, 0, 1):
        assert not column[:, :2].any()
        assert len(np.unique(problem.run[column[:, 2] != 0.0])) == 1


@pytest.mark.slow
def test_a_bias_that_walks_five_times_as_fast_as_usual_is_no_error_of_the_odometry(tmp_path):
    path = bag(tmp_path / "run.mcap", 5, 5e-4, duration_s=180.0, route="loops")
    said = oc.diagnose(path).to_dict()
    assert (said["found"], said["unknown"]) == ([], [])


@pytest.mark.slow
def test_unequal_wheels_are_found_though_the_bias_was_taken_from_an_odometry_that_hardly_rests(tmp_path, monkeypatch):
    """That bias contains the turns of unequal wheels, so that their inclusion seemed to increase the error."""
    monkeypatch.setattr("odomcorrupt.study.io.gyro._MIN_STILL_S", 1e9)
    path = bag(tmp_path / "run.mcap", 4, 1e-4, "unequal_wheels", parameters={"curvature": 0.03}, duration_s=180.0)
    found = oc.diagnose(path)
    (one,) = found.to_dict()["found"]
    assert (one["effect"], one["confidence"] > 0.9) == ("unequal_wheels", True)
    assert one["parameters"]["curvature"]["value"] == pytest.approx(0.03, abs=0.005)
    first, last = found.result.sequence.evaluations[0], found.result.sequence.evaluations[-1]
    assert last.ten_second_error_m < 0.7 * first.ten_second_error_m
