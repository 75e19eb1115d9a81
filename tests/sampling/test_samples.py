import math
from dataclasses import replace

import numpy as np
import pytest

from odomcorrupt.corruption.path import NoisyPath
from odomcorrupt.model.motion_model import MotionModel, Noise, Step
from odomcorrupt.model.noise_laws import LAWS, Coefficients, Variances, law_named
from odomcorrupt.rng import stream
from odomcorrupt.sampling.samples import (
    EXAMPLES,
    ellipse,
    linearised_moments,
    move_between,
    move_sampled,
    move_variances,
    sample_moments,
    with_noise,
)

ARTICLE = EXAMPLES["article"]


def article_move():
    return move_between(np.array(ARTICLE.start_xyt), np.array(ARTICLE.end_xyt))


def listing(noise):
    """The article's listing, written out with numbers of its own: errors of rot1, trans, rot2 in, a pose out."""
    theta1, theta2 = math.radians(30), math.radians(10)
    rot1 = math.atan2(0.35, 0.2) - theta1
    trans = math.hypot(0.2, 0.35)
    rot2 = theta2 - theta1 - rot1
    rot1, trans, rot2 = rot1 + noise[0], trans + noise[1], rot2 + noise[2]
    return trans * math.cos(theta1 + rot1), trans * math.sin(theta1 + rot1), theta1 + rot1 + rot2


def listing_deviations():
    rot1, trans, rot2 = math.radians(30.2551187), 0.4031128874, math.radians(-50.2551187)
    a1, a2, a3, a4 = 0.05, math.radians(15), 0.05, 0.01
    sd_trans = a3 * trans + a4 * (abs(rot1) + abs(rot2))
    return a1 * abs(rot1) + a2 * trans, sd_trans, a1 * abs(rot2) + a2 * trans


def test_article_example_is_turn_drive_turn_of_the_listing():
    rng = np.random.default_rng(0)
    noise = rng.normal(size=(20, 3))
    ours = with_noise(article_move(), np.insert(noise, 2, 0.0, axis=1))
    np.testing.assert_allclose(ours, [listing(row) for row in noise], atol=1e-12)


def test_article_law_has_the_deviations_of_the_article_and_its_listing_their_squares():
    intended = move_variances(ARTICLE.noise, article_move())
    imitated = move_variances(replace(ARTICLE.noise, law_name="article-code"), article_move())
    for name, deviation in zip(("rot1", "trans", "rot2"), listing_deviations(), strict=True):
        assert math.sqrt(getattr(intended, name)[0]) == pytest.approx(deviation, rel=1e-6)
        assert math.sqrt(getattr(imitated, name)[0]) == pytest.approx(deviation**2, rel=1e-6)


@pytest.mark.parametrize("law", sorted(LAWS))
def test_small_noise_has_the_linearised_moments(law):
    move = move_between(np.array([1.0, -2.0, 0.4]), np.array([2.1, -1.5, 1.0]))
    noise = Noise(law, Coefficients(1e-2, 1e-2, 1e-2, 1e-2))
    variances = move_variances(noise, move)
    variances = type(variances)(*(1e-4 * getattr(variances, n) for n in ("rot1", "trans", "across", "rot2")))
    drawn = sample_moments(move_sampled(move, variances, 40_000, np.random.default_rng(3)))
    expected = linearised_moments(move, variances)
    scale = np.sqrt(np.outer(np.diag(expected.covariance), np.diag(expected.covariance)))
    assert np.abs((drawn.covariance - expected.covariance) / scale).max() < 0.03
    assert np.abs((drawn.mean_xyt - expected.mean_xyt) / np.sqrt(np.diag(expected.covariance))).max() < 0.03


def test_straight_motion_is_drawn_as_corruption_draws_it():
    """Corruption goes along the body's axis, sampling along the bearing: on a straight drive they are the same."""
    noise = Noise("diffusion", Coefficients(0.3, 0.2, 0.1, 0.05))
    poses = np.array([[0.5, 0.2, 0.3], [0.5 + math.cos(0.3), 0.2 + math.sin(0.3), 0.3]])
    stamps = np.array([0, 10**9])
    for run in range(5):
        knots = NoisyPath(MotionModel(noise), 9, run).feed(stamps, poses)
        rng = stream(9, run, "noise")
        rng.standard_normal(4)  # the first pose draws too, and stays
        move = move_between(*poses)
        ours = move_sampled(move, move_variances(noise, move), 1, rng)
        np.testing.assert_allclose(ours[0], (poses + knots.error_xyt)[1], atol=1e-12)


def test_clean_motion_ends_where_odometry_says_even_below_the_bearing_threshold():
    move = move_between(np.array([0.0, 0.0, 3.0]), np.array([0.01, 0.02, -3.0]))
    silent = move_variances(Noise("diffusion", Coefficients(0, 0, 0, 0)), move)
    end = move_sampled(move, silent, 2, np.random.default_rng(0))
    np.testing.assert_allclose(end[:, :2], [[0.01, 0.02]] * 2, atol=1e-15)
    np.testing.assert_allclose(end[:, 2], 2 * math.pi - 3.0)


def test_step_of_a_book_law_is_honoured():
    """Ten steps of 0.1 m have a tenth of the variance of trans of one metre at once."""
    move = move_between(np.zeros(3), np.array([1.0, 0.0, 0.0]))
    coefficients = Coefficients(0, 0, 0.01, 0)
    once = move_variances(Noise("quadratic", coefficients), move)
    stepped = move_variances(Noise("quadratic", coefficients, Step(0.1, 1.0)), move)
    assert stepped.trans[0] == pytest.approx(once.trans[0] / 10, rel=1e-6)


def test_ellipse_holds_the_share_of_a_gaussian():
    rng = np.random.default_rng(1)
    covariance = np.array([[0.04, 0.03, 0], [0.03, 0.09, 0], [0, 0, 1]])
    points = rng.multivariate_normal([1, 2, 0], covariance, 50_000)
    e = ellipse(sample_moments(points), 2.0)
    turned = (points[:, :2] - e.centre_xy) @ np.array(
        [[math.cos(e.angle_rad), -math.sin(e.angle_rad)], [math.sin(e.angle_rad), math.cos(e.angle_rad)]]
    )
    inside = (turned[:, 0] / e.major_m) ** 2 + (turned[:, 1] / e.minor_m) ** 2 < 1
    assert inside.mean() == pytest.approx(1 - math.exp(-2), abs=0.006)
    assert e.major_m > e.minor_m


def test_lecture_settings_are_what_they_are_called():
    spreads = {}
    for name in ("balanced", "translation-heavy", "rotation-heavy"):
        example = EXAMPLES[name]
        move = move_between(np.array(example.start_xyt), np.array(example.end_xyt))
        v = move_variances(example.noise, move)
        spreads[name] = math.sqrt(v.trans[0]) / (math.sqrt(v.rot1[0]) * move.parts.trans_m[0])
        assert example.count == 500
    assert spreads["translation-heavy"] > 3 > spreads["balanced"] > 1 / 3 > spreads["rotation-heavy"]


def test_velocity_law_drives_the_exact_arc_of_the_book():
    """Against table 5.3 of Probabilistic Robotics, written out: a quarter of a metre turned by 60 degrees."""
    turn, radius = np.radians(60.0), 1.0
    end = np.array([radius * np.sin(turn), radius * (1.0 - np.cos(turn)), turn])
    noise = Noise("velocity", law_named("velocity").coefficients((0.05, 0.02, 0.03, 0.04, 0.01, 0.01)))
    move = move_between(np.zeros(3), end, arc=True)
    variances = move_variances(noise, move)
    v, omega = radius * turn, turn
    expected = [0.05 * v**2 + 0.02 * omega**2, 0.03 * v**2 + 0.04 * omega**2, 0.01 * v**2 + 0.01 * omega**2]
    np.testing.assert_allclose(np.concatenate((variances.trans, variances.rot1, variances.rot2)), expected)
    errors = np.random.default_rng(3).standard_normal((1000, 4)) * np.array([0.3, 0.3, 0.0, 0.1])
    v_hat, omega_hat = v + errors[:, 1], omega + errors[:, 0]
    book = np.column_stack(
        (v_hat / omega_hat * np.sin(omega_hat), v_hat / omega_hat * (1.0 - np.cos(omega_hat)), omega_hat + errors[:, 3])
    )
    np.testing.assert_allclose(with_noise(move, errors), book, atol=1e-9)
    # what a Kalman filter takes for it agrees where the noise is small
    small = Variances(*(1e-6 * np.concatenate([[9.0], [4.0], [0.0], [1.0]])[:, None]))
    drawn = sample_moments(move_sampled(move, small, 400_000, np.random.default_rng(1))).covariance
    np.testing.assert_allclose(linearised_moments(move, small).covariance, drawn, atol=1e-7)


@pytest.mark.parametrize("alphas", [(0.05, 0.01, 0.02, 0.05, 0.0, 0.0), (0.02, 0.01, 0.1, 0.05, 0.01, 0.0)])
def test_variances_on_an_arc_of_60_degrees_are_those_of_the_book_and_not_of_its_chord(alphas):
    """Moments of table 5.3's sampling by Gauss-Hermite quadrature over the errors of v and omega, one metre of arc."""
    turn, way = np.radians(60.0), 1.0
    end = np.array([way * np.sin(turn) / turn, way * (1.0 - np.cos(turn)) / turn, turn])
    move = move_between(np.zeros(3), end, arc=True)
    variances = move_variances(Noise("velocity", law_named("velocity").coefficients(alphas)), move)
    nodes, weights = np.polynomial.hermite_e.hermegauss(24)
    weights = np.outer(weights, weights).ravel() / weights.sum() ** 2
    v_hat = (way + math.sqrt(alphas[0] * way**2 + alphas[1] * turn**2) * nodes)[:, None]
    omega_hat = (turn + math.sqrt(alphas[2] * way**2 + alphas[3] * turn**2) * nodes)[None, :]
    book = np.stack((v_hat / omega_hat * np.sin(omega_hat), v_hat / omega_hat * (1.0 - np.cos(omega_hat))), axis=-1)
    chord_m = way * 2.0 * math.sin(turn / 2.0) / turn
    half = (omega_hat / 2.0)[..., None]
    chord = (v_hat * chord_m / way)[..., None] * np.concatenate((np.cos(half), np.sin(half)), axis=-1)
    expected, straight = (
        np.average((xy.reshape(-1, 2) - np.average(xy.reshape(-1, 2), axis=0, weights=weights)) ** 2, axis=0,
                   weights=weights) for xy in (book, chord)
    )  # fmt: skip
    drawn = move_sampled(move, variances, 400_000, np.random.default_rng(5))[:, :2].var(axis=0)
    np.testing.assert_allclose(drawn, expected, rtol=0.01)
    assert (np.abs(drawn / straight - 1.0) > 0.03).any()


def test_figures_of_a_60_degree_arc_are_those_of_its_arc_and_not_of_its_chord():
    """Variances of x and y after 1 m and 60 degrees in one second: .0519 and .0317; the chord has .0470 and .0360.

    Lengths from 0.75 m to 5 m have coefficients with these four figures; those of 1 m are taken here.
    """
    alphas, turn, way = (0.0514, 0.0063, 0.0720, 0.0590, 0.0, 0.0), np.radians(60.0), 1.0
    nodes, weights = np.polynomial.hermite_e.hermegauss(24)
    weights = np.outer(weights, weights).ravel() / weights.sum() ** 2

    def drawn_by(length):
        """Return ways and turns at the nodes, by the coefficients at a length."""
        speed = length + math.sqrt(alphas[0] * length**2 + alphas[1] * turn**2) * nodes
        rate = turn + math.sqrt(alphas[2] * length**2 + alphas[3] * turn**2) * nodes
        return speed[:, None] + 0.0 * rate[None, :], rate[None, :] + 0.0 * speed[:, None]

    def variances_of(x, y):
        xy = np.stack((x, y), axis=-1).reshape(-1, 2)
        return np.average((xy - np.average(xy, axis=0, weights=weights)) ** 2, axis=0, weights=weights)

    v, omega = drawn_by(way)
    arc = variances_of(v / omega * np.sin(omega), v / omega * (1.0 - np.cos(omega)))
    v, omega = drawn_by(way * 2.0 * math.sin(turn / 2.0) / turn)
    chord = variances_of(v * np.cos(omega / 2.0), v * np.sin(omega / 2.0))
    assert [round(value, 4) for value in (*chord, *arc)] == [0.0470, 0.0360, 0.0519, 0.0317]

    end = np.array([way * np.sin(turn) / turn, way * (1.0 - np.cos(turn)) / turn, turn])
    move = move_between(np.zeros(3), end, arc=True)
    variances = move_variances(Noise("velocity", law_named("velocity").coefficients(alphas)), move)
    drawn = move_sampled(move, variances, 400_000, np.random.default_rng(5))[:, :2].var(axis=0)
    np.testing.assert_allclose(drawn, arc, rtol=0.01)


def test_a_gyro_noise_that_grows_with_time_is_no_part_of_one_motion():
    still = Noise("diffusion", Coefficients(0.05, 0.02, 0.05, 0.01))
    gyro = replace(still, coefficients=replace(still.coefficients, rot_time=1e-3))
    move = move_between(np.zeros(3), np.array([1.0, 0.2, 0.3]))
    assert move_variances(gyro, move) == move_variances(still, move)
