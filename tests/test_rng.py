"""Streams of random numbers."""

from itertools import combinations, product

import numpy as np
import pytest

from odomcorrupt.errors import ModelError
from odomcorrupt.rng import SEED_LIMIT, draw_seed, stream

GOLDEN = [3682676098, 2229788546, 3194216964]


def test_a_stream_is_a_function_of_its_four_keys():
    keys = list(product((0, 1, 2**40), (0, 7), ("noise", "gyro_bias"), (0, 1)))
    first = {key: stream(*key).standard_normal(4) for key in keys}
    for key in keys:
        assert np.array_equal(stream(*key).standard_normal(4), first[key])
    for a, b in combinations(keys, 2):
        assert not np.isin(first[a], first[b]).any()


def test_a_stream_never_changes_between_versions():
    """A number that moves here makes every seed in every published result mean something else."""
    assert stream(7, 0, "noise").integers(0, 2**32, 3).tolist() == GOLDEN


def test_rows_of_normals_do_not_depend_on_how_they_are_cut():
    whole = stream(1, 0, "noise").standard_normal((500, 4))
    rng = stream(1, 0, "noise")
    assert np.array_equal(np.concatenate([rng.standard_normal((n, 4)) for n in (1, 0, 99, 400)]), whole)


def test_seeds_and_runs_out_of_range_are_refused():
    for seed in (-1, SEED_LIMIT):
        with pytest.raises(ModelError, match="seed"):
            stream(seed, 0, "noise")
    with pytest.raises(ModelError, match="runs are counted from 0"):
        stream(0, -1, "noise")


def test_drawn_seeds_are_in_range_and_differ():
    seeds = [draw_seed() for _ in range(50)]
    assert len(set(seeds)) > 45
    assert all(0 <= seed < 2**32 for seed in seeds)
