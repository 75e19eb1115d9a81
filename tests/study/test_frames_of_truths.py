"""Places and headings that were learned in one truth's frame have no meaning in another one, as of a laser's map."""

from dataclasses import replace

import numpy as np
import pytest
from test_held_out import drive, learned_with, with_truth

from odomcorrupt.effects.ground import Slope
from odomcorrupt.geometry.se2 import compose
from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.model.model_file import format_model, parse_model
from odomcorrupt.study.estimate.calibrate import model_of
from odomcorrupt.study.estimate.config import Approach
from odomcorrupt.study.estimate.problem import pose_problem
from odomcorrupt.study.estimate.regressors import driving_motion
from odomcorrupt.study.io.recording import shared_frame
from odomcorrupt.study.select.contribution import contributions
from odomcorrupt.study.select.screening import CoarseDesign
from odomcorrupt.study.terms.basis import basis_functions
from odomcorrupt.study.terms.library import library_families
from odomcorrupt.study.terms.splines import curve_regressors
from odomcorrupt.study.validate.compare import compare
from odomcorrupt.study.validate.held_out import drop_unsupported_parts

CREEP = 0.03


def on_a_slope(seed, frame, turned=0.0):
    """Return a drive on a slope, with a truth whose axes are turned, in a frame of the given name."""
    run, true = drive(seed, seconds=120.0)
    steps = np.diff(true[:, :2], axis=0)
    slid = np.zeros_like(true)
    slid[1:, 0] = np.cumsum(CREEP * np.linalg.norm(steps, axis=1))
    moved = compose(np.array([0.0, 0.0, turned]), true + slid)
    run = with_truth((run, moved), seed + 1)
    return replace(run, name=f"drive {seed}", frame=frame)


@pytest.fixture(scope="module")
def first():
    return on_a_slope(4, "map of 4")


@pytest.fixture(scope="module")
def other():
    return on_a_slope(6, "map of 6", turned=np.pi)


@pytest.fixture(scope="module")
def learned(first):
    return learned_with(first, "slope", "wheel_scale")


@pytest.mark.slow
def test_a_slope_is_applied_in_its_frame_only_and_that_is_noted(learned, other):
    model = parse_model(format_model(model_of(learned.fit)))
    flat = replace(model, effects=tuple(e for e in model.effects if e.name != "slope"))
    named, without = compare([other], {"slope": model, "none": flat}).evaluations
    assert named.ten_second_error_m == without.ten_second_error_m
    assert "slope not applied" in " ".join(named.notes)
    same = compare([replace(other, frame="map of 4")], {"slope": model}).evaluations[0]
    assert same.ten_second_error_m > 1.2 * without.ten_second_error_m


@pytest.mark.slow
def test_another_map_does_not_refuse_a_slope_but_still_refuses_a_scale(first, other):
    steps = np.diff(first.odometry.xyt, axis=0) * (1.03, 1.03, 1.0)
    far = np.concatenate((first.odometry.xyt[:1], first.odometry.xyt[0] + np.cumsum(steps, axis=0)))
    long = replace(first, odometry=Trajectory(first.odometry.stamps_ns, far))
    kept, _ = drop_unsupported_parts(learned_with(long, "slope", "wheel_scale"), [other])
    assert [effect.name for effect in kept.fit.effects] == ["slope"]


def test_the_contribution_of_a_slope_is_measured_where_it_was_learned(learned, other):
    assert contributions(learned.fit, [other], [learned.fit.problem.clocks[0]]) == contributions(learned.fit)


def test_functions_of_places_and_headings_are_not_tried_on_several_maps(first, other):
    def tried(runs):
        motions = [driving_motion(run, "truth") for run in runs]
        families = library_families(runs, motions, ())
        placed = shared_frame(runs) is not None
        reach = {f.regressor for f in basis_functions(motions, placed=placed)} | {
            *curve_regressors(motions, placed=placed)
        }
        return {family[0].start.name for family in families if family[0].start.reads_places}, reach

    names, regressors = tried([first, replace(other, frame=first.frame)])
    assert Slope.name in names
    assert {"heading", "position"} <= regressors
    names, regressors = tried([first, other])
    assert not names
    assert not {"heading", "position"} & regressors
    design = CoarseDesign(pose_problem([first, other], approach=Approach()))
    assert "ground" not in {action.target for action in design.actions}  # which only places move
