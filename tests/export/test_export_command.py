"""What the command prints is YAML that ROS reads as numbers, with what is left out in its comments."""

import io
import re

import pytest
from ruamel.yaml import YAML

from odomcorrupt.cli import run

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
def export(tmp_path, capsys):
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


def test_wheel_multipliers(export):
    code, found, text, _ = export("ros2_control", "--controller", "base_controller")
    assert code == 0
    values = found["base_controller"]["ros__parameters"]
    assert values["wheel_separation_multiplier"] == pytest.approx(1.03)
    difference = values["right_wheel_radius_multiplier"] - values["left_wheel_radius_multiplier"]
    assert difference == pytest.approx(0.01 * 1.03 * 0.4, abs=1e-5)
    said = comments(text)
    assert "side_slip" in said
    assert "because it is random: gauss_markov" in said
    assert "wheelbase" not in said


def test_a_gyros_gain_is_not_taken_for_a_track(export):
    _, found, text, _ = export("ros2_control", more='[[effect]]\nname = "gyro_scale"\ne = 0.05\n[robot]\ntrack = 0.4')
    assert found["diff_drive_controller"]["ros__parameters"]["wheel_separation_multiplier"] == pytest.approx(1.03)
    assert "gyro_scale is left out: it is the gain of a heading sensor" in comments(text)


def test_a_file_has_the_whole_text_and_the_terminal_eight_lines(tmp_path, export, capsys):
    text = export("ros2_control")[2]
    target = tmp_path / "controller.yaml"
    words = ["export", str(tmp_path / "robot.toml"), "--to", "ros2_control", "-o", str(target)]
    assert run(words) == 0
    said = capsys.readouterr()
    assert target.read_text() == text
    assert len((said.out + said.err).splitlines()) <= 8
    assert "left out  side_slip, gauss_markov: comments in the file say why" in said.out
    assert " ros2 run controller_manager spawner diff_drive_controller " in said.out
    assert said.out.splitlines()[0].startswith("EXPORTED")
    assert run(words) == 1
    assert run([*words, "--force", "-q"]) == 0
    assert capsys.readouterr().out == ""


def test_a_missing_track_is_asked_for(export):
    code, _, text, said = export("ros2_control", more="")
    assert (code, text) == (2, "")
    assert "give --track" in said
    assert export("ros2_control", "--track", "0.4", more="")[0] == 0


def test_alphas_of_amcl(export):
    code, found, text, _ = export("nav2", "--update-min-d", "0.5", "--update-min-a", "0.1")
    assert code == 0
    values = found["amcl"]["ros__parameters"]
    assert values["alpha2"] == pytest.approx(0.01**2 / (2 * 0.5))
    assert values["alpha3"] == pytest.approx(0.02**2 / 0.5)
    assert values["alpha1"] == pytest.approx(2 * 0.03**2 / 0.1)
    assert export("nav2", "--turn", "spot")[1]["amcl"]["ros__parameters"]["alpha1"] == pytest.approx(0.03**2 / 0.2)
    assert (values["update_min_d"], values["update_min_a"]) == (0.5, 0.1)
    assert "wheelbase, unequal_wheels, side_slip" in comments(text)
    assert "depends on the message rate" not in comments(text)


def test_alphas_that_depend_on_the_rate_say_which_one_was_assumed(export):
    assert "0.5 m/s, 0.5 rad/s and 20 Hz" in comments(export("nav2", "--rate", "20", law="linear")[2])


def test_covariances_for_robot_localization(export):
    code, found, text, _ = export("robot_localization", "--speed", "0.4", "--rate", "20")
    assert code == 0
    diagonal = found["diff_drive_controller"]["ros__parameters"]["twist_covariance_diagonal"]
    assert len(diagonal) == 6
    assert diagonal[0] == pytest.approx((0.02**2 * 0.4 + 1e-12 * 0.5) * 20, rel=1e-3)
    assert diagonal[5] == pytest.approx((0.03**2 * 0.5 + 0.01**2 * 0.4) * 20, rel=1e-3)
    config = found["ekf_filter_node"]["ros__parameters"]["odom0_config"]
    assert [i for i, used in enumerate(config) if used] == [6, 7, 11]
    assert len(config) == 15
    assert "0.4 m/s, 0.5 rad/s and 20 Hz" in comments(text)


def test_every_number_is_a_float_of_yaml_1_1_and_1_2(export):
    for target in ("ros2_control", "nav2", "robot_localization"):
        _, found, text, _ = export(target)
        numbers = [v for node in found.values() for v in node["ros__parameters"].values() if not isinstance(v, str)]
        flat = [x for v in numbers for x in (v if isinstance(v, list) else [v])]
        assert all(isinstance(x, (bool, float)) for x in flat)
        old = YAML(typ="safe")
        old.version = (1, 1)
        assert old.load(io.StringIO(text)) == found


@pytest.mark.parametrize("flag", ["--update-min-d", "--update-min-a", "--rate", "--speed"])
def test_what_must_move_is_refused_in_one_line_where_it_does_not(export, flag):
    code, _, text, said = export("nav2", flag, "0")
    assert (code, text) == (2, "")
    assert len(said.splitlines()) == 1


def test_an_amcl_without_spread_from_turns_is_said(tmp_path, capsys):
    path = tmp_path / "robot.toml"
    for rot_rot, said in (("0.0", True), ("0.03", False)):
        path.write_text(MODEL.format(law="quadratic", more="").replace("rot_rot = 0.03", f"rot_rot = {rot_rot}"))
        assert run(["export", str(path), "--to", "nav2"]) == 0
        printed = capsys.readouterr()
        assert YAML().load(printed.out)["amcl"]["ros__parameters"]["update_min_d"] > 0.0
        assert ("no spread from turns" in printed.err) is said


def test_the_plugin_of_gazebo_computes_with_the_nominal_dimensions(export):
    code, _, printed, _ = export("gazebo", "--wheel-radius", "0.05")
    comment, sdf = printed.split("-->")
    values = dict(re.findall(r"<(\w+)>([\d.]+)</\1>", sdf))
    assert code == 0
    assert 'name="gz::sim::systems::DiffDrive"' in sdf
    assert float(values["wheel_separation"]) == pytest.approx(0.4 / 1.03, rel=1e-4)
    assert float(values["wheel_radius"]) == pytest.approx(0.05)
    for said in ("the left wheel's collision", "side_slip", "because it is random: gauss_markov"):
        assert said in " ".join(comment.split())
    code, _, _, said = export("gazebo", "--wheel-radius", "3.5")
    assert "3.5 cm are 0.035" in said
    code, _, _, said = export("gazebo")
    assert code == 2
    assert "give --wheel-radius (see" in said


@pytest.mark.parametrize("given", [{"more": '[setup]\ndrive_type = "omni"'}, {"law": "omni", "more": ""}])
def test_an_omni_base_is_exported_for_its_own_controller_plugin_and_motion_model(export, given):
    size = ["--track", "0.4", "--wheelbase", "0.3", "--wheel-radius", "0.05"]
    found = export("ros2_control", *size, **given)[1]["mecanum_drive_controller"]["ros__parameters"]
    assert found["kinematics.wheels_radius"] == pytest.approx(0.05)
    assert found["kinematics.sum_of_robot_center_projection_on_X_Y_axis"] == pytest.approx(0.35 * 1.03, rel=1e-5)
    sdf = export("gazebo", *size, **given)[2]
    assert 'filename="gz-sim-mecanum-drive-system" name="gz::sim::systems::MecanumDrive"' in sdf
    assert float(re.findall(r"<wheelbase>(.+)</wheelbase>", sdf)[0]) == pytest.approx(0.3 / 1.03, rel=1e-4)
    assert "mecanum_drive_controller" in export("robot_localization", **given)[1]
    amcl = export("nav2", **given)[1]["amcl"]["ros__parameters"]
    assert amcl["robot_model_type"] == "nav2_amcl::OmniMotionModel"
    assert amcl["alpha1"] == pytest.approx(0.03 / 20 if "law" in given else 0.03**2 / 0.2)
    for target in ("ros2_control", "gazebo"):
        assert "give --track, --wheelbase, --wheel-radius" in export(target, **given)[3]


def test_a_steered_base_is_exported_for_its_own_controller_and_plugin(export):
    more = '[[effect]]\nname = "steering_scale"\ne = 0.02\n[setup]\ndrive_type = "{}"'
    size, longer = ["--wheelbase", "0.3", "--wheel-radius", "0.05"], 1.0 / (1.02 - 0.03 / 1.03)
    for kind, controller in (("car", "ackermann_steering_controller"), ("tricycle", "tricycle_steering_controller")):
        _, found, text, _ = export("ros2_control", *size, more=more.format(kind))
        values = {"wheelbase": 0.3 * longer, "traction_wheels_radius": 0.05}
        assert found[controller]["ros__parameters"] == pytest.approx(values, rel=1e-5)
        assert "constants of the wheels): unequal_wheels, side_slip" in comments(text)
    assert "oc.Drift" in export("gazebo", *size, more=more.format("tricycle"))[3]
    sdf = export("gazebo", *size, more=more.format("car"))[2]
    assert 'filename="gz-sim-ackermann-steering-system" name="gz::sim::systems::AckermannSteering"' in sdf
    assert float(re.findall(r"<wheel_base>(.+)</wheel_base>", sdf)[0]) == pytest.approx(0.3 / longer, 1e-4)
    assert "give --wheelbase, --wheel-radius" in export("gazebo", more=more.format("car"))[3]
