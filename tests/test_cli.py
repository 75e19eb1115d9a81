"""The command line: which command runs, what it says, and with which exit code it ends."""

import io
import os
import re
import subprocess
import sys
from pathlib import Path
from unittest.mock import patch

import click
import pytest
from click.shell_completion import BashComplete

import odomcorrupt
from odomcorrupt.cli import cli, run
from odomcorrupt.effects import registry
from odomcorrupt.errors import BagError
from odomcorrupt.model.noise_laws import LAWS
from odomcorrupt.model.presets import PRESETS
from recordings import FIXTURES

OFFICE = str(FIXTURES / "office.mcap")


@pytest.fixture
def corrupt(tmp_path, capsys):
    """Run the default command from the office into a file; return exit code, the line said, and the file."""

    def call(*args, source=OFFICE, name="out.mcap"):
        target = tmp_path / name
        code = run([source, str(target), "-v", *args])
        captured = capsys.readouterr()
        assert not captured.out
        return code, captured.err, target

    return call


def require_refused(done, code, sentence):
    """Require that a run ended with this code and one line, and left nothing."""
    ended, said, target = done
    assert ended == code
    assert sentence in said
    assert said.startswith("odomcorrupt: ")
    assert said.count("\n") == 1
    assert not target.exists()


def test_the_top_help_shows_the_default_commands_options_and_every_command(invoke):
    text = invoke(["--help"]).out
    default = cli.get_command(click.Context(cli), "corrupt")
    for option in default.params:
        if isinstance(option, click.Option):
            assert option.opts[0] in text
    commands = cli.list_commands(click.Context(cli))
    assert {"corrupt", "fit", "compare", "diagnose"} <= set(commands)
    for name in commands:
        assert f"\n  {name} " in text
    assert not any(name.startswith("_") for name in commands)
    assert all(name in text for name in (*LAWS, "odomcorrupt presets"))


def test_help_needs_none_of_the_heavy_libraries():
    code = (
        "import sys; from odomcorrupt.cli import run; run(['--help']); run(['corrupt', '--help']);"
        "print(sorted({'numpy', 'scipy', 'rosbags', 'mcap'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"


def test_version_and_no_arguments(invoke):
    assert invoke(["--version"]).out == f"odomcorrupt {odomcorrupt.__version__}\n"
    assert "Usage: odomcorrupt [OPTIONS] INPUT OUTPUT" in invoke([], 2).err


@pytest.mark.parametrize("first", [[], ["corrupt"], ["--"], ["--run", "0"]])
def test_the_default_command_needs_no_name(first, tmp_path, capsys):
    assert run([*first, OFFICE, str(tmp_path / "out.mcap"), *([] if first == ["--"] else ["--seed", "1"])]) == 0
    assert "/odom 3000, TF odom -> base_link 3000" in capsys.readouterr().err


def test_a_bag_named_like_a_command_is_reached_by_its_path(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("fit").write_bytes(Path(OFFICE).read_bytes())
    assert run(["./fit", "out.mcap", "-v", "--seed", "1"]) == 0
    assert Path("out.mcap").exists()
    assert "MOVED" in capsys.readouterr().err


SAID_BACK = {
    "": [
        "rot_rot 0.05 rot_trans 0.02 trans_trans 0.05 trans_rot 0.01 (preset typical: ", PRESETS["typical"].source,
        "/imu, /tf base_link -> wheel_left_link, /tf base_link -> wheel_right_link: still contain the true motion",
    ],
    "--preset article": [
        "Once per message acts the law linear: these numbers mean a drift of 0.", "per 10 m at this bag's 50 Hz",
    ],
    "--effect wheel_scale:e=0.01": ["No noise; effects wheel_scale (e 0.01)"], "--preset husky": ["(mean of preset "],
    "--alpha 5deg 10deg/m 0.05 0.01": ["rot_rot 0.08727 rot_trans 0.1745 trans_trans 0.05 trans_rot 0.01"],
    "--alpha 5deg/rad 10deg 0.05/m 0.01/rad": ["rot_rot 0.08727 rot_trans 0.1745 trans_trans 0.05 trans_rot 0.01"],
    "--alpha 0.1rad 0.2rad/m 0 0": ["rot_rot 0.1 rot_trans 0.2 trans_trans 0 trans_rot 0"],
    "--law linear --step 0.25m,0.2rad --alpha 0.1 0.1 0.1 0.1": ["Law linear, rot_rot 0.1 ", "once per 0.25m,0.2rad"],
    "--effect unequal_wheels:curvature=0.01 --effect lever_arm:x=0.1,y=-0.05": [
        "unequal_wheels (curvature 0.01 rad/m), lever_arm (x 0.1 m, y -0.05 m)",
    ],
    "--keep-truth /odom_true": ["3000 messages of clean odometry on /odom_true added"],
    "--twist-noise 0.2 0.04": ["white_v 0.2 white_omega 0.04", "Once per message acts white noise on twists: these"],
}  # fmt: skip


@pytest.mark.parametrize("args", SAID_BACK)
def test_noise_its_source_its_rate_and_what_still_tells_the_truth_are_said(corrupt, args):
    code, said, _ = corrupt(*args.split(), "--seed", "1")
    assert code == 0
    assert all(sentence in said for sentence in SAID_BACK[args])
    assert ("other values at another rate" in said) == (args in ("--preset article", "--twist-noise 0.2 0.04"))


def test_a_seed_is_drawn_printed_and_repeats_the_run(corrupt):
    code, said, target = corrupt(name="first.mcap")
    assert code == 0
    seed = said.split("seed ")[1].split(",")[0]
    again = corrupt("--seed", seed, name="second.mcap")[2]
    other = corrupt("--seed", seed, "--run", "1", name="third.mcap")[2]
    assert target.read_bytes() == again.read_bytes()
    assert target.read_bytes() != other.read_bytes()


@pytest.mark.parametrize(
    ("alphas", "law", "said_back"),
    [("0.01 0.02 0.03 0.04 0.05", "omni", "rot_rot 0.01 rot_trans 0.02 trans_trans 0.03 trans_rot 0.04 across_"),
    ("1e-3 2e-3 3e-3 4e-3 5e-3 6e-3", "velocity", "rot_rot 0.004 rot_trans 0.003 trans_trans 0.001 trans_"),
    ("1e-3 2e-3 3e-3 4e-3", "velocity", "end_trans 0 end_rot 0")],
)  # fmt: skip
def test_alpha_takes_as_many_numbers_as_the_law_has_wherever_it_stands(tmp_path, invoke, alphas, law, said_back):
    target = tmp_path / "out.mcap"
    assert said_back in invoke(["--law", law, "--alpha", *alphas.split(), OFFICE, target, "-v", "--seed", "1"]).err
    assert run([OFFICE, str(target), "--overwrite", "--law", law, "--seed", "1", "--alpha", *alphas.split()]) == 0


def test_a_model_file_brings_noise_and_effects_and_alpha_overrides_its_noise(corrupt, tmp_path):
    file = tmp_path / "robot.toml"
    file.write_text(
        'schema = 1\n[noise]\nlaw = "diffusion"\nrot_rot = 0.03\nrot_trans = 0.01\ntrans_trans = 0.02\n'
        'trans_rot = 0.0\n[[effect]]\nname = "wheelbase"\ne = 0.02\n'
    )
    code, said, _ = corrupt("--model", str(file), "--seed", "1")
    assert code == 0
    assert "rot_rot 0.03" in said
    assert "effects wheelbase (e 0.02)" in said
    _, said, _ = corrupt("--model", str(file), "--seed", "1", "--alpha", "0", "0", "0", "0", name="other.mcap")
    assert "No noise" in said
    assert "effects wheelbase (e 0.02)" in said


@pytest.mark.parametrize(
    ("args", "sentence"),
    [(["--alpha", "1", "2", "3", "x"], "--alpha: 3 numbers, then 'x'; every law takes 4 numbers or more"),
    (["--alpha", "-1", "0", "0", "0"], "coefficient rot_rot: -1.0; it must be a number from zero to 1e+06"),
    (["--alpha", "1", "2", "3"], "alpha: 3 numbers; the law diffusion takes 4"),
    (["--alpha", "1", "2", "3", "4", "5"], "alpha: 5 numbers; the law diffusion takes 4"),
    (["--alpha", "1", "2", "3", "4", "5", "6", "--law", "omni"], "alpha: 6 numbers; the law omni takes 4 to 5"),
    (["--alpha"], "alpha: 0 numbers; the law diffusion takes 4"),
    (["--twist-noise", "-1", "0"], "coefficient white_v: -1.0"),
    (["--law", "linear"], "--law linear: what coefficients mean depends on the law"),
    (["--alpha", "0", "0", "0", "0", "--law", "cubic"], "no law is called 'cubic'; there are diffusion"),
    (["--preset", "article", "--alpha", "0", "0", "0", "0"], "--alpha and --preset both define noise"),
    (["--step", "0.25m,0.2rad"], "the law diffusion is the same at every step: leave --step out"),
    (["--preset", "article", "--step", "often"], "step: 'often'; write message"),
    (["--effect", "wheel_scale:e"], "'e' is not key=number"), (["--effect", "wheel_scale:x=1"], "has no parameter 'x'"),
    (["--effect", "wheel_scale:e=7000"], "e: 7000; it must lie in"),
    (["--effect", "wheel_scale=0.01"], "write wheel_scale:e=0.01"),
    (["--effect", "unequal_wheels:curvature=1%"], "is a share, but the parameter has the unit rad/m"),
    (["--alpha", "0.05,0.02,0.05,0.01"], "put spaces between the numbers: --alpha 0.05 0.02 0.05 0.01"),
    (["--track", "0"], "0; write metres between the wheels, more than 0"),
    (["--alpha", "5deg", "10deg/m", "5deg", "0.1"], "trans_trans: 5deg is an angle, but this coefficient is in metres"),
    (["--alpha", "5deg/m", "0", "0", "0"], "rot_rot: 5deg/m; this coefficient is per rad, not per m"),
    (["--alpha", "0", "5deg/rad", "0", "0"], "rot_trans: 5deg/rad; this coefficient is per m, not per rad"),
    (["--alpha", "0.1/m", "0", "0", "0"], "rot_rot: 0.1/m; this coefficient is per rad"),
    (["--alpha", "5deg", "0", "0", "0", "--law", "quadratic"], "alphas of the law quadratic scale variances"),
    (["--alpha", "0", "0", "0", "1deg", "--law", "omni"], "alphas of the law omni scale variances"),
    (["--seed", "-1"], "--seed"), (["--nonsense"], "--nonsense"), (["third"], "unexpected extra argument")],
)  # fmt: skip
def test_wrong_usage_is_one_line_exit_code_two_and_no_output(corrupt, args, sentence):
    require_refused(corrupt(*args), 2, sentence)


BROKEN = {
    "missing": lambda: None,
    "text": lambda: b"this is no bag at all, but long enough to be one\n" * 9,
    "empty": lambda: b"",
    "without a header": lambda: Path(OFFICE).read_bytes()[:8] + b"\x07" + Path(OFFICE).read_bytes()[9:],
    "truncated.mcap": lambda: Path(OFFICE).read_bytes()[:320_000],
    "truncated.bag": lambda: (FIXTURES / "office.bag").read_bytes()[:300_000],
}


def broken(tmp_path, kind):
    path, data = tmp_path / kind, BROKEN[kind]()
    if data is not None:
        path.write_bytes(data)
    return path


@pytest.mark.parametrize("kind", BROKEN)
def test_an_input_that_is_no_whole_bag_is_one_line_exit_code_one_and_leaves_nothing(corrupt, tmp_path, kind):
    source = broken(tmp_path, kind)
    before = sorted(tmp_path.iterdir())
    require_refused(corrupt("--seed", "1", source=str(source)), 1, f"odomcorrupt: {source}: ")
    assert sorted(tmp_path.iterdir()) == before


@pytest.mark.parametrize(
    ("args", "sentence"),
    [(["--odom-topic", "/nothing"], "no topic /nothing (nav_msgs/Odometry is on /odom); name another one"),
    (["--odom", "/imu"], "/imu is sensor_msgs/msg/Imu in cdr; --odom-topic must name a nav_msgs/Odometry"),
    (["--effect", "wheel_scale:e=-0.5"] * 2, "too strong for this drive"),
    (["--odom-frame", "x"], "--odom-frame x: no odometry message and no transform has this frame"),
    (["--compression", "rar"], "compression rar: is not available"),
    (["--model", "nowhere.toml"], "nowhere.toml: cannot be read")],
)  # fmt: skip
def test_a_run_that_fails_is_one_line_exit_code_one_and_leaves_nothing(corrupt, tmp_path, args, sentence):
    require_refused(corrupt(*args), 1, sentence)
    assert not list(tmp_path.iterdir())


def test_an_existing_output_is_refused_and_replaced_on_request(corrupt):
    target = corrupt("--seed", "1")[2]
    before = target.read_bytes()
    code, said, _ = corrupt("--seed", "2")
    assert (code, said.count("\n")) == (1, 1)
    assert "exists already" in said
    assert target.read_bytes() == before
    assert corrupt("--seed", "2", "--overwrite")[0] == 0
    assert target.read_bytes() != before


def stopping(error):
    def stop(*_args, **_options):
        raise error

    return stop


@pytest.mark.parametrize(
    ("error", "code", "said"), [(KeyboardInterrupt(), 130, "interrupted: nothing"), (BagError("a\nb"), 1, "a b\n")]
)
def test_interrupts_and_errors_end_with_their_code(monkeypatch, invoke, error, code, said):
    monkeypatch.setattr("odomcorrupt.api.corruption.corrupt_bag", stopping(error))
    assert invoke([OFFICE, "out.mcap"], code).err.strip().startswith(f"odomcorrupt: {said.strip()}")


def test_a_terminal_is_not_fed_with_bytes(monkeypatch, invoke):
    monkeypatch.setattr(sys, "stdout", io.StringIO())
    sys.stdout.isatty = lambda: True
    assert "stdout is a terminal" in invoke([OFFICE, "-"], 2).err


def completed(words):
    """Return what the shell is offered behind these words."""
    with patch.dict(os.environ, {"COMP_WORDS": words, "COMP_CWORD": str(words.count(" "))}):
        return BashComplete(cli, {}, "odomcorrupt", "_ODOMCORRUPT_COMPLETE").complete().splitlines()


def test_the_shell_completes_commands_options_and_files():
    invoke = {"_ODOMCORRUPT_COMPLETE": "bash_complete", "COMP_WORDS": "odomcorrupt pre", "COMP_CWORD": "1"}
    line = [sys.executable, "-m", "odomcorrupt"]
    done = subprocess.run(line, env=os.environ | invoke, capture_output=True, text=True, check=False)
    assert done.stdout.splitlines() == completed("odomcorrupt pre")
    assert "plain,preview" in completed("odomcorrupt pre")
    assert {"plain,--seed", "plain,--version"} <= set(completed("odomcorrupt --"))
    assert "plain,--odom-topic" in completed("odomcorrupt in.bag --odom")
    assert "file,in" in completed("odomcorrupt in")
    assert "plain,keep" in completed("odomcorrupt in.bag out.bag --twist k")
    assert set(completed("odomcorrupt in.bag out.bag --law ")) == {f"plain,{name}" for name in LAWS}
    optitrack = {"plain,optitrack-diff-drive", "plain,optitrack-tricycle"}
    assert set(completed("odomcorrupt preview in.bag --preset opti")) == optitrack
    for words in ("export", "compare in.bag", "diagnose in.bag", "fit in.bag"):
        assert completed(f"odomcorrupt {words} acker") == ["plain,ackermann", "file,acker"]
    gyro = {f"plain,{name}" for name in registry() if name.startswith("gyro")}
    for words in ("in.bag out.bag --effect", "simulate out.bag --effect", "batch in.bag b --sweep", "fit in.bag --add"):
        assert set(completed(f"odomcorrupt {words} gyro")) == gyro


def test_data_that_end_early_are_no_interruption(monkeypatch, invoke):
    def ends(*_, **__):
        raise EOFError("data too short")

    monkeypatch.setattr("odomcorrupt.cli.cli.invoke", ends)
    assert invoke(["in.mcap", "out.mcap"], 1).err.strip() == "odomcorrupt: a file ended early: data too short"


@pytest.mark.parametrize("name", ["compare", "diagnose", "fit", "learn"])
def test_the_help_of_a_study_begins_with_what_most_recordings_need(name, invoke):
    options = re.findall(r"^  (?:-\w, )?(--[a-z-]+)", invoke([name, "--help"]).out, re.MULTILINE)
    assert [option for option in options if option != "--output"][:3] == ["--truth", "--track", "--odom"]
    assert "--output" not in options[1:]
