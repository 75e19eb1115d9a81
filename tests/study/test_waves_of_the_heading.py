"""Waves over the heading: where the data do not show their period, they act only at the headings that were driven."""

from dataclasses import replace

import numpy as np
import pytest
from hidden import as_recording, basis_dependences, ten_second_error

from odomcorrupt.effects.compensation import error_of
from odomcorrupt.simulation import simulate
from odomcorrupt.study.estimate.config import choose_approach
from odomcorrupt.study.estimate.gauss_newton import fit
from odomcorrupt.study.estimate.regressors import driving_motion
from odomcorrupt.study.select.selection import learn
from odomcorrupt.study.terms.basis import basis_functions
from odomcorrupt.study.terms.channels import Action
from odomcorrupt.study.terms.term import BasisTerm


@pytest.fixture(scope="module")
def motion():
    return driving_motion(as_recording(simulate(73, None, duration_s=60.0)), "odometry")


def waves(motion, move="abs(v)", channel="across"):
    functions = [f for f in basis_functions([motion]) if f.regressor == "heading"]
    return [BasisTerm(f, Action(channel, move)) for f in functions]


def toward(motion, theta):
    """Return the motion at constant speed with other headings."""
    ones = np.ones(len(motion))
    return replace(motion, v=0.5 * ones, omega=ones, dt_s=0.02 * ones, theta=np.resize(theta, len(motion)))


def test_a_wave_on_driven_headings_is_the_wave_there_and_zero_elsewhere(motion):
    two = np.concatenate((np.linspace(167.0, 182.0, 50), np.linspace(11.0, 19.0, 50)))  # one of them across 180 degrees
    line = toward(motion, np.radians(two))
    for term in waves(motion):
        limited = term.where_driven([line])
        assert limited.function.place == "known from 10 to 20 and 165 to 185 deg only"
        full, part = (error_of(one.effect([0.03, -0.02]), line) for one in (term, limited))
        assert np.array_equal(part, full)
        elsewhere = toward(motion, np.radians(np.arange(-700.0, 700.0, 180.0) + 60.0))
        assert not error_of(limited.effect([0.03, -0.02]), elsewhere).any()
        around = toward(motion, np.linspace(-7.0, 7.0, 1000))
        ((_, rate),) = limited.action.rates({"body": around}, None)
        size = sum(k * part(around) for k, part in zip((0.03, -0.02), limited.function.parts, strict=True))
        assert np.allclose(error_of(limited.effect([0.03, -0.02]), around)[:, 1], -rate[:, 1] * size, atol=1e-12)


def test_small_gaps_between_headings_are_bridged_and_a_full_turn_is_no_limit(motion):
    once, twice = waves(motion)
    four = toward(motion, np.radians([0.0, 90.0, 180.0, 270.0]) + 0.04)
    assert once.where_driven([four]).function.text == once.function.text  # a quarter of its period
    assert twice.where_driven([four]).function.text.count("where") == 4
    around = toward(motion, np.radians(np.arange(0.0, 360.0, 40.0)))
    assert twice.where_driven([around]).function.text == twice.function.text


def test_headings_of_turns_count_for_an_error_of_turns_only(motion):
    """A robot that drives on one line and turns on the spot shows travel at one heading, and turns at all."""
    spinning = np.arange(len(motion)) % 2 == 0
    theta = np.where(spinning, np.linspace(0.0, 20.0, len(motion)), 0.02)
    seen = toward(motion, theta)
    seen = replace(seen, v=np.where(spinning, 0.0, 0.5), omega=np.where(spinning, 1.0, 0.0))
    assert "where" in waves(motion)[0].where_driven([seen]).function.text
    assert "where" not in waves(motion, "omega", "yaw")[0].where_driven([seen]).function.text


def proposed(seed, **options):
    """Return the dependence that would be included, and the 10 s error (m) of another drive without it and with it."""
    options = {"size": 2.0, "duration_s": 200.0, **options}
    run = as_recording(simulate(seed, "floor_grain", **options))
    fitted = fit([run], approach=choose_approach([run]))
    found = next(one for one in basis_dependences(fitted) if one.regressor == "heading")
    corrected = fitted.refit([found.score.estimated])
    other = as_recording(simulate(seed + 1000, "floor_grain", robot_seed=seed, **options))
    return found, ten_second_error([other]), ten_second_error([other], corrected.effects)


def test_a_wave_fitted_on_one_line_does_not_make_a_drive_on_another_line_worse():
    """A shuttle shows a slope over 15 degrees of heading: waves of both periods fit, one is right elsewhere."""
    law, before, after = proposed(505, route="shuttle")
    assert (law.channel, law.regressor) == ("across", "heading")
    assert "where(cos(theta" in law.expression
    assert law.place == "known from -145 to -130 deg only"
    assert after < 1.02 * before


def test_a_wave_whose_period_the_headings_show_is_applied_at_all_headings():
    law, before, after = proposed(82)
    assert law.regressor == "heading"
    assert not law.place
    assert "where" not in law.expression
    assert after < 0.85 * before


@pytest.mark.slow
def test_what_is_learned_on_one_line_still_corrects_that_line():
    run = as_recording(simulate(505, "floor_grain", size=2.0, route="shuttle", duration_s=200.0))
    learned = learn([run])
    assert [law.regressor for law in learned.laws] == ["heading"]
    assert ten_second_error([run], learned.fit.effects) < 0.5 * ten_second_error([run])
