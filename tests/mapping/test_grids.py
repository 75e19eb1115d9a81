"""Occupancy grids: files, messages, frames, rays, and the thickness of walls."""

import numpy as np
import pytest
from packed import ROS1, ROS2, grid, scan

from odomcorrupt.errors import BagError, MapError, RecordingError, TopicError
from odomcorrupt.mapping.messages import FrameTree, _matrix, read_grid, read_scan
from odomcorrupt.mapping.occupancy_grid import (
    FREE,
    OCCUPIED,
    UNKNOWN,
    Grid,
    canvas_for,
    draw_map,
    format_map,
    read_map,
    traverse,
)
from odomcorrupt.mapping.scan_map import MIN_NEIGHBOURS, WINDOW_M, added_thickness, distance_to_surface, wall_thickness

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
