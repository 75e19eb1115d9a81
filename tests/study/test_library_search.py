"""Search in the library with a given model: candidates have their best shape, and few are refined."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import pytest
from hidden import as_recording

from odomcorrupt.effects.ground import RegionSlip
from odomcorrupt.simulation import simulate
from odomcorrupt.study.estimate.config import choose_approach
from odomcorrupt.study.estimate.gauss_newton import fit
from odomcorrupt.study.select import candidates
from odomcorrupt.study.select.candidates import library
from odomcorrupt.study.select.decisions import DECISIONS
from odomcorrupt.study.select.dependence import basis_scores
from odomcorrupt.study.select.library_search import LibrarySearch
from odomcorrupt.study.select.score import score_terms
from odomcorrupt.study.select.shape_search import ShapeSearch
from odomcorrupt.study.terms.term import LibraryTerm


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


@pytest.mark.parametrize("heading", ["wheels", "gyro"])
@pytest.mark.parametrize(("more_nats", "width"), [(6.5, 0.0), (8.5, 1.0)])
def test_a_rectangle_pays_for_the_two_numbers_more_than_a_disc_has(monkeypatch, fitted, heading, more_nats, width):
    """Its price is log(240) = 5.5 nats and the 2 nats of any other form, whichever heading the disc has."""

    def gain(_, term):
        return 50.0 + 20.0 * (term.start.heading == heading) + more_nats * bool(term.start.width)

    disc, wide = RegionSlip(radius=1.0), RegionSlip(radius=1.0, width=1.0, angle=0.5)
    monkeypatch.setattr(ShapeSearch, "gain", gain)
    monkeypatch.setattr(ShapeSearch, "_highest", lambda self, family: (self.gain(family[0]), family[0]))
    monkeypatch.setattr(ShapeSearch, "_refined", lambda self, terms, _: [(self.gain(t), t) for t in terms])
    monkeypatch.setattr(RegionSlip, "related", lambda self: (replace(wide, heading=self.heading),))
    family = [LibraryTerm.of(replace(disc, x=x), fitted.problem.motions) for x in (0.0, 1.0)]
    assert len(fitted.problem.intervals) == pytest.approx(240, abs=3)
    found = ShapeSearch(fitted, DECISIONS).best(family).start
    assert (found.heading, found.width) == (heading, width)


def test_a_shape_is_accepted_by_the_likelihood_at_unchanged_weights(monkeypatch, fitted):
    """With weights of its own the moved patch is 0.5 nats likelier, because its fit excludes fewer intervals."""
    patch = RegionSlip(slip=0.05, radius=1.0)
    (family,) = (f for f in library(fitted) if f[0].name == "region_slip")
    own = SimpleNamespace(log_likelihood=100.5)
    same = SimpleNamespace(log_likelihood=105.0, refit=lambda **_: own)
    before = SimpleNamespace(
        effects=(patch,), log_likelihood=100.0,
        refit=lambda *_, weights_of=None: same if weights_of is before else own,
    )  # fmt: skip
    found = SimpleNamespace(maximise=lambda _: family[1])
    monkeypatch.setattr(candidates, "ShapeSearch", lambda *_: found)
    monkeypatch.setattr(candidates, "drop_term", lambda *_: None)
    monkeypatch.setattr(candidates, "_nearby", lambda *_: None)
    score = score_terms(fitted, [family[0]], DECISIONS)[0]
    assert candidates._with_shape_moved(before, score, DECISIONS, None)[0] is own


def test_functions_that_cannot_compete_with_an_effect_are_not_refined_but_the_best_one_is(fitted):
    every = basis_scores(fitted, DECISIONS)
    most = max(one.score.nats for one in every)
    few = basis_scores(fitted, DECISIONS, against_nats=most)
    assert max(one.score.nats for one in few) == most
    assert {one.kind for one in few} >= {one.kind for one in every if one.score.nats > 0.6 * most}
    assert len(few) < len(every)
    (best,) = basis_scores(fitted, DECISIONS, against_nats=1e6)
    assert best.score.nats > 0.3 * most
