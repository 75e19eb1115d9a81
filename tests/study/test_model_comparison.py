"""Comparison of library effects with basis functions."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import ClassVar

from odomcorrupt.effects import effect_from_values
from odomcorrupt.errors import FitError
from odomcorrupt.study.select import model_comparison, proposals
from odomcorrupt.study.select.candidates import Candidate
from odomcorrupt.study.select.decisions import DECISIONS
from odomcorrupt.study.select.model_comparison import (
    ModelComparison,
    margins,
    rivals,
)
from odomcorrupt.study.select.proposals import best_dependence, best_replacement


@dataclass(frozen=True)
class Found:
    """A dependence with its best basis function."""

    best: SimpleNamespace
    nats: float
    score: SimpleNamespace
    instead_of: tuple[str, ...] = ()


class Unfit:
    """A fit beside which no further term can be fitted."""

    effects = random = ()

    def refit(self, effects, **_):
        raise FitError(f"{effects}: the covariance of the residuals is not positive definite")


def test_a_term_whose_first_estimate_is_too_far_off_to_be_fitted_is_passed_over():
    form = SimpleNamespace(term=SimpleNamespace(name="along over acceleration"), estimated="a step of -140 %")
    found = SimpleNamespace(best=SimpleNamespace(score=form, others=()), name="along over acceleration", nats=50.0)
    assert best_dependence(Unfit(), [found], DECISIONS) is None
    compared = SimpleNamespace(
        effects=[SimpleNamespace(name="wheel_scale")],
        better=lambda *_: [SimpleNamespace(**vars(found), channel="along")],
        penalty=0.0,
        margin=-50.0,
    )
    assert best_replacement(Unfit(), [compared], DECISIONS) is None


def test_a_basis_function_that_explains_nearly_as_much_is_a_rival_and_replaces_nothing(monkeypatch):
    monkeypatch.setattr(model_comparison, "dependences", lambda _, scores, __: scores)
    basis = SimpleNamespace(score=SimpleNamespace(nats=41.0))
    near = SimpleNamespace(best=basis, nats=41.0, score=basis.score)
    own = ModelComparison(effects=(), bare=None, nats=43.0, penalty=3.0, scores=[near], decisions=DECISIONS)
    assert own.better(-DECISIONS.alternative_nats) == [near]
    assert own.better(DECISIONS.replacement_nats) == []
    assert ModelComparison(effects=(), bare=None, nats=30.0, penalty=3.0, scores=[near], decisions=DECISIONS).better(
        DECISIONS.replacement_nats
    ) == [near]


def test_effects_that_together_imitate_a_dependence_share_its_margin(monkeypatch):
    monkeypatch.setattr(model_comparison, "dependences", lambda _, scores, __: scores)
    slip, scale = (effect_from_values(name, {}) for name in ("accel_slip", "wheel_scale"))

    def compared(effects, nats, *gains):
        bases = [SimpleNamespace(score=SimpleNamespace(nats=gain)) for gain in gains]
        found = [Found(basis, basis.score.nats, basis.score) for basis in bases]
        return ModelComparison(effects=effects, bare=None, nats=nats, penalty=3.0, scores=found, decisions=DECISIONS)

    every = [compared((slip,), 96.0), compared((scale,), 39.0, 20.0), compared((slip, scale), 150.0, 148.0)]
    assert margins(every) == {"accel_slip": 2.0, "wheel_scale": 2.0}
    (rival,) = rivals(every, DECISIONS)
    assert (rival.nats, rival.instead_of) == (148.0, ("accel_slip", "wheel_scale"))


class Weighted:
    """A fit with the gain of its effect; the hinge gains 60 nats more if the outliers that it leaves lose weight."""

    GAINS: ClassVar = {"hinge": 120.0, "step": 144.0}
    random: ClassVar = ()

    def __init__(self, weights, effects=()):
        self.noise, self.effects = SimpleNamespace(weights=weights), effects
        self.log_likelihood = sum(self.GAINS[effect] for effect in effects)
        if "hinge" in effects and weights == "re-estimated":
            self.log_likelihood += 60.0

    def refit(self, effects=None, *, weights_of=None):
        weights = weights_of.noise.weights if weights_of else "re-estimated"
        return Weighted(weights, self.effects if effects is None else effects)


def test_dependences_are_compared_by_refits_with_the_same_outliers(monkeypatch):
    def found(name, nats):
        form = SimpleNamespace(term=SimpleNamespace(name=name), estimated=name, penalty=10.0)
        return SimpleNamespace(best=SimpleNamespace(score=form, others=()), name=name, nats=nats)

    def refitted(_, with_it, score, *, gain, least):
        return Candidate(score=score, fit=with_it, gain=gain, refused="" if gain > least else "gains less")

    monkeypatch.setattr(proposals, "tried", refitted)
    monkeypatch.setattr(proposals, "with_shape_refined", lambda fit, score, *_: (fit, score))
    monkeypatch.setattr(proposals, "_reshaped", lambda one, _: one)
    larger, smaller = found("hinge", 77.0), found("step", 70.0)
    best = best_dependence(Weighted("before"), [larger, smaller], DECISIONS)
    # the score test of the hinge is larger by 7 nats, and its fit has more outliers without weight
    assert best.dependence is smaller
    assert best.candidate.gain == 134.0
    # the fit that is continued from has weights of its own
    assert best.candidate.fit.noise.weights == "re-estimated"
    monkeypatch.setitem(Weighted.GAINS, "step", 122.0)
    assert best_dependence(Weighted("before"), [larger, smaller], DECISIONS).dependence is larger


class Fitted:
    """A fit whose log likelihood is the sum of its effects' gains, nats."""

    GAINS: ClassVar = {"unequal_wheels": 80.0, "wheel_scale": 79.0, "speed_scale": 30.0}

    def __init__(self, *effects):
        self.effects = effects
        self.by_name = {effect.name: effect for effect in effects}
        self.log_likelihood = sum(self.GAINS[effect.name] for effect in effects)

    def refit(self, effects, **_):
        return Fitted(*effects)
