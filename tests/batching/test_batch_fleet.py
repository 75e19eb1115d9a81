"""A fleet's robots have its mean and spread; ranges of a sweep are covered evenly."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from odomcorrupt.batching.parameter_draws import fleet_model
from odomcorrupt.batching.sweep import parse_range, sobol_points, variants
from odomcorrupt.cli import run
from odomcorrupt.errors import ModelError
from odomcorrupt.model.model_file import parse_model, read_model

OFFICE = Path(__file__).parents[2] / "fixtures" / "office.mcap"


def robot(rot, e=None, error=0.0, law="diffusion"):
    text = (
        f'schema = 1\n[noise]\nlaw = "{law}"\nrot_rot = {rot}\nrot_trans = 0.02\ntrans_trans = 0.02\ntrans_rot = 0.0\n'
    )
    if e is not None:
        text += f'[[effect]]\nname = "wheelbase"\ne = {{ value = {e}, standard_error = {error} }}\n'
    return text


def fleet(*texts):
    return fleet_model({f"{i}.toml": parse_model(text) for i, text in enumerate(texts)})


def test_mean_and_spread_are_those_of_the_robots():
    found = fleet(robot(0.01, 0.01), robot(0.02, 0.02), robot(0.03, 0.03))
    assert found.noise.coefficients.rot_rot == pytest.approx(0.02)
    assert found.effects[0].e == pytest.approx(0.02)
    assert found.standard_errors["rot_rot"] == pytest.approx(0.01)
    assert found.standard_errors["wheelbase.e"] == pytest.approx(0.01)
    assert "rot_trans" not in found.standard_errors


def test_what_the_fits_are_unsure_of_is_no_spread_of_robots():
    rng = np.random.default_rng(1)
    spreads = []
    for _ in range(100):
        true = 0.02 + 0.01 * rng.standard_normal(12)
        read = true + 0.02 * rng.standard_normal(12)
        spreads.append(fleet(*(robot(0.01, float(e), 0.02) for e in read)).standard_errors.get("wheelbase.e", 0.0) ** 2)
    assert np.mean(spreads) == pytest.approx(0.01**2, rel=0.35)


def test_a_robot_without_an_effect_has_it_at_zero():
    found = fleet(robot(0.01, 0.04), robot(0.01))
    assert found.effects[0].e == pytest.approx(0.02)
    assert found.standard_errors["wheelbase.e"] == pytest.approx(0.04 / np.sqrt(2.0), rel=1e-2)


@pytest.mark.parametrize(
    ("texts", "said"),
    [((robot(0.01),), "two or more"), ((robot(0.01), robot(0.01, law="linear")), "different noise laws")],
)
def test_what_is_no_fleet_is_refused(texts, said):
    with pytest.raises(ModelError, match=said):
        fleet(*texts)


def test_every_run_of_a_batch_is_another_robot_of_the_fleet(tmp_path, capsys):
    files = []
    for i, rot in enumerate((0.01, 0.02, 0.04)):
        files += ["--fleet", str(tmp_path / f"{i}.toml")]
        (tmp_path / f"{i}.toml").write_text(robot(rot, 0.01 * i))
    words = ["batch", str(OFFICE), str(tmp_path / "runs"), "--runs", "5", "--seed", "3", "--output", "trajectories"]
    assert run([*words, *files]) == 0
    lines = [json.loads(line) for line in (tmp_path / "runs" / "manifest.jsonl").read_text().splitlines()]
    assert len({line["drawn"]["wheelbase.e"] for line in lines}) == 5
    own = read_model(tmp_path / "runs" / lines[2]["robot"])
    assert own.effects[0].e == pytest.approx(lines[2]["drawn"]["wheelbase.e"])
    assert run([*words, *files, "--preset", "article"]) == 2
    assert "--fleet and --preset" in capsys.readouterr().err


def test_sobol_points_fill_every_cell_of_both_ranges():
    ranges = [parse_range("alpha-scale=0.25..4:log"), parse_range("wheel_scale.e=-0.02..0.02")]
    points = np.array([[float(value) for _, value in point] for point in sobol_points(ranges, 16)])
    scale = np.log(points[:, 0] / 0.25) / np.log(16.0)
    e = (points[:, 1] + 0.02) / 0.04
    for part in (scale, e):
        assert sorted((part * 16).astype(int).tolist()) == list(range(16))
    # a square of a quarter by a quarter holds one point each
    assert len({(int(4 * a), int(4 * b)) for a, b in zip(scale, e, strict=True)}) == 16


def test_a_sweep_adds_effects_and_names_its_points_by_their_values():
    model = parse_model(robot(0.01))
    found = variants(model, ["wheel_scale.e=0..0.02", "alpha-scale=1,2"], 4)
    assert len(found) == 8
    assert len({one.name for one in found}) == 8
    for one in found:
        assert f"wheel_scale.e={one.model.effects[0].e:.4g}" in one.name


@pytest.mark.parametrize(
    ("sweeps", "points", "said"),
    [
        (["alpha-scale=1..2"], 0, "go together"),
        (["alpha-scale=1,2"], 4, "go together"),
        (["alpha-scale=2..1"], 4, "lower value to the higher"),
        (["alpha-scale=0..1:log"], 4, "above 0"),
        (["speed.e=0..1"], 4, "is not known"),
        (["wheelbase.k=0..1"], 4, "is not known"),
    ],
)
def test_ranges_that_make_no_sense_are_refused(sweeps, points, said):
    with pytest.raises(ModelError, match=said):
        variants(parse_model(robot(0.01)), sweeps, points)
