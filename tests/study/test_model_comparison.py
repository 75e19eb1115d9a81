"""Comparison of library effects with basis functions."""

from __future__ import annotations

from types import SimpleNamespace

from odomcorrupt.errors import FitError
from odomcorrupt.study.select import model_comparison
from odomcorrupt.study.select.decisions import DECISIONS
from odomcorrupt.study.select.model_comparison import ModelComparison, best_dependence, best_replacement


class Unfit:
    """A fit beside which no further term can be fitted."""

    effects = ()

    def refit(self, effects):
        raise FitError(f"{effects}: the covariance of the residuals is not positive definite")


def test_a_term_whose_first_estimate_is_too_far_off_to_be_fitted_is_passed_over():
    form = SimpleNamespace(term=SimpleNamespace(name="along over acceleration"), estimated="a step of -140 %")
    found = SimpleNamespace(best=SimpleNamespace(score=form, others=()), name="along over acceleration", nats=50.0)
    assert best_dependence(Unfit(), [found], DECISIONS) is None
    compared = SimpleNamespace(
        effects=[SimpleNamespace(name="wheel_scale")],
        better=lambda *_: [SimpleNamespace(**vars(found), channel="along")],
        penalty=0.0,
    )
    assert best_replacement(Unfit(), [compared], DECISIONS) is None


def test_a_basis_function_that_explains_nearly_as_much_is_a_rival_and_replaces_nothing(monkeypatch):
    monkeypatch.setattr(model_comparison, "dependences", lambda _, scores, __: scores)
    basis = SimpleNamespace(score=SimpleNamespace(nats=41.0))
    near = SimpleNamespace(best=basis, nats=41.0, score=basis.score)
    own = ModelComparison(effects=(), bare=None, nats=43.0, penalty=3.0, scores=[near])
    assert own.better(DECISIONS, -DECISIONS.alternative_nats) == [near]
    assert own.better(DECISIONS, DECISIONS.replacement_nats) == []
    assert ModelComparison(effects=(), bare=None, nats=30.0, penalty=3.0, scores=[near]).better(
        DECISIONS, DECISIONS.replacement_nats
    ) == [near]
