"""Decisions: documents agree with the code, and replacing a decision changes the selection."""

from dataclasses import replace
from math import e, exp, inf, log
from pathlib import Path

import pytest
from hidden import as_recording

from odomcorrupt.simulation import simulate
from odomcorrupt.study.select.confidence import (
    Evidence,
    chance_odds,
    confidence,
    evidence_of,
    held_out_errors,
    odds_against,
)
from odomcorrupt.study.select.decisions import DECISIONS, equal_candidates
from odomcorrupt.study.select.selection import learn

PAGE = Path(__file__).parents[2] / "docs" / "json.md"
EVIDENCE = Evidence(
    own=9.0, rivals=(4.0, 6.5), left=3.0, correlated=7.0, margin=2.5, candidates=7.0, held_out_errors=2.5
)


def test_the_formula_of_the_page_is_what_is_computed():
    (formula,) = [line for line in PAGE.read_text(encoding="utf8").splitlines() if line.startswith("    sum(exp(")]
    numbers = {"g": EVIDENCE.own, "m": EVIDENCE.margin, "u": EVIDENCE.left, "w": EVIDENCE.correlated}
    numbers |= {"n": EVIDENCE.candidates, "p": 0.0062097, "rivals": EVIDENCE.rivals}  # p of 2.5 standard errors
    named = {**numbers, "B": lambda p: -e * p * log(p), "exp": exp, "sum": sum, "max": max, "__builtins__": {}}
    printed = eval(formula.strip(), named)  # noqa: S307 - our own formula
    assert odds_against(EVIDENCE, DECISIONS.prior) == pytest.approx(printed)
    assert confidence(EVIDENCE, DECISIONS.prior) == pytest.approx(1.0 / (1.0 + printed))


def test_a_gain_that_chance_reaches_gives_no_high_confidence():
    # 4 nats are odds of 55 to 1 for one candidate, but the largest of seven gains is that large seven times as often
    small = Evidence(own=4.0, candidates=equal_candidates(["wheelbase"] * 7, DECISIONS))
    assert confidence(small) < 0.9 < confidence(replace(small, candidates=1.0))
    assert equal_candidates(["side_slip"] * 7, DECISIONS) == pytest.approx(7.0 * exp(-DECISIONS.rare_nats))
    # one standard error cannot give 0.95, whatever the noise model says of the fitted data
    sure = [confidence(Evidence(own=50.0, held_out_errors=n)) for n in (-1.0, 1.0, 2.0, 3.0, 5.0, inf)]
    assert sure == sorted(sure)
    assert sure[1] < 0.7
    assert sure[2] < 0.9 < sure[3]
    assert sure[4] > 0.99
    assert chance_odds(-1.0) == chance_odds(0.0) == 1.0


def test_a_cause_that_acts_in_a_few_blocks_keeps_its_confidence():
    # ten kicks of a castor: 227 nats, with 127 between blocks
    assert chance_odds(held_out_errors(227.0, 127.0)) < 1e-6
    assert held_out_errors(7.0, 3.5) == pytest.approx(2.0)
    assert held_out_errors(-7.0, 3.5) == pytest.approx(-2.0)
    assert held_out_errors(7.0, inf) == inf


def test_another_decision_selects_another_model():
    run = as_recording(simulate(91, "unequal_wheels", duration_s=120.0))
    none = learn([run], decisions=replace(DECISIONS, term_nats=1e6))
    (step,) = none.rounds
    assert step.candidates[0].name == "unequal_wheels"
    assert (none.added, none.fit.effects) == ((), ())
    assert learn([run]).added == ("unequal_wheels",)


@pytest.mark.slow
def test_errors_of_the_heading_beside_a_dead_band_have_even_odds_at_most():
    run = as_recording(simulate(91, "wheelbase", duration_s=120.0))
    for recording, low, high in ((run, 0.9, 1.0), (replace(run, yaw_dead_band_radps=0.01), 0.3, 0.5)):
        learned = learn([recording])
        (step,) = (step for step in learned.steps if step.added == "wheelbase")
        assert low < confidence(evidence_of(step, learned)) <= high
