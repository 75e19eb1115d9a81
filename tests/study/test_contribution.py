"""Whether a part of a model matters in practice is separate from whether it is significant."""

from dataclasses import replace

import numpy as np
import pytest
from test_held_out import drive, learned_with, with_truth

from odomcorrupt.study.estimate.problem import undo
from odomcorrupt.study.select.contribution import Contribution, Span, contributions
from odomcorrupt.study.select.decisions import DECISIONS, Practical

LITTLE, MUCH = Span(0.001, 0.01, 7.0), Span(0.01, 0.01, 7.0)


@pytest.mark.parametrize(
    ("ten_seconds", "far", "negligible"),
    [
        (LITTLE, None, True),
        (LITTLE, LITTLE, True),
        (MUCH, LITTLE, False),
        (LITTLE, Span(0.1, 0.1, 50.0), False),  # a bias hardly moves anything in 10 s
        (Span(6e-4, 1e-5, 7.0), Span(4e-3, 1e-5, 50.0), True),  # exact truth: a tenth of a millimetre per metre
    ],
)
def test_what_hardly_moves_the_odometry_near_and_far_is_negligible(ten_seconds, far, negligible):
    assert Contribution(ten_seconds, far).negligible(DECISIONS.practical) is negligible


def test_the_share_is_by_how_much_an_independent_error_would_grow():
    assert Span(3.0, 4.0, 10.0).share == pytest.approx(0.25)


@pytest.fixture(scope="module")
def learned():
    """A robot that is wide by 2 %, and a scale that is nearly nothing."""
    return learned_with(with_truth(drive(4, wide=1.02), 5), "wheelbase", "wheel_scale")


def test_a_large_cause_matters_and_what_chance_makes_of_another_does_not(learned):
    found = replace(learned, contributions=contributions(learned.fit))
    assert found.added == ("wheelbase", "wheel_scale")
    assert found.matters == ("wheelbase",)
    assert found.is_negligible("wheel_scale")
    strict = replace(found, decisions=replace(DECISIONS, practical=Practical(share=0.0, far_share=0.0, per_m=0.0)))
    assert not strict.is_negligible("wheel_scale")


def test_it_is_measured_on_recordings_that_were_not_fitted_where_there_are_any(learned):
    """The distance between both paths is that of the effect alone, whatever the truth's noise."""
    run = with_truth(drive(7, wide=1.02), 8)
    own = contributions(learned.fit, [run], [learned.fit.problem.clocks[0]])["wheelbase"].ten_seconds
    bare = learned.fit.refit([e for e in learned.fit.effects if e.name != "wheelbase"], weights_of=learned.fit)
    far = undo(run, learned.fit.effects).odometry.xyt[:, :2] - undo(run, bare.effects).odometry.xyt[:, :2]
    assert 0.0 < own.moved_m < np.abs(far).max()
    assert own.travelled_m == pytest.approx(contributions(learned.fit)["wheelbase"].ten_seconds.travelled_m, rel=0.5)


def test_effects_that_nobody_measured_matter(learned):
    assert not learned.is_negligible("wheel_scale")
    assert contributions(learned.fit.refit([])) == {}
