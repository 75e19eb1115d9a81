"""The example of docs/model-file.md is a model file, and its values are what the comments and the table say."""

import math
import re
from pathlib import Path

import pytest

from odomcorrupt.errors import ModelError
from odomcorrupt.model.model_file import format_model, parse_model
from odomcorrupt.model.motion_model import Origin

PAGE = (Path(__file__).parents[2] / "docs" / "model-file.md").read_text(encoding="utf8")
(EXAMPLE,) = re.findall(r"```toml\n(.*?)```", PAGE, re.DOTALL)


def test_the_example_is_read():
    model = parse_model(EXAMPLE)
    noise = model.noise.coefficients
    assert noise.rot_trans == pytest.approx(math.radians(0.2))
    assert noise.trans_rot == pytest.approx(0.0009)
    assert [effect.name for effect in model.effects] == ["wheelbase", "bumps", "flat_tyre"]
    assert model.track_m == pytest.approx(0.423)
    assert model.setup.origin == Origin(48.1, 11.5, 520.0)
    assert parse_model(format_model(model)).setup.origin == model.setup.origin


@pytest.mark.parametrize(
    ("origin", "complaint"),
    [
        ("{ latitude = 48.1 }", "longitude is missing"),
        ("{ latitude = 95, longitude = 1 }", "in degrees"),
        ("3", "table"),
    ],
)
def test_an_origin_that_is_no_place_is_refused(origin, complaint):
    with pytest.raises(ModelError, match=complaint):
        parse_model(re.sub(r"origin = \{.*?\}", f"origin = {origin}", EXAMPLE))


def test_every_coefficient_of_the_example_is_in_the_table():
    table = set(re.findall(r"^\| `(\w+)` \|", PAGE, re.MULTILINE))
    assert table == set(re.findall(r"^(\w+_(?:rot|trans|time)) = ", EXAMPLE, re.MULTILINE))
