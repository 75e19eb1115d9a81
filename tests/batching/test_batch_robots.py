"""Robots and fleets of a batch."""

import json
import shlex
from pathlib import Path

import numpy as np
import pytest
from test_batch_bytes import records

from odomcorrupt.batching.job import draw_robot, fleet_model, parse_range, sobol_points, spreads_of, variants
from odomcorrupt.cli import run
from odomcorrupt.errors import ModelError
from odomcorrupt.model.model_file import parse_model, read_model

MODEL = """schema = 1
[noise]
rot_rot = 0.03
rot_trans = "0.02 +- 0.008"
trans_trans = { value = 0.02, standard_error = 0.005 }
trans_rot = 0.0
[[effect]]
name = "unequal_wheels"
curvature = "0.004 +- 0.002"
"""


@pytest.fixture(autouse=True)
def _robot(here):
    Path("robot.toml").write_text(MODEL)


def test_drawn_robots_have_the_stated_mean_and_spread():
    model = parse_model(MODEL)
    spreads = spreads_of(model, {"rot_trans", "unequal_wheels.curvature"})
    assert [spread.parameter for spread in spreads] == ["rot_trans", "curvature"]
    robots = [draw_robot(model, spreads, 5, k) for k in range(400)]
    curvature = np.array([robot.effects[0].curvature for robot in robots])
    rot_trans = np.array([robot.noise.coefficients.rot_trans for robot in robots])
    assert abs(curvature.mean() - 0.004) < 4 * 0.002 / 20
    assert curvature.std() == pytest.approx(0.002, rel=0.15)
    assert rot_trans.min() >= 0.0
    assert rot_trans.mean() == pytest.approx(0.02, abs=4 * 0.008 / 20)
    assert abs(np.corrcoef(curvature, rot_trans)[0, 1]) < 0.2
    assert {robot.noise.coefficients.rot_rot for robot in robots} == {0.03}


def test_one_more_distribution_changes_no_other_value():
    model = parse_model(MODEL)
    few, more = (spreads_of(model, names) for names in ({"unequal_wheels.curvature"}, None))
    assert len(more) == 3
    assert draw_robot(model, few, 5, 9).effects == draw_robot(model, more, 5, 9).effects


CORRELATED = """schema = 1
[noise]
rot_rot = 0.03
rot_trans = { value = 0.02, standard_error = 0.004 }
trans_trans = { value = 0.02, standard_error = 0.02 }
trans_rot = 0.0
[[effect]]
name = "wheelbase"
e = { value = 0.01, standard_error = 0.002 }
[[effect]]
name = "wheel_scale"
e = { value = 0.02, standard_error = 0.001 }
[fit.correlation]
parameters = ["wheelbase.e", "wheel_scale.e", "rot_trans", "trans_trans"]
matrix = [[1.0, -0.9, 0.0, 0.0], [-0.9, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.6], [0.0, 0.0, 0.6, 1.0]]
"""


def test_posterior_robots_hang_together_as_the_fit_says():
    model = parse_model(CORRELATED)
    spreads = spreads_of(model, None)
    robots = [draw_robot(model, spreads, 5, k) for k in range(600)]
    base, scale = (np.array([robot.effects[i].e for robot in robots]) for i in (0, 1))
    assert np.corrcoef(base, scale)[0, 1] == pytest.approx(-0.9, abs=0.03)
    assert base.mean() == pytest.approx(0.01, abs=4 * 0.002 / 600**0.5)
    assert base.std() == pytest.approx(0.002, rel=0.12)
    assert scale.std() == pytest.approx(0.001, rel=0.12)
    k = [robot.noise.coefficients for robot in robots]
    turn, along = np.array([one.rot_trans for one in k]), np.array([one.trans_trans for one in k])
    # cut off at zero, so a little less than the 0.6 of the whole plane
    assert 0.4 < np.corrcoef(turn, along)[0, 1] < 0.65
    assert along.min() >= 0.0
    assert abs(np.corrcoef(turn, base)[0, 1]) < 0.15
    assert not robots[0].correlation


def test_what_does_not_hang_together_keeps_its_draws():
    model, free = parse_model(CORRELATED), parse_model(CORRELATED[: CORRELATED.index("[fit")])
    tied, loose = (draw_robot(one, spreads_of(one, {"wheelbase.e", "rot_trans"}), 5, 9) for one in (model, free))
    assert tied == loose
    tied, loose = (draw_robot(one, spreads_of(one, None), 5, 9) for one in (model, free))
    assert tied.effects[0] == loose.effects[0]
    assert tied.effects[1] != loose.effects[1]


def test_an_error_without_end_is_refused():
    model = parse_model(CORRELATED.replace("standard_error = 0.02 ", "standard_error = inf "))
    with pytest.raises(ModelError, match="trans_trans: standard error inf"):
        spreads_of(model, None)


def test_a_mean_beyond_its_bounds_is_refused_and_not_drawn_for_ever():
    model = parse_model(MODEL)
    spreads = tuple(
        type(spread)(spread.effect, spread.parameter, 1e9) for spread in spreads_of(model, {"unequal_wheels.curvature"})
    )
    with pytest.raises(ModelError, match="hardly ever"):
        draw_robot(model, spreads, 1, 1)


@pytest.mark.parametrize(("robots", "names"), [
    ("stated", {"rot_trans", "unequal_wheels.curvature"}),
    ("posterior", {"rot_trans", "trans_trans", "unequal_wheels.curvature"}),
])  # fmt: skip
def test_a_drawn_robot_is_in_the_manifest_and_its_command_makes_its_bytes(robots, names, here):
    words = ["batch", "in.mcap", "runs", "--runs", "3", "--model", "robot.toml", "--seed", "7", "--robots", robots]
    assert run(words) == 0
    made = records(here / "runs")
    assert all(set(record["drawn"]) == names for record in made)
    assert len({record["drawn"]["rot_trans"] for record in made}) == 3
    command = shlex.split(made[2]["command"])
    assert run(command[1:]) == 0
    assert Path(command[2]).read_bytes() == (here / "runs" / made[2]["file"]).read_bytes()


def test_a_model_file_edited_later_does_not_change_the_command(here):
    Path("plain.toml").write_text(
        MODEL.split("[[effect]]", maxsplit=1)[0].replace('"0.02 +- 0.008"', "0.0212345678912345")
    )
    assert run(["batch", "in.mcap", "runs", "--runs", "2", "--model", "plain.toml", "--seed", "7"]) == 0
    Path("plain.toml").write_text("gone")
    record = records(here / "runs")[1]
    assert run(shlex.split(record["command"])[1:]) == 0
    assert Path(record["file"]).read_bytes() == (here / "runs" / record["file"]).read_bytes()


def test_sweeps_make_a_directory_each_that_stands_alone(here):
    words = ["batch", "in.mcap", "runs", "--runs", "2", "--seed", "7", "--output", "overlay", "--alpha", "5deg", "0.02",
             "0.05", "0.01", "--sweep", "alpha-scale=0.5,2", "--sweep", "trans_trans=0,0.1"]  # fmt: skip
    assert run(words) == 0
    names = {path.name for path in (here / "runs").iterdir()}
    assert names == {f"alpha-scale={a},trans_trans={b}" for a in ("0.5", "2") for b in ("0", "0.1")}
    record = records(here / "runs" / "alpha-scale=2,trans_trans=0")[1]
    command = shlex.split(record["command"])
    assert run(command[1:]) == 0
    assert run(["assemble", f"runs/alpha-scale=2,trans_trans=0/{record['file']}", "joined.mcap"]) == 0
    assert Path(command[2]).read_bytes() == Path("joined.mcap").read_bytes()


def test_alpha_scale_scales_deviations_under_every_law():
    for law, factor in (("diffusion", 3.0), ("linear", 3.0), ("quadratic", 9.0), ("velocity", 9.0), ("omni", 9.0)):
        model = parse_model(f'schema = 1\n[noise]\nlaw = "{law}"\nrot_rot = 0.01\nrot_trans = 0.02\n'
                            "trans_trans = 0.03\ntrans_rot = 0.04\n")  # fmt: skip
        (variant,) = variants(model, ["alpha-scale=3"])
        assert variant.model.noise.coefficients.rot_trans == pytest.approx(0.02 * factor)


@pytest.mark.parametrize("sweep", ["nothing=1", "alpha-scale", "alpha-scale=1,1", "alpha-scale=-1", "wheelbase.k=1"])
def test_a_sweep_that_makes_no_sense_is_refused(sweep):
    with pytest.raises(ModelError, match="sweeps"):
        variants(parse_model(MODEL), [sweep])


@pytest.mark.slow
@pytest.mark.usefixtures("here")
@pytest.mark.parametrize("model", ["noise", "robots"])
def test_the_spread_is_what_the_linear_model_predicts(model, invoke):
    """A deviation of n draws is known to 1/sqrt(2 n); turns of some degrees are linear to a few per cent."""
    Path("small.toml").write_text(
        MODEL.replace('"0.02 +- 0.008"', "0.01") if model == "robots" else
        MODEL.split("[[effect]]", maxsplit=1)[0].replace('"0.02 +- 0.008"', "0.02")
    )  # fmt: skip
    words = ["--runs", "250", "--model", "small.toml", "--seed", "7", "--output", "trajectories"]
    assert run(["batch", "in.mcap", "runs", *words]) == 0
    report = json.loads(invoke(["spread", "runs", "--json", "-o", "picture.svg"]).out)
    assert report["runs"] == 250
    for row in report["rows"]:
        assert row["position_m"] == pytest.approx(row["position_predicted_m"], rel=0.15)
        assert row["heading_rad"] == pytest.approx(row["heading_predicted_rad"], rel=0.15)
    assert report["rows"][-1]["after_m"] == pytest.approx(25.05, abs=0.01)
    assert Path("picture.svg").stat().st_size > 10_000


@pytest.mark.usefixtures("here")
def test_a_spread_of_one_run_or_of_no_batch_is_refused(invoke):
    assert "holds no batch" in invoke(["spread", "."], 1).err
    assert run(["batch", "in.mcap", "runs", "--runs", "1", "--seed", "7", "--output", "trajectories"]) == 0
    assert "at least two" in invoke(["spread", "runs"], 1).err
    assert "name one of its points, as runs" in invoke(["spread", "."], 1).err


@pytest.mark.parametrize("output", ["full", "overlay", "trajectories"])
def test_of_several_odometry_topics_a_batch_takes_the_one_that_the_model_was_learned_from(here, capsys, invoke, output):
    assert run(["in.mcap", "two.mcap", "--alpha", "0", "0", "0", "0", "--seed", "1", "--keep-truth", "/wheels"]) == 0
    words = ["batch", "two.mcap", "runs", "--runs", "2", "--model", "robot.toml", "--output", output]
    assert "2 nav_msgs/Odometry topics" in invoke(words, 1).err
    (here / "robot.toml").write_text(MODEL + '[source]\nodometry = "/wheels"\n')
    assert run(words) == 0, capsys.readouterr().err
    assert len(records(here / "runs")) == 2


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


def test_every_run_of_a_batch_is_another_robot_of_the_fleet(here, invoke):
    files = []
    for i, rot in enumerate((0.01, 0.02, 0.04)):
        files += ["--fleet", f"{i}.toml"]
        Path(f"{i}.toml").write_text(robot(rot, 0.01 * i))
    words = ["batch", "in.mcap", "runs", "--runs", "5", "--seed", "3", "--output", "trajectories"]
    assert run([*words, *files]) == 0
    lines = records(here / "runs")
    assert len({line["drawn"]["wheelbase.e"] for line in lines}) == 5
    own = read_model(here / "runs" / lines[2]["robot"])
    assert own.effects[0].e == pytest.approx(lines[2]["drawn"]["wheelbase.e"])
    assert "--fleet and --preset" in invoke([*words, *files, "--preset", "article"], 2).err


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
    [(["alpha-scale=1..2"], 0, "go together"),
    (["alpha-scale=1,2"], 4, "go together"),
    (["alpha-scale=2..1"], 4, "lower value to the higher"),
    (["alpha-scale=0..1:log"], 4, "above 0"),
    (["speed.e=0..1"], 4, "is not known"),
    (["wheelbase.k=0..1"], 4, "is not known")],
)  # fmt: skip
def test_ranges_that_make_no_sense_are_refused(sweeps, points, said):
    with pytest.raises(ModelError, match=said):
        variants(parse_model(robot(0.01)), sweeps, points)
