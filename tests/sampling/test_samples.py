"""Integration of odometry, and samples and density of one motion and along drives, against the book and textbooks."""

import csv
import json
import math
import re
from dataclasses import replace
from typing import get_args

import numpy as np
import pytest
from bagged import messages_in, rows_of

import odomcorrupt as oc
from odomcorrupt.cli import run
from odomcorrupt.corruption.path import NoisyPath
from odomcorrupt.errors import ModelError, RecordingError
from odomcorrupt.mapping.occupancy_grid import OCCUPIED, Constraint, Grid, free_space
from odomcorrupt.model.motion_model import MotionModel, Noise, Step
from odomcorrupt.model.noise_laws import LAWS, Coefficients, Variances, law_named
from odomcorrupt.rng import stream
from odomcorrupt.sampling.convert import convert, drift_of
from odomcorrupt.sampling.density import density_on_grid, hypothetical, pose_density, product, within_map
from odomcorrupt.sampling.samples import (
    EXAMPLES,
    ellipse,
    linearised_moments,
    move_between,
    move_sampled,
    move_variances,
    places_along,
    sample_moments,
    sample_particles,
    with_noise,
)
from odomcorrupt.trajectories import Drive, Rule, integrate, noisy_twists, read_drive
from recordings import OFFICE, RECORDINGS, ROOT

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
    for k in range(5):
        knots = NoisyPath(MotionModel(noise), 9, k).feed(stamps, poses)
        rng = stream(9, k, "noise")
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


@pytest.mark.parametrize(
    ("alphas", "figures"),
    [
        ((0.05, 0.01, 0.02, 0.05, 0.0, 0.0), None),
        ((0.02, 0.01, 0.1, 0.05, 0.01, 0.0), None),
        # lengths from 0.75 m to 5 m have coefficients with these four figures; those of 1 m are taken here
        ((0.0514, 0.0063, 0.0720, 0.0590, 0.0, 0.0), [0.0470, 0.0360, 0.0519, 0.0317]),
    ],
)
def test_variances_on_an_arc_of_60_degrees_are_those_of_the_book_and_not_of_its_chord(alphas, figures):
    """Moments of table 5.3's sampling by Gauss-Hermite quadrature over the errors of v and omega, one metre of arc.

    figures : variances of x and y on the chord, and on the arc
    """
    turn, way = np.radians(60.0), 1.0
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
    end = np.array([way * np.sin(turn) / turn, way * (1.0 - np.cos(turn)) / turn, turn])
    move = move_between(np.zeros(3), end, arc=True)
    variances = move_variances(Noise("velocity", law_named("velocity").coefficients(alphas)), move)
    drawn = move_sampled(move, variances, 400_000, np.random.default_rng(5))[:, :2].var(axis=0)
    np.testing.assert_allclose(drawn, arc, rtol=0.01)
    assert (np.abs(drawn / chord - 1.0) > 0.03).any()
    assert figures is None or [round(value, 4) for value in (*chord, *arc)] == figures


def test_a_gyro_noise_that_grows_with_time_is_no_part_of_one_motion():
    still = Noise("diffusion", Coefficients(0.05, 0.02, 0.05, 0.01))
    gyro = replace(still, coefficients=replace(still.coefficients, rot_time=1e-3))
    move = move_between(np.zeros(3), np.array([1.0, 0.2, 0.3]))
    assert move_variances(gyro, move) == move_variances(still, move)


FORWARD = move_between(np.array([0.3, -0.2, 0.5]), np.array([1.1, 0.4, 1.2]))
REVERSE = move_between(np.array([0.3, -0.2, 0.5]), np.array([-0.5, -0.5, 0.2]))
ARC = move_between(np.array([0.3, -0.2, 0.5]), np.array([1.1, 0.4, 1.2]), arc=True)
SHORT = move_between(np.array([0.0, 0.0, 0.5]), np.array([0.03, 0.002, 0.7]))


def of(rot1, trans, rot2):
    return Variances(*(np.array([v**2]) for v in (rot1, trans, 0.0, rot2)))


NOISES = [
    (FORWARD, of(0.15, 0.08, 0.1)),
    (FORWARD, of(0.9, 0.05, 0.7)),  # wraps
    (FORWARD, of(0.3, 0.6, 0.3)),  # often drives backwards
    (REVERSE, of(0.2, 0.1, 0.2)),
    (SHORT, of(0.3, 0.01, 0.2)),  # across its axis a little
    (ARC, of(0.4, 0.1, 0.2)),
]


@pytest.mark.slow
@pytest.mark.parametrize(("move", "variances"), NOISES)
def test_pose_density_is_what_samples_follow(move, variances):
    """The probability of boxes, by sampling and by integrating: every box within five standard errors."""
    n = 400_000
    drawn = move_sampled(move, variances, n, np.random.default_rng(5))
    drawn[:, 2] = np.mod(drawn[:, 2], 2 * math.pi)
    rng = np.random.default_rng(6)
    size = np.array([*(0.3 * drawn[:, :2].std(axis=0)), 0.3])
    nodes = (np.arange(12) + 0.5) / 12
    unit = np.stack(np.meshgrid(nodes, nodes, nodes), axis=-1).reshape(-1, 3)
    centres = drawn[rng.integers(0, n, 25)]
    for centre in centres:
        points = centre + (unit - 0.5) * size
        expected = pose_density(points, move, variances).mean() * size.prod()
        error = drawn - centre
        error[:, 2] -= 2 * math.pi * np.round(error[:, 2] / (2 * math.pi))
        measured = (np.abs(error) <= size / 2).all(axis=1).mean()
        assert abs(measured - expected) < 5 * math.sqrt(expected / n) + 0.02 * expected


@pytest.mark.slow
@pytest.mark.parametrize(("move", "variances"), [NOISES[0], NOISES[1], NOISES[3], NOISES[5]])
def test_pose_density_integrates_to_one_and_the_product_does_not(move, variances):
    assert density_on_grid(move, variances).integral == pytest.approx(1.0, abs=2e-3)
    length = float(np.hypot(*move.shift_xy))
    if not move.arc:
        grid = density_on_grid(move, variances, density_of=lambda at: product(at, move, variances))
        assert grid.integral == pytest.approx(length, rel=0.02)


def test_product_is_three_densities_written_by_hand():
    def prob(error, variance):
        return math.exp(-error * error / (2 * variance)) / math.sqrt(2 * math.pi * variance)

    variances = of(0.1, 0.05, 0.12)
    x0, y0, theta0 = FORWARD.start_xyt
    rot1, trans, rot2 = (float(v[0]) for v in (FORWARD.parts.rot1_rad, FORWARD.parts.trans_m, FORWARD.parts.rot2_rad))
    for x, y, theta in ((1.0, 0.45, 1.1), (1.15, 0.3, 1.3)):
        hat1 = math.atan2(y - y0, x - x0) - theta0
        hat = math.hypot(x - x0, y - y0)
        hat2 = theta - theta0 - hat1
        expected = prob(rot1 - hat1, 0.01) * prob(trans - hat, 0.0025) * prob(rot2 - hat2, 0.0144)
        ours = product(np.array([[x, y, theta]]), FORWARD, variances)[0]
        assert ours == pytest.approx(expected, rel=1e-9)
        assert pose_density(np.array([[x, y, theta]]), FORWARD, variances)[0] == pytest.approx(expected / hat, rel=1e-9)


def test_hypothetical_reading_asks_the_law_at_every_pose():
    noise = Noise("quadratic", Coefficients(0.02, 0.01, 0.02, 0.01))
    poses = FORWARD.end_xyt + np.array([[0.0, 0.0, 0.0], [0.3, 0.2, 0.1], [-0.2, 0.1, -0.4]])
    expected = [
        product(pose[None], FORWARD, move_variances(noise, move_between(FORWARD.start_xyt, pose)))[0] for pose in poses
    ]
    np.testing.assert_allclose(hypothetical(poses, FORWARD, noise), expected, rtol=1e-9)


def test_two_readings_of_the_lecture_at_one_pose():
    """Table 5.5 of the book worked by hand for the lecture's `balanced`: variances of u, and of the hypothesis."""
    example = EXAMPLES["balanced"]
    move = move_between(np.array(example.start_xyt), np.array(example.end_xyt))
    at = np.array([[0.8, 0.5, math.radians(20.0)]])
    assert product(at, move, move_variances(example.noise, move))[0] == pytest.approx(0.00101, rel=0.01)
    assert hypothetical(at, move, example.noise)[0] == pytest.approx(5.4e-5, rel=0.01)


def test_density_within_a_map_integrates_to_one_over_what_is_free():
    cells = np.zeros((60, 60), dtype=np.uint8)
    cells[:, 45:] = OCCUPIED  # beyond x = 1.5 - 0.6
    space = free_space(Grid(cells, 0.05, np.array([-1.2, -1.2, 0.0])), 0.0)
    grid = density_on_grid(*NOISES[0], cells=80)
    within, part = within_map(grid, Constraint(space), FORWARD.start_xyt[:2])
    assert within.integral == pytest.approx(grid.integral, rel=1e-9)
    drawn = move_sampled(*NOISES[0], 100_000, np.random.default_rng(5))
    # half a cell of the grid lies on the wrong side of the wall
    assert part == pytest.approx(space.free(drawn[:, :2]).mean(), abs=0.03)
    assert 0.02 < part < 0.98
    gx, gy = np.meshgrid(within.x_m, within.y_m)
    free = space.free(np.column_stack((gx.ravel(), gy.ravel()))).reshape(gx.shape)
    assert (within.density[~free] == 0.0).all()


def test_odometry_is_the_likeliest_end_of_a_long_drive_by_the_product():
    example = EXAMPLES["balanced"]
    move = move_between(np.array(example.start_xyt), np.array(example.end_xyt))
    variances = move_variances(example.noise, move)
    best = product(move.end_xyt[None], move, variances)[0]
    near = move.end_xyt + np.random.default_rng(0).normal(scale=0.02, size=(200, 3))
    assert (product(near, move, variances) < best).all()


@pytest.mark.parametrize(
    ("variances", "word"),
    [(of(0.0, 0.1, 0.1), "rot1"), (of(0.1, 0.0, 0.1), "trans"), (Variances(*np.full((4, 1), 0.1)), "across")],
)
def test_what_has_no_closed_form_is_refused(variances, word):
    with pytest.raises(ModelError, match=word):
        pose_density(FORWARD.end_xyt[None], FORWARD, variances)


STEP = Step(0.25, 0.2)
QUADRATIC = Noise("quadratic", Coefficients(0.1, 0.05, 0.04, 0.02), STEP)


def spread(noise, poses, runs=600):
    """Standard deviations of heading and of travel at the end of a drive corrupted at 50 Hz, travel by itself."""
    stamps = np.arange(len(poses)) * 20_000_000
    ends = np.array([NoisyPath(MotionModel(noise), 4, k).feed(stamps, poses).error_xyt[-1] for k in range(runs)])
    return ends.std(axis=0)


@pytest.mark.slow
@pytest.mark.parametrize(("end_xyt", "columns"), [((5, 0, 0), [0, 2]), ((0, 0, 4), [2])], ids=["straight", "turning"])
def test_converted_law_drifts_the_same_in_simulation(end_xyt, columns):
    poses = np.linspace((0, 0, 0), end_xyt, 401)
    expected = pytest.approx(spread(QUADRATIC, poses)[columns], rel=0.09)
    for target, step in (("diffusion", None), ("linear", Step(0.5, 0.1))):
        assert spread(convert(QUADRATIC, law_named(target), step), poses)[columns] == expected, target


@pytest.mark.parametrize("law", ["diffusion", "linear", "quadratic", "velocity", "omni"])
def test_there_and_back_is_where_it_began(law):
    other = convert(QUADRATIC, law_named(law), Step(0.1, 0.3))
    back = convert(other, law_named("quadratic"), STEP)
    for name in ("rot_rot", "rot_trans", "trans_trans", "trans_rot"):
        assert getattr(back.coefficients, name) == pytest.approx(getattr(QUADRATIC.coefficients, name))
    assert drift_of(other).rot_rot == pytest.approx(drift_of(QUADRATIC).rot_rot)


def test_what_has_no_place_in_the_other_law_is_reported():
    sideways = Noise("diffusion", Coefficients(0.1, 0.1, 0.1, 0.1, across_trans=0.02))
    with pytest.raises(ModelError, match="across_trans"):
        convert(sideways, law_named("quadratic"), STEP)
    assert convert(sideways, law_named("omni"), STEP).coefficients.across_trans > 0


def test_command_prints_what_to_type_next(capsys, invoke):
    arguments = ["convert-alpha", "0.1", "0.05", "0.04", "0.02", "--from", "quadratic", "--step", "0.25m"]
    said = invoke([*arguments, "--to", "diffusion"]).out.replace(" \\\n", " ").split()
    assert " ".join(said).endswith("next odomcorrupt in.bag out.bag --law diffusion --alpha 0.1 0.158114 0.1 0.0447214")
    assert run([*arguments, "--to", "diffusion", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["to"]["coefficients"]["rot_rot"] == pytest.approx(0.1)


PAGE = (ROOT / "docs" / "laws.md").read_text()


def test_every_law_is_in_the_table():
    table = [line for line in PAGE.splitlines() if line.startswith("| `")]
    named = {re.match(r"\| `([\w-]+)`", line)[1] for line in table}
    assert set(LAWS) <= named


def test_session_on_the_page_is_what_the_command_prints(invoke):
    session = re.search(r"```\n\$ odomcorrupt (.*?)\n(.*?)```", PAGE, re.DOTALL)
    assert invoke(session[1].split()).out == session[2]


@pytest.mark.parametrize("name", ["linear", "quadratic", "velocity", "omni"])
def test_formulas_of_the_conversion_table_hold(name):
    row = re.findall(rf"^\| `{name}` \|(.*)\|$", PAGE, re.MULTILINE)[-1]
    law = law_named(name)
    step = Step(0.3, 0.15)
    alphas = [0.11, 0.07, 0.05, 0.03, 0.02, 0.013][: len(law.alphas)]
    if name == "omni":
        alphas = alphas[:4]
    found = convert(Noise(name, law.coefficients(alphas), step), law_named("diffusion"), None).coefficients
    symbols = {f"A{i + 1}": a for i, a in enumerate(alphas)} | {"D": step.distance_m, "Φ": step.angle_rad}
    for cell, coefficient in zip(row.split("|"), ("rot_rot", "rot_trans", "trans_trans", "trans_rot"), strict=True):
        text = re.sub(r"√(\w+)", r"√(\1)", cell.strip())
        text = re.sub(r"(?<=[\w)]) (?=[\w√(])", "*", text).replace("√", "sqrt")
        value = eval(text, {"sqrt": np.sqrt, "__builtins__": {}}, symbols)  # noqa: S307 - our own page
        assert getattr(found, coefficient) == pytest.approx(value), cell


def test_same_numbers_differ_between_laws_as_the_page_says():
    said = re.search(
        r"deviation of ([\d.]+) rad\s+by\s+`linear`, ([\d.]+) rad by `quadratic` and ([\d.]+) rad by `diff", PAGE
    )
    per_message = Step(0.02, 1.0)
    for name, value in zip(("linear", "quadratic", "diffusion"), said.groups(), strict=True):
        noise = Noise(name, Coefficients(0.05, 0.05, 0.05, 0.05), per_message if LAWS[name].per_step else None)
        assert np.sqrt(10.0 * drift_of(noise).rot_trans) == pytest.approx(float(value), abs=0.005)


def test_article_banana_needs_no_more_words(tmp_path, invoke):
    picture = tmp_path / "banana.png"
    said = invoke(["sample", "-o", picture]).out
    assert "1000 of seed" in said
    assert "rot_trans 0.2618" in said
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_same_seed_gives_the_same_picture_to_the_bit(tmp_path):
    for name in ("a.svg", "b.svg"):
        assert run(["sample", "-o", str(tmp_path / name), "--seed", "4", "-n", "50"]) == 0
    assert (tmp_path / "a.svg").read_bytes() == (tmp_path / "b.svg").read_bytes()


def test_csv_and_json_hold_the_same_samples(tmp_path):
    for name in ("s.csv", "s.json"):
        assert run(["sample", "--end", "1,0.2,20deg", "-n", "20", "--seed", "5", "-o", str(tmp_path / name)]) == 0
    content = json.loads((tmp_path / "s.json").read_text())
    with (tmp_path / "s.csv").open() as file:
        rows = [[float(v) for v in row.values()] for row in csv.DictReader(file)]
    assert rows == content["xyt"]
    np.testing.assert_allclose(content["samples"]["mean_xyt"], np.mean(rows, axis=0))
    np.testing.assert_allclose(content["samples"]["covariance"], np.cov(np.transpose(rows)))


def test_article_code_says_what_it_means(invoke):
    assert "sd*sd" in invoke(["sample", "-v", "--law", "article-code", "--seed", "1"]).out


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (["sample", "-o", "x.gif"], ".gif"),
        (["sample", "--example", "nope"], "balanced"),
        (["sample", "--example", "balanced", "--preset", "typical"], "has its own noise"),
        (["sample", "--effect", "wheel_scale:e=0.01"], "duration"),
        (["sample", "--law", "quadratic"], "--alpha"),
        (["sample", "--law", "article-code", "--preset", "typical"], "--alpha"),
        (["density", "--alpha", "0", "0", "0.1", "0.1"], "rot1"),
        (["convert-alpha", "1", "1", "1", "1", "--from", "quadratic", "--to", "diffusion"], "--step"),
        (["convert-alpha", "1", "1", "1", "1", "--from", "diffusion", "--to", "linear"], "--to-step"),
        (["convert-alpha", "1", "1", "1", "--from", "diffusion", "--to", "linear"], "3 numbers"),
        (["convert-alpha", "1", "1", "1", "x", "--from", "diffusion", "--to", "linear"], "'x'"),
        (["convert-alpha", "1", "1", "1", "1", "--from", "cubic", "--to", "linear"], "cubic"),
    ],
)
def test_wrong_usage_is_reported_in_one_line(arguments, word, invoke):
    lines = invoke(arguments, 2).err.strip().splitlines()
    assert len(lines) == 1
    assert word in lines[0]


def test_start_alone_moves_the_examples_motion(invoke):
    parts = []
    for start in ([], ["--start", "5,-3,0.1"]):
        content = json.loads(invoke(["sample", "--seed", "1", "--json", *start]).out)
        parts.append([content[name] for name in ("rot1_rad", "trans_m", "rot2_rad")])
    np.testing.assert_allclose(parts[0], parts[1], atol=1e-12)


def test_density_is_printed_and_drawn(tmp_path, invoke):
    picture = tmp_path / "density.svg"
    out = invoke(["density", "-o", picture, "--seed", "1", "--at", "0.2,0.35,10deg"]).out
    integral = float(re.search(r"end poses: ([\d.]+)", out)[1])
    assert integral == pytest.approx(1.0, abs=1e-3)
    assert float(re.search(r"10 deg\): ([\d.]+)", out)[1]) > 100
    assert picture.read_bytes().startswith(b"<?xml")


def textbook(start, twist, t, rule):
    """One step after the other, with scalars."""
    poses = [tuple(start)]
    for (vx, vy, omega), before, after in zip(twist, t, t[1:], strict=False):
        x, y, theta = poses[-1]
        dt = after - before
        if rule == "exact" and omega:
            # the centre of the circle stays where it is
            turned = theta + omega * dt
            x += (vx * (math.sin(turned) - math.sin(theta)) + vy * (math.cos(turned) - math.cos(theta))) / omega
            y += (vx * (math.cos(theta) - math.cos(turned)) + vy * (math.sin(turned) - math.sin(theta))) / omega
        else:
            along = theta + (omega * dt / 2 if rule == "midpoint" else 0)
            x += dt * (vx * math.cos(along) - vy * math.sin(along))
            y += dt * (vx * math.sin(along) + vy * math.cos(along))
        poses.append((x, y, theta + omega * dt))
    return poses


@pytest.mark.parametrize("rule", get_args(Rule))
def test_rule_is_the_textbook_loop(rule):
    rng = np.random.default_rng(2)
    twist, t = rng.normal(size=(40, 3)), np.cumsum(rng.uniform(0, 0.5, 40))
    start = np.array([1.0, -2.0, 0.7])
    np.testing.assert_allclose(integrate(start, twist, t, rule), textbook(start, twist, t, rule), atol=1e-12)


def test_exact_closes_a_circle_in_any_number_of_steps():
    for n in (3, 7, 100):
        t = np.linspace(0, 2 * math.pi, n + 1)
        end = integrate(np.zeros(3), np.tile([1.0, 0.0, 1.0], (n + 1, 1)), t, "exact")[-1]
        np.testing.assert_allclose(end, [0, 0, 2 * math.pi], atol=1e-12)


def test_hold_says_which_interval_a_twist_is_for():
    twist, t = np.array([[1.0, 0, 0], [2.0, 0, 0], [4.0, 0, 0]]), np.array([0.0, 1.0, 2.0])
    assert integrate(np.zeros(3), twist, t, "exact", hold="next")[-1, 0] == 3.0
    assert integrate(np.zeros(3), twist, t, "exact", hold="previous")[-1, 0] == 6.0


def test_noisy_run_does_not_depend_on_its_company():
    twist = np.zeros((30, 3))
    many = noisy_twists(twist, 0.2, 0.04, seed=3, runs=range(8))
    alone = noisy_twists(twist, 0.2, 0.04, seed=3, runs=range(5, 6))
    np.testing.assert_array_equal(many[5], alone[0])
    assert not np.array_equal(many[4], many[5])


def test_noise_on_twists_drifts_as_white_noise_does():
    """Heading after n steps: sd omega dt sqrt(n); along a straight drive: sd v dt sqrt(n)."""
    n, dt = 400, 0.01
    twists = noisy_twists(np.tile([1.0, 0, 0], (n + 1, 1)), 0.2, 0.04, seed=1, runs=range(2000))
    ends = integrate(np.zeros(3), twists, np.arange(n + 1) * dt, "exact")[:, -1]
    assert ends[:, 2].std() == pytest.approx(0.04 * dt * math.sqrt(n), rel=0.06)
    assert ends[:, 0].std() == pytest.approx(0.2 * dt * math.sqrt(n), rel=0.06)


GAZEBO = RECORDINGS / "real" / "rob521_gazebo.mcap"


@pytest.mark.recordings
def test_euler_is_within_two_centimetres_of_the_truth(tmp_path, capsys):
    picture = tmp_path / "errors.png"
    assert run(["integrate", str(GAZEBO), "--integrate", "euler", "--plot", str(picture)]) == 0
    metres, radians = re.search(r"/ground_truth: at most ([\d.]+) m and ([\d.]+) rad", capsys.readouterr().out).groups()
    assert float(metres) < 0.02
    assert float(radians) < 0.026
    assert picture.stat().st_size > 10_000


@pytest.mark.slow
@pytest.mark.recordings
def test_hundred_noisy_runs_surround_the_truth(tmp_path, invoke):
    arguments = ["--twist-noise", "0.2", "0.04", "--runs", "100", "--seed", "1", "--plot", str(tmp_path / "runs.png")]
    said = invoke(["integrate", "-v", GAZEBO, "--integrate", "euler", *arguments]).out
    # white noise of 0.04 rad/s over 12956 intervals of 10 or 20 ms
    heading = float(re.search(r"([\d.]+) rad away", said)[1])
    drive = read_drive(GAZEBO, None)
    expected = 0.04 * np.sqrt((np.diff(drive.t_s) ** 2).sum())
    assert heading == pytest.approx(expected, rel=0.25)


def test_output_holds_the_integrated_path_and_nothing_else_changed(tmp_path):
    out = tmp_path / "out.mcap"
    assert run(["integrate", str(OFFICE), str(out), "--integrate", "midpoint", "--odom-topic", "/odom"]) == 0
    before, after = read_drive(OFFICE, "/odom"), read_drive(out, "/odom")
    expected = integrate(before.xyt[0], before.twist, before.t_s, "midpoint")
    np.testing.assert_allclose(after.xyt[:, :2], expected[:, :2], atol=1e-9)
    np.testing.assert_allclose(np.exp(1j * after.xyt[:, 2]), np.exp(1j * expected[:, 2]), atol=1e-9)
    np.testing.assert_array_equal(after.twist, before.twist)
    assert others(out) == others(OFFICE)


def others(path):
    """Every message but odometry and transforms: topic, log time, bytes."""
    return [one for one in messages_in(path) if one[0] not in ("/odom", "/tf", "/tf_static")]


@pytest.mark.slow
def test_transform_says_what_the_odometry_says(tmp_path):
    out = tmp_path / "out.mcap"
    assert run(["integrate", str(OFFICE), str(out), "--twist-noise", "1", "1", "--seed", "2"]) == 0
    drive = read_drive(out, None)
    xy = rows_of(out, "/tf", (drive.frame_id, drive.child_frame_id)).xyt[:, :2]
    away = np.abs(xy[:, None] - drive.xyt[None, :, :2]).sum(axis=2).min(axis=1)
    original = read_drive(OFFICE, None)
    assert np.abs(drive.xyt[:, :2] - original.xyt[:, :2]).max() > 0.05
    assert np.median(away) < 1e-6


def test_truth_of_a_wrong_type_is_named(invoke):
    assert "TFMessage" in invoke(["integrate", OFFICE, "--truth", "/tf"], 1).err


NOISE = oc.Noise(alpha=(0.05, 0.02, 0.05, 0.01))


def straight(length, n=500):
    xyt = np.zeros((n, 3))
    xyt[:, 0] = np.linspace(0, length, n)
    return Drive("/odom", "odom", "base", np.arange(n) * 10**8, xyt, np.zeros((n, 3)))


def test_run_of_the_cloud_is_the_path_that_corruption_writes(tmp_path):
    noisy = tmp_path / "noisy.mcap"
    arguments = ["--alpha", "0.05", "0.02", "0.05", "0.01", "--seed", "9"]
    assert run([str(OFFICE), str(noisy), *arguments, "--run", "3"]) == 0
    cloud = oc.sample_along(OFFICE, NOISE, seed=9, runs=4, every_m=7.0).result
    np.testing.assert_allclose(cloud.xyt[3, -1, :2], read_drive(noisy, None).xyt[-1, :2], atol=1e-9)


@pytest.mark.slow
def test_cloud_spreads_as_the_law_says():
    """On a straight drive: along by sqrt(distance), heading by sqrt(distance), across by distance^1.5."""
    drive = straight(16.0)
    cloud = sample_particles(drive, oc.Model(NOISE).motion_model, places_along(drive, 4.0), seed=1, runs=3000)
    np.testing.assert_allclose(cloud.distance_m, [4, 8, 12, 16], atol=0.05)
    spread = cloud.xyt.std(axis=0)
    d = cloud.distance_m
    np.testing.assert_allclose(spread[:, 2], 0.02 * np.sqrt(d), rtol=0.06)
    np.testing.assert_allclose(spread[:, 0], 0.05 * np.sqrt(d), rtol=0.06)
    np.testing.assert_allclose(spread[:, 1], 0.02 * np.sqrt(d**3 / 3), rtol=0.06)


def test_parked_robot_has_no_cloud():
    with pytest.raises(RecordingError, match="does not move"):
        places_along(straight(0.0), 1.0)


def test_last_place_is_the_end_and_no_place_is_near_it():
    drive = straight(10.1)
    np.testing.assert_allclose(drive.distance_m[places_along(drive, 5.0)], [5, 10.1], atol=0.05)


def test_command_writes_every_run(tmp_path, invoke):
    names = [tmp_path / f"cloud.{end}" for end in ("csv", "json", "png")]
    for name in names:
        assert f"wrote {name}" in invoke(["sample", OFFICE, "-n", "6", "--every", "10", "--seed", "1", "-o", name]).err
    assert names[2].read_bytes().startswith(b"\x89PNG")
    with names[0].open() as file:
        rows = list(csv.DictReader(file))
    places = json.loads(names[1].read_text())["places"]
    assert len(rows) == 6 * len(places)
    last = [float(row["x_m"]) for row in rows if float(row["distance_m"]) == places[-1]["distance_m"]]
    assert np.mean(last) == pytest.approx(places[-1]["mean_xyt"][0])
