"""Correlations of a fit's parameters: as numbers, and in the model file."""

import numpy as np
import pytest

from odomcorrupt.errors import ModelError
from odomcorrupt.model.correlation import Correlation
from odomcorrupt.model.model_file import format_model, parse_model

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
