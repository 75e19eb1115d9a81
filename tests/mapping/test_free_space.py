"""Free space of a robot in a map, and paths within it."""

import numpy as np
import pytest
from rooms import MODEL, RESOLUTION, drive, room

from odomcorrupt.corruption.path import NoisyPath
from odomcorrupt.effects import effect_from_values
from odomcorrupt.errors import MapError, ModelError
from odomcorrupt.mapping.conditioned import FreePath, FreeRuns, free_paths, whole_path
from odomcorrupt.mapping.occupancy_grid import OCCUPIED, UNKNOWN, Constraint, Grid, free_space
from odomcorrupt.model.motion_model import MotionModel, Noise, Step
from odomcorrupt.model.noise_laws import Coefficients, Variances
from odomcorrupt.sampling.samples import move_between, move_sampled, move_sampled_in_map

WALL = (2.0, -1.0, 2.2, 1.0)
AHEAD = move_between(np.zeros(3), np.array([3.0, 0.0, 0.0]))
NOISE = Variances(*(np.array([v]) for v in (0.16, 0.04, 0.0, 0.01)))


@pytest.mark.parametrize("radius", [0.0, 0.04, 0.1, 0.35, 0.62])
def test_robot_keeps_its_radius_from_every_wall(radius):
    """Against distances to every occupied square, at the middles of cells."""
    rng = np.random.default_rng(4)
    cells = (rng.uniform(size=(30, 40)) < 0.01).astype(np.uint8)
    space = free_space(Grid(cells, RESOLUTION, np.zeros(3)), radius, unknown="free")
    row, column = np.mgrid[:30, :40]
    gap = np.full(cells.shape, np.inf)
    for r, c in np.argwhere(cells == OCCUPIED):
        dx, dy = np.maximum(np.abs(column - c) - 0.5, 0), np.maximum(np.abs(row - r) - 0.5, 0)
        gap = np.minimum(gap, RESOLUTION * np.hypot(dx, dy))
    np.testing.assert_array_equal(space.blocked == 1, gap <= radius + 1e-12)


def test_unknown_is_as_asked_inside_and_beyond_the_map():
    grid = room()
    grid.cells[:, :50] = UNKNOWN
    places = np.array([[-1.0, 0.0], [1.0, 0.0], [50.0, 0.0]])
    assert free_space(grid, 0.1).free(places).tolist() == [False, True, False]
    assert free_space(grid, 0.1, unknown="free").free(places).tolist() == [True, True, True]


def test_behind_a_wall_is_free_and_not_reachable():
    space = free_space(room(WALL), 0.1)
    origin, there = np.zeros((3, 2)), np.array([[3.0, 0.0], [3.0, 3.0], [1.5, 0.0]])
    assert Constraint(space).allows(origin, there).tolist() == [True, True, True]
    assert Constraint(space, "path").allows(origin, there).tolist() == [False, True, True]


def test_path_through_a_wall_one_cell_thin_is_seen_at_any_angle():
    rng = np.random.default_rng(5)
    space = free_space(room((1.0, -5.0, 1.1, 5.0)), 0.0, unknown="free")
    start = np.column_stack((rng.uniform(-4, 0.9, 500), rng.uniform(-4, 4, 500)))
    end = np.column_stack((rng.uniform(1.2, 4, 500), rng.uniform(-4, 4, 500)))
    assert not space.reachable(start, end).any()
    assert not space.reachable(end, start).any()
    assert space.reachable(start, start[::-1]).all()


def test_poses_are_given_in_the_odom_frame():
    space = free_space(room(WALL), 0.1, map_from_odom=np.array([2.1, -3.0, np.pi / 2]))
    assert space.free(np.array([[3.0, 0.0], [1.0, 0.0]])).tolist() == [False, True]


@pytest.mark.parametrize("check", ["endpoint", "path"])
def test_rejection_samples_the_motion_given_that_it_is_free(check):
    """The same distribution as drawing very many and keeping the free ones."""
    within = Constraint(free_space(room(WALL), 0.2), check)
    ours = move_sampled_in_map(AHEAD, NOISE, 20_000, np.random.default_rng(1), within).xyt
    many = move_sampled(AHEAD, NOISE, 80_000, np.random.default_rng(2))
    kept = many[within.allows(np.zeros((len(many), 2)), many[:, :2])]
    for column in range(3):
        np.testing.assert_allclose(
            np.quantile(ours[:, column], [0.1, 0.3, 0.7, 0.9]),
            np.quantile(kept[:, column], [0.1, 0.3, 0.7, 0.9]),
            atol=0.04,
        )


def test_tries_are_bounded_and_counted():
    within = Constraint(free_space(room(WALL), 0.2), "path", 2)
    drawn = move_sampled_in_map(AHEAD, NOISE, 400, np.random.default_rng(1), within)
    assert 0 < drawn.lost < 400
    assert len(drawn.xyt) == 400 - drawn.lost
    assert drawn.candidates == 400 + (400 - drawn.free_at_first)
    assert f"{drawn.lost} were given up after 2 tries" in drawn.account()


def test_where_nothing_is_free_it_is_said():
    boxed = Constraint(free_space(room((1.0, -5.0, 5.0, 5.0)), 0.1))
    with pytest.raises(MapError, match="none of 3000 candidates"):
        move_sampled_in_map(AHEAD, Variances(*np.full((4, 1), 1e-6)), 30, np.random.default_rng(1), boxed)
    inside = move_between(np.array([2.0, 0.0, 0.0]), np.array([3.0, 0.0, 0.0]))
    with pytest.raises(MapError, match="begins at"):
        move_sampled_in_map(inside, NOISE, 30, np.random.default_rng(1), boxed)


def test_paths_stay_free_and_do_not_depend_on_their_company():
    stamps, xyt = drive()
    space = free_space(room((1.5, 0.3, 4.5, 0.5), (1.5, -0.5, 4.5, -0.3)), 0.15)
    places = np.arange(len(xyt))
    many = free_paths(stamps, xyt, MODEL, Constraint(space), seed=1, runs=range(30), places=places)
    assert space.free(many.xyt.reshape(-1, 3)[:, :2]).all()
    assert many.redrawn > 0
    alone = free_paths(stamps, xyt, MODEL, Constraint(space), seed=1, runs=range(17, 18), places=places)
    np.testing.assert_array_equal(alone.xyt[0], many.xyt[17])


def test_runs_before_a_closed_wall_are_refused_and_at_a_gap_all_pass():
    stamps, xyt = drive()
    given = {"seed": 1, "runs": range(30), "places": np.arange(300)}
    quiet = MotionModel(Noise("diffusion", Coefficients(0.02, 0.01, 0.01, 0.01)))
    with pytest.raises(MapError, match="the map and the drive do not match"):
        free_paths(stamps, xyt, quiet, Constraint(free_space(room((2.0, -5.0, 2.2, 5.0)), 0.1), "path", 3), **given)
    gap = Constraint(free_space(room((2.0, -5.0, 2.2, 0.0), (2.0, 0.1, 2.2, 5.0)), 0.0), "path", 3)
    paths = free_paths(stamps, xyt, MODEL, gap, **given)
    assert paths.resampled > 0
    assert (paths.xyt[:, -1, 0] > 3.5).all()
    # copies are copies of whole paths: each passed the gap where it was, and made no leap
    for path in paths.xyt:
        assert gap.allows(path[:-1, :2], path[1:, :2]).all()
    assert np.hypot(*np.diff(paths.xyt[..., :2], axis=1).T).max() < 0.2


def test_cut_into_batches_changes_no_bit_and_open_space_changes_nothing():
    stamps, xyt = drive()
    xyt[150:] += [3.0, 0.5, 1.0]  # a jump
    narrow = Constraint(free_space(room((1.0, 0.3, 1.6, 0.5), (1.0, -0.5, 1.6, -0.3)), 0.2))
    whole = FreeRuns(MODEL, narrow, seed=1, runs=range(3)).feed(stamps, xyt).xyt
    cut = FreeRuns(MODEL, narrow, seed=1, runs=range(3))
    parts = []
    for i in range(0, 300, 37):
        walked = cut.feed(stamps[i : i + 37], xyt[i : i + 37])
        parts = [*(part[walked.ancestors] for part in parts), walked.xyt]
    np.testing.assert_array_equal(np.concatenate(parts, axis=1), whole)
    assert cut.redrawn > 0
    wide = Constraint(free_space(room(), 0.2, unknown="free"))
    for run, path in enumerate(FreeRuns(MODEL, wide, seed=1, runs=range(3)).feed(stamps, xyt).xyt):
        noisy = xyt + NoisyPath(MODEL, 1, run).feed(stamps, xyt).error_xyt
        np.testing.assert_allclose(path, noisy, atol=1e-12)


CORRIDOR = ((1.5, 0.3, 4.5, 0.5), (1.5, -0.5, 4.5, -0.3))
LOUD = MotionModel(Noise("diffusion", Coefficients(0.6, 0.6, 0.2, 0.3)))
BOOK = MotionModel(Noise("linear", Coefficients(0.3, 0.6, 0.4, 0.2), Step(0.25, 0.2)))


@pytest.mark.slow
@pytest.mark.parametrize("model", [LOUD, BOOK])
@pytest.mark.parametrize("check", ["endpoint", "path"])
def test_run_is_the_one_that_sampling_draws(model, check):
    stamps, xyt = drive()
    space = free_space(room(*CORRIDOR), 0.15)
    runs = FreeRuns(model, Constraint(space, check), seed=1, runs=range(8)).feed(stamps, xyt).xyt
    redrawn = same = 0
    for run, sampled in enumerate(runs):
        path = FreePath(model, Constraint(space, check), 1, run)
        try:
            noisy = xyt + path.feed(stamps, xyt).error_xyt
        except MapError:  # stuck, so that sampling copied another run
            continue
        same += 1
        np.testing.assert_allclose(noisy, sampled, atol=1e-9)
        assert space.free(noisy[:, :2]).all()
        redrawn += path.redrawn
    assert redrawn > 0
    assert same > 3


def test_cut_into_batches_changes_no_bit():
    stamps, xyt = drive()
    xyt[150:] += [0.4, 0.1, 1.0]  # a jump
    within = Constraint(free_space(room(*CORRIDOR), 0.2, unknown="free"))
    one, path = (FreePath(LOUD, within, 1, 5) for _ in range(2))
    whole = one.feed(stamps, xyt)
    parts = [path.feed(stamps[i : i + 37], xyt[i : i + 37]) for i in range(0, 300, 37)]
    np.testing.assert_array_equal(np.concatenate([part.error_xyt for part in parts]), whole.error_xyt)
    np.testing.assert_array_equal(np.concatenate([part.sums for part in parts], axis=1), whole.sums)
    assert one.account() == path.account()
    assert path.redrawn > 0


def test_open_space_changes_no_bit():
    stamps, xyt = drive()
    within = Constraint(free_space(room(), 0.2, unknown="free"))
    ours, plain = FreePath(MODEL, within, 1, 2).feed(stamps, xyt), NoisyPath(MODEL, 1, 2).feed(stamps, xyt)
    np.testing.assert_array_equal(ours.error_xyt, plain.error_xyt)
    np.testing.assert_array_equal(ours.sums, plain.sums)


@pytest.mark.slow
def test_path_through_a_pocket_is_drawn_as_a_whole_and_free():
    stamps, xyt = drive()
    # the upper half of the corridor ends in a pocket: who drifts up is stuck, who stays low passes below it
    pocket = room((2.0, 0.05, 2.2, 5.0), (0.5, 0.35, 2.1, 0.5), (0.5, -0.5, 4.5, -0.4))
    within = Constraint(free_space(pocket, 0.0), "path", 5)
    stuck = []
    for run in range(20):
        try:
            FreePath(MODEL, within, 1, run).feed(stamps, xyt)
        except MapError:
            stuck.append(run)
    assert 0 < len(stuck) < 20
    ends = []
    for run in range(20):
        path = whole_path(stamps, xyt, MODEL, within, 1, run)
        noisy = xyt + path.feed(stamps, xyt).error_xyt
        assert within.allows(noisy[:-1, :2], noisy[1:, :2]).all()
        assert ("one of 64 paths" in path.account()) is (run in stuck)
        ends.append(noisy[-1])
    assert min(end[0] for end in ends) > 3.5
    assert len({tuple(end) for end in ends}) == 20


def test_path_that_is_never_stuck_has_the_bits_of_the_single_increments():
    stamps, xyt = drive()
    within = Constraint(free_space(room(*CORRIDOR), 0.15))
    plain = FreePath(LOUD, within, 1, 3).feed(stamps, xyt)
    whole = whole_path(stamps, xyt, LOUD, within, 1, 3).feed(stamps, xyt)
    np.testing.assert_array_equal(whole.error_xyt, plain.error_xyt)


def test_drive_through_a_wall_is_refused():
    stamps, xyt = drive()
    within = Constraint(free_space(room((2.0, -5.0, 2.2, 5.0)), 0.1), "path", 20)
    with pytest.raises(MapError, match="the map and the drive do not match"):
        FreePath(MODEL, within, 1).feed(stamps, xyt)
    with pytest.raises(MapError, match="the map and the drive do not match"):
        whole_path(stamps, xyt, MODEL, within, 1)


def test_odometry_that_is_not_free_itself_is_refused():
    stamps, xyt = drive()
    space = free_space(room((2.0, -0.5, 4.0, 0.5)), 0.0)
    share = 1.0 - np.mean(space.free(xyt[:, :2]))
    assert share > 0.25
    with pytest.raises(MapError, match=f"{share:.0%} of the odometry's own poses are not free; check map_pose"):
        whole_path(stamps, xyt, MODEL, Constraint(space), 1)


def test_robot_whose_pose_was_set_into_a_wall_is_let_out_of_it():
    stamps, xyt = drive()
    xyt[150:, 0] += 30.0
    xyt[150:, 1] = np.linspace(0.0, 1.0, 150)
    space = free_space(room(), 0.0)  # 30 m ahead is beyond the map, which blocks
    path = FreePath(MODEL, Constraint(space), 1)
    noisy = xyt + path.feed(stamps, xyt).error_xyt
    assert not space.free(noisy[150:, :2]).any()
    assert np.ptp(noisy[150:, 1]) > 0.8


def test_drive_that_begins_in_a_wall_and_effects_are_refused():
    stamps, xyt = drive()
    inside = Constraint(free_space(room((-0.5, -0.5, 0.5, 0.5)), 0.1))
    with pytest.raises(MapError, match=r"begins at \(0.000 m"):
        FreePath(MODEL, inside, 1).feed(stamps, xyt)
    wide = MotionModel(MODEL.noise, (effect_from_values("wheel_scale", {"e": 0.01}),))
    with pytest.raises(ModelError, match="wheel_scale is not noise"):
        FreePath(wide, inside, 1)
