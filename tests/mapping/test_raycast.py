import numpy as np
import pytest

from odomcorrupt.errors import RecordingError
from odomcorrupt.mapping.occupancy_grid import FREE, OCCUPIED, UNKNOWN, canvas_for, draw_map, traverse


def crossed(start, end):
    """Cells of a line by walking it in ten thousand steps: all that it spends a visible length in."""
    points = start + np.linspace(0, 1, 10_001)[:, None] * (end - start)
    cells, counts = np.unique(np.floor(points).astype(int), axis=0, return_counts=True)
    return {tuple(c) for c, n in zip(cells, counts, strict=True) if n > 3}, {tuple(c) for c in cells}


def test_traverse_gives_every_cell_once_but_the_last():
    rng = np.random.default_rng(3)
    start, end = rng.uniform(-8, 8, (200, 2)), rng.uniform(-8, 8, (200, 2))
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
