"""Errors of an estimate are evo's where stamps agree, and failures are found when they happen."""

import numpy as np
import pytest

from evo_oracle import as_evo, evo_metrics
from odomcorrupt.geometry.se2 import Increments, accumulate, compose
from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.scoring.errors import Limits, ScoreError, path_errors

N = 1200
STAMPS = 10**18 + np.arange(N) * 100_000_000


def truth_path():
    turn = 0.03 * np.sin(np.arange(N - 1) / 40.0)
    return accumulate(np.array([3.0, -2.0, 1.0]), Increments(np.full(N - 1, 0.04), np.zeros(N - 1), turn))


def estimate_path(seed):
    rng = np.random.default_rng(seed)
    draws = rng.standard_normal((N, 3)) * [0.02, 0.02, 0.01] + np.linspace(0.0, 0.5, N)[:, None] * [1.0, -0.5, 0.3]
    return compose(np.array([-7.0, 4.0, -1.2]), compose(truth_path(), draws))


def trajectory(xyt, stamps=STAMPS):
    return Trajectory(stamps, xyt)


@pytest.mark.parametrize("align", ["rigid", "origin", "none"])
def test_ate_and_rpe_are_evos_for_every_alignment(align):
    metrics = evo_metrics()
    truth, own = truth_path(), estimate_path(1)
    reference, estimate = as_evo(truth, STAMPS), as_evo(own, STAMPS)
    if align == "rigid":
        estimate.align(reference, correct_scale=False)
    elif align == "origin":
        estimate.align_origin(reference)
    ape = metrics.APE(metrics.PoseRelation.translation_part)
    ape.process_data((reference, estimate))
    heading = metrics.APE(metrics.PoseRelation.rotation_angle_rad)
    heading.process_data((reference, estimate))
    rpe = metrics.RPE(metrics.PoseRelation.translation_part, delta=1.0, delta_unit=metrics.Unit.meters, all_pairs=False)
    rpe.process_data((reference, estimate))
    found = path_errors(trajectory(own), trajectory(truth), align=align).metrics()
    assert found["ate_m"] == pytest.approx(ape.get_statistic(metrics.StatisticsType.rmse), rel=1e-6)
    assert found["ate_rad"] == pytest.approx(heading.get_statistic(metrics.StatisticsType.rmse), rel=1e-6)
    assert found["max_m"] == pytest.approx(ape.get_statistic(metrics.StatisticsType.max), rel=1e-6)
    assert found["end_m"] == pytest.approx(ape.error[-1], rel=1e-6)
    assert found["rpe_m"] == pytest.approx(rpe.get_statistic(metrics.StatisticsType.rmse), rel=1e-6)


def test_the_10_s_error_is_evos_rpe_of_a_hundred_frames():
    metrics = evo_metrics()
    rpe = metrics.RPE(metrics.PoseRelation.translation_part, delta=100, delta_unit=metrics.Unit.frames, all_pairs=False)
    rpe.process_data((as_evo(truth_path(), STAMPS), as_evo(estimate_path(1), STAMPS)))
    found = path_errors(trajectory(estimate_path(1)), trajectory(truth_path())).metrics()
    assert found["error_10s_m"] == pytest.approx(rpe.get_statistic(metrics.StatisticsType.rmse), rel=1e-6)


def test_the_truth_is_interpolated_where_stamps_differ():
    late = STAMPS[:-1] + 50_000_000
    truth = trajectory(truth_path())
    between = truth.at((late - STAMPS[0]) * 1e-9, int(STAMPS[0]))
    assert path_errors(trajectory(between, late), truth, align="none").metrics()["ate_m"] < 1e-9


@pytest.mark.parametrize("turned", [0.0, 2.0])
def test_nees_of_the_right_covariance_is_one_however_the_map_is_turned(turned):
    rng = np.random.default_rng(3)
    root = np.array([[0.05, 0.0, 0.0], [0.03, 0.02, 0.0], [0.0, 0.01, 0.02]])
    own = truth_path() + rng.standard_normal((N, 3)) @ root.T
    covariance = np.broadcast_to(root @ root.T, (N, 3, 3))
    frame = np.array([5.0, 1.0, turned])
    turn = np.eye(3)
    turn[:2, :2] = [[np.cos(turned), -np.sin(turned)], [np.sin(turned), np.cos(turned)]]
    found = path_errors(
        trajectory(compose(frame, own)), trajectory(truth_path()), covariance=turn @ covariance @ turn.T
    ).metrics()
    assert found["nees"] == pytest.approx(1.0, abs=0.1)
    assert found["inside_95"] == pytest.approx(0.95, abs=0.02)


def with_jump(size_m, from_s, to_s):
    own = truth_path()
    t_s = np.arange(N) * 0.1
    own[(t_s >= from_s) & (t_s < to_s), 0] += size_m
    return path_errors(trajectory(own), trajectory(truth_path()), align="none")


def test_a_loss_is_reported_when_it_begins_and_only_where_it_lasts():
    limits = Limits(lost_m=1.0, lost_s=10.0)
    assert with_jump(1.5, 30.0, 38.0).failure(limits) is None
    lost = with_jump(1.5, 30.0, 45.0).failure(limits)
    assert (lost.kind, lost.t_s) == ("lost", pytest.approx(30.0))
    assert lost.distance_m == pytest.approx(0.04 * 300, rel=1e-3)
    assert with_jump(1.5, 118.0, 1e9).failure(limits).kind == "lost"
    assert with_jump(15.0, 30.0, 1e9).failure(limits).kind == "diverged"


def test_jumps_are_counted_both_ways():
    assert len(with_jump(0.6, 30.0, 31.0).jumps(Limits(jump_m=0.5))) == 2
    assert len(with_jump(0.4, 30.0, 31.0).jumps(Limits(jump_m=0.5))) == 0


def test_coverage_is_of_the_path_and_not_of_the_time():
    half = path_errors(trajectory(truth_path()[: N // 2], STAMPS[: N // 2]), trajectory(truth_path()))
    assert half.coverage == pytest.approx(0.5, abs=0.01)
    parked = np.concatenate((truth_path(), np.repeat(truth_path()[-1:], N, axis=0)))
    stamps = 10**18 + np.arange(2 * N) * 100_000_000
    assert path_errors(trajectory(truth_path()), Trajectory(stamps, parked)).coverage == pytest.approx(1.0)


def test_positions_alone_have_an_ate_and_no_rpe():
    own = truth_path()
    own[:, 2] = np.nan
    found = path_errors(trajectory(own), trajectory(truth_path())).metrics()
    assert found["ate_m"] < 1e-9
    assert np.isnan(found["rpe_m"])


def test_another_clock_is_said_with_both_spans():
    with pytest.raises(ScoreError, match=r"no time in common.*0\.000 to.*use_sim_time"):
        path_errors(trajectory(truth_path(), STAMPS - 10**18), trajectory(truth_path()))
