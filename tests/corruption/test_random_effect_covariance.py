"""Random effects in the covariance: what they draw is as wide as is stated, at every place and for any cut."""

import numpy as np
import pytest
from bagged import IMU, ODOM, TF, MemoryBag, blocks_of, read, robot
from drives import error_in_any_cut, model, office, silent

from odomcorrupt.corruption.covariance import SUMS, has_random_part, pose_covariance
from odomcorrupt.corruption.path import NoisyPath
from odomcorrupt.corruption.transform import Options, Transform
from odomcorrupt.effects import effect_from_values, registry
from odomcorrupt.model.noise_laws import Coefficients

WEAK = Coefficients(0.02, 0.01, 0.02, 0.01)
TRACK_M = 0.5
RANDOM = {
    "gain": ("gauss_markov", {"sigma": 0.04, "tau": 3.0}),
    "difference of the wheels": ("gauss_markov", {"sigma": 0.01, "tau": 3.0, "channel": "wheels"}),
    "turning gain": ("gauss_markov", {"sigma": 0.03, "tau": 3.0, "channel": "yaw"}),
    "walk": ("gyro_bias_walk", {"density": 3e-4}),
    "bias that comes back": ("gyro_bias_walk", {"density": 2e-3, "tau": 4.0}),
    "bursts of both wheels": ("slip_burst", {"rate": 0.3, "slip": 0.2, "duration": 0.3}),
    "bursts of a wheel": ("slip_burst", {"rate": 0.1, "slip": 0.1, "duration": 0.3}),
    "losses": ("lost_increments", {"fraction": 0.02}),
    "dead band": ("gyro_dead_band", {"threshold": 0.2, "noise": 0.1}),
}
BOUNDED = {"quantization", "heavy_tails"}
"""The error of the one never grows; the other draws within the law's own variance."""


def chosen(which, coefficients=WEAK):
    name, values = RANDOM[which]
    track = TRACK_M if which == "bursts of a wheel" else None
    return model(coefficients=coefficients, effects=[effect_from_values(name, values)], track_m=track)


@pytest.mark.slow
@pytest.mark.parametrize("which", RANDOM)
def test_covariance_is_calibrated_about_the_mean_of_the_runs(which):
    t, poses = office(10.0, 40.0)
    places, runs = np.array([60, 130, 200, 400]), 400
    errors, P = np.empty((runs, len(places), 3)), np.empty((runs, len(places), 3, 3))
    for number in range(runs):
        samples = NoisyPath(chosen(which), 11, number).feed(t, poses)
        errors[number] = samples.error_xyt[places]
        noisy = (poses[places, :2] + errors[number, :, :2] - samples.origin_xy).T
        P[number] = pose_covariance(samples.sums[:, places], noisy)
        without = pose_covariance(samples.sums[:SUMS, places], noisy)
        assert np.linalg.det(P[number, -1]) > 1.3 * np.linalg.det(without[-1]), "the effect is no small part of it"
    off = errors - errors.mean(axis=0)
    nees = np.einsum("rpi,rpi->rp", off, np.linalg.solve(P, off[..., None])[..., 0]).mean(axis=0) / 3.0
    assert nees == pytest.approx(np.ones(len(places)), abs=0.15)


@pytest.mark.parametrize("which", RANDOM)
def test_any_cut_into_batches_gives_the_same_bits(which):
    error_in_any_cut(chosen(which), *office(10.0, 20.0))


def test_a_new_stretch_begins_with_no_uncertainty_but_a_bias_that_has_wandered():
    t, poses = office(10.0, 20.0)
    path = NoisyPath(chosen("walk"), 5)
    first = path.feed(t, poses).sums
    path.restart()
    second = path.feed(t, poses).sums
    assert not second[:, 0].any()
    assert second[SUMS + 9, -1] > 1.5 * first[SUMS + 9, -1] > 0.0, "the turn's own variance: row 3 of 5, column 3"


def test_every_random_effect_states_its_gains_or_is_bounded():
    random = {name for name, kind in registry().items() if kind.kind == "noise" and name != "user"}
    stating = {
        effect.name
        for name, values in RANDOM.values()
        if has_random_part(effect := effect_from_values(name, values), None)
    }
    assert random == stating | BOUNDED


def test_an_effect_alone_that_draws_is_in_the_messages_covariances():
    t, poses = office(10.0, 20.0)
    only = silent([effect_from_values("gyro_bias_walk", {"density": 1e-3})])

    def covariances(**options):
        bag = MemoryBag(blocks_of(robot(t, poses), 40), {c.id: c for c in (ODOM, TF, IMU)}, True)
        out = list(Transform(only, 3, 0, Options(**options)).blocks(bag, "test.mcap"))
        return read(out, ODOM, "pose_covariance")[1]

    yaw = covariances().reshape(-1, 6, 6)[:, 5, 5]
    assert yaw == pytest.approx(NoisyPath(only, 3).feed(t, poses).sums[SUMS + 9] + 1e-9, rel=1e-9)
    assert yaw[-1] == pytest.approx(1e-6 * 20.0**3 / 3.0, rel=0.05), "a walk's integral: density^2 t^3 / 3"
    before = read(blocks_of(robot(t, poses)), ODOM, "pose_covariance")[1]
    assert np.array_equal(covariances(keep_covariance=True), before)
