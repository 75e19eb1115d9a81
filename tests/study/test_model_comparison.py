"""Effects of the library against basis functions."""

from __future__ import annotations

from types import SimpleNamespace

from odomcorrupt.errors import FitError
from odomcorrupt.study.select.decisions import DECISIONS
from odomcorrupt.study.select.model_comparison import best_dependence, best_replacement


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
