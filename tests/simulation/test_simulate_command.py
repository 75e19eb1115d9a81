"""The command hides what is wrong, says it in another file, and does as it is told."""

import tomllib
from hashlib import sha256

import pytest
from mcap.reader import make_reader
from test_wheelsim import write_commands

from odomcorrupt.cli import run
from odomcorrupt.simulation.faults import EVERY


def simulated(folder, *options, name="out"):
    code = run(["simulate", str(folder / f"{name}.mcap"), "--duration", "15", *options])
    assert code == 0
    return folder / f"{name}.mcap", folder / f"{name}.answer.toml"


def metadata(bag):
    with bag.open("rb") as file:
        return {record.name: record.metadata for record in make_reader(file).iter_metadata()}


def answered(file):
    return tomllib.loads(file.read_text())


@pytest.mark.parametrize("effect", ["hidden", "none", "region_slip", "gyro_bias", "eccentric_wheel"])
def test_answer_is_beside_the_bag_and_only_its_hash_in_it(tmp_path, effect):
    bag, secret = simulated(tmp_path, "--effect", effect, "--seed", "6")
    assert metadata(bag) == {"simulate": {"answer_sha256": sha256(secret.read_bytes()).hexdigest()}}
    with bag.open("rb") as file:
        said = b" ".join(message.data for _, _, message in make_reader(file).iter_messages())
    with bag.open("rb") as file:
        reader = make_reader(file)
        assert not list(reader.iter_attachments())
        assert reader.get_header().library == "wheelsim"
    assert not any(name.encode() in said + bag.read_bytes() for name in (*EVERY, "salt", "seed"))


def test_hidden_is_the_default_and_the_same_seed_makes_the_same_files(tmp_path):
    one, secret = simulated(tmp_path, "--seed", "9")
    two, again = simulated(tmp_path, "--effect", "hidden", "--seed", "9", name="two")
    assert one.read_bytes() == two.read_bytes()
    assert secret.read_bytes() == again.read_bytes()
    other, _ = simulated(tmp_path, "--seed", "10", name="three")
    assert one.read_bytes() != other.read_bytes()


def test_hidden_robot_is_met_again_in_another_drive(tmp_path):
    _, first = simulated(tmp_path, "--seed", "9")
    write_commands(tmp_path / "next.mcap", [(0.1 * i, 0.5, 0.0) for i in range(100)])
    _, second = simulated(tmp_path, "--seed", "11", "--robot", "9", "--drive", str(tmp_path / "next.mcap"), name="b")
    assert answered(first)["causes"] == answered(second)["causes"]
    assert answered(first)["heading"] == answered(second)["heading"]


def test_mixture_with_some_parameters_given(tmp_path):
    options = ("--effect", "mount_yaw:yaw=2deg", "--effect", "gauss_markov:channel=yaw,tau=5", "--size", "strong")
    _, secret = simulated(tmp_path, *options, "--truth", "rtk", "--drive-type", "skid", "--route", "yard")
    answer = answered(secret)
    yawed, wandering = answer["causes"]
    assert (yawed["name"], yawed["in_library"]) == ("mount_yaw", True)
    assert yawed["parameters"]["yaw"] == pytest.approx(0.0349, abs=1e-4)
    assert (wandering["parameters"]["channel"], wandering["parameters"]["tau"]) == ("yaw", 5.0)
    assert wandering["parameters"]["sigma"] >= 0.02
    assert (answer["drive_type"], answer["truth"], answer["route"]) == ("skid", "rtk", "yard")


def test_cause_of_no_library_says_what_it_depends_on(tmp_path):
    _, secret = simulated(tmp_path, "--effect", "floor_grain")
    assert answered(secret)["causes"][0] | {"parameters": 0} == {
        "name": "floor_grain",
        "in_library": False,
        "depends_on": "heading",
        "parameters": 0,
    }


def test_control_has_no_causes(tmp_path):
    _, secret = simulated(tmp_path, "--effect", "none", "--heading", "gyro")
    assert answered(secret)["causes"] == []


@pytest.mark.parametrize(
    ("options", "code", "says"),
    [
        (["--effect", "wheel_skale"], 2, "is not a cause"),
        (["--effect", "slope", "--effect", "slope"], 2, "once"),
        (["--effect", "gyro_bias", "--heading", "wheels"], 2, "has no effect"),
        (["--effect", "gyro_bias", "--effect", "wheelbase"], 2, "different sources"),
        (["--effect", "slope:crep=0.1"], 2, "it has creep, direction"),
        (["--effect", "side_slip:k=-0.1"], 2, "must not be negative"),
        (["--effect", "slope:creep=much"], 2, "is not a number"),
        (["--effect", "gauss_markov:channel=up"], 2, "along, yaw or wheels"),
    ],
)
def test_what_makes_no_sense_is_said(tmp_path, capsys, options, code, says):
    assert run(["simulate", str(tmp_path / "out.mcap"), *options]) == code
    assert says in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_nothing_is_overwritten_unasked(tmp_path, capsys):
    simulated(tmp_path)
    assert run(["simulate", str(tmp_path / "out.mcap")]) == 1
    assert "exists already" in capsys.readouterr().err
    (tmp_path / "out.mcap").unlink()
    assert run(["simulate", str(tmp_path / "out.mcap")]) == 1
    simulated(tmp_path, "--overwrite")


def test_pipe_needs_a_place_for_the_answer(tmp_path, capfdbinary):
    assert run(["simulate", "-", "--duration", "15"]) == 2
    assert run(["simulate", "-", "--duration", "15", "--seed", "0", "--answer", str(tmp_path / "a.toml")]) == 0
    said = capfdbinary.readouterr().out
    bag, _ = simulated(tmp_path, "--seed", "0")
    assert said == bag.read_bytes()
