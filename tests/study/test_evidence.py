"""Evidence of sets of terms: that of explicit fits to the other folds; the search finds what was planted."""

from dataclasses import replace

import numpy as np
import pytest

from odomcorrupt.study.select.evidence import FOLDS, Evidence, Search

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
