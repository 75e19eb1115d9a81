"""Searched shapes reach the maximum of the likelihood, in any frame, with correct standard errors."""

import re
from dataclasses import fields, replace

import numpy as np
import pytest
from hidden import as_recording

from odomcorrupt.effects import effect_from_values
from odomcorrupt.geometry.motion import motion_of
from odomcorrupt.geometry.se2 import Increments, accumulate, increments
from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.simulation import simulate
from odomcorrupt.study.estimate.config import choose_approach
from odomcorrupt.study.estimate.gauss_newton import fit
from odomcorrupt.study.estimate.robust_errors import between_blocks, inflation, shared_variance, with_robust_errors
from odomcorrupt.study.select.selection import learn
from odomcorrupt.study.select.shape_search import maximise, starts
from odomcorrupt.study.terms.basis.motion import functions_of_motion
from odomcorrupt.study.terms.basis.place import _box, _strip
from odomcorrupt.study.terms.channels import Action
from odomcorrupt.study.terms.term import BasisTerm

FAR_AWAY = np.array([512_345.0, 4_998_765.0, 0.0])
"""Where a map in UTM may begin, m."""


def test_a_ridge_is_followed_to_its_top():
    # no single number moved alone gains anything on the way
    top = maximise(lambda v: -50.0 * (v[0] - v[1]) ** 2 - 5.0 * (v[0] + v[1] - 6.0) ** 2, np.zeros(2), np.full(2, 0.1))
    assert top == pytest.approx([3.0, 3.0], abs=0.05)


@pytest.mark.parametrize("side", ["left", "right", "wheels", "along"])
def test_a_step_is_searched_beside_a_hinge_of_the_same_regressor(side):
    motion = motion_of(np.arange(401) * 0.05, np.column_stack((np.linspace(0.0, 4.0, 401) ** 2, *np.zeros((2, 401)))))
    of_speed = [f for f in functions_of_motion([motion]) if f.regressor == "speed" and f.form]
    ranked = [BasisTerm(f, Action(side, "v")) for f in sorted(of_speed, key=lambda f: f.form)]
    assert [term.function.form for term in starts(ranked, 500.0)] == ["hinge", "step"]
    assert "where(abs(v) >" in next(f for f in of_speed if f.form == "step").text


@pytest.mark.slow
@pytest.mark.parametrize("seed", [84, 86])
def test_a_patch_is_found_as_far_as_its_errors_say_and_where_the_map_begins_far_away(seed):
    run = simulate(seed, "region_slip", duration_s=400.0)
    recording = as_recording(run)
    moved = Trajectory(recording.truth.stamps_ns, recording.truth.xyt + FAR_AWAY)
    here, there = (learn([r]) for r in (recording, replace(recording, truth=moved)))
    for learned, origin in ((here, np.zeros(3)), (there, FAR_AWAY)):
        (patch,) = learned.fit.effects
        sought = run.answer["parameters"]
        assert patch.name == "region_slip"
        assert abs(patch.slip - sought["slip"]) < 3.0 * learned.fit.standard_errors[0]
        assert patch.slip == pytest.approx(sought["slip"], rel=0.03)
        assert patch.radius == pytest.approx(sought["radius"], rel=0.15)
        assert (patch.x - origin[0], patch.y - origin[1]) == pytest.approx((sought["x"], sought["y"]), abs=0.15)
    assert there.error_m == pytest.approx(here.error_m, rel=0.02)


@pytest.mark.slow
def test_a_carpet_is_a_rectangle_and_is_continued_to_places_that_the_drive_does_not_reach():
    run = simulate(85, None, duration_s=300.0)
    recording = as_recording(run)
    truth, steps = recording.truth, increments(recording.odometry.xyt)
    x, y = (np.interp(recording.odometry.stamps_ns[:-1], truth.stamps_ns, truth.xyt[:, i]) for i in (0, 1))
    edge = float(np.median(x))
    turning = np.where(x > edge, 1.0 / 0.95, 1.0)
    slipping = Increments(*(turning * getattr(steps, f.name) for f in fields(steps)))
    odometry = replace(recording.odometry, xyt=accumulate(recording.odometry.xyt[0], slipping))
    (patch,) = learn([replace(recording, odometry=odometry)]).fit.effects
    assert patch.name == "region_slip"
    assert patch.slip == pytest.approx(0.05, rel=0.05)
    corners = [
        (edge + across, along) for across in (0.1, x.max() - edge + 0.3) for along in (y.min() - 0.3, y.max() + 0.3)
    ]
    inside = motion_of(np.arange(4.0), np.array([(*corner, 0.0) for corner in corners]))
    assert (patch._ratio(inside) < 0.0).all()
    left = motion_of(np.arange(2.0), np.array([(edge - 0.1, y.mean(), 0.0), (x.min(), y.mean(), 0.0)]))
    assert not patch._ratio(left).any()


def test_the_error_of_a_slip_grows_where_its_place_was_searched_too():
    run = simulate(84, "region_slip", duration_s=300.0)
    recording = as_recording(run)
    patch = effect_from_values("region_slip", run.answer["parameters"])
    fitted = fit([recording], [patch], approach=choose_approach([recording]))
    known, sought = (with_robust_errors(fitted, names).standard_errors[0] for names in ((), ("region_slip",)))
    assert known >= fitted.standard_errors[0]
    assert 1.1 * known < sought < 4.0 * known


def test_estimates_that_blocks_disagree_on_have_larger_errors():
    rng = np.random.default_rng(1)
    block, pull = np.repeat(np.arange(40), 30), np.ones((1200, 1))
    calm = rng.standard_normal(1200)
    told = []
    for together in (0.0, 1.0):  # what all innovations of a block share
        variance, dof = between_blocks(block, pull, calm + together * np.repeat(rng.standard_normal(40), 30))
        told.append(float(inflation(variance, dof, shared_variance(variance, dof))[0]))
    assert told[0] == pytest.approx(1.0, abs=0.3)
    assert told[1] == pytest.approx(31.0, rel=0.5)


@pytest.mark.parametrize("function", [_strip((0.3, *FAR_AWAY[:2], 0.6)), _box((0.3, *FAR_AWAY[:2], 0.6, 1.2))])
def test_a_place_far_from_the_origin_is_written_to_a_millimetre(function):
    assert "512345)" in function.text
    assert "4998765)" in function.text


def test_no_basis_function_hangs_on_an_acceleration_that_is_noise():
    recording = as_recording(simulate(87, None, duration_s=120.0))
    (motion,) = fit([recording], approach=choose_approach([recording])).problem.motions
    written = [
        float(function.text.split(" < ")[-1].split(" > ")[-1].split(",")[0])
        for function in functions_of_motion([motion])
        if "where(a * sign(v)" in function.text
    ]
    assert len(written) > 20
    assert min(map(abs, written)) >= 0.1


def test_no_hinge_and_no_step_hangs_on_the_last_of_a_range():
    recording = as_recording(simulate(87, None, duration_s=120.0))
    (motion,) = fit([recording], approach=choose_approach([recording])).problem.motions
    fastest = np.quantile(np.abs(motion.v), 0.99)
    late = [f for f in functions_of_motion([motion]) if f.regressor == "speed" and f.form]
    assert {f.form for f in late} == {"hinge", "step"}
    for function in late:
        # wherever a search moves the threshold, a tenth of the speeds lies beyond
        moved = function.with_shape((0.999 * fastest,)) if function.with_shape else function
        cut = float(re.search(r"abs\(v\) [->] ([\d.]+)", moved.text)[1])
        assert cut <= 0.901 * fastest
        assert np.mean(moved.parts[0](motion) > 0.0) > 0.01


def test_thresholds_reach_braking_that_is_rare():
    # ten minutes at 0.5 m/s with 9 s of hard braking in all: 1.5 % of the time, below the lowest of even quantiles
    t_s = np.arange(30_001) * 0.02
    late = t_s % 60.0
    v = np.interp(late, [0.0, 4.0, 59.1, 60.0], [0.05, 0.5, 0.5, 0.05])
    x = np.concatenate(([0.0], np.cumsum(0.5 * (v[1:] + v[:-1]) * 0.02)))
    motion = motion_of(t_s, np.column_stack((x, *np.zeros((2, len(x))))))
    steps = [f for f in functions_of_motion([motion]) if f.regressor == "acceleration" and "< -" in f.text]
    hard = [np.mean(f.parts[0](motion)) for f in steps if f.form == "step" and f.shape[0] < -0.3]
    assert any(0.01 < part < 0.025 for part in hard)
