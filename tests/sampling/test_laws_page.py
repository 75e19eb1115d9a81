import re
from pathlib import Path

import numpy as np
import pytest

from odomcorrupt.cli import run
from odomcorrupt.model.motion_model import Noise, Step
from odomcorrupt.model.noise_laws import LAWS, Coefficients, law_named
from odomcorrupt.sampling.convert import convert, drift_of

PAGE = (Path(__file__).parents[2] / "docs" / "laws.md").read_text()


def test_every_law_is_in_the_table():
    table = [line for line in PAGE.splitlines() if line.startswith("| `")]
    named = {re.match(r"\| `([\w-]+)`", line)[1] for line in table}
    assert set(LAWS) <= named


def test_session_on_the_page_is_what_the_command_prints(capsys):
    session = re.search(r"```\n\$ odomcorrupt (.*?)\n(.*?)```", PAGE, re.DOTALL)
    assert run(session[1].split()) == 0
    assert capsys.readouterr().out == session[2]


@pytest.mark.parametrize("name", ["linear", "quadratic", "velocity", "omni"])
def test_formulas_of_the_conversion_table_hold(name):
    row = re.findall(rf"^\| `{name}` \|(.*)\|$", PAGE, re.MULTILINE)[-1]
    law = law_named(name)
    step = Step(0.3, 0.15)
    alphas = [0.11, 0.07, 0.05, 0.03, 0.02, 0.013][: len(law.alphas)]
    if name == "omni":
        alphas = alphas[:4]
    found = convert(Noise(name, law.coefficients(alphas), step), law_named("diffusion"), None).coefficients
    symbols = {f"A{i + 1}": a for i, a in enumerate(alphas)} | {"D": step.distance_m, "Φ": step.angle_rad}
    for cell, coefficient in zip(row.split("|"), ("rot_rot", "rot_trans", "trans_trans", "trans_rot"), strict=True):
        text = re.sub(r"√(\w+)", r"√(\1)", cell.strip())
        text = re.sub(r"(?<=[\w)]) (?=[\w√(])", "*", text).replace("√", "sqrt")
        value = eval(text, {"sqrt": np.sqrt, "__builtins__": {}}, symbols)  # noqa: S307 - our own page
        assert getattr(found, coefficient) == pytest.approx(value), cell


def test_same_numbers_differ_between_laws_as_the_page_says():
    said = re.search(
        r"deviation of ([\d.]+) rad\s+by\s+`linear`, ([\d.]+) rad by `quadratic` and ([\d.]+) rad by `diff", PAGE
    )
    per_message = Step(0.02, 1.0)
    for name, value in zip(("linear", "quadratic", "diffusion"), said.groups(), strict=True):
        noise = Noise(name, Coefficients(0.05, 0.05, 0.05, 0.05), per_message if LAWS[name].per_step else None)
        assert np.sqrt(10.0 * drift_of(noise).rot_trans) == pytest.approx(float(value), abs=0.005)
