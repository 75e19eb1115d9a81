"""The verdict takes every measure into account, and reports when they disagree."""

from types import SimpleNamespace

import pytest

from odomcorrupt.report.comparison import falls_sentence, measures_words
from odomcorrupt.study.validate.compare import agreement_of


def judged(name, error, nats, ate, gain=0.0, gain_error=0.1):
    return SimpleNamespace(
        name=name,
        judged_on="recordings",
        ten_second_error_m=error,
        nats=SimpleNamespace(per_m=nats, gain_per_m=gain, gain_error=gain_error),
        trajectory=SimpleNamespace(ate_m=ate),
    )


def compared(error, gain, ate):
    first = judged("base", 0.100, 5.0, 0.010)
    evaluations = (first, judged("robot", error, 5.0 + gain, ate, gain))
    return SimpleNamespace(evaluations=evaluations, judged_on="recordings")


@pytest.mark.parametrize(
    ("error", "gain", "ate", "verdict"),
    [
        (0.060, 2.0, 0.006, "better"),
        (0.060, 2.0, 0.0105, "better"),
        (0.095, -24.0, 0.014, "mixed"),
        (0.095, 1.0, 0.014, "mixed"),
        (0.120, -1.0, 0.010, "worse"),
        (0.101, 0.1, 0.0105, "same"),
    ],
)
def test_all_measures_count(error, gain, ate, verdict):
    assert agreement_of(compared(error, gain, ate)).verdict == verdict


def test_the_error_does_not_fall_where_measures_disagree():
    said = falls_sentence(compared(0.095, -24.0, 0.014))
    assert "the error falls" not in said
    assert "log likelihood -24 nats/m" in said
    assert said.endswith("they disagree")
    assert falls_sentence(compared(0.060, 2.0, 0.006)) == "the error falls to 60 % from base to robot"


@pytest.mark.parametrize(("gain", "said"), [(0.19, False), (0.21, True), (-0.19, False), (-0.21, True)])
def test_a_change_of_the_likelihood_is_printed_if_it_exceeds_two_standard_errors(gain, said):
    words = measures_words(compared(0.060, gain, 0.006))
    assert words.startswith("10 s error 100 mm -> 60 mm")
    assert ("log likelihood" in words) == said
    assert "ATE 10 mm -> 6.0 mm" in words
    assert measures_words(compared(float("nan"), 0.19, float("nan"))) == "log likelihood: no change"


def test_what_is_not_known_does_not_count():
    comparison = compared(float("nan"), 2.0, float("nan"))
    assert agreement_of(comparison).verdict == "better"
    assert measures_words(comparison) == "log likelihood +2 nats/m"
