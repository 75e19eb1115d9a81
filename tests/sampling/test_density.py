import math

import numpy as np
import pytest

from odomcorrupt.errors import ModelError
from odomcorrupt.mapping.occupancy_grid import OCCUPIED, Constraint, Grid, free_space
from odomcorrupt.model.motion_model import Noise
from odomcorrupt.model.noise_laws import Coefficients, Variances
from odomcorrupt.sampling.density import density_on_grid, hypothetical, pose_density, product, within_map
from odomcorrupt.sampling.samples import EXAMPLES, move_between, move_sampled, move_variances

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
    grid = density_on_grid(*NOISES[0])
    within, part = within_map(grid, Constraint(space), FORWARD.start_xyt[:2])
    assert within.integral == pytest.approx(grid.integral, rel=1e-9)
    drawn = move_sampled(*NOISES[0], 100_000, np.random.default_rng(5))
    # half a cell of the grid lies on the wrong side of the wall
    assert part == pytest.approx(space.free(drawn[:, :2]).mean(), abs=0.02)
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
