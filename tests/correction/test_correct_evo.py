"""A robot learned on one drive, corrected on another: evo's errors against the truth fall."""

from __future__ import annotations

from copy import deepcopy

import numpy as np
import pytest
from bag_contents import rows_of

from odomcorrupt.cli import run
from odomcorrupt.simulation import simulate, write_mcap

ROBOT = 41


def recorded(path, seed, cause, route):
    with path.open("wb") as file:
        write_mcap(simulate(seed, cause, duration_s=240.0, robot_seed=ROBOT, route=route), file)
    return path


def as_evo(xyt):
    trajectory = pytest.importorskip("evo.core.trajectory", reason="evo is not installed; it is the oracle here")
    half, none = xyt[:, 2] / 2.0, np.zeros(len(xyt))
    return trajectory.PosePath3D(
        positions_xyz=np.column_stack((xyt[:, :2], none)),
        orientations_quat_wxyz=np.column_stack((np.cos(half), none, none, np.sin(half))),
    )


def evo_errors(bag):
    """Return evo's APE (m), and its RPE over 5 m (m, degrees), of /odom against the truth at its stamps."""
    metrics = pytest.importorskip("evo.core.metrics", reason="evo is not installed; it is the oracle here")
    from evo.core.units import Unit

    odometry, truth = rows_of(bag, "/odom"), rows_of(bag, "/ground_truth")
    since, unwrapped = truth.stamps_ns[0], np.unwrap(truth.xyt[:, 2])
    inside = (odometry.stamps_ns >= since) & (odometry.stamps_ns <= truth.stamps_ns[-1])
    at = odometry.stamps_ns[inside] - since
    columns = (truth.xyt[:, 0], truth.xyt[:, 1], unwrapped)
    seen = np.column_stack([np.interp(at, truth.stamps_ns - since, column) for column in columns])
    reference, estimate = as_evo(seen), as_evo(odometry.xyt[inside])
    found = []
    aligned = deepcopy(estimate)
    aligned.align(reference)
    ape = metrics.APE(metrics.PoseRelation.translation_part)
    ape.process_data((reference, aligned))
    found.append(ape.get_statistic(metrics.StatisticsType.rmse))
    for relation in (metrics.PoseRelation.translation_part, metrics.PoseRelation.rotation_angle_deg):
        rpe = metrics.RPE(relation, delta=5.0, delta_unit=Unit.meters)
        rpe.process_data((reference, estimate))
        found.append(rpe.get_statistic(metrics.StatisticsType.rmse))
    return np.array(found)


@pytest.mark.slow
@pytest.mark.parametrize("cause", ["unequal_wheels", "wheelbase", ("side_slip", "unequal_wheels"), "slope"])
def test_the_error_falls_on_a_drive_that_was_not_fitted(tmp_path, cause):
    pytest.importorskip("evo", reason="evo is not installed; it is the oracle here")
    fitted = recorded(tmp_path / "fitted.mcap", 1, cause, "office")
    other = recorded(tmp_path / "other.mcap", 2, cause, "loops")
    model, corrected = tmp_path / "robot.toml", tmp_path / "corrected.mcap"
    assert run(["learn", str(fitted), "-o", str(model)]) == 0
    began = ",".join(map(str, rows_of(other, "/ground_truth").xyt[0]))
    assert run(["correct", "-v", str(other), str(corrected), "--model", str(model), "--start", began]) == 0
    before, after = evo_errors(other), evo_errors(corrected)
    bends = cause != "slope"  # a slope shifts the robot and leaves its heading alone
    assert (after[:2] < 0.6 * before[:2]).all()
    assert after[2] < (0.6 if bends else 1.2) * before[2]
