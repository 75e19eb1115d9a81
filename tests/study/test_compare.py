"""A comparison accepts a right model, says where a wrong one fails, and measures paths as evo does."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import chi2, norm
from wandering import PLANTED, RATE_HZ, drive, noisy_path, positions_only, recording, slewed, wander

from evo_oracle import as_evo, evo_metrics
from odomcorrupt.effects import effect_from_values
from odomcorrupt.geometry.se2 import Increments, accumulate, compose
from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.model.motion_model import MotionModel, Noise, Setup, TruthNoise
from odomcorrupt.model.noise_laws import Coefficients
from odomcorrupt.report.comparison import comparison_text, falls_sentence, measures_words, sentence, size
from odomcorrupt.study.estimate.config import Approach
from odomcorrupt.study.estimate.windows import WindowErrors, drift_of, time_windows
from odomcorrupt.study.io.headings import with_headings
from odomcorrupt.study.io.recording import content_of
from odomcorrupt.study.validate.calibration import HORIZONS_M, ParameterUncertainty, horizon_of
from odomcorrupt.study.validate.compare import agreement_of, compare
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
from odomcorrupt.study.validate.predictive_check import replay
from odomcorrupt.study.validate.trajectory_error import (
    absolute_errors,
    aligned_at_origin,
    aligned_rigidly,
    relative_errors,
    trajectory_error,
)

RIGHT = MotionModel(Noise("diffusion", PLANTED), setup=Setup(truth=TruthNoise(0.003, 0.003, 0.0)))
SURE = ParameterUncertainty(np.zeros(0), np.zeros((0, 0)), np.zeros(3))


def judged(seed, seconds, model=RIGHT):
    return evaluate_stretch(drive(seed, seconds, PLANTED), model, Approach("truth"))


def outside(horizon):
    low, high = horizon.nees_bounds
    return not low <= horizon.nees <= high


def gaussian_windows(seed, count, scale=1.0):
    rng = np.random.default_rng((4, seed))
    roots = np.tril(rng.uniform(-1.0, 1.0, (count, 3, 3))) + 1.5 * np.eye(3)
    error = np.einsum("nij,nj->ni", roots, rng.standard_normal((count, 3)))
    return WindowErrors(scale * error, roots @ np.swapaxes(roots, 1, 2))


@pytest.mark.slow
def test_at_every_length_of_path_and_in_every_check_a_right_model_keeps_its_level():
    looks, inside, rejected, failing = {}, [], [], []
    for seed in range(120):
        piece = judged(seed, 150.0)
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
        failing.append(bool(found) or bool(drift_failures(horizons)))
    for look, results in looks.items():
        assert 0.01 <= np.mean(results) <= 0.1, f"{look}: {np.mean(results)}"
    np.testing.assert_allclose(np.mean(inside, axis=0), 0.9, atol=0.025)
    assert np.mean(rejected) <= 0.1
    assert np.mean(failing) <= 0.08


def test_chance_alone_leaves_the_bounds_in_one_of_twenty_and_a_wrong_scale_in_most():
    chance = [outside(horizon_of(1.0, [(gaussian_windows(seed, 40), SURE)])) for seed in range(400)]
    assert 0.025 <= np.mean(chance) <= 0.08
    wrong = [outside(horizon_of(1.0, [(gaussian_windows(seed, 40, 1.5), SURE)])) for seed in range(40)]
    assert np.mean(wrong) > 0.95


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


def test_a_model_fails_where_sizes_are_wrong_by_a_factor_that_matters():
    looks = (Check("memory", 1e-9),)
    assert all(Verdict(0.05, looks, misfit).fails for misfit in (0.5, 1.3))
    assert not any(Verdict(0.05, looks, misfit).fails for misfit in (0.9, 1.0, 1.2))
    assert not Verdict(0.05, (Check("memory", 0.5),), 2.0).fails


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


WEAK = Coefficients(0.02, 0.01, 0.02, 0.005)
WEAK_MODEL = MotionModel(Noise("diffusion", WEAK), setup=Setup(truth=TruthNoise(0.003, 0.003, 0.0)))


def judged_with(seed, seconds=300.0, *, along=None, yaw=None):
    """Judge a drive whose odometry has `along` (n,) m and `yaw` (n,) rad, of its steps and true poses, too much."""
    steps = wander(seed, seconds)
    truth = accumulate(np.zeros(3), steps)[:-1]
    more = [extra(steps, truth) if extra else 0.0 for extra in (along, yaw)]
    wrong = Increments(steps.ds_m + more[0], steps.dl_m, steps.dtheta_rad + more[1])
    return evaluate_stretch(recording(steps, noisy_path(wrong, WEAK, seed), seed=seed), WEAK_MODEL, Approach("truth"))


def found_in(piece):
    return failures(piece.problem, piece.whitener, piece.innovations)


def test_an_error_of_left_turns_is_reported_as_one_with_size_and_sense():
    rate = 0.04

    def too_far_left(steps, _truth):
        left = (steps.dtheta_rad > 0.1 * np.abs(steps.ds_m)) & (np.abs(steps.ds_m) > 0.02 / RATE_HZ)
        return rate * np.abs(steps.ds_m) * left

    first = found_in(judged_with(1, yaw=too_far_left))[0]
    assert (first.kind, first.channel, first.where) == ("motion", "yaw", "in left turns")
    assert first.measured == pytest.approx(rate, abs=1.5 * first.expected)
    assert sentence(first).startswith("yaw error grows +")
    assert "the odometry turns too far left" in sentence(first)


@pytest.mark.parametrize(("factor", "sense"), [(1.02, "too far ahead"), (0.98, "too far behind")])
def test_the_sign_is_odometry_minus_truth(factor, sense):
    first = found_in(judged_with(2, along=lambda steps, _: (factor - 1.0) * np.maximum(steps.ds_m, 0.0)))[0]
    assert first.channel == "along"
    assert np.sign(first.measured) == np.sign(factor - 1.0)
    assert sense in sentence(first)


def test_an_error_of_one_stretch_of_time_is_reported_as_one():
    def drifting(steps, _truth):
        t = np.arange(len(steps)) / RATE_HZ
        return 0.05 * np.abs(steps.ds_m) * ((t > 130.0) & (t < 170.0))

    first = found_in(judged_with(3, yaw=drifting))[0]
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
        return 0.15 * np.abs(steps.ds_m) * (np.linalg.norm(pose[:, :2] - centre, axis=1) < 1.5)

    places = [f for f in found_in(judged_with(4, 600.0, along=slippery)) if f.kind == "place"]
    assert places
    x, y, radius = places[0].place
    assert np.hypot(x - centre[0], y - centre[1]) < radius + 1.5
    assert places[0].channel == "along"


def test_a_sudden_slip_is_reported_with_its_moment():
    at = 100.0

    piece = judged_with(5, along=lambda steps, _: np.where(np.arange(len(steps)) == int(at * RATE_HZ), -0.2, 0.0))
    worst = sudden_failures(piece.problem, piece.covariance, piece.innovations)[0]
    assert worst.span_s[0] <= at <= worst.span_s[1] + 1.0 / RATE_HZ
    assert worst.channel == "along"
    assert worst.measured == pytest.approx(-0.2, abs=0.03)
    assert "too far behind" in sentence(worst)


def test_one_cause_is_not_reported_twice():
    bent = judged_with(6, yaw=lambda steps, _: 0.03 * steps.ds_m * (steps.ds_m > 0.0))
    assert 1 <= len([f for f in found_in(bent) if f.channel == "yaw"]) <= 3


def test_a_drift_is_reported_with_what_was_measured_and_what_is_expected():
    horizons = horizons_of([judged_with(7, yaw=lambda steps, _: 0.03 * steps.ds_m)], HORIZONS_M)
    yaw = next(f for f in drift_failures(horizons) if f.channel == "yaw")
    h = next(h for h in horizons if f"over {h.distance_m:g} m" in yaw.where)
    assert (yaw.measured, yaw.expected) == (h.measured[2], h.expected[2])
    assert "larger than" in sentence(yaw)
    exact = replace(h, measured=np.zeros(3), excess_p=np.zeros(3))  # of a simulation without errors
    assert [one.measured for one in drift_failures([exact])] == [0.0, 0.0, 0.0]


@pytest.mark.parametrize(
    ("channel", "value", "text"),
    [
        ("yaw", np.radians(3.14159), "3.1 deg"), ("yaw", np.radians(0.052), "0.052 deg"), ("along", 0.0123, "12 mm"),
        ("across", 2.444, "2.44 m"), ("along", 0.9999, "1000 mm"), ("yaw", np.radians(36.2), "36 deg"),
    ],
)  # fmt: skip
def test_sizes_are_written_as_people_write_them(channel, value, text):
    assert size(channel, value) == text


def replayed(seed, model=RIGHT, runs=60):
    return replay(judged(seed, 30.0, model), runs=runs)


def inside(model, parts, drives):
    """Return the share of drives whose end is within each part of the runs of a model."""
    found = []
    for seed in range(drives):
        paths = replayed(seed, model)
        found.append([paths.inside(np.array([len(paths.distance_m) - 1]), part)[0] for part in parts])
    return list(np.mean(found, axis=0))


@pytest.mark.slow
def test_a_right_model_covers_the_end_of_the_drive_at_its_level():
    most, half = inside(RIGHT, [0.9, 0.5], 40)
    assert most == pytest.approx(0.9, abs=0.1)
    assert half == pytest.approx(0.5, abs=0.17)
    timid = replace(RIGHT, noise=Noise("diffusion", Coefficients(0.015, 0.006, 0.015, 0.003)))
    assert inside(timid, [0.9], 12)[0] < 0.5


def test_runs_start_at_the_truth_and_are_the_same_every_time():
    paths, again = replayed(1, runs=20), replayed(1, runs=20)
    np.testing.assert_array_equal(paths.runs_xyt, again.runs_xyt)
    assert np.abs(paths.runs_xyt[:, 0] - paths.truth_xyt[0]).max() < 5.0 * 0.003
    np.testing.assert_allclose(paths.measured_xyt[0, :2], paths.truth_xyt[0, :2], atol=1e-12)
    assert np.std(paths.runs_xyt[:, -1, 0]) > 0.02


def test_too_few_runs_are_refused():
    with pytest.raises(ValueError, match="20 or more"):
        replayed(1, runs=3)


@pytest.fixture(scope="module")
def one_drive():
    return drive(3, 150.0, PLANTED)


def test_a_model_without_effects_has_the_path_errors_of_the_odometry_though_it_is_judged_in_halves(one_drive):
    fitted_here = replace(RIGHT, source={"fitted": [content_of(one_drive)]})
    found = compare([one_drive], {"own": fitted_here})
    assert found.evaluations[0].trajectory == found.clock_trajectory
    assert found.evaluations[0].ten_second_error_m == found.clock_error_m
    whole = compare([one_drive], {"other's": RIGHT})
    assert "paths, in halves" in comparison_text(found)
    assert "whole paths" in comparison_text(whole)
    # a path twice as long drifts farther: the two are not to be compared
    assert whole.clock_trajectory.ate_origin_m != found.clock_trajectory.ate_origin_m


def test_notes_name_the_random_effects_that_are_not_counted_and_no_others(one_drive):
    wandering = effect_from_values("gauss_markov", {"sigma": 0.01, "tau": 5.0})
    tails = effect_from_values("heavy_tails", {})
    counted = compare([one_drive], {"m": replace(RIGHT, effects=(wandering,))}).evaluations[0]
    assert not any("do not include" in note for note in counted.notes)
    left_out = compare([one_drive], {"m": replace(RIGHT, effects=(wandering, tails))}).evaluations[0]
    note = next(note for note in left_out.notes if "do not include" in note)
    assert "heavy_tails" in note
    assert "gauss_markov" not in note


@pytest.fixture(scope="module", params=[1, 2])
def pair(request):
    steps = wander(request.param, 120.0)
    truth = accumulate(np.array([3.0, -2.0, 2.5]), steps)
    noisy = compose(np.array([-7.0, 4.0, -1.2]), noisy_path(steps, Coefficients(0.1, 0.05, 0.1, 0.02), request.param))
    return truth[::10], noisy[::10]


@pytest.mark.parametrize("rigidly", [True, False])
def test_ate_is_evos(pair, rigidly):
    metrics = evo_metrics()
    truth, odometry = pair
    reference, estimate = as_evo(truth), as_evo(odometry)
    if rigidly:
        estimate.align(reference, correct_scale=False)
    else:
        estimate.align_origin(reference)
    ate = metrics.APE(metrics.PoseRelation.translation_part)
    ate.process_data((reference, estimate))
    own = absolute_errors(truth, (aligned_rigidly if rigidly else aligned_at_origin)(truth, odometry))
    np.testing.assert_allclose(own, ate.error, atol=1e-6)


@pytest.mark.parametrize("delta_m", [0.5, 1.0, 5.0])
def test_rpe_is_evos(pair, delta_m):
    metrics = evo_metrics()
    from evo.core.units import Unit

    truth, odometry = pair
    both = as_evo(truth), as_evo(odometry)
    own = relative_errors(truth, odometry, delta_m)
    for relation, errors in (
        (metrics.PoseRelation.translation_part, own.translation_m),
        (metrics.PoseRelation.rotation_angle_rad, own.rotation_rad),
    ):
        rpe = metrics.RPE(relation, delta=delta_m, delta_unit=Unit.meters)
        rpe.process_data(both)
        assert len(errors) > 5
        np.testing.assert_allclose(errors, rpe.error, atol=1e-6)


def test_a_recording_is_compared_at_the_truths_stamps():
    run = drive(5, 60.0, PLANTED, truth_mm=0.0, truth_rad=0.0)
    errors = trajectory_error([run])
    truth, odometry = run.truth.xyt, run.odometry.xyt
    assert errors.ate_origin_m == pytest.approx(
        np.sqrt(np.mean(absolute_errors(truth, aligned_at_origin(truth, odometry)) ** 2)), rel=1e-9
    )
    assert errors.ate_m < errors.ate_origin_m


def of_positions(seed, truth_mm, k):
    run = with_headings(positions_only(drive(seed, 150.0, k, truth_mm=truth_mm), every=10))
    model = MotionModel(Noise("diffusion", k), setup=Setup(truth=TruthNoise(truth_mm * 1e-3, 0.5, 0.0)))
    return evaluate_stretch(run, model, Approach("truth"))


@pytest.mark.parametrize(
    ("truth_mm", "k"),
    [(100.0, Coefficients(0.01, 0.004, 0.01, 0.002)), (12.0, Coefficients(0.02, 0.02, 0.01, 0.002))],
    ids=["radio", "satellites"],
)
def test_errors_are_as_large_as_a_right_model_predicts(truth_mm, k):
    for h in horizons_of([of_positions(seed, truth_mm, k) for seed in range(3)], (1.0, 2.0, 5.0, 10.0, 20.0)):
        low, high = np.sqrt(chi2.ppf([0.001, 0.999], h.windows) / h.windows)
        for channel in (0, 1):
            assert low < h.measured[channel] / h.expected[channel] < high, f"{h.distance_m} m, channel {channel}"
        assert h.nees_p > 0.002, f"{h.distance_m} m"


QUIET = Coefficients(0.003, 0.001, 0.002, 0.0)
STATED = TruthNoise(0.003, 0.003, 0.0)
STATED_MODEL = MotionModel(Noise("diffusion", QUIET), setup=Setup(truth=STATED))


def slipping(slips, *, throughout=False, truth_mm=3.0, truth_rad=0.003):
    """Return two minutes in which some seconds turn the odometry by 12 degrees too much, or every step by chance."""

    def turned(steps):
        noise = np.random.default_rng(1).normal(0.0, np.radians(0.5), len(steps)) if throughout else 0.0
        return slewed(slips, 12.0)(replace(steps, dtheta_rad=steps.dtheta_rad + noise))

    return drive(5, 120.0, QUIET, said=turned, truth_mm=truth_mm, truth_rad=truth_rad)


def judged_of(run, model=STATED_MODEL):
    return evaluate_stretch(run, model, Approach())


def test_slips_are_not_taken_for_noise_of_the_truth():
    piece = judged_of(slipping((20, 35, 50, 70, 90)))
    assert piece.truth == STATED
    # and so they stand out
    assert np.sum(piece.innovations.reshape(-1, 3) ** 2, axis=1).max() > 1000.0


def test_a_robot_that_is_noisier_throughout_is_not_excused_by_a_truth_whose_samples_are_good():
    piece = judged_of(slipping((), throughout=True))
    assert piece.truth.yaw_rad < 0.02
    assert np.mean(piece.innovations**2) > 2.0


def test_a_truth_that_is_noisier_is_judged_as_such():
    piece = judged_of(slipping((), truth_mm=20.0, truth_rad=0.02))
    assert piece.truth.xy_m == pytest.approx(0.02, rel=0.15)
    assert piece.truth.yaw_rad == pytest.approx(0.02, rel=0.15)
    assert np.mean(piece.innovations**2) == pytest.approx(1.0, abs=0.2)


def test_a_model_that_states_none_estimates_it_without_the_slips():
    piece = judged_of(slipping((20, 35, 50, 70, 90)), MotionModel(Noise("diffusion", QUIET)))
    assert piece.truth.xy_m == pytest.approx(0.003, rel=0.3)
    assert piece.truth.yaw_rad == pytest.approx(0.003, rel=0.5)


def scored(name, error, nats, ate, gain=0.0, gain_error=0.1):
    measured = {"nats": SimpleNamespace(per_m=nats, gain_per_m=gain, gain_error=gain_error)}
    measured["trajectory"] = SimpleNamespace(ate_m=ate)
    return SimpleNamespace(name=name, judged_on="recordings", ten_second_error_m=error, **measured)


def compared(error, gain, ate):
    first = scored("base", 0.100, 5.0, 0.010)
    evaluations = (first, scored("robot", error, 5.0 + gain, ate, gain))
    return SimpleNamespace(evaluations=evaluations, judged_on="recordings")


@pytest.mark.parametrize(
    ("error", "gain", "ate", "verdict"),
    [
        (0.060, 2.0, 0.006, "better"), (0.060, 2.0, 0.0105, "better"), (0.095, -24.0, 0.014, "mixed"),
        (0.095, 1.0, 0.014, "mixed"), (0.120, -1.0, 0.010, "worse"), (0.101, 0.1, 0.0105, "same"),
    ],
)  # fmt: skip
def test_all_measures_count(error, gain, ate, verdict):
    assert agreement_of(compared(error, gain, ate)).verdict == verdict


def test_the_error_does_not_fall_where_measures_disagree():
    said = falls_sentence(compared(0.095, -24.0, 0.014))
    assert "the error falls" not in said
    assert "log likelihood -24 nats/m" in said
    assert said.endswith("they disagree")
    assert falls_sentence(compared(0.060, 2.0, 0.006)) == "the error falls to 60 % from base to robot"


@pytest.mark.parametrize(("gain", "said"), [(0.19, False), (0.21, True), (-0.19, False), (-0.21, True)])
def test_a_change_of_the_likelihood_is_printed_if_it_exceeds_two_standard_errors(gain, said):
    words = measures_words(compared(0.060, gain, 0.006))
    assert words.startswith("10 s error 100 mm -> 60 mm")
    assert ("log likelihood" in words) == said
    assert "ATE 10 mm -> 6.0 mm" in words
    assert measures_words(compared(float("nan"), 0.19, float("nan"))) == "log likelihood: no change"


def test_what_is_not_known_does_not_count():
    comparison = compared(float("nan"), 2.0, float("nan"))
    assert agreement_of(comparison).verdict == "better"
    assert measures_words(comparison) == "log likelihood +2 nats/m"


def run_with_gaps(seconds, *unknown):
    """Return a drive whose truth has no samples in the given stretches, seconds since its first one."""
    run = drive(1, seconds, Coefficients(0.0, 0.0, 0.0, 0.0))
    at_s = (run.truth.stamps_ns - run.truth.stamps_ns[0]) * 1e-9
    kept = ~np.any([(at_s > a) & (at_s < b) for a, b in unknown], axis=0)
    return replace(run, truth=Trajectory(run.truth.stamps_ns[kept], run.truth.xyt[kept]))


def test_windows_restart_after_a_stretch_without_truth():
    windows = time_windows(run_with_gaps(40.0, (8.5, 12.5), (18.5, 24.0), (29.0, 31.5)))
    assert len(windows) == 3
    np.testing.assert_allclose(windows.end_s - windows.start_s, 10.0, atol=1.0)
    assert np.all(windows.start_s[1:] >= windows.end_s[:-1])


def test_a_complete_truth_has_a_window_for_every_ten_seconds():
    assert [len(squared) for squared in drift_of([run_with_gaps(60.5, (70.0, 80.0))]).squared] == [6, 5, 5, 5, 5]
