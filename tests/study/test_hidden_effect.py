"""First test of the study: a random cause in a simulation that shares no formula with the effects."""

import numpy as np
import pytest
from hidden import as_recording, ten_second_error

from odomcorrupt.simulation import simulate, simulate_without
from odomcorrupt.study.io.clock import Clock
from odomcorrupt.study.select.selection import learn

SEEDS = (*range(100, 109), 113)
"""These draw every cause but unequal wheels, which test_library.py has."""
CAUSES = (
    "gyro_bias",
    "lever_arm",
    "mount_yaw",
    "side_slip",
    "time_offset",
    "unequal_wheels",
    "wheel_scale",
    "wheelbase",
)


def first_name(learned) -> str | None:
    """Return the first thing named: a clock that is off comes before anything else."""
    if learned.clocks.free[0][0]:
        return "time_offset"
    return learned.added[0] if learned.added else None


@pytest.mark.slow
def test_the_right_effect_is_first_and_the_held_out_error_falls_to_its_floor():
    right, ratios = [], []
    for seed in SEEDS:
        cause = np.random.default_rng((7, seed)).choice(CAUSES)
        run = simulate(seed, cause, duration_s=600.0)
        learned = learn([as_recording(run)])
        right.append(first_name(learned) == cause)
        # another drive of the same robot, with the flaw and without it
        options = {"duration_s": 300.0, "robot_seed": seed}
        judged = as_recording(simulate(seed + 1000, cause, **options))
        floor = as_recording(simulate_without(seed + 1000, cause, **options))
        after = ten_second_error([judged], learned.fit.effects, learned.fit.problem.clocks[0])
        ratios.append(after / ten_second_error([floor]))
    assert np.mean(right) >= 0.95
    assert np.mean(np.array(ratios) <= 1.1) >= 0.9, sorted(ratios)
    assert np.median(ratios) <= 1.02


@pytest.mark.slow
def test_nothing_is_added_where_nothing_is_hidden():
    added = [learn([as_recording(simulate(seed, None, duration_s=600.0))]) for seed in SEEDS[:8]]
    quiet = [not learned.added and learned.fit.problem.clocks == (Clock(),) for learned in added]
    assert sum(quiet) >= 7
