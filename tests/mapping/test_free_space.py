"""Occupancy grids, free space of a robot in them, paths within it, and the thickness of walls."""

import numpy as np
import pytest
from packed import ROS1, ROS2, grid, scan

from odomcorrupt.corruption.path import NoisyPath
from odomcorrupt.effects import effect_from_values
from odomcorrupt.errors import BagError, MapError, ModelError, RecordingError, TopicError
from odomcorrupt.mapping.conditioned import FreePath, FreeRuns, free_paths, whole_path
from odomcorrupt.mapping.messages import FrameTree, _matrix, read_grid, read_scan
from odomcorrupt.mapping.occupancy_grid import (
    FREE,
    OCCUPIED,
    UNKNOWN,
    Constraint,
    Grid,
    canvas_for,
    draw_map,
    format_map,
    free_space,
    read_map,
    traverse,
)
from odomcorrupt.mapping.scan_map import MIN_NEIGHBOURS, WINDOW_M, added_thickness, distance_to_surface, wall_thickness
from odomcorrupt.model.motion_model import MotionModel, Noise, Step
from odomcorrupt.model.noise_laws import Coefficients, Variances
from odomcorrupt.model.presets import preset_named
from odomcorrupt.sampling.samples import move_between, move_sampled, move_sampled_in_map

RESOLUTION = 0.1

MODEL = MotionModel(preset_named("typical").noise)


def room(*walls):
    """Ten by ten metres about the origin; walls are boxes x0, y0, x1, y1."""
    cells = np.zeros((100, 100), dtype=np.uint8)
    for x0, y0, x1, y1 in walls:
        c = (np.array([x0, y0, x1, y1]) / RESOLUTION + 50).astype(int)
        cells[c[1] : c[3], c[0] : c[2]] = OCCUPIED
    return Grid(cells, RESOLUTION, np.array([-5.0, -5.0, 0.0]))


def drive(n=300):
    """Four metres along x in three seconds."""
    xyt = np.zeros((n, 3))
    xyt[:, 0] = np.linspace(0, 4, n)
    return np.arange(n) * 10**7, xyt


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


YAML = "image: m.pgm\nresolution: 0.1\norigin: [-1.0, 2.0, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.25\n"
PGM = b"P5\n# by a camera\n3 1\n255\n\x00\x80\xfe"


def written(tmp_path, yaml=YAML, pgm=b"P5\n2 1\n255\n\x00\xfe"):
    (tmp_path / "m.pgm").write_bytes(pgm)
    (tmp_path / "m.yaml").write_text(yaml)
    return tmp_path / "m.yaml"


def test_written_map_reads_back(tmp_path):
    cells = np.random.default_rng(1).integers(0, 3, (7, 11)).astype(np.uint8)
    grid = Grid(cells, 0.05, np.array([-3.5, 1.25, 0.5]))
    image, text = format_map(grid, "m.pgm")
    back = read_map(written(tmp_path, text, image))
    np.testing.assert_array_equal(back.cells, cells)
    np.testing.assert_allclose(back.origin_xyt, grid.origin_xyt)
    assert back.resolution_m == 0.05


def test_first_row_of_the_image_is_the_top(tmp_path):
    grid = read_map(written(tmp_path, pgm=b"P5 1 2 255\n\x00\xfe"))
    xy = np.array([[-0.95, 2.05], [-0.95, 2.15], [-0.95, 2.25], [np.nan, 2.05]])
    assert grid.states(xy).tolist() == [FREE, OCCUPIED, UNKNOWN, UNKNOWN]


def test_turned_map_is_looked_up_in_its_own_axes():
    grid = Grid(np.array([[FREE, OCCUPIED]], dtype=np.uint8), 1.0, np.array([5.0, 5.0, np.pi / 2]))
    assert grid.states(np.array([[4.5, 5.5], [4.5, 6.5], [5.5, 5.5]])).tolist() == [FREE, OCCUPIED, UNKNOWN]


@pytest.mark.parametrize(
    ("extra", "states"),
    [
        ("", [OCCUPIED, UNKNOWN, FREE]),
        ("negate: 1\n", [FREE, UNKNOWN, OCCUPIED]),
        ("mode: raw\n", [FREE, UNKNOWN, UNKNOWN]),  # 0 %, 128 % and 254 %
    ],
)
def test_modes_mean_what_map_server_means(tmp_path, extra, states):
    yaml = YAML.replace("negate: 0\n", "") + extra
    assert read_map(written(tmp_path, yaml, PGM)).cells[0].tolist() == states


@pytest.mark.parametrize(
    ("yaml", "pgm", "word"),
    [
        ("image: m.pgm\n", b"", "resolution"), (YAML.replace("0.1", "-1"), PGM, "resolution"),
        (YAML.replace("0.65", "0.2"), PGM, "occupied_thresh 0.2"),
        (YAML.replace("0.1", "!!python/object:os.system"), PGM, "number"),
        (YAML.replace("[-1.0, 2.0, 0]", "[1, 2]"), PGM, "x, y, yaw"),
        (YAML.replace("m.pgm", "/dev/zero"), PGM, "outside of the map"),
        (YAML.replace("m.pgm", "gone.pgm"), PGM, "No such file"), (YAML + "mode: odd\n", PGM, "trinary"),
        (YAML, b"\x89PNG....", "PGM"), (YAML, b"P5 900000000 900000000 255\n\x00", "at most 50,000,000"),
        (YAML, b"P5 2 2 65535\n" + bytes(8), "damaged"), (YAML, b"P5 0 2 255\n" + bytes(8), "damaged"),
    ],
)  # fmt: skip
def test_map_that_makes_no_sense_is_reported_in_one_sentence(tmp_path, yaml, pgm, word):
    with pytest.raises(MapError, match=word):
        read_map(written(tmp_path, yaml, pgm))


def test_missing_and_binary_yaml(tmp_path):
    with pytest.raises(MapError, match="cannot be read"):
        read_map(tmp_path / "none.yaml")
    (tmp_path / "b.yaml").write_bytes(b"\0" * 100)
    with pytest.raises(MapError, match=r"\.yaml"):
        read_map(tmp_path / "b.yaml")


def test_saved_unknown_is_not_free_whatever_the_threshold(tmp_path):
    assert read_map(written(tmp_path, pgm=b"P5 1 1 255\n\xcd")).cells[0, 0] == UNKNOWN


def crossed(start, end):
    """Cells of a line by walking it in ten thousand steps: all that it spends a visible length in."""
    points = start + np.linspace(0, 1, 10_001)[:, None] * (end - start)
    cells, counts = np.unique(np.floor(points).astype(int), axis=0, return_counts=True)
    return {tuple(c) for c, n in zip(cells, counts, strict=True) if n > 3}, {tuple(c) for c in cells}


def test_traverse_gives_every_cell_once_but_the_last():
    rng = np.random.default_rng(3)
    start, end = rng.uniform(-8, 8, (60, 2)), rng.uniform(-8, 8, (60, 2))
    start[:10, 0] = end[:10, 0]  # upright
    start[10:20, 1] = end[10:20, 1]  # level
    end[20:25] = start[20:25]  # nowhere
    walked = [[] for _ in start]
    for number, cell in traverse(start, end):
        for i, c in zip(number, cell, strict=True):
            walked[i].append(tuple(int(v) for v in c))
    for i, cells in enumerate(walked):
        certain, possible = crossed(start[i], end[i])
        last = tuple(np.floor(end[i]).astype(int))
        assert len(set(cells)) == len(cells)
        assert last not in cells
        assert certain - {last} <= set(cells) <= possible | {last}


def test_rays_free_what_they_pass_and_occupy_where_they_end():
    angle = np.linspace(0, 2 * np.pi, 4000, endpoint=False)
    ends = 2.0 * np.column_stack((np.cos(angle), np.sin(angle)))
    canvas = canvas_for(ends, 0.1)
    grid = draw_map(canvas, np.zeros_like(ends), ends)
    assert (grid.states(ends) == OCCUPIED).mean() > 0.97
    assert (grid.states(0.85 * ends) == FREE).all()
    assert (grid.states(1.15 * ends) == UNKNOWN).all()


def test_thing_that_moved_away_is_free():
    """One ray ended where a hundred passed."""
    ends = np.array([[1.05, 0.05], *[[2.05, 0.05]] * 100])
    grid = draw_map(canvas_for(np.array([[-1.0, -1.0], [3.0, 1.0]]), 0.1), np.full_like(ends, 0.05), ends)
    assert grid.states(ends[:2]).tolist() == [FREE, OCCUPIED]


def test_map_of_a_continent_is_refused():
    with pytest.raises(RecordingError, match="coarser resolution"):
        canvas_for(np.array([[0, 0], [1e6, 1e6]]), 0.05)
    with pytest.raises(RecordingError):
        canvas_for(np.array([[0, 0], [np.inf, 1]]), 0.05)


@pytest.mark.parametrize("angle", [0.0, 0.4, 1.2])
@pytest.mark.parametrize("sd", [0.01, 0.05])
def test_straight_wall_has_the_thickness_it_was_made_with(angle, sd):
    rng = np.random.default_rng(1)
    along, across = rng.uniform(-10, 10, 20_000), rng.normal(scale=sd, size=20_000)
    points = np.column_stack((along * np.cos(angle), along * np.sin(angle)))
    points += across[:, None] * [-np.sin(angle), np.cos(angle)]
    assert wall_thickness(points + np.array([300.0, -40.0])) == pytest.approx(sd, rel=0.05)


def test_it_is_the_mean_plane_variance_written_as_a_loop():
    rng = np.random.default_rng(2)
    points = rng.uniform(0, 3, (400, 2))
    half, smallest = round(WINDOW_M / 2 / 0.02), []
    # whole cells, as the windows are
    shift = np.floor((points - (points.min(axis=0) - 0.04)) / 0.02)
    for i in range(len(points)):
        near = (np.abs(shift - shift[i]) <= half).all(axis=1)
        if near.sum() >= MIN_NEIGHBOURS:
            smallest.append(np.linalg.eigvalsh(np.cov(points[near].T, bias=True))[0])
    assert wall_thickness(points) == pytest.approx(np.sqrt(np.mean(smallest)), rel=1e-9)


def test_doubled_wall_is_half_the_gap_thick():
    x = np.linspace(0, 20, 5000)
    walls = np.concatenate([np.column_stack((x, np.full_like(x, y))) for y in (0.0, 0.2)])
    assert wall_thickness(walls) == pytest.approx(0.1, rel=0.02)


def test_lonely_points_have_no_thickness():
    assert np.isnan(wall_thickness(np.array([[0.0, 0.0], [100.0, 0.0]])))


def test_noise_adds_what_it_adds_whatever_was_there():
    clean = np.array([0.03, 0.04, 0.05])
    np.testing.assert_allclose(added_thickness(clean, np.hypot(clean, 0.02)), 0.02)
    assert added_thickness(clean, clean / 2).tolist() == [0.0, 0.0, 0.0]


def test_hits_are_measured_across_the_clean_wall_and_grow_with_the_drive():
    """Walls shifted and turned as a whole keep their thickness; hits off the clean walls show it."""
    rng = np.random.default_rng(4)
    x = rng.uniform(0.0, 10.0, 4000)
    clean = np.concatenate(
        (np.column_stack((x, np.full(4000, 2.0))), np.column_stack((np.full(4000, 12.0), rng.uniform(-5.0, 0.0, 4000))))
    ) + rng.normal(scale=0.01, size=(8000, 2))
    moved = clean + np.array([0.3, 0.4])
    off = distance_to_surface(clean, moved)
    known = np.isfinite(off)
    assert known.mean() > 0.9
    np.testing.assert_allclose(off[:4000][known[:4000]], 0.4, atol=0.02)
    np.testing.assert_allclose(off[4000:][known[4000:]], 0.3, atol=0.02)
    assert wall_thickness(moved) == pytest.approx(wall_thickness(clean), rel=1e-3)
    blob = rng.normal(scale=0.2, size=(4000, 2))
    assert np.isfinite(distance_to_surface(blob, blob + 1.0)).mean() < 0.2


def tree(*edges):
    out = FrameTree()
    for parent, child, position, quat in edges:
        out._static[child] = (parent, _matrix(np.array(position), np.array(quat, dtype=float)))
    return out


def test_laser_over_a_common_ancestor():
    half = np.sqrt(0.5)
    mount = tree(
        ("base_footprint", "base_link", (0, 0, 0.1), (0, 0, 0, 1)),
        ("base_footprint", "tower", (0.2, 0.1, 0.3), (0, 0, half, half)),
        ("tower", "laser", (0.1, 0, 0), (0, 0, 0, 2)),  # a quaternion of length two
    ).mount("base_link", "/laser", "bag")
    np.testing.assert_allclose(mount.position_xy, [0.2, 0.2], atol=1e-12)
    np.testing.assert_allclose(mount.plane @ [1, 0], [0, 1], atol=1e-12)


def test_laser_hung_upside_down_mirrors():
    mount = tree(("base", "laser", (0, 0, 1), (1, 0, 0, 0))).mount("base", "laser", "bag")
    np.testing.assert_allclose(mount.plane @ [np.cos(0.3), np.sin(0.3)], [np.cos(0.3), -np.sin(0.3)], atol=1e-12)


def test_missing_link_and_loop_are_reported():
    with pytest.raises(TopicError, match="laser_pose"):
        tree(("a", "b", (0, 0, 0), (0, 0, 0, 1)), ("b", "a", (0, 0, 0), (0, 0, 0, 1))).mount("base", "a", "bag")


@pytest.mark.parametrize(("store", "encoding"), [(ROS2, "cdr"), (ROS1, "ros1")])
def test_scan_of_another_writer_is_read(store, encoding):
    for frame in ("laser", "a", "base_scan_link"):  # strings of all alignments
        read = read_scan(scan([1.0, np.inf, 2.5], store, frame=frame), "/scan", encoding)
        assert (read.stamp_ns, read.frame_id) == (5_000_000_007, frame)
        assert (read.angle_min, read.angle_step, read.range_max_m) == (-0.5, 0.25, 10.0)
        assert read.time_step_s == pytest.approx(1e-3)
        assert read.ranges_m.tolist() == [1.0, np.inf, 2.5]


@pytest.mark.parametrize(("store", "encoding"), [(ROS2, "cdr"), (ROS1, "ros1")])
def test_grid_of_another_writer_is_read(store, encoding):
    cells = np.array([[0, 100, -1], [50, 0, 0]])
    read = read_grid(grid(cells, store), "/map", encoding)
    np.testing.assert_array_equal(read.cells, cells)
    np.testing.assert_allclose(read.origin_xyt, [1.0, -2.0, 0.4])
    assert read.resolution_m == pytest.approx(0.05)


@pytest.mark.parametrize(
    ("make", "read"), [(lambda: scan([1.0] * 5), read_scan), (lambda: grid(np.zeros((3, 3))), read_grid)]
)
def test_cut_message_is_an_error_at_every_byte(make, read):
    whole = make()
    end = len(whole) - (12 if read is read_scan else 0)  # intensities are never looked at
    for size in range(end):
        with pytest.raises(BagError):
            read(whole[:size], "/topic", "cdr")


def test_claimed_size_is_held_against_the_bytes():
    whole = bytearray(grid(np.zeros((3, 3))))
    at = whole.index((3).to_bytes(4, "little") + (3).to_bytes(4, "little"))
    whole[at : at + 4] = (2**31).to_bytes(4, "little")
    with pytest.raises(BagError, match="carries 9"):
        read_grid(bytes(whole), "/map", "cdr")


def test_other_encodings_are_named():
    with pytest.raises(BagError, match="json"):
        read_scan(b"{}", "/scan", "json")
