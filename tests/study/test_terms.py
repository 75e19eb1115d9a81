"""Terms: the tested columns are those of the resulting effect, and shapes stay in bounds."""

from dataclasses import replace

import numpy as np
import pytest
from hidden import as_recording

from odomcorrupt.effects import registry
from odomcorrupt.effects.effect import parameters
from odomcorrupt.geometry.motion import motion_of
from odomcorrupt.simulation import simulate
from odomcorrupt.study.estimate.config import choose_approach
from odomcorrupt.study.estimate.gauss_newton import fit
from odomcorrupt.study.select.candidates import drop_term
from odomcorrupt.study.select.decisions import DECISIONS
from odomcorrupt.study.select.dictionary import families
from odomcorrupt.study.select.score import project_out
from odomcorrupt.study.select.screening import CoarseDesign
from odomcorrupt.study.select.shape_search import ShapeSearch
from odomcorrupt.study.terms.basis import basis_functions
from odomcorrupt.study.terms.channels import actions_on, every_action
from odomcorrupt.study.terms.term import BasisTerm, LibraryTerm, neighbours


@pytest.fixture(scope="module")
def fitted():
    run = as_recording(simulate(92, "region_slip", duration_s=200.0))
    return fit([run], approach=choose_approach([run]))


def basis_terms(fitted, every=101):
    """Return some of the basis functions on everything that they act on."""
    motions = fitted.problem.motions
    pairs = [
        (f, a) for a in actions_on(motions) for f in basis_functions(motions) if not a.reaches.isdisjoint(f.reaches)
    ]
    return [BasisTerm(function, action) for function, action in pairs[::every]]


def test_a_basis_function_has_the_columns_of_the_effect_that_it_becomes(fitted):
    for term in basis_terms(fitted):
        tested, fits = term.columns(fitted.problem), fitted.problem.columns(term.start)
        # numbers are written with four digits, so single samples may lie on the other side of an edge
        assert np.abs(tested - fits).max(axis=(1, 2)).mean() < 1e-3 * np.abs(fits).max() + 1e-12, term


def test_what_both_wheels_do_at_a_time_needs_no_track(fitted):
    run = replace(fitted.problem.recordings[0], track_m=None)
    untracked = fit([run], approach=fitted.problem.approach)
    step = next(f for f in basis_functions(fitted.problem.motions) if f.regressor == "time" and "where(t >" in f.text)
    twist = next(a for a in actions_on(untracked.problem.motions) if a.target == "twist")
    wheels = next(a for a in actions_on(fitted.problem.motions) if a.target == "wheels" and a.heading == "wheels")
    own = BasisTerm(step, twist)
    np.testing.assert_allclose(
        own.columns(untracked.problem), BasisTerm(step, wheels).columns(fitted.problem), atol=1e-12
    )
    np.testing.assert_allclose(own.columns(untracked.problem), untracked.problem.columns(own.start), atol=1e-9)
    assert all(action.target != "twist" for action in actions_on(fitted.problem.motions))


def test_screening_knows_about_what_exact_columns_explain(fitted):
    search, rest = ShapeSearch(fitted, DECISIONS), project_out(fitted)
    terms = [t for t in basis_terms(fitted, 53) if t.action.move != "1"]
    about = search.coarse_gains(terms)
    exact = np.array([rest.gain(fitted.noise.whitener.whiten(t.columns(fitted.problem))) for t in terms])
    plain = exact > 10.0
    assert plain.sum() > 5
    assert np.median(np.abs(about[plain] / exact[plain] - 1.0)) < 0.1


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


def test_a_dropped_effect_explains_again_what_it_did(fitted):
    run = fitted.problem.recordings[0]
    kind = registry()["wheel_scale"]
    with_it = fit([run], [kind()], approach=fitted.problem.approach)
    bare = drop_term(with_it, with_it.effects[0])
    assert bare.effects == ()
    term = LibraryTerm.of(with_it.effects[0], fitted.problem.motions)
    white = bare.noise.whitener.whiten(term.columns(bare.problem))
    explained = project_out(bare).gain(white)
    assert explained == pytest.approx(0.5 * with_it.wald["wheel_scale"], rel=0.05, abs=0.05)


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
