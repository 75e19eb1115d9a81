"""Windows of 10 s are found wherever the truth is known at both ends."""

from dataclasses import replace

import numpy as np
from wandering import noisy_path, recording, wander

from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.model.noise_laws import Coefficients
from odomcorrupt.study.estimate.windows import phased_misses, time_windows


def run_with_gaps(seconds, *unknown):
    """Return a drive whose truth has no samples in the given stretches, seconds since its first one."""
    steps = wander(1, seconds)
    run = recording(steps, noisy_path(steps, Coefficients(0.0, 0.0, 0.0, 0.0), 1), seed=1)
    at_s = (run.truth.stamps_ns - run.truth.stamps_ns[0]) * 1e-9
    kept = ~np.any([(at_s > a) & (at_s < b) for a, b in unknown], axis=0)
    return replace(run, truth=Trajectory(run.truth.stamps_ns[kept], run.truth.xyt[kept]))


def test_windows_restart_after_a_stretch_without_truth():
    """On one grid of 10 s no window would be complete: its ends are in the stretches."""
    windows = time_windows(run_with_gaps(40.0, (8.5, 12.5), (18.5, 24.0), (29.0, 31.5)))
    assert len(windows) == 3
    np.testing.assert_allclose(windows.end_s - windows.start_s, 10.0, atol=1.0)
    assert np.all(windows.start_s[1:] >= windows.end_s[:-1])


def test_a_grid_that_loses_few_windows_is_kept():
    windows = time_windows(run_with_gaps(60.5, (18.5, 22.0)))
    np.testing.assert_allclose(windows.start_s % 10.0, windows.start_s[0] % 10.0, atol=0.1)
    assert len(windows) == 4


def test_a_complete_truth_has_a_window_for_every_ten_seconds():
    assert [len(squared) for squared in phased_misses([run_with_gaps(60.5, (70.0, 80.0))])] == [6, 5, 5, 5, 5]
