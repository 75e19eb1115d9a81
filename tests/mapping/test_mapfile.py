import time

import numpy as np
import pytest

from odomcorrupt.errors import MapError
from odomcorrupt.mapping.occupancy_grid import FREE, OCCUPIED, UNKNOWN, Grid, format_map, read_map

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
        ("image: m.pgm\n", b"", "resolution"),
        (YAML.replace("0.1", "-1"), PGM, "resolution"),
        (YAML.replace("0.1", "!!python/object:os.system"), PGM, "number"),
        (YAML.replace("[-1.0, 2.0, 0]", "[1, 2]"), PGM, "x, y, yaw"),
        (YAML.replace("m.pgm", "/dev/zero"), PGM, "outside of the map"),
        (YAML.replace("m.pgm", "gone.pgm"), PGM, "No such file"),
        (YAML + "mode: odd\n", PGM, "trinary"),
        (YAML, b"\x89PNG....", "PGM"),
        (YAML, b"P5 900000000 900000000 255\n\x00", "at most 50,000,000"),
        (YAML, b"P5 2 2 65535\n" + bytes(8), "damaged"),
        (YAML, b"P5 0 2 255\n" + bytes(8), "damaged"),
    ],
)
def test_map_that_makes_no_sense_is_reported_in_one_sentence(tmp_path, yaml, pgm, word):
    with pytest.raises(MapError, match=word):
        read_map(written(tmp_path, yaml, pgm))


def test_hostile_header_takes_no_time(tmp_path):
    began = time.perf_counter()
    with pytest.raises(MapError):
        read_map(written(tmp_path, pgm=b"P5" + b" #\n" * 2000))
    assert time.perf_counter() - began < 1.0


def test_missing_and_binary_yaml(tmp_path):
    with pytest.raises(MapError, match="cannot be read"):
        read_map(tmp_path / "none.yaml")
    (tmp_path / "b.yaml").write_bytes(b"\0" * 100)
    with pytest.raises(MapError, match=r"\.yaml"):
        read_map(tmp_path / "b.yaml")


def test_saved_unknown_is_not_free_whatever_the_threshold(tmp_path):
    assert read_map(written(tmp_path, pgm=b"P5 1 1 255\n\xcd")).cells[0, 0] == UNKNOWN
