"""Terms: the tested columns are those of the resulting effect, and shapes stay in bounds."""

from dataclasses import replace

import numpy as np
import pytest
from hidden import as_recording

from odomcorrupt.effects.effect import parameters
from odomcorrupt.geometry.motion import motion_of
from odomcorrupt.simulation import simulate
from odomcorrupt.study.estimate.config import choose_approach
from odomcorrupt.study.estimate.gauss_newton import fit
from odomcorrupt.study.select.decisions import DECISIONS
from odomcorrupt.study.select.dictionary import families
from odomcorrupt.study.select.screening import CoarseDesign
from odomcorrupt.study.select.shape_search import ShapeSearch
from odomcorrupt.study.terms.basis import basis_functions
from odomcorrupt.study.terms.channels import actions_on, every_action
from odomcorrupt.study.terms.term import BasisTerm, neighbours


@pytest.fixture(scope="module")
def fitted():
    run = as_recording(simulate(92, "region_slip", duration_s=200.0))
    return fit([run], approach=choose_approach([run]))


def test_a_basis_function_has_the_columns_of_the_effect_that_it_becomes(fitted):
    motions = fitted.problem.motions
    pairs = [
        (f, a) for a in actions_on(motions) for f in basis_functions(motions) if not a.reaches.isdisjoint(f.reaches)
    ]
    for term in (BasisTerm(function, action) for function, action in pairs[::303]):
        tested, fits = term.columns(fitted.problem), fitted.problem.columns(term.start)
        # numbers are written with four digits, so single samples may lie on the other side of an edge
        assert np.abs(tested - fits).max(axis=(1, 2)).mean() < 1e-3 * np.abs(fits).max() + 1e-12, term


def test_a_shape_never_leaves_the_bounds_of_an_effect(fitted):
    (family,) = (f for f in families(fitted) if f[0].name == "region_slip")
    assert {term.trials for term in family} == {len(family)}
    for moved in neighbours(family[0], 1e4):
        for p in (p for p in parameters(moved.start) if not p.amplitude):
            assert p.low <= getattr(moved.start, p.name) <= p.high


def test_a_search_leads_to_the_place_that_was_planted():
    run = simulate(92, "region_slip", duration_s=200.0)
    planted = run.answer["parameters"]
    fitted = fit([as_recording(run)], approach=choose_approach([as_recording(run)]))
    (family,) = (f for f in families(fitted) if f[0].name == "region_slip")
    found = ShapeSearch(fitted, DECISIONS, CoarseDesign(fitted.problem)).located(family)[0].start
    assert np.hypot(found.x - planted["x"], found.y - planted["y"]) < 0.3 * planted["radius"]


def test_a_refit_of_the_same_model_is_the_same_fit_and_keeps_its_clocks(fitted):
    run = fitted.problem.recordings[0]
    free = fit([run], free_clocks=[(True, False)], approach=fitted.problem.approach)
    again = free.refit()
    assert again.free_clocks == ((True, False),)
    assert again.log_likelihood == pytest.approx(free.log_likelihood, abs=0.05)
    held = free.refit(free_clocks=[(False, False)])
    assert held.design_matrix.shape[2] == 0
    assert replace(free, free_clocks=((False, False),)).design_matrix.shape[2] == 0


def test_no_patch_of_floor_pushes_a_robot_to_its_side():
    motion = motion_of(np.arange(401) * 0.05, np.column_stack((np.linspace(0.0, 8.0, 401), *np.zeros((2, 401)))))
    places = [f for f in basis_functions([motion]) if f.regressor == "position"]
    targets = {a.target for f in places for a in every_action() if not a.reaches.isdisjoint(f.reaches)}
    assert {"along", "yaw", "ground"} <= targets
    assert "across" not in targets


def test_loads_of_a_while_have_no_time_in_common_in_several_drives(fitted):
    (motion,) = fitted.problem.motions
    for later_s, some in ((0.0, False), (1e3, True)):
        found = basis_functions((motion, replace(motion, t_s=motion.t_s + later_s)))
        assert any("where" in f.text for f in found if f.regressor == "time") == some
