"""Single wrong poses are left out, however small their error, and no others."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from odomcorrupt.geometry.se2 import wrap
from odomcorrupt.simulation import simulate, write_mcap
from odomcorrupt.study.estimate.calibrate import fit_robot
from odomcorrupt.study.io import Source, read_runs
from odomcorrupt.study.io.jumps import reach_of, stretches
from odomcorrupt.study.io.raw_trajectory import Samples
from odomcorrupt.study.validate.compare import compare


@pytest.fixture(scope="module")
def office():
    return simulate(31, None, duration_s=60.0)


def read(folder, run):
    write_mcap(run, folder / "run.mcap")
    return read_runs(Source(folder / "run.mcap", track_m=run.track_m))


def spoilt(run, rows, error_xyt):
    """The run with errors (k, 3) on some poses of its truth."""
    xyt = run.truth_xyt.copy()
    xyt[rows] += error_xyt
    xyt[:, 2] = wrap(xyt[:, 2])
    return replace(run, truth_xyt=xyt)


def left_out(run, recordings):
    """Rows of the truth that no recording has, those at the ends aside."""
    kept = np.concatenate([r.truth.stamps_ns for r in recordings])
    return set(np.flatnonzero(~np.isin(run.truth_stamps_ns, kept)))


@pytest.mark.parametrize("parts", [(0, 0, 0.5), (0.5, 0.5, 0.5), (0.5, 0.5, 0)])
def test_swapped_markers_are_left_out_and_their_neighbours_are_kept(tmp_path, office, parts):
    rng = np.random.default_rng(5)
    rows = np.flatnonzero(rng.random(len(office.truth_xyt)) < 0.005)
    error = rng.normal(size=(len(rows), 3)) * parts
    (recording,) = read(tmp_path, spoilt(office, rows, error))
    out = left_out(office, [recording])
    assert out <= set(rows)
    # by less than that a pose may be off by noise
    off = np.maximum(np.linalg.norm(error[:, :2], axis=1), np.abs(error[:, 2]))
    assert set(rows[off > 0.12]) <= out
    (note,) = (note for note in recording.notes if "outliers" in note)
    assert f"{len(out)} outliers (jumps there and back) left out" in note


def test_headings_that_are_wrong_for_a_moment_never_cut_the_run(tmp_path, office):
    """Near what counts as a jump (.3 rad), one side of it is one and the other not."""
    cases = list(product((0.2, 0.29, 0.3, 0.31, 0.5, 3.0), (1, 2, 3)))
    first = np.linspace(500, len(office.truth_xyt) - 500, len(cases), dtype=int)
    rows = np.concatenate([k + np.arange(length) for k, (_, length) in zip(first, cases, strict=True)])
    errors = np.repeat([error for error, _ in cases], [length for _, length in cases])
    recordings = read(tmp_path, spoilt(office, rows, errors[:, None] * [0.0, 0.0, 1.0]))
    assert len(recordings) == 1
    assert left_out(office, recordings) == set(rows)


def fixes(seed, spikes_m, *, lasting_m=0.0):
    """Return 60 s of fixes at 10 Hz of a robot at 0.6 m/s, each off by 0.1 m, with spikes and a jump that lasts."""
    rng = np.random.default_rng(seed)
    t_s = np.arange(600) / 10.0
    xyz = np.column_stack((0.6 * t_s, np.zeros((600, 2)))) + rng.normal(size=(600, 3)) * (0.1, 0.1, 0.0)
    rows = np.linspace(20, 580, len(spikes_m), dtype=int)
    xyz[rows, 1] += spikes_m
    xyz[300:, 1] += lasting_m
    stamps_ns, nothing = (t_s * 1e9).astype(np.int64), np.full(600, np.nan)
    return rows, Samples("run: /uwb", "/uwb", "map", stamps_ns, xyz, nothing, stamps_ns, nothing)


SPEEDS = np.array([0.6, 0.0])


@pytest.mark.parametrize("seed", range(4))
def test_no_fix_that_is_off_cuts_the_run_however_far_it_is_off(seed):
    """Near what counts as a jump (2 m), the step to it may be one and the step back not: the run was cut there."""
    rows, path = fixes(seed, np.linspace(1.0, 3.5, 29))
    reach = replace(reach_of(path, path), rate=4.0 * SPEEDS, top=SPEEDS)
    found = stretches(path, reach)
    assert len(found.rows) == 1
    assert set(np.delete(np.arange(600), found.rows[0])) >= set(rows[5:])
    assert found.outliers <= len(rows)


@pytest.mark.parametrize("lasting_m", [-4.0, 4.0])
def test_a_jump_of_fixes_that_lasts_cuts_the_run_there(lasting_m):
    _, path = fixes(1, [], lasting_m=lasting_m)
    found = stretches(path, replace(reach_of(path, path), rate=4.0 * SPEEDS, top=SPEEDS))
    assert [list(rows[[0, -1]]) for rows in found.rows] == [[0, 299], [300, 599]]
    assert not found.outliers


@pytest.mark.slow
def test_a_truth_with_swapped_markers_is_judged_like_the_clean_one(tmp_path):
    office = simulate(31, None, duration_s=120.0)
    rng = np.random.default_rng(6)
    rows = np.flatnonzero(rng.random(len(office.truth_xyt)) < 0.005)
    error = rng.normal(size=(len(rows), 3)) * [0.0, 0.0, 0.5]
    errors = []
    for run in (office, spoilt(office, rows, error)):
        recordings = read(tmp_path, run)
        model = fit_robot(recordings, (), law_name="diffusion").model
        found = compare(recordings, {"own": model})
        errors.append(found.evaluations[0].ten_second_error_m)
    assert errors[1] == pytest.approx(errors[0], rel=0.1)


def test_a_map_that_is_turned_for_good_still_cuts_the_run(tmp_path, office):
    rows = np.arange(len(office.truth_xyt) // 2, len(office.truth_xyt))
    recordings = read(tmp_path, spoilt(office, rows, [0.0, 0.0, 0.8]))
    assert len(recordings) == 2
    assert not left_out(office, recordings)


def test_a_tracker_with_bad_moments_is_accepted(tmp_path, office):
    """White noise ten times as large for half of the time is noise, not outliers."""
    rng = np.random.default_rng(7)
    bad = np.flatnonzero(np.arange(len(office.truth_xyt)) % 1000 < 500)
    noise = rng.normal(size=(len(bad), 3)) * [0.01, 0.01, 0.02]
    (recording,) = read(tmp_path, spoilt(office, bad, noise))
    assert not left_out(office, [recording])
