"""A problem posed after an earlier one: what is the same of both is shared, and nothing else."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from hidden import as_recording

from odomcorrupt.effects import effect_from_values
from odomcorrupt.simulation import simulate
from odomcorrupt.study.estimate.config import choose_approach
from odomcorrupt.study.estimate.gauss_newton import fit
from odomcorrupt.study.estimate.intervals import Intervals
from odomcorrupt.study.estimate.problem import pose_problem
from odomcorrupt.study.io.clock import Clock
from odomcorrupt.study.select.elimination import drop_term
from odomcorrupt.study.terms.regressors import driving_motion

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
        assert np.array_equal(getattr(after.nodes, field.name), getattr(alone.nodes, field.name))
    for name in ("v", "omega", "acceleration", "x", "theta", "distance"):
        assert np.array_equal(getattr(after.motions[0], name), getattr(alone.motions[0], name))
    assert (after.smoothers == earlier.smoothers) == (clock == Clock())


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
    assert np.array_equal(posed.nodes.residual, alone.nodes.residual)
    assert not np.array_equal(posed.nodes.residual, bare.nodes.residual)
