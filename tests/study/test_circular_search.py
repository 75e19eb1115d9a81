"""A search never returns to an earlier model: the step to it is skipped, and the better model is kept."""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

from odomcorrupt.study.estimate.clocks import Clocks
from odomcorrupt.study.io.clock import Clock
from odomcorrupt.study.select import stepwise
from odomcorrupt.study.select.decisions import DECISIONS


@dataclass(frozen=True)
class Scored:
    """A candidate that is known by its name alone."""

    name: str
    fit: Any
    refused: str
    gain: float = 20.0
    score: None = None


def model(*names):
    effects = tuple(SimpleNamespace(name=name) for name in names)
    fit = SimpleNamespace(effects=effects, random=(), free_clocks=((False, False),), log_likelihood=0.0)
    fit.by_name = {effect.name: effect for effect in effects}
    fit.refit = lambda *_, **__: fit
    fit.for_reports = lambda: fit
    return fit


NO_CLOCK = Clocks((Clock(),), ((False, False),), ((0.0, 0.0),))
NOTHING, SLIP, LAG = model(), model("accel_slip"), model("channel_lag")
NEXT = {(): ("accel_slip", SLIP), ("accel_slip",): ("channel_lag", LAG), ("channel_lag",): ("accel_slip", SLIP)}
"""Of each model what is best beside it, and what the two end in: either makes the other redundant."""


def search(monkeypatch, following, decisions=DECISIONS):
    """Return a finished selection in which `following` gives for each model the best candidate and what it leads to."""

    def candidates(fit, _, circular):
        name, then = following[tuple(e.name for e in fit.effects)]
        return [Scored(name, then, "circular" if name in circular else "")]

    monkeypatch.setattr(stepwise, "library_candidates", candidates)
    monkeypatch.setattr(stepwise, "with_shape_refined", lambda fit, score, _: (fit, score))
    monkeypatch.setattr(stepwise, "without_redundant", lambda fit, *_: fit)
    for name, does in {
        "_correlated": lambda *_: None,
        "_propose": lambda *_, **__: None,
        "_finish": lambda _: None,
    }.items():
        monkeypatch.setattr(stepwise._Selection, name, does)
    return stepwise._Selection(NOTHING, [], set(), NO_CLOCK, decisions).run()


def test_what_leads_back_to_an_earlier_model_is_passed_over(monkeypatch):
    found = search(monkeypatch, NEXT)
    assert found.fit is LAG
    assert [step.added for step in found.steps] == ["accel_slip", "channel_lag", None]


def test_effects_that_were_dropped_again_do_not_count_as_effects_of_the_model(monkeypatch):
    both = model("channel_lag", "wheel_scale")
    following = {**NEXT, ("channel_lag",): ("wheel_scale", both), ("channel_lag", "wheel_scale"): ("backlash", model())}
    found = search(monkeypatch, following, replace(DECISIONS, max_effects=2))
    assert found.fit is both
    assert [step.added for step in found.steps] == ["accel_slip", "channel_lag", "wheel_scale", None]


def test_a_law_that_physics_contradicts_does_not_come_again_for_ever(monkeypatch):
    bare, law = model(), model("yaw_over_speed")
    law.refit = lambda *_, **__: bare
    dependence = SimpleNamespace(name="yaw_over_speed", channel="yaw")
    forbidden = SimpleNamespace(fit=None, score=SimpleNamespace(effect=None), name="accel_slip")
    for name, does in {
        "library_candidates": lambda *_: [],
        "CoarseDesign": lambda *_: None,
        "basis_scores": lambda *_: [],
        "dependences": lambda *_: [],
        "channels_of": lambda *_: [],
        "best_replacement": lambda *_: None,
        "best_dependence": lambda *_: SimpleNamespace(dependence=dependence, candidate=SimpleNamespace(fit=law)),
        "name_for": lambda *_: forbidden,
        "without_redundant": lambda fit, *_: fit,
    }.items():
        monkeypatch.setattr(stepwise, name, does)
    for name in ("_correlated", "_finish", "_compare"):
        monkeypatch.setattr(stepwise._Selection, name, lambda *_, **__: None)
    bare.problem = law.problem = None
    found = stepwise._Selection(bare, [], set(), NO_CLOCK, DECISIONS).run()
    assert found.fit is bare
    assert [step.name for step in found.contradictions] == ["accel_slip"]
