"""Noise laws: their formulas, what each must and must not depend on, and how coefficients hang together."""

import math

import numpy as np
import pytest

from odomcorrupt.errors import ModelError
from odomcorrupt.geometry.se2 import Increments
from odomcorrupt.model.correlation import Correlation
from odomcorrupt.model.model_file import format_model, parse_model
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


NAMES = ("a", "b", "c", "d")
MATRIX = np.array([[1.0, 0.8, 0.0, 0.0], [0.8, 1.0, 0.3, 0.0], [0.0, 0.3, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])

FILE = """schema = 1
[noise]
rot_rot = 0.03
rot_trans = "0.02 +- 0.002"
trans_trans = { value = 0.02, standard_error = 0.005 }
trans_rot = 0.0
[[effect]]
name = "wheelbase"
e = { value = 0.01, standard_error = 0.002 }
[[effect]]
name = "wheel_scale"
e = { value = 0.02, standard_error = 0.001 }
[fit.correlation]
parameters = ["wheelbase.e", "wheel_scale.e", "trans_trans"]
matrix = [
  [1.0, -0.9, 0.0],  # wheelbase.e
  [-0.9, 1.0, 0.2],
  [0.0, 0.2, 1],
]
"""


def test_factor_makes_the_matrix_and_keeps_every_deviation():
    rng = np.random.default_rng(1)
    for n in (1, 2, 5, 9):
        whole = np.cov(rng.normal(size=(n, 2 * n)) + 1.0).reshape(n, n)
        one = Correlation.of_covariance([str(i) for i in range(n)], whole)
        factor = np.array(one.factor())
        np.testing.assert_allclose(factor @ factor.T, np.array(one.matrix), atol=1e-9)
        assert (np.triu(factor, 1) == 0.0).all()


@pytest.mark.parametrize("less", [0.0, 4e-5])
def test_what_is_fully_correlated_moves_as_one_though_rounding_made_it_indefinite(less):
    close = 1.0 - less
    matrix = ((1.0, 1.0, 0.5), (1.0, 1.0, 0.5 + 2e-4), (0.5, 0.5 + 2e-4, close + less))
    factor = np.array(Correlation(("a", "b", "c"), matrix).factor())
    np.testing.assert_allclose(np.linalg.norm(factor, axis=1), 1.0, atol=1e-12)
    np.testing.assert_allclose(factor @ factor.T, matrix, atol=1e-3)


def test_groups_hang_together_by_any_chain_and_loners_are_in_none():
    one = Correlation(NAMES, tuple(map(tuple, MATRIX.tolist())))
    assert one.groups() == [("a", "b", "c")]
    assert one.among(["c", "a", "x"]) == Correlation(("c", "a"), ((1.0, 0.0), (0.0, 1.0)))
    assert one.among(["a", "c"]).groups() == []


def test_covariance_gives_correlations_and_drops_what_has_no_variance():
    covariance = np.diag([2.0, 0.0, 0.5, 3.0]) @ MATRIX @ np.diag([2.0, 0.0, 0.5, 3.0])
    one = Correlation.of_covariance(NAMES, covariance)
    assert one.names == ("a", "c", "d")
    assert one.matrix[0] == (1.0, 0.0, 0.0)


def test_file_keeps_it_in_the_order_of_its_parameters():
    model = parse_model(FILE)
    assert model.correlation.names == ("wheelbase.e", "wheel_scale.e", "trans_trans")
    text = format_model(model)
    assert "  [1.0000, 0.0000, 0.2000],  # trans_trans" in text
    again = parse_model(text)
    assert again.correlation.names == ("trans_trans", "wheelbase.e", "wheel_scale.e")
    assert again.correlation.matrix[1][2] == -0.9
    assert format_model(again) == text
    alone = FILE[: FILE.index("[fit")]
    assert "[fit" not in format_model(parse_model(alone))


@pytest.mark.parametrize(
    ("old", "new", "word"),
    [
        ('"trans_trans"]', '"wheelbase.e"]', "each once"),
        ('["wheelbase.e", "wheel_scale.e", "trans_trans"]', '"wheelbase.e"', "write a list of names"),
        ("[0.0, 0.2, 1]", "[0.0, 0.2]", "3 rows of 3 numbers"),
        ("[0.0, 0.2, 1]", "[0.0, 0.3, 1]", "symmetric"),
        ("[0.0, 0.2, 1]", "[0.0, 0.2, 0.5]", "1 on its diagonal"),
        ("[0.0, 0.2, 1]", "[0.0, nan, 1]", "write numbers from -1 to 1"),
        ("[0.0, 0.2, 1]", "[0.0, 1e400, 1]", "write numbers from -1 to 1"),
        ("[0.0, 0.2, 1]", "[0.0, true, 1]", "write numbers from -1 to 1"),
        ("[0.0, 0.2, 1]", '[0.0, "0.2", 1]', "write numbers from -1 to 1"),
        ("matrix =", "covariance =", "unknown key 'covariance'"),
        ("[fit.correlation]", "[fit.other]", "unknown key 'other'"),
        ("[fit.correlation]", "[[fit.correlation]]", "it must be a table"),
    ],
)
def test_what_makes_no_sense_is_reported_in_one_line(old, new, word):
    assert old in FILE
    with pytest.raises(ModelError) as caught:
        parse_model(FILE.replace(old, new))
    assert word in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "gone"),
    [
        ("{ value = 0.02, standard_error = 0.005 }", "0.02", "trans_trans"),
        ('name = "wheelbase"', 'name = "gyro_scale"', "wheelbase.e"),
    ],
)
def test_an_edited_file_is_read_without_its_correlation_and_one_warning_says_so(old, new, gone):
    assert old in FILE
    with pytest.warns(UserWarning, match=rf"\[fit.correlation\] is left out: {gone} has no standard error") as said:
        model = parse_model(FILE.replace(old, new))
    assert len(said) == 1
    assert "\n" not in str(said[0].message)
    assert len(model.correlation) == 0
    assert "[fit" not in format_model(model)


def test_errors_that_cannot_hang_together_so_are_refused():
    with pytest.raises(ModelError, match=r"smallest eigenvalue is -0\.\d+"):
        parse_model(
            FILE.replace("0.2", "0.9").replace("[1.0, -0.9, 0.0]", "[1.0, -0.9, 0.9]").replace("[0.0,", "[0.9,")
        )
    many = ", ".join(f'"x{i}"' for i in range(65))
    with pytest.raises(ModelError, match="65 names; at most 64"):
        parse_model(FILE.replace('"wheelbase.e", "wheel_scale.e", "trans_trans"', many))
