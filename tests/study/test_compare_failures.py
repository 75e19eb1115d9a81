"""Lack of fit is attributed to the right motion, time, place and moment, with an unambiguous sign."""

import numpy as np
import pytest
from wandering import RATE_HZ, noisy_path, recording, wander

from odomcorrupt.geometry.se2 import Increments, accumulate
from odomcorrupt.model.motion_model import MotionModel, Noise, Setup, TruthNoise
from odomcorrupt.model.noise_laws import Coefficients
from odomcorrupt.report.comparison import sentence, size
from odomcorrupt.study.estimate.config import Approach
from odomcorrupt.study.validate.calibration import HORIZONS_M
from odomcorrupt.study.validate.evaluation import evaluate_stretch, horizons_of
from odomcorrupt.study.validate.lack_of_fit import Failure, drift_failures, failures, sudden_failures

PLANTED = Coefficients(0.02, 0.01, 0.02, 0.005)
MODEL = MotionModel(Noise("diffusion", PLANTED), setup=Setup(truth=TruthNoise(0.003, 0.003, 0.0)))


def judged(seed: int, extra, seconds: float = 300.0):
    """Judge a drive whose odometry has `extra(steps, truth) -> (n, 3)` added to its increments."""
    steps = wander(seed, seconds)
    truth = accumulate(np.zeros(3), steps)
    added = extra(steps, truth[:-1])
    wrong = Increments(steps.ds_m + added[:, 0], steps.dl_m, steps.dtheta_rad + added[:, 2])
    return evaluate_stretch(recording(steps, noisy_path(wrong, PLANTED, seed), seed=seed), MODEL, Approach("truth"))


def found_in(piece) -> list[Failure]:
    return failures(piece.problem, piece.whitener, piece.innovations)


def test_an_error_of_left_turns_is_reported_as_one_with_size_and_sense():
    rate = 0.04

    def too_far_left(steps, _truth):
        left = (steps.dtheta_rad > 0.1 * np.abs(steps.ds_m)) & (np.abs(steps.ds_m) > 0.02 / RATE_HZ)
        added = np.zeros((len(steps), 3))
        added[:, 2] = rate * np.abs(steps.ds_m) * left
        return added

    first = found_in(judged(1, too_far_left))[0]
    assert (first.kind, first.channel, first.where) == ("motion", "yaw", "in left turns")
    assert first.measured == pytest.approx(rate, abs=1.5 * first.expected)
    assert sentence(first).startswith("yaw error grows +")
    assert "the odometry turns too far left" in sentence(first)


@pytest.mark.parametrize(("factor", "sense"), [(1.02, "too far ahead"), (0.98, "too far behind")])
def test_the_sign_is_odometry_minus_truth(factor, sense):
    def stretched(steps, _truth):
        added = np.zeros((len(steps), 3))
        added[:, 0] = (factor - 1.0) * np.maximum(steps.ds_m, 0.0)
        return added

    first = found_in(judged(2, stretched))[0]
    assert first.channel == "along"
    assert np.sign(first.measured) == np.sign(factor - 1.0)
    assert sense in sentence(first)


def test_an_error_of_one_stretch_of_time_is_reported_as_one():
    def drifting(steps, _truth):
        t = np.arange(len(steps)) / RATE_HZ
        added = np.zeros((len(steps), 3))
        added[:, 2] = 0.05 * np.abs(steps.ds_m) * ((t > 130.0) & (t < 170.0))
        return added

    first = found_in(judged(3, drifting))[0]
    assert (first.kind, first.channel) == ("time", "yaw")
    start, end = first.span_s
    overlap = min(end, 170.0) - max(start, 130.0)
    assert overlap > 0.6 * (end - start)


def test_an_error_of_one_place_is_reported_as_one():
    # the path's densest metre or so, met several times
    truth = accumulate(np.zeros(3), wander(4, 600.0))[::25, :2]
    near = np.sum(np.linalg.norm(truth[:, None] - truth[None], axis=2) < 1.5, axis=1)
    centre = truth[np.argmax(near)]

    def slippery(steps, pose):
        inside = np.linalg.norm(pose[:, :2] - centre, axis=1) < 1.5
        added = np.zeros((len(steps), 3))
        added[:, 0] = 0.15 * np.abs(steps.ds_m) * inside
        return added

    places = [f for f in found_in(judged(4, slippery, 600.0)) if f.kind == "place"]
    assert places
    x, y, radius = places[0].place
    assert np.hypot(x - centre[0], y - centre[1]) < radius + 1.5
    assert places[0].channel == "along"


def test_a_sudden_slip_is_reported_with_its_moment():
    at = 100.0

    def jolt(steps, _truth):
        added = np.zeros((len(steps), 3))
        added[int(at * RATE_HZ), 0] = -0.2
        return added

    piece = judged(5, jolt)
    worst = sudden_failures(piece.problem, piece.covariance, piece.innovations)[0]
    assert worst.span_s[0] <= at <= worst.span_s[1] + 1.0 / RATE_HZ
    assert worst.channel == "along"
    assert worst.measured == pytest.approx(-0.2, abs=0.03)
    assert "too far behind" in sentence(worst)


def test_one_cause_is_not_reported_twice():
    def curved(steps, _truth):
        added = np.zeros((len(steps), 3))
        added[:, 2] = 0.03 * steps.ds_m * (steps.ds_m > 0.0)
        return added

    yaw = [f for f in found_in(judged(6, curved)) if f.channel == "yaw"]
    assert 1 <= len(yaw) <= 3


def test_a_drift_is_reported_with_what_was_measured_and_what_is_expected():
    def curved(steps, _truth):
        added = np.zeros((len(steps), 3))
        added[:, 2] = 0.03 * steps.ds_m
        return added

    horizons = horizons_of([judged(7, curved)], HORIZONS_M)
    yaw = next(f for f in drift_failures(horizons) if f.channel == "yaw")
    h = next(h for h in horizons if f"over {h.distance_m:g} m" in yaw.where)
    assert (yaw.measured, yaw.expected) == (h.measured[2], h.expected[2])
    assert "larger than" in sentence(yaw)


@pytest.mark.parametrize(
    ("channel", "value", "text"),
    [
        ("yaw", np.radians(3.14159), "3.1 deg"),
        ("yaw", np.radians(0.052), "0.052 deg"),
        ("along", 0.0123, "12 mm"),
        ("across", 2.444, "2.44 m"),
        ("along", 0.9999, "1000 mm"),
        ("yaw", np.radians(36.2), "36 deg"),
    ],
)
def test_sizes_are_written_as_people_write_them(channel, value, text):
    assert size(channel, value) == text
