"""Terms have the columns of their effects; the evidence of sets of them is that of fits to the other folds."""

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
from odomcorrupt.study.select.evidence import FOLDS, Evidence, Search
from odomcorrupt.study.select.screening import CoarseDesign
from odomcorrupt.study.select.shape_search import ShapeSearch
from odomcorrupt.study.terms.basis import basis_functions
from odomcorrupt.study.terms.channels import actions_on, every_action
from odomcorrupt.study.terms.term import BasisTerm, neighbours

ROWS, TERMS, COST = 2000, 12, 4.0


def evidence_of(columns, y, **changed):
    """Return the evidence of terms with one column (n, J) each, on data y (n,)."""
    fold = np.arange(len(y)) // 40 % FOLDS
    plain = Evidence(
        first=np.arange(columns.shape[1] + 1),
        gram=np.stack([columns[fold == k].T @ columns[fold == k] for k in range(FOLDS)]),
        score=np.stack([columns[fold == k].T @ y[fold == k] for k in range(FOLDS)]),
        whole=np.einsum("ij,ij->j", columns, columns),
        precision=np.full(columns.shape[1], 1e-6),
        low=np.full(columns.shape[1], -np.inf),
        high=np.full(columns.shape[1], np.inf),
        cost=np.full(columns.shape[1], COST),
        group=np.arange(columns.shape[1]),
        limited=np.zeros(columns.shape[1], dtype=bool),
    )
    return replace(plain, **changed), fold


@pytest.fixture
def columns():
    return np.random.default_rng(0).standard_normal((ROWS, TERMS))


def test_a_gain_is_that_of_fits_to_the_other_folds(columns):
    y = columns[:, [1, 4]] @ [0.2, -0.1] + np.random.default_rng(1).standard_normal(ROWS)
    evidence, fold = evidence_of(columns, y)
    expected = []
    for k in range(FOLDS):
        x, own = columns[:, [1, 4, 7]], fold == k
        theta = np.linalg.lstsq(x[~own], y[~own], rcond=None)[0]
        expected.append(0.5 * (np.sum(y[own] ** 2) - np.sum((y[own] - x[own] @ theta) ** 2)))
    gains = evidence.gains([(1, 4, 7), ()])
    np.testing.assert_allclose(gains.folds[0], expected, rtol=1e-4, atol=1e-4)
    assert gains.score.tolist() == pytest.approx([sum(expected) - 3 * COST, 0.0], abs=1e-3)


def test_what_cannot_be_has_no_evidence(columns):
    y = 0.3 * columns[:, 0]
    high = np.full(TERMS, np.inf)
    high[0] = 0.2
    evidence, _ = evidence_of(columns, y, high=high)
    assert evidence.gains([(0,)]).score[0] == -np.inf
    twice = np.column_stack((columns, columns[:, 0] * (1.0 + 1e-6)))
    evidence, _ = evidence_of(twice, y)
    assert evidence.gains([(0, TERMS)]).score[0] == -np.inf
    assert evidence.gains([(0,)]).score[0] > 0.0


@pytest.mark.parametrize("planted", [(), (3,), (2, 9), (0, 5, 11)])
def test_the_search_finds_what_was_planted(columns, planted):
    y = 0.2 * columns[:, list(planted)].sum(axis=1) + np.random.default_rng(2).standard_normal(ROWS)
    evidence, _ = evidence_of(columns, y)
    search = Search.of(evidence)
    assert search.clear_parts(1.5) == planted
    assert Search.of(evidence, start=(1, 8)).clear_parts(1.5) == planted


def test_two_terms_that_only_together_explain_are_found(columns):
    difference = columns[:, 0] + 0.05 * columns[:, 1]
    close = np.column_stack((columns[:, 0], difference, columns[:, 2:]))
    y = 3.0 * (close[:, 1] - close[:, 0]) + np.random.default_rng(3).standard_normal(ROWS)
    evidence, _ = evidence_of(close, y)
    assert Search.of(evidence, start=(0, 1)).best == (0, 1)


def test_terms_of_one_group_exclude_each_other_and_kinds_are_limited(columns):
    y = 0.2 * columns[:, :4].sum(axis=1) + np.random.default_rng(4).standard_normal(ROWS)
    group = np.array([0, 0, *range(2, TERMS)])
    evidence, _ = evidence_of(columns, y, group=group)
    best = Search.of(evidence).best
    assert len({0, 1} & set(best)) == 1
    limited, _ = evidence_of(columns, y, limited=np.ones(TERMS, dtype=bool), most=2)
    assert len(Search.of(limited).best) == 2


def test_a_gain_in_one_fold_alone_is_not_clear(columns):
    fold = np.arange(ROWS) // 40 % FOLDS
    column = columns[:, :1] * np.where(fold == 3, 1.0, 1e-2)[:, None]
    noise = np.random.default_rng(5).standard_normal(ROWS)
    y = 0.5 * columns[:, 0] * (fold == 3) * np.sign(np.sin(np.arange(ROWS))) + noise
    evidence, _ = evidence_of(np.column_stack((column, columns[:, 1:])), y, cost=np.zeros(TERMS))
    assert 0 not in Search.of(evidence).clear_parts(1.5)


def test_a_refused_set_is_not_offered_again(columns):
    y = 0.2 * columns[:, [3, 6]].sum(axis=1) + np.random.default_rng(6).standard_normal(ROWS)
    evidence, _ = evidence_of(columns, y)
    refused = (search := Search.of(evidence)).best
    assert {3, 6} <= set(refused)
    search.refuse(refused)
    assert len(search.best) <= max(len(refused) // 2, 1)


@pytest.mark.parametrize(("share", "copied"), [(0.999, True), (0.9, False)])
def test_a_threshold_beyond_nearly_all_data_is_a_copy_of_the_plain_term(columns, share, copied):
    columns[:, -1] = columns[:, 0] * (np.arange(ROWS) < share * ROWS)
    evidence, _ = evidence_of(columns, columns[:, 0])
    assert evidence.copies(np.arange(TERMS) < 2).tolist() == [False] * (TERMS - 1) + [copied]


def test_a_search_adds_few_terms_and_counts_their_prior(columns):
    y = 0.2 * columns[:, :6].sum(axis=1) + np.random.default_rng(8).standard_normal(ROWS)
    evidence, _ = evidence_of(columns, y)
    assert len(first := Search.of(evidence).best) == 3
    assert Search.of(evidence, first).best == tuple(range(6))
    firm, _ = evidence_of(columns, y, precision=np.full(TERMS, 100.0))
    one = firm.gains([(0,)])
    assert one.score[0] == pytest.approx(one.folds[0].sum() - COST - 50.0 * firm.estimate((0,))[0] ** 2)


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
