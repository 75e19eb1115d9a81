"""A driver who steers by the truth: turns that respond to noise are not taken for an odometry error."""

import numpy as np
import pytest
from wandering import recording

from odomcorrupt.geometry.se2 import Increments, accumulate
from odomcorrupt.study.select.selection import learn


def kept_on_a_line(seed: int, seconds: float = 600.0):
    """Return a drive at two speeds along one line, by somebody who takes its turns back in two seconds."""
    rng = np.random.default_rng(seed)
    n = int(seconds * 50.0)
    way = np.where(np.arange(n) // 1000 % 2, 0.006, 0.016)
    kicks = 0.02 * np.sqrt(way) * rng.standard_normal(n)
    heading, turned, true = 0.0, np.zeros(n), np.zeros(n)
    for i in range(n):
        turned[i] = -0.01 * heading
        true[i] = turned[i] + kicks[i]
        heading += true[i]
    zero = np.zeros(n)
    odometry = accumulate(np.zeros(3), Increments(way, zero, turned))
    return recording(Increments(way, zero, true), odometry, truth_mm=1.0, truth_rad=0.001, seed=seed)


@pytest.mark.slow
@pytest.mark.parametrize(
    "seed",
    [4, 8],
)
def test_nothing_is_learned_from_a_driver_who_steers_back(seed):
    learned = learn([kept_on_a_line(seed)])
    assert learned.added == ()
    assert learned.unknown == ()
