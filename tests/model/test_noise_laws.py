"""Noise laws: their formulas, and what each must and must not depend on."""

import math

import numpy as np
import pytest

from odomcorrupt.errors import ModelError
from odomcorrupt.geometry.se2 import Increments
from odomcorrupt.model.motion_model import Noise, Step, parse_alpha
from odomcorrupt.model.noise_laws import LAWS, Coefficients, law_named, variances
from odomcorrupt.model.presets import DEFAULT, PRESETS, preset_named

K = Coefficients(0.05, 0.17, 0.04, 0.01)


def of(law, ds, dl=0.0, dtheta=0.0, k=K):
    v = variances(LAWS[law], k, Increments(np.array([ds]), np.array([dl]), np.array([dtheta])))
    return tuple(float(part[0]) for part in (v.rot1, v.trans, v.across, v.rot2))


def test_linear_is_the_articles_formula():
    """One metre ahead with 10 degrees per metre: 10 degrees before it and 10 after."""
    rot1, trans, across, rot2 = of("linear", 1.0, k=Coefficients(0.0, math.radians(10), 0.05, 0.0))
    assert math.degrees(math.sqrt(rot1)) == pytest.approx(10.0)
    assert rot2 == rot1
    assert (math.sqrt(trans), across) == pytest.approx((0.05, 0.0))
    rot1, trans, _, rot2 = of("linear", 0.0, 0.0, 1.0)
    assert (rot1, rot2) == pytest.approx(((0.05 * 0.5) ** 2,) * 2)
    assert trans == pytest.approx(0.01**2)


def test_quadratic_is_table_5_6_of_probabilistic_robotics():
    rot1, trans, across, rot2 = of("quadratic", 1.0, 0.0, 0.6)
    assert rot1 == pytest.approx(0.05 * 0.3**2 + 0.17)
    assert rot2 == rot1
    assert (trans, across) == pytest.approx((0.04 + 0.01 * 2 * 0.3**2, 0.0))


def test_diffusion_is_the_standard_deviation_after_one_metre_and_after_one_radian():
    rot1, trans, _, rot2 = of("diffusion", -1.0)
    assert math.sqrt(rot1 + rot2) == pytest.approx(0.17)
    assert math.sqrt(trans) == pytest.approx(0.04)
    rot1, trans, _, rot2 = of("diffusion", 0.0, 0.0, -1.0)
    assert math.sqrt(rot1 + rot2) == pytest.approx(0.05)
    assert math.sqrt(trans) == pytest.approx(0.01)
    assert of("diffusion", 1.0, k=Coefficients(0, 0, 0, 0, across_trans=0.03))[2] == pytest.approx(0.03**2)


def test_diffusion_is_the_lectures_variance_per_rotation():
    """There each rotation has variance a1 |rot| + a2 trans: a1 is rot_rot^2, a2 is rot_trans^2 / 2."""
    a1, a2 = K.rot_rot**2, K.rot_trans**2 / 2
    rot1 = of("diffusion", 0.7, 0.0, 0.4)[0]
    assert rot1 == pytest.approx(a1 * 0.2 + a2 * 0.7)


def test_diffusion_does_not_depend_on_the_step_and_the_book_laws_do():
    for law in LAWS:
        whole, half = of(law, 0.4, 0.0, 0.2), of(law, 0.2, 0.0, 0.1)
        if law == "diffusion":
            assert whole == pytest.approx(tuple(2 * part for part in half))
        else:
            # half of a chord belongs to a little less than half of its arc
            near = 3e-3 if LAWS[law].arc else 1e-6
            assert whole[0] == pytest.approx((16 if law == "article-code" else 4) * half[0], rel=near)


@pytest.mark.parametrize("bearing", np.linspace(-3.1, 3.1, 9))
def test_the_bearing_of_jitter_means_nothing_to_any_law(bearing):
    for law in LAWS:
        ds, dl = 1e-5 * math.cos(bearing), 1e-5 * math.sin(bearing)
        assert of(law, ds, dl) == pytest.approx(of(law, 1e-5), rel=1e-9, abs=1e-30)


@pytest.mark.parametrize("law", sorted(LAWS))
def test_forwards_and_backwards_and_left_and_right_are_equally_uncertain(law):
    assert of(law, 0.3, 0.0, 0.1) == pytest.approx(of(law, -0.3, 0.0, 0.1))
    assert of(law, 0.3, 0.0, 0.1) == pytest.approx(of(law, 0.3, 0.0, -0.1))
    assert of(law, 0.01, 0.0, 0.1) == pytest.approx(of(law, -0.01, 0.0, 0.1))


@pytest.mark.parametrize("law", sorted(LAWS))
def test_standing_still_is_certain(law):
    assert of(law, 0.0) == (0.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize("law", sorted(LAWS))
def test_degree_says_how_variances_scale_with_coefficients(law):
    twice = Coefficients(0.1, 0.34, 0.08, 0.02)
    scaled = tuple(2 ** LAWS[law].degree * part for part in of(law, 0.3, 0.1, 0.2))
    assert of(law, 0.3, 0.1, 0.2, twice) == pytest.approx(scaled)


def test_unknown_laws_and_senseless_coefficients_are_refused():
    with pytest.raises(ModelError, match="no law is called 'cubic'; there are diffusion, linear, quadratic"):
        law_named("cubic")
    for bad in (-0.1, math.nan, math.inf):
        with pytest.raises(ModelError, match="rot_trans"):
            Coefficients(0.1, bad, 0.1, 0.1)
    assert Coefficients(0, 0, 0, 0).noise_free
    assert not Coefficients(0, 0, 0, 0, 0.1).noise_free


def test_coefficients_are_read_in_radians_or_degrees():
    assert parse_alpha("0.05") == 0.05
    assert parse_alpha("10deg/m") == pytest.approx(math.radians(10))
    assert parse_alpha(" 5 deg ") == pytest.approx(math.radians(5))
    assert parse_alpha("1e-3rad") == 1e-3
    for bad in ("", "ten", "5 dog", "1 2", "nan", "deg"):
        with pytest.raises(ModelError, match="coefficient"):
            parse_alpha(bad)


def test_steps_are_read_written_and_refused_where_they_mean_nothing():
    assert Step.parse("message") is None
    assert Step.parse(" 0.25m , 10deg") == Step(0.25, math.radians(10))
    assert Step.parse(str(Step(0.25, 0.2))) == Step(0.25, 0.2)
    for bad in ("0.25", "0m,0.2rad", "0.25m,-1rad", "1m,1m"):
        with pytest.raises(ModelError):
            Step.parse(bad)
    with pytest.raises(ModelError, match="leave step out"):
        Noise("diffusion", K, Step(0.25, 0.2))


def test_presets_carry_their_law_numbers_and_source():
    article = preset_named("article").noise
    assert (article.law_name, article.coefficients.rot_trans) == ("linear", math.radians(10))
    assert preset_named(DEFAULT).noise.law_name == "diffusion"
    assert all(preset.source for preset in PRESETS.values())
    with pytest.raises(ModelError, match="no preset is called"):
        preset_named("perfect")
