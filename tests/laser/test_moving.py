"""People who walk with the robot: their returns are left out; a laser that sees hardly anything else is refused."""

import numpy as np
import pytest
import raycaster

from odomcorrupt.errors import OdomCorruptError
from odomcorrupt.laser.calibrate import calibrate
from odomcorrupt.laser.moving import without_moving
from odomcorrupt.laser.scans import read_sweeps
from odomcorrupt.study.io import Source
from odomcorrupt.study.io.reader import read_odometry, read_runs

PEOPLE_M = (0.75, -0.75)


def sweeps_of(path):
    return read_sweeps(path, "run", "/scan", "base_link")


@pytest.mark.slow
def test_returns_of_people_who_walk_with_the_robot_are_left_out_and_those_of_walls_and_boxes_stay(tmp_path):
    alone = sweeps_of(raycaster.drive(tmp_path / "alone.mcap", stated=(0.1, 0.0, 0.0)))
    path = raycaster.drive(tmp_path / "run.mcap", people_m=PEOPLE_M, stated=(0.1, 0.0, 0.0))
    both, (odometry, _) = sweeps_of(path), read_odometry(Source(path))
    found = without_moving(calibrate(both, odometry, int(odometry.stamps_ns[0])))
    left_out = {True: 0, False: 0}
    seen = {True: 0, False: 0}
    for before, sweep, kept in zip(alone.sweeps, both.sweeps, found.sweeps.sweeps, strict=True):
        _, own, other = np.intersect1d(sweep.after_s, before.after_s, return_indices=True)
        person = np.ones(len(sweep), dtype=bool)
        person[own] = np.linalg.norm(sweep.xy[own] - before.xy[other], axis=1) > 0.1
        gone = ~np.isin(sweep.after_s, kept.after_s)
        for is_person in (True, False):
            seen[is_person] += np.count_nonzero(person == is_person)
            left_out[is_person] += np.count_nonzero(gone & (person == is_person))
    assert left_out[True] > 0.8 * seen[True]
    assert left_out[False] < 0.01 * seen[False]
    assert "moving objects" in found.said[-1]


@pytest.mark.slow
def test_a_laser_that_sees_hardly_more_than_people_beside_the_robot_is_refused_in_one_line(tmp_path):
    path = raycaster.drive(tmp_path / "run.mcap", people_m=(0.5, -0.5), field=True, stated=(0.1, 0.0, 0.0))
    with pytest.raises(OdomCorruptError, match="what moves with the robot") as refused:
        read_runs(Source(path, scan="/scan"))
    assert "\n" not in str(refused.value)
