"""`compare` accepts a correct model: NEES, coverage, PIT, whiteness and verdict keep their levels."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm
from wandering import RATE_HZ, noisy_path, recording, wander

from odomcorrupt.effects import effect_from_values
from odomcorrupt.model.motion_model import MotionModel, Noise, Setup, TruthNoise
from odomcorrupt.model.noise_laws import Coefficients
from odomcorrupt.study.estimate.config import Approach
from odomcorrupt.study.estimate.windows import WindowErrors
from odomcorrupt.study.validate.calibration import ParameterUncertainty, horizon_of
from odomcorrupt.study.validate.evaluation import evaluate_stretch, horizons_of, log_score_of
from odomcorrupt.study.validate.goodness_of_fit import (
    Check,
    Verdict,
    ljung_box,
    pit_of,
    pits_of,
    verdict_of,
    whiteness_of,
)
from odomcorrupt.study.validate.lack_of_fit import drift_failures, failures, sudden_failures

PLANTED = Coefficients(0.05, 0.02, 0.05, 0.01)
RIGHT = MotionModel(Noise("diffusion", PLANTED), setup=Setup(truth=TruthNoise(0.003, 0.003, 0.0)))
SURE = ParameterUncertainty(np.zeros(0), np.zeros((0, 0)), np.zeros(3))


def judged(seed: int, seconds: float, model: MotionModel = RIGHT):
    steps = wander(seed, seconds)
    run = recording(steps, noisy_path(steps, PLANTED, seed), seed=seed)
    return evaluate_stretch(run, model, Approach("truth"))


def outside(horizon) -> bool:
    low, high = horizon.nees_bounds
    return not low <= horizon.nees <= high


def gaussian_windows(seed: int, count: int, scale: float = 1.0) -> WindowErrors:
    rng = np.random.default_rng((4, seed))
    roots = np.tril(rng.uniform(-1.0, 1.0, (count, 3, 3))) + 1.5 * np.eye(3)
    error = np.einsum("nij,nj->ni", roots, rng.standard_normal((count, 3)))
    return WindowErrors(scale * error, roots @ np.swapaxes(roots, 1, 2))


@pytest.mark.slow
def test_at_every_length_of_path_and_in_every_check_a_right_model_keeps_its_level():
    looks, inside, rejected, told = {}, [], [], []
    for seed in range(120):
        piece = judged(seed, 300.0)
        horizons = horizons_of([piece], (1.0, 2.0, 5.0, 10.0, 20.0))
        pits, whiteness = pits_of(piece.chains()), whiteness_of(piece.chains())
        for h in horizons:
            looks.setdefault(h.distance_m, []).append(outside(h))
        inside.append(horizons[0].coverage_90)
        for kind in (pits, whiteness):
            for name, result in kind.items():
                looks.setdefault((type(result).__name__, name), []).append(result.p < 0.05)
        rejected.append(verdict_of(horizons, pits, whiteness).rejected)
        found = failures(piece.problem, piece.whitener, piece.innovations)
        found += sudden_failures(piece.problem, piece.covariance, piece.innovations)
        told.append(bool(found) or bool(drift_failures(horizons)))
    for look, results in looks.items():
        assert 0.01 <= np.mean(results) <= 0.1, f"{look}: {np.mean(results)}"
    np.testing.assert_allclose(np.mean(inside, axis=0), 0.9, atol=0.025)
    assert np.mean(rejected) <= 0.1
    assert np.mean(told) <= 0.08


def test_chance_alone_leaves_the_bounds_in_one_of_twenty_and_a_wrong_scale_in_most():
    chance = [outside(horizon_of(1.0, [(gaussian_windows(seed, 40), SURE)])) for seed in range(400)]
    assert 0.025 <= np.mean(chance) <= 0.08
    wrong = [outside(horizon_of(1.0, [(gaussian_windows(seed, 40, 1.5), SURE)])) for seed in range(40)]
    assert np.mean(wrong) > 0.95


def test_bounds_widen_by_what_the_model_does_not_know_of_itself():
    errors = gaussian_windows(0, 400)
    sure = horizon_of(1.0, [(errors, SURE)])
    unsure = horizon_of(1.0, [(errors, replace(SURE, scale=np.array([0.2])))])
    assert np.ptp(unsure.nees_bounds) > 3.0 * np.ptp(sure.nees_bounds)
    shifted = horizon_of(1.0, [(errors, replace(SURE, gram=np.array([[0.3]])))])
    assert shifted.nees_bounds[1] > sure.nees_bounds[1] + 0.5
    assert shifted.nees_bounds[0] > 0.95 * sure.nees_bounds[0]


def test_doubt_is_what_one_standard_error_does_to_the_nees():
    off = 0.1
    known = judged(1, 120.0, replace(RIGHT, standard_errors={"trans_trans": off * PLANTED.trans_trans}))
    errors, doubt = known.windows(2.0)
    more = replace(PLANTED, trans_trans=PLANTED.trans_trans * (1.0 + off))
    larger, _ = judged(1, 120.0, replace(RIGHT, noise=Noise("diffusion", more))).windows(2.0)
    grown = np.trace(np.linalg.solve(errors.covariance, larger.covariance), axis1=1, axis2=2).mean() / 3.0
    assert 1.0 + doubt.scale[0] == pytest.approx(grown, rel=0.02)
    assert doubt.scale[0] > 0.05


def test_doubt_of_an_effect_is_what_its_standard_error_does_to_the_windows():
    off = 0.005
    track = effect_from_values("wheelbase", {"e": 0.0})
    piece = judged(2, 120.0, replace(RIGHT, effects=(track,), standard_errors={"wheelbase.e": off}))
    errors, doubt = piece.windows(5.0)
    other, _ = judged(2, 120.0, replace(RIGHT, effects=(replace(track, e=off),))).windows(5.0)
    shift = other.error - errors.error
    expected = np.mean([s @ np.linalg.solve(c, s) for s, c in zip(shift, errors.covariance, strict=True)]) / 3.0
    assert doubt.gram[0, 0] == pytest.approx(expected, rel=0.1)


def test_crps_is_the_integral_of_squared_differences_of_distributions():
    errors = gaussian_windows(5, 3)
    direct = np.zeros(3)
    for e, s in zip(errors.error, errors.deviation, strict=True):
        for c in range(3):
            x = np.linspace(-30.0, 30.0, 200_001)
            direct[c] += np.trapezoid((norm.cdf(x / s[c]) - (x >= e[c])) ** 2, x) / 3.0
    np.testing.assert_allclose(errors.crps, direct, rtol=1e-3)


def test_pit_keeps_its_level_and_sees_wrong_widths_and_means():
    rng = np.random.default_rng(11)
    right = [pit_of(rng.standard_normal(300)) for _ in range(300)]
    assert 0.02 <= np.mean([p.p < 0.05 for p in right]) <= 0.08
    assert 0.02 <= np.mean([not p.inside for p in right]) <= 0.08
    assert pit_of(0.7 * rng.standard_normal(300)).p < 0.01
    assert not pit_of(0.5 + rng.standard_normal(300)).inside


def test_ljung_box_is_the_textbook_sum_and_knows_no_pairs_across_breaks():
    rng = np.random.default_rng(12)
    x = rng.standard_normal(200)
    c = x - x.mean()
    rho = [np.sum(c[k:] * c[:-k]) / np.sum(c**2) for k in range(1, 6)]
    expected = 200 * 202 * sum(r**2 / (200 - k) for k, r in enumerate(rho, start=1))
    assert ljung_box([x], 5).statistic == pytest.approx(expected)
    # alternating runs: a strong memory within chains, none if their ends were glued
    chains = [np.array([1.0, 1.0]), np.array([-1.0, -1.0])] * 60
    assert ljung_box(chains, 1).correlation[0] == pytest.approx(0.5)
    walk = np.cumsum(rng.standard_normal(300))
    assert ljung_box([walk]).p < 1e-6


def test_a_verdict_is_one_level_for_all_checks_together():
    looks = tuple(Check(f"look {i}", p) for i, p in enumerate((0.006, 0.2, 0.3, 0.9, 0.01)))
    verdict = Verdict(0.05, looks)
    assert verdict.threshold == pytest.approx(0.01)
    assert [look.question for look in verdict.against] == ["look 0"]
    assert not Verdict(0.05, looks[1:4]).rejected


def test_a_model_fails_where_sizes_are_wrong_by_a_factor_that_matters():
    looks = (Check("memory", 1e-9),)
    assert all(Verdict(0.05, looks, misfit).fails for misfit in (0.5, 1.3))
    assert not any(Verdict(0.05, looks, misfit).fails for misfit in (0.9, 1.0, 1.2))
    assert not Verdict(0.05, (Check("memory", 0.5),), 2.0).fails


def test_one_of_several_lengths_that_deviates_by_chance_gives_no_reason_to_reject():
    """Errors over 1 m are significantly but irrelevantly larger; those of three windows deviate at a level of 3 %."""
    many = horizon_of(1.0, [(gaussian_windows(0, 2000, 1.1), SURE)])
    few = replace(horizon_of(100.0, [(gaussian_windows(0, 3), SURE)]), nees=2.2, nees_bounds=(0.3, 2.1), nees_p=0.03)
    verdict = verdict_of([many, few], {}, {})
    assert verdict.rejected
    assert verdict.misfit == pytest.approx(1.1, rel=0.03)
    assert not verdict.fails
    assert verdict_of([many, replace(few, nees_p=0.01)], {}, {}).fails


@pytest.mark.parametrize("scale", [0.5, 1.0, 2.0])
def test_the_misfit_is_by_how_much_errors_differ_from_the_predicted_ones(scale):
    horizon = horizon_of(2.0, [(gaussian_windows(1, 400, scale), SURE)])
    assert verdict_of([horizon], {}, {}).misfit == pytest.approx(scale, rel=0.1)
    # hundredths of a millimetre per metre matter to nobody
    same = replace(horizon, position_measured=1e-5, position_expected=2e-5)
    assert verdict_of([same], {}, {}).misfit == 1.0


def test_the_right_model_gains_nats_over_a_wrong_one_by_more_than_the_paired_error():
    right = judged(3, 300.0)
    wrong = judged(3, 300.0, replace(RIGHT, noise=Noise("diffusion", Coefficients(0.1, 0.02, 0.05, 0.01))))
    paired = log_score_of([right], [wrong])
    assert paired.gain_per_m > 3.0 * paired.gain_error
    assert paired.gain_error < 0.5 * paired.error, "pairing takes out what the drive itself varies by"
    assert paired.per_m * right.interval_metres.sum() == pytest.approx(
        right.whitener.log_likelihood(right.innovations), rel=1e-12
    )
    assert log_score_of([right], [right]).gain_error == 0.0


def wandering_gain(seed: int):
    """Return a drive whose turns are reported with a gain that wanders: 8 %, remembered for 5 s."""
    steps = wander(seed, 240.0)
    rng = np.random.default_rng((6, seed))
    keep = np.exp(-1.0 / (RATE_HZ * 5.0))
    gain = np.zeros(len(steps))
    gain[0] = 0.08 * rng.standard_normal()
    for i in range(1, len(steps)):
        gain[i] = keep * gain[i - 1] + 0.08 * np.sqrt(1.0 - keep**2) * rng.standard_normal()
    turned = replace(steps, dtheta_rad=steps.dtheta_rad * (1.0 + gain))
    return recording(steps, noisy_path(turned, PLANTED, seed), seed=seed)


@pytest.mark.slow
def test_a_gain_that_wanders_belongs_to_what_the_model_expects():
    effect = effect_from_values("gauss_markov", {"sigma": 0.08, "tau": 5.0, "channel": "yaw"})
    nees, log_likelihood = {}, {}
    for name, model in {"without": RIGHT, "with": replace(RIGHT, effects=(effect,))}.items():
        pieces = [evaluate_stretch(wandering_gain(seed), model, Approach("truth")) for seed in range(12)]
        nees[name] = [h.nees for h in horizons_of(pieces, (2.0, 10.0))]
        log_likelihood[name] = sum(float(piece.interval_nats.sum()) for piece in pieces)
        whitened = sum(piece.whitener.log_likelihood(piece.innovations) for piece in pieces)
        assert log_likelihood[name] == pytest.approx(whitened, rel=1e-9)
    assert min(nees["without"]) > 1.2
    np.testing.assert_allclose(nees["with"], 1.0, atol=0.1)
    assert log_likelihood["with"] > log_likelihood["without"] + 50.0
