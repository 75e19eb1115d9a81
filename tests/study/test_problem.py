"""A problem posed after an earlier one shares its unchanged parts, and only those."""

from dataclasses import fields, replace
from itertools import pairwise

import numpy as np
import pytest
from hidden import as_recording

from odomcorrupt.effects import effect_from_values
from odomcorrupt.geometry.se2 import increments
from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.simulation import simulate
from odomcorrupt.study.estimate.config import choose_approach
from odomcorrupt.study.estimate.gauss_newton import fit
from odomcorrupt.study.estimate.intervals import Intervals
from odomcorrupt.study.estimate.problem import pose_problem
from odomcorrupt.study.estimate.regressors import driving_motion
from odomcorrupt.study.io.clock import Clock
from odomcorrupt.study.select.candidates import drop_term

EFFECTS = (effect_from_values("wheel_scale", {"e": 0.02}), effect_from_values("accel_slip", {"k": 0.01}))


@pytest.fixture(scope="module")
def recording():
    return as_recording(simulate(93, "wheel_scale", duration_s=60.0))


@pytest.mark.parametrize("side", ["odometry", "truth"])
@pytest.mark.parametrize("clock", [Clock(), Clock(0.03)])
def test_a_problem_after_an_earlier_one_is_the_problem_by_itself(recording, side, clock):
    approach = replace(choose_approach([recording]), side=side)
    earlier = pose_problem([recording], approach=approach)
    after = pose_problem([recording], EFFECTS, [clock], approach=approach, before=earlier)
    alone = pose_problem([recording], EFFECTS, [clock], approach=approach)
    for field in fields(Intervals):
        assert np.array_equal(getattr(after.intervals, field.name), getattr(alone.intervals, field.name))
    for name in ("v", "omega", "acceleration", "x", "theta", "distance"):
        assert np.array_equal(getattr(after.motions[0], name), getattr(alone.motions[0], name))
    assert (after.smoothers == earlier.smoothers) == (clock == Clock())


def test_the_odometrys_own_motion_is_shared_between_offsets_of_its_clock(recording):
    approach = replace(choose_approach([recording]), side="odometry")
    earlier = pose_problem([recording], approach=approach)
    (now,) = pose_problem([recording], clocks=[Clock(0.03)], approach=approach, before=earlier).motions
    (before,) = earlier.motions
    assert now.acceleration is before.acceleration
    assert np.array_equal(now.v, before.v)
    assert not np.array_equal(now.t_s, before.t_s)
    assert not np.array_equal(now.x, before.x)


def test_nodes_are_the_same_samples_of_the_truth_for_every_clock(recording):
    approach = choose_approach([recording])
    plain, *others = (
        pose_problem([recording], clocks=[Clock(offset_s)], approach=approach).intervals.start_s
        for offset_s in (0.0, 0.003, -0.055, 0.21, -2.3)
    )
    for other in others:
        assert np.isin(other, plain[1:-1]).sum() >= len(plain) - 8
        assert np.isin(other, plain)[1:-1].all()


def test_accelerations_are_those_of_what_effects_leave(recording):
    problem = pose_problem([recording], EFFECTS, approach=choose_approach([recording]))
    left = driving_motion(problem.left[0], "odometry")
    assert np.array_equal(problem.motions[0].acceleration, left.acceleration)
    assert not np.array_equal(problem.motions[0].v, left.v)


def test_the_same_model_is_not_posed_again_and_one_with_a_dropped_effect_is(recording):
    fitted = fit([recording], [effect_from_values("wheel_scale", {"e": 0.02})], approach=choose_approach([recording]))
    problem = fitted.problem
    again = pose_problem([recording], problem.effects, problem.clocks, approach=problem.approach, before=problem)
    assert again is problem
    bare = drop_term(fitted, fitted.effects[0]).problem
    posed = pose_problem([recording], (), problem.clocks, approach=problem.approach, before=bare)
    alone = pose_problem([recording], (), problem.clocks, approach=problem.approach)
    assert np.array_equal(posed.intervals.residual, alone.intervals.residual)
    assert not np.array_equal(posed.intervals.residual, bare.intervals.residual)


def stretches(recording, *times_s):
    """Return the stretches of a recording whose truth jumps, each with the odometry from the beginning."""
    cut = []
    for i, (first_s, last_s) in enumerate(pairwise((0.0, *times_s, np.inf))):
        truth_s, own = recording.truth.seconds_since(recording.origin_ns), recording.odometry
        rows = (truth_s >= first_s) & (truth_s < last_s)
        known = recording.odometry_s <= truth_s[rows][-1] + 1.0
        jumped = recording.truth.xyt[rows] + (float(i), 0.5 * i, 0.0)
        truth = Trajectory(recording.truth.stamps_ns[rows], jumped)
        odometry = Trajectory(own.stamps_ns[known], own.xyt[known])
        cut.append(replace(recording, name=f"part {i}", clock="one", odometry=odometry, truth=truth))
    return cut


@pytest.mark.parametrize("side", ["odometry", "truth"])
def test_stretches_of_a_run_share_its_motion_and_pose_the_problem_that_each_poses_alone(recording, side):
    parts = stretches(recording, 17.3, 38.0)
    approach = replace(choose_approach([recording]), side=side)
    lever = effect_from_values("lever_arm", {"x": 0.1})
    tried = (lever, *EFFECTS, *(effect_from_values(name, {}) for name in ("slope", "time_offset", "region_slip")))
    together = pose_problem(parts, EFFECTS, [Clock(0.03)] * 3, approach=approach)
    apart = [pose_problem([part], EFFECTS, [Clock(0.03)], approach=approach) for part in parts]
    assert len(together.motions) == 1
    assert len(together.motions[0]) == len(recording.odometry) - 1
    for name in ("start_s", "residual", "share", "lever", "truth_xyt"):
        whole = np.concatenate([getattr(one.intervals, name) for one in apart])
        np.testing.assert_allclose(getattr(together.intervals, name), whole, rtol=0.0, atol=1e-12)
    # about a jump the motion of one stretch ends and that of the other begins
    inner = together.intervals.linked & np.append(together.intervals.linked[1:], True)
    for effect in tried:
        whole = np.concatenate([one.columns(effect) for one in apart])
        most = (1e-3 if side == "odometry" else 0.02) * np.abs(whole).max()
        np.testing.assert_allclose(together.columns(effect), whole, rtol=0.0, atol=most)
        if side == "odometry":
            np.testing.assert_allclose(together.columns(effect)[inner], whole[inner], rtol=0.0, atol=1e-7)


def test_recordings_with_clocks_or_odometry_of_their_own_share_no_motion(recording):
    first, second = stretches(recording, 30.0)
    approach = choose_approach([recording])
    changed = replace(second, odometry=Trajectory(second.odometry.stamps_ns, 1.01 * second.odometry.xyt))
    for parts, clocks in (
        ([first, second], [Clock(), Clock(0.1)]),
        ([first, changed], [Clock()] * 2),
        ([first, replace(second, clock="other")], [Clock()] * 2),
    ):
        assert len(pose_problem(parts, (), clocks, approach=approach).motions) == 2


def test_a_wheel_rolls_as_far_as_the_odometry_reports_also_if_speeds_are_the_truths(recording):
    wheels = replace(recording, track_m=0.4)
    sides = {side: driving_motion(wheels, side) for side in ("odometry", "truth")}
    steps = increments(recording.odometry.xyt)
    for arm_m in (0.2, -0.2):
        assert np.allclose(sides["truth"].rolled(arm_m)[1:], np.cumsum(steps.ds_m + arm_m * steps.dtheta_rad))
    # the scale hidden in this odometry is 2 %, so integrals of the truth's speeds end elsewhere
    speeds = np.cumsum(sides["truth"].v * sides["truth"].dt_s)
    assert abs(sides["odometry"].rolled(0.0)[-1] - sides["truth"].rolled(0.0)[-1]) < 1e-3 * abs(speeds[-1])
