"""Decisions: documents agree with the code, and replacing a decision changes the selection."""

from dataclasses import replace
from math import e, exp, inf, log
from pathlib import Path

import pytest
from hidden import as_recording

from odomcorrupt.simulation import simulate
from odomcorrupt.study.select.confidence import (
    Support,
    chance_odds,
    confidence,
    held_out_errors,
    odds_against,
    support_of,
)
from odomcorrupt.study.select.decisions import DECISIONS
from odomcorrupt.study.select.selection import learn

PAGE = Path(__file__).parents[2] / "docs" / "json.md"
SUPPORT = Support(own=9.0, against=0.02, rivals=1, left=3.0, correlated=7.0, held_out_errors=2.5)


def test_the_formula_of_the_page_is_what_is_computed():
    (formula,) = [line for line in PAGE.read_text(encoding="utf8").splitlines() if line.startswith("    max(q, exp(")]
    numbers = {"g": SUPPORT.own, "q": SUPPORT.against, "u": SUPPORT.left, "w": SUPPORT.correlated}
    numbers |= {"s": SUPPORT.rivals, "p": 0.0062097}  # p of 2.5 standard errors
    named = {**numbers, "B": lambda p: -e * p * log(p), "exp": exp, "max": max, "__builtins__": {}}
    printed = eval(formula.strip(), named)  # noqa: S307 - our own formula
    assert odds_against(SUPPORT, DECISIONS.prior) == pytest.approx(printed)
    assert confidence(SUPPORT, DECISIONS.prior) == pytest.approx(1.0 / (1.0 + printed))


def test_confidence_falls_with_rivals_with_what_is_left_and_with_little_evidence():
    plain = confidence(Support(50.0))
    assert plain > 0.99
    assert confidence(Support(50.0, 0.6)) == pytest.approx(1.0 / 1.605)
    assert confidence(Support(50.0, rivals=1)) < 0.5
    assert confidence(Support(50.0, left=100.0)) < 0.4
    assert plain > confidence(Support(50.0, correlated=50.0)) > confidence(Support(50.0, left=50.0))
    assert confidence(Support(1.0)) < 0.75
    assert confidence(Support(-1.0)) == 0.0


def test_one_standard_error_on_held_out_data_gives_no_high_confidence():
    sure = [confidence(Support(50.0, held_out_errors=n)) for n in (-1.0, 1.0, 2.0, 3.0, 5.0, inf)]
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
        assert low < confidence(support_of(step, learned)) <= high
