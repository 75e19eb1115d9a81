"""A mounting is reported if it is significant and large enough, with its size; sizes of regions are full ones."""

from types import SimpleNamespace

import numpy as np
import pytest

from odomcorrupt.effects import effect_from_values
from odomcorrupt.report.text.brief import _mounting_words
from odomcorrupt.report.text.design import advice_sentences
from odomcorrupt.report.text.numbers import numbers_text
from odomcorrupt.study.design.advise import Advice
from odomcorrupt.study.design.identifiability import UntestableEffect
from odomcorrupt.study.estimate.drive_type import DriveType


def words(name, values, errors):
    run = SimpleNamespace(matched=True)
    problem = SimpleNamespace(recordings=[run])
    fit = SimpleNamespace(effects=[effect_from_values(name, values)], standard_errors=np.array(errors), problem=problem)
    return _mounting_words(SimpleNamespace(added=(), drive_type=DRIVE), fit)


DRIVE = DriveType("differential", "", "")


@pytest.mark.parametrize(("yaw", "error"), [(2e-4, 1.5e-4), (2e-4, 1e-6), (0.02, 0.01)])
def test_an_insignificant_or_tiny_yaw_is_not_reported(yaw, error):
    assert words("mount_yaw", {"yaw": yaw}, [error]) == ""


def test_a_yaw_is_a_turn_and_a_lever_arm_a_point():
    assert words("mount_yaw", {"yaw": 0.0052}, [2e-4]) == "the truth is turned by 0.3 deg against TF"
    said = words("lever_arm", {"x": 0.06, "y": -0.001}, [1e-3, 1e-3])
    assert said.startswith("the truth follows a point 6 cm ahead of the base (lever_arm")


def test_a_region_is_given_by_its_full_size():
    patch = effect_from_values("region_slip", {"slip": 0.1, "x": 1.0, "y": 2.0, "radius": 2.483, "width": 3.455})
    said = ", ".join(numbers_text(patch, [0.01]))
    assert said.endswith("5.0 m x 6.9 m")
    assert "radius" not in said


def test_an_effect_with_evidence_is_not_called_untestable():
    advice = Advice((), (UntestableEffect("backlash", "never reversed", None, "reverse"),), (), None)
    assert advice_sentences(advice) == ["backlash: not testable here: never reversed; reverse"]
    assert advice_sentences(advice, {"backlash": "wheelbase"}) == ["backlash: not separated from wheelbase; reverse"]
