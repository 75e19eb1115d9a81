"""Search in the library with a given model: candidates have their best shape, and few are refined."""

from __future__ import annotations

import pytest
from hidden import as_recording

from odomcorrupt.simulation import simulate
from odomcorrupt.study.estimate.config import choose_approach
from odomcorrupt.study.estimate.gauss_newton import fit
from odomcorrupt.study.select.candidates import library
from odomcorrupt.study.select.decisions import DECISIONS
from odomcorrupt.study.select.library_search import LibrarySearch
from odomcorrupt.study.select.shape_search import ShapeSearch


@pytest.fixture(scope="module")
def fitted():
    run = as_recording(simulate(92, "region_slip", duration_s=120.0))
    return fit([run], approach=choose_approach([run]))


@pytest.fixture(scope="module")
def best(fitted):
    """Return the best member of every family, by name, from exact columns, and the nats that it explains."""
    search = ShapeSearch(fitted, DECISIONS)
    terms = [search.best(family) for family in library(fitted)]
    return {term.name: (term, search.gain(term)) for term in terms}


def test_what_is_likeliest_is_refined_to_the_best_of_its_family(fitted, best):
    search = LibrarySearch(fitted, library(fitted), DECISIONS)
    while not (prospect := search.likeliest()).exact:
        search.refine(prospect)
    score = search.decide(prospect)
    assert score.term.name == "region_slip"
    assert score.term == best["region_slip"][0]
    assert search.likeliest().family != prospect.family


def test_no_family_explains_more_than_its_located_member_lets_expect(fitted, best):
    search = ShapeSearch(fitted, DECISIONS)
    for family in library(fitted):
        located = search.located(family)
        term, nats = best[family[0].name]
        assert nats <= located.at_most(search.gain(located.term)) + 1e-9, term


def test_scores_above_a_gain_are_those_of_the_best_members(fitted, best):
    found = LibrarySearch(fitted, library(fitted), DECISIONS).scores_above(0.0)
    assert "region_slip" in {score.term.name for score in found}
    for score in found:
        assert score.term == best[score.term.name][0]
