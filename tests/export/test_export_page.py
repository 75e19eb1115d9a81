"""The formulas that docs/export.md prints are what the code computes."""

import re
from pathlib import Path

import pytest

from odomcorrupt.effects import effect_from_values
from odomcorrupt.export import FLOOR, Steady, amcl_alphas, message_noise, twist_variances, wheel_multipliers
from odomcorrupt.model.motion_model import MotionModel, Noise
from odomcorrupt.model.noise_laws import Coefficients

PAGE = (Path(__file__).parents[2] / "docs" / "export.md").read_text(encoding="utf8")
DIFFUSION = Noise("diffusion", Coefficients(0.04, 0.03, 0.05, 0.02))
K = {"rot_rot": 0.04, "rot_trans": 0.03, "trans_trans": 0.05, "trans_rot": 0.02}
DRIVE = Steady(0.5, 0.4, 50.0)


def formula(name: str, *, holding: str = "") -> str:
    """Return the right side of a formula of the page as Python; `holding` chooses among several of one name."""
    found = re.findall(rf"(?<!\w){re.escape(name)} = (.+?)(?=  |$|,  |\. |\.\n| and Var|:\n)", PAGE, re.MULTILINE)
    (chosen,) = {one for one in found if holding in one}
    return re.sub(r"(?<=[\w)]) +(?=[\w(])", " * ", chosen).replace("^", "**")


def value(name: str, numbers: dict[str, object], *, holding: str = "") -> float:
    return eval(formula(name, holding=holding), {"__builtins__": {}}, numbers)  # noqa: S307 - our own page


def test_wheel_multipliers():
    n: dict[str, object] = {"E": 0.02, "e": 0.05, "c": 0.03, "b": 0.4}
    n["g"] = value("g", n)
    n["M"] = value("M", n, holding="E")
    n["s"] = value("s", n, holding="M")
    n["D"] = value("D", n, holding="c s b")
    right, left = value("m_R, m_L", n)
    effects = (("wheel_scale", {"e": 0.02}), ("wheelbase", {"e": 0.05}), ("unequal_wheels", {"curvature": 0.03}))
    model = MotionModel(DIFFUSION, tuple(effect_from_values(name, values) for name, values in effects), 0.4)
    found = wheel_multipliers(model)
    assert [*found.values()] == pytest.approx([n["s"], left, right])


@pytest.mark.parametrize(("turn", "h"), [("rolling", 2.0), ("spot", 1.0)])
def test_amcl_alphas(turn, h):
    *computed, _ = amcl_alphas(DIFFUSION, 0.25, 0.2, turn=turn, drive=DRIVE).values()
    names = ("alpha1", "alpha2", "alpha3", "alpha4")
    marks = ("rot_rot", "rot_trans", "trans_trans", "trans_rot")
    n: dict[str, object] = {**K, "d": 0.25, "a": 0.2, "h": h}
    printed = [value(name, n, holding=mark) for name, mark in zip(names, marks, strict=True)]
    assert computed == pytest.approx(printed)
    n["V_heading"] = {0.25: K["rot_trans"] ** 2 * 0.25, 0.2: K["rot_rot"] ** 2 * 0.2}.get
    n["V_travel"] = {0.25: K["trans_trans"] ** 2 * 0.25, 0.2: K["trans_rot"] ** 2 * 0.2}.get
    general = [
        value(name, n, holding=mark)
        for name, mark in zip(names, ("h V", "V_heading(d)/(2", "V_travel(d)", "h V"), strict=True)
    ]
    assert computed == pytest.approx(general)


def test_variances_of_twists():
    n: dict[str, object] = {**K, "v": DRIVE.speed, "omega": DRIVE.yaw_rate, "h": DRIVE.rate_hz}
    forward, leftward, yaw = twist_variances(DIFFUSION, DRIVE)
    assert forward - FLOOR == pytest.approx(value("Var(vx)", n, holding="trans_trans"))
    assert yaw - FLOOR == pytest.approx(value("Var(yaw rate)", n, holding="rot_trans"))
    message = message_noise(DIFFUSION, DRIVE)
    n |= {"V_travel": message.along, "V_heading": message.heading, "V_across": message.across}
    assert forward - FLOOR == pytest.approx(value("Var(vx)", n, holding="V_travel"))
    assert yaw - FLOOR == pytest.approx(value("Var(yaw rate)", n, holding="V_heading"))
    assert leftward - FLOOR == pytest.approx(value("Var(vy)", n))
