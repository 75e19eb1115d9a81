"""Parameters of other programs: numbers, the command, and the page."""

import io
import math
import re
from functools import cache

import numpy as np
import pytest
from ruamel.yaml import YAML

from odomcorrupt import export
from odomcorrupt.cli import run
from odomcorrupt.correction.undo import undo_effects
from odomcorrupt.corruption.path import NoisyPath
from odomcorrupt.effects import effect_from_values
from odomcorrupt.errors import ModelError
from odomcorrupt.export import (
    FLOOR,
    Steady,
    amcl_alphas,
    amcl_snippet,
    message_noise,
    twist_variances,
    wheel_multipliers,
)
from odomcorrupt.geometry.se2 import Increments, accumulate, increments
from odomcorrupt.model.motion_model import MotionModel, Noise, Setup, Step
from odomcorrupt.model.noise_laws import Coefficients
from recordings import ROOT

TRACK = 0.4
DRIVE = Steady(0.5, 0.5, 50.0)
DIFFUSION = Noise("diffusion", Coefficients(0.04, 0.03, 0.05, 0.02))
SILENT = Noise("diffusion", Coefficients(0.0, 0.0, 0.0, 0.0))
NOISES = {
    "diffusion": DIFFUSION,
    "linear per message": Noise("linear", Coefficients(0.3, 0.2, 0.4, 0.1)),
    "quadratic per step": Noise("quadratic", Coefficients(0.02, 0.01, 0.03, 0.005), Step(0.1, 0.3)),
    "velocity per message": Noise("velocity", Coefficients(0.3, 0.4, 0.5, 0.1, end_trans=0.1, end_rot=0.2)),
    "with white twists": Noise("diffusion", Coefficients(0.02, 0.01, 0.02, 0.01, white_v=0.05, white_omega=0.1)),
}


def robot(*effects, track_m=TRACK):
    return MotionModel(SILENT, tuple(effect_from_values(name, values) for name, values in effects), track_m)


def wheel_path(right_m, left_m, track_m):
    """The mid-point rule of a driver, from the travel of its two wheels."""
    along, turn = (right_m + left_m) / 2.0, (right_m - left_m) / track_m
    return accumulate(np.zeros(3), Increments(along, np.zeros_like(along), turn))


@pytest.mark.parametrize(
    ("effects", "tolerance"),
    [
        ((("wheel_scale", {"e": 0.03}),), 1e-9),
        ((("wheelbase", {"e": 0.05}),), 1e-9),
        ((("unequal_wheels", {"curvature": 0.02}),), 1e-9),
        ((("wheel_scale", {"e": -0.02}), ("wheelbase", {"e": 0.3})), 1e-9),
        # a controller applies the curvature's along part to the true track: a product of two small numbers is left
        ((("wheel_scale", {"e": 0.01}), ("wheelbase", {"e": 0.02}), ("unequal_wheels", {"curvature": 0.01})), 2e-3),
    ],
)
def test_a_controller_with_these_multipliers_computes_the_corrected_path(effects, tolerance):
    t_s = np.arange(2000) / 50.0
    right = 0.01 + 0.004 * np.sin(t_s)[1:]
    left = 0.01 + 0.003 * np.cos(0.4 * t_s)[1:]
    nominal = wheel_path(right, left, TRACK)
    model = robot(*effects)
    corrected = nominal + undo_effects(model.effects, t_s, nominal, TRACK).error_xyt
    found = wheel_multipliers(model)
    separation, left_radius, right_radius = found.values()
    controller = wheel_path(right * right_radius, left * left_radius, TRACK * separation)
    assert np.abs(corrected - nominal).max() > 0.05
    np.testing.assert_allclose(controller, corrected, atol=tolerance)


def test_a_steering_controller_with_these_dimensions_computes_the_corrected_path():
    t_s = np.arange(2000) / 50.0
    tangent, travel = np.tan(0.15 * np.sin(0.7 * t_s[1:])), 0.01 + 0.004 * np.sin(t_s[1:])

    def path(radius, axles):
        return accumulate(np.zeros(3), Increments(radius * travel, 0.0 * travel, radius * travel * tangent / axles))

    effects = tuple(effect_from_values(f"{name}_scale", {"e": e}) for name, e in (("steering", 0.05), ("wheel", 0.02)))
    model = MotionModel(SILENT, effects, setup=Setup(drive_type="car"))
    corrected = path(1.0, 0.3) + undo_effects(effects, t_s, path(1.0, 0.3), None).error_xyt
    found = path(*export.wheels_snippet(model, export.Base(wheelbase=0.3, radius=1.0), "node").values.values())
    np.testing.assert_allclose(found, corrected, atol=1e-9)
    assert np.abs(found - path(1.0, 0.3)).max() > 0.05


def test_unequal_wheels_need_a_track_and_the_others_do_not():
    bent = robot(("unequal_wheels", {"curvature": 0.02}), track_m=None)
    with pytest.raises(ModelError, match="track_m"):
        wheel_multipliers(bent)
    assert [*wheel_multipliers(bent, 0.4).values()] == pytest.approx([1.0, 0.996, 1.004])
    wider = wheel_multipliers(robot(("wheelbase", {"e": 0.05}), track_m=None))
    assert wider["wheel_separation_multiplier"] == pytest.approx(1.05)
    with pytest.raises(ModelError, match="no radius"):
        wheel_multipliers(robot(("unequal_wheels", {"curvature": 1.0})), 3.0)


def differential_update(alphas, delta, samples, rng):
    """One update of nav2's differential motion model as its documentation and the book have it, from heading 0."""
    dx, dy, dtheta = delta
    trans = math.hypot(dx, dy)
    rot1 = math.atan2(dy, dx) if trans >= 0.01 else 0.0
    rot2 = dtheta - rot1
    spread_rot = [math.sqrt(alphas["alpha1"] * rot**2 + alphas["alpha2"] * trans**2) for rot in (rot1, rot2)]
    spread_trans = math.sqrt(alphas["alpha3"] * trans**2 + alphas["alpha4"] * (rot1**2 + rot2**2))
    turned = rot1 - rng.normal(0.0, spread_rot[0], samples)
    far = trans - rng.normal(0.0, spread_trans, samples)
    return np.stack(
        (far * np.cos(turned), far * np.sin(turned), turned + rot2 - rng.normal(0.0, spread_rot[1], samples)), 1
    )


def amcl_ends(alphas, delta, updates, samples=6000):
    rng = np.random.default_rng(5)
    pose = np.zeros((samples, 3))
    for _ in range(updates):
        step = differential_update(alphas, delta, samples, rng)
        c, s = np.cos(pose[:, 2]), np.sin(pose[:, 2])
        pose[:, 0] += c * step[:, 0] - s * step[:, 1]
        pose[:, 1] += s * step[:, 0] + c * step[:, 1]
        pose[:, 2] += step[:, 2]
    return pose


@cache
def model_ends(noise, speed, yaw_rate, seconds, runs=800):
    t_s = np.arange(round(seconds * DRIVE.rate_hz) + 1) / DRIVE.rate_hz
    n = len(t_s) - 1
    rows = (np.full(n, speed), np.zeros(n), np.full(n, yaw_rate))
    clean = accumulate(np.zeros(3), Increments(*(row / DRIVE.rate_hz for row in rows)))
    stamps_ns = (t_s * 1e9).astype(np.int64)
    model = MotionModel(noise)
    return np.array([NoisyPath(model, seed).feed(stamps_ns, clean).error_xyt[-1] for seed in range(runs)])


@pytest.mark.slow
@pytest.mark.parametrize("name", list(NOISES))
def test_amcls_particles_spread_on_a_straight_drive_as_the_model_does(name):
    alphas = amcl_alphas(NOISES[name], 0.25, 0.2, drive=DRIVE)
    particles = amcl_ends(alphas, (0.25, 0.0, 0.0), 20)
    drawn = model_ends(NOISES[name], DRIVE.speed, 0.0, 5.0 / DRIVE.speed)
    np.testing.assert_allclose(particles[:, :1].std(axis=0), drawn[:, :1].std(axis=0), rtol=0.1)
    np.testing.assert_allclose(particles[:, 1:].std(axis=0), drawn[:, 1:].std(axis=0), rtol=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("name", list(NOISES))
@pytest.mark.parametrize("turn", ["rolling", "spot"])
def test_amcls_particles_spread_in_turns_as_the_model_does(name, turn):
    alphas = amcl_alphas(NOISES[name], 0.25, 0.2, turn=turn, drive=DRIVE)
    # rolling so slowly that the way does not count, but far enough to have a bearing
    chord = 0.011 if turn == "rolling" else 0.0
    delta = (chord * math.cos(0.1), chord * math.sin(0.1), 0.2)
    particles = amcl_ends(alphas, delta, 15)
    drawn = model_ends(NOISES[name], 0.0, DRIVE.yaw_rate, 3.0 / DRIVE.yaw_rate)
    assert particles[:, 2].std() == pytest.approx(drawn[:, 2].std(), rel=0.1)
    # along the bearing of each step, where both put the noise of the travel
    assert np.hypot(*particles[:, :2].std(axis=0)) == pytest.approx(np.hypot(*drawn[:, :2].std(axis=0)), rel=0.2)


def test_amcls_own_law_at_its_own_step_comes_back():
    k = Coefficients(0.2, 0.1, 0.3, 0.15)
    own = Noise("quadratic", k, Step(0.25, 0.2))
    assert [*amcl_alphas(own, 0.25, 0.2, drive=DRIVE).values()][:4] == pytest.approx([0.2, 0.1, 0.3, 0.15])
    omni = Noise("omni", Coefficients(0.2, 0.1, 0.3, 0.15, across_trans=0.05), Step(0.25, 0.2))
    alphas = amcl_alphas(omni, 0.25, 0.2, drive=DRIVE, omni=True)
    assert [*alphas.values()] == pytest.approx([0.2, 0.1, 0.3, 0.15, 0.05])
    assert '"nav2_amcl::OmniMotionModel"' in amcl_snippet(MotionModel(omni), 0.25, 0.2, "rolling", DRIVE).text


def test_alphas_depend_on_the_rate_only_where_they_say_so():
    for name, noise in NOISES.items():
        text = amcl_snippet(MotionModel(noise), 0.25, 0.2, "rolling", DRIVE).text
        assert ("depends on the message rate" in text) is (name not in {"diffusion", "quadratic per step"})
    slow, fast = (amcl_alphas(DIFFUSION, 0.25, 0.2, drive=Steady(v, v, h)) for v, h in ((0.1, 10.0), (1.0, 100.0)))
    assert slow == pytest.approx(fast)


@pytest.mark.parametrize("name", list(NOISES))
def test_twist_variances_are_those_of_the_models_velocities(name):
    noise = NOISES[name]
    found = twist_variances(noise, DRIVE)
    t_s = np.arange(20_001) / DRIVE.rate_hz
    n = len(t_s) - 1
    rows = (np.full(n, DRIVE.speed), np.zeros(n), np.full(n, DRIVE.yaw_rate))
    clean = accumulate(np.zeros(3), Increments(*(row / DRIVE.rate_hz for row in rows)))
    samples = NoisyPath(MotionModel(noise), 7).feed((t_s * 1e9).astype(np.int64), clean)
    noisy = increments(clean + samples.error_xyt)
    drawn = [np.var(part * DRIVE.rate_hz) for part in (noisy.ds_m, noisy.dl_m, noisy.dtheta_rad)]
    assert found == pytest.approx(drawn, rel=0.08)


def test_a_robot_at_rest_has_no_noise_but_that_of_its_twists():
    rest = Steady(0.0, 0.0, 50.0)
    assert message_noise(NOISES["quadratic per step"], rest).heading == 0.0
    assert message_noise(DIFFUSION, rest).along == 0.0
    assert message_noise(NOISES["with white twists"], rest).along == pytest.approx((0.05 / 50.0) ** 2)


MODEL = """schema = 1
[noise]
law = "{law}"
rot_rot = 0.03
rot_trans = 0.01
trans_trans = 0.02
trans_rot = 0.000001
[[effect]]
name = "wheelbase"
e = 0.03
[[effect]]
name = "unequal_wheels"
curvature = 0.01
[[effect]]
name = "side_slip"
k = 0.02
[[effect]]
name = "gauss_markov"
sigma = 0.02
{more}
"""


@pytest.fixture
def exported(tmp_path, capsys):
    """Export a model; return exit code, the parsed YAML, what was printed, and what was said."""

    def call(target, *args, law="diffusion", more="[robot]\ntrack = 0.4"):
        path = tmp_path / "robot.toml"
        path.write_text(MODEL.format(law=law, more=more))
        code = run(["export", "-v", str(path), "--to", target, *args])
        printed = capsys.readouterr()
        found = None if printed.out.startswith("<") else YAML(typ="safe").load(io.StringIO(printed.out))
        return code, found, printed.out, printed.err

    return call


def comments(text):
    return " ".join(line.removeprefix("# ") for line in text.splitlines() if line.startswith("# "))


def test_wheel_multipliers(exported):
    code, found, text, _ = exported("ros2_control", "--controller", "base_controller")
    assert code == 0
    values = found["base_controller"]["ros__parameters"]
    assert values["wheel_separation_multiplier"] == pytest.approx(1.03)
    difference = values["right_wheel_radius_multiplier"] - values["left_wheel_radius_multiplier"]
    assert difference == pytest.approx(0.01 * 1.03 * 0.4, abs=1e-5)
    said = comments(text)
    assert "side_slip" in said
    assert "because it is random: gauss_markov" in said
    assert "wheelbase" not in said


def test_a_gyros_gain_is_not_taken_for_a_track(exported):
    _, found, text, _ = exported("ros2_control", more='[[effect]]\nname = "gyro_scale"\ne = 0.05\n[robot]\ntrack = 0.4')
    assert found["diff_drive_controller"]["ros__parameters"]["wheel_separation_multiplier"] == pytest.approx(1.03)
    assert "gyro_scale is left out: it is the gain of a heading sensor" in comments(text)


def test_a_file_has_the_whole_text_and_the_terminal_eight_lines(tmp_path, exported, invoke):
    text = exported("ros2_control")[2]
    target = tmp_path / "controller.yaml"
    words = ["export", str(tmp_path / "robot.toml"), "--to", "ros2_control", "-o", str(target)]
    said = invoke(words)
    assert target.read_text() == text
    assert len((said.out + said.err).splitlines()) <= 8
    assert "left out  side_slip, gauss_markov: comments in the file say why" in said.out
    assert " ros2 run controller_manager spawner diff_drive_controller " in said.out
    assert said.out.splitlines()[0].startswith("EXPORTED")
    assert run(words) == 1
    assert invoke([*words, "--force", "-q"]).out == ""


def test_a_missing_track_is_asked_for(exported):
    code, _, text, said = exported("ros2_control", more="")
    assert (code, text) == (2, "")
    assert "give --track" in said
    assert exported("ros2_control", "--track", "0.4", more="")[0] == 0


def test_alphas_of_amcl(exported):
    code, found, text, _ = exported("nav2", "--update-min-d", "0.5", "--update-min-a", "0.1")
    assert code == 0
    values = found["amcl"]["ros__parameters"]
    assert values["alpha2"] == pytest.approx(0.01**2 / (2 * 0.5))
    assert values["alpha3"] == pytest.approx(0.02**2 / 0.5)
    assert values["alpha1"] == pytest.approx(2 * 0.03**2 / 0.1)
    assert exported("nav2", "--turn", "spot")[1]["amcl"]["ros__parameters"]["alpha1"] == pytest.approx(0.03**2 / 0.2)
    assert (values["update_min_d"], values["update_min_a"]) == (0.5, 0.1)
    assert "wheelbase, unequal_wheels, side_slip" in comments(text)
    assert "depends on the message rate" not in comments(text)


def test_alphas_that_depend_on_the_rate_say_which_one_was_assumed(exported):
    assert "0.5 m/s, 0.5 rad/s and 20 Hz" in comments(exported("nav2", "--rate", "20", law="linear")[2])


def test_covariances_for_robot_localization(exported):
    code, found, text, _ = exported("robot_localization", "--speed", "0.4", "--rate", "20")
    assert code == 0
    diagonal = found["diff_drive_controller"]["ros__parameters"]["twist_covariance_diagonal"]
    assert len(diagonal) == 6
    assert diagonal[0] == pytest.approx((0.02**2 * 0.4 + 1e-12 * 0.5) * 20, rel=1e-3)
    assert diagonal[5] == pytest.approx((0.03**2 * 0.5 + 0.01**2 * 0.4) * 20, rel=1e-3)
    config = found["ekf_filter_node"]["ros__parameters"]["odom0_config"]
    assert [i for i, used in enumerate(config) if used] == [6, 7, 11]
    assert len(config) == 15
    assert "0.4 m/s, 0.5 rad/s and 20 Hz" in comments(text)


def test_every_number_is_a_float_of_yaml_1_1_and_1_2(exported):
    for target in ("ros2_control", "nav2", "robot_localization"):
        _, found, text, _ = exported(target)
        numbers = [v for node in found.values() for v in node["ros__parameters"].values() if not isinstance(v, str)]
        flat = [x for v in numbers for x in (v if isinstance(v, list) else [v])]
        assert all(isinstance(x, (bool, float)) for x in flat)
        old = YAML(typ="safe")
        old.version = (1, 1)
        assert old.load(io.StringIO(text)) == found


@pytest.mark.parametrize("flag", ["--update-min-d", "--update-min-a", "--rate", "--speed"])
def test_what_must_move_is_refused_in_one_line_where_it_does_not(exported, flag):
    code, _, text, said = exported("nav2", flag, "0")
    assert (code, text) == (2, "")
    assert len(said.splitlines()) == 1


def test_an_amcl_without_spread_from_turns_is_said(tmp_path, invoke):
    path = tmp_path / "robot.toml"
    for rot_rot, said in (("0.0", True), ("0.03", False)):
        path.write_text(MODEL.format(law="quadratic", more="").replace("rot_rot = 0.03", f"rot_rot = {rot_rot}"))
        printed = invoke(["export", path, "--to", "nav2"])
        assert YAML().load(printed.out)["amcl"]["ros__parameters"]["update_min_d"] > 0.0
        assert ("no spread from turns" in printed.err) is said


def test_the_plugin_of_gazebo_computes_with_the_nominal_dimensions(exported):
    code, _, printed, _ = exported("gazebo", "--wheel-radius", "0.05")
    comment, sdf = printed.split("-->")
    values = dict(re.findall(r"<(\w+)>([\d.]+)</\1>", sdf))
    assert code == 0
    assert 'name="gz::sim::systems::DiffDrive"' in sdf
    assert float(values["wheel_separation"]) == pytest.approx(0.4 / 1.03, rel=1e-4)
    assert float(values["wheel_radius"]) == pytest.approx(0.05)
    for said in ("the left wheel's collision", "side_slip", "because it is random: gauss_markov"):
        assert said in " ".join(comment.split())
    code, _, _, said = exported("gazebo", "--wheel-radius", "3.5")
    assert "3.5 cm are 0.035" in said
    code, _, _, said = exported("gazebo")
    assert code == 2
    assert "give --wheel-radius (see" in said


@pytest.mark.parametrize("given", [{"more": '[setup]\ndrive_type = "omni"'}, {"law": "omni", "more": ""}])
def test_an_omni_base_is_exported_for_its_own_controller_plugin_and_motion_model(exported, given):
    size = ["--track", "0.4", "--wheelbase", "0.3", "--wheel-radius", "0.05"]
    found = exported("ros2_control", *size, **given)[1]["mecanum_drive_controller"]["ros__parameters"]
    assert found["kinematics.wheels_radius"] == pytest.approx(0.05)
    assert found["kinematics.sum_of_robot_center_projection_on_X_Y_axis"] == pytest.approx(0.35 * 1.03, rel=1e-5)
    sdf = exported("gazebo", *size, **given)[2]
    assert 'filename="gz-sim-mecanum-drive-system" name="gz::sim::systems::MecanumDrive"' in sdf
    assert float(re.findall(r"<wheelbase>(.+)</wheelbase>", sdf)[0]) == pytest.approx(0.3 / 1.03, rel=1e-4)
    assert "mecanum_drive_controller" in exported("robot_localization", **given)[1]
    amcl = exported("nav2", **given)[1]["amcl"]["ros__parameters"]
    assert amcl["robot_model_type"] == "nav2_amcl::OmniMotionModel"
    assert amcl["alpha1"] == pytest.approx(0.03 / 20 if "law" in given else 0.03**2 / 0.2)
    for target in ("ros2_control", "gazebo"):
        assert "give --track, --wheelbase, --wheel-radius" in exported(target, **given)[3]


def test_a_steered_base_is_exported_for_its_own_controller_and_plugin(exported):
    more = '[[effect]]\nname = "steering_scale"\ne = 0.02\n[setup]\ndrive_type = "{}"'
    size, longer = ["--wheelbase", "0.3", "--wheel-radius", "0.05"], 1.0 / (1.02 - 0.03 / 1.03)
    for kind, controller in (("car", "ackermann_steering_controller"), ("tricycle", "tricycle_steering_controller")):
        _, found, text, _ = exported("ros2_control", *size, more=more.format(kind))
        values = {"wheelbase": 0.3 * longer, "traction_wheels_radius": 0.05}
        assert found[controller]["ros__parameters"] == pytest.approx(values, rel=1e-5)
        assert "constants of the wheels): unequal_wheels, side_slip" in comments(text)
    assert "oc.Drift" in exported("gazebo", *size, more=more.format("tricycle"))[3]
    sdf = exported("gazebo", *size, more=more.format("car"))[2]
    assert 'filename="gz-sim-ackermann-steering-system" name="gz::sim::systems::AckermannSteering"' in sdf
    assert float(re.findall(r"<wheel_base>(.+)</wheel_base>", sdf)[0]) == pytest.approx(0.3 / longer, 1e-4)
    assert "give --wheelbase, --wheel-radius" in exported("gazebo", more=more.format("car"))[3]


PAGE = (ROOT / "docs" / "export.md").read_text(encoding="utf8")
K = {"rot_rot": 0.04, "rot_trans": 0.03, "trans_trans": 0.05, "trans_rot": 0.02}
PAGE_DRIVE = Steady(0.5, 0.4, 50.0)


def formula(name: str, *, holding: str = "") -> str:
    """Return the right side of a formula of the page as Python; `holding` chooses among several of one name."""
    found = re.findall(rf"(?<!\w){re.escape(name)} = (.+?)(?=  |$|,  |\. |\.\n| and Var|:\n)", PAGE, re.MULTILINE)
    (chosen,) = {one for one in found if holding in one}
    return re.sub(r"(?<=[\w)]) +(?=[\w(])", " * ", chosen).replace("^", "**")


def value(name: str, numbers: dict[str, object], *, holding: str = "") -> float:
    return eval(formula(name, holding=holding), {"__builtins__": {}}, numbers)  # noqa: S307 - our own page


def test_wheel_multipliers_of_the_page():
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
    *computed, _ = amcl_alphas(DIFFUSION, 0.25, 0.2, turn=turn, drive=PAGE_DRIVE).values()
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
    n: dict[str, object] = {**K, "v": PAGE_DRIVE.speed, "omega": PAGE_DRIVE.yaw_rate, "h": PAGE_DRIVE.rate_hz}
    forward, leftward, yaw = twist_variances(DIFFUSION, PAGE_DRIVE)
    assert forward - FLOOR == pytest.approx(value("Var(vx)", n, holding="trans_trans"))
    assert yaw - FLOOR == pytest.approx(value("Var(yaw rate)", n, holding="rot_trans"))
    message = message_noise(DIFFUSION, PAGE_DRIVE)
    n |= {"V_travel": message.along, "V_heading": message.heading, "V_across": message.across}
    assert forward - FLOOR == pytest.approx(value("Var(vx)", n, holding="V_travel"))
    assert yaw - FLOOR == pytest.approx(value("Var(yaw rate)", n, holding="V_heading"))
    assert leftward - FLOOR == pytest.approx(value("Var(vy)", n))
