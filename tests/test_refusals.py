"""Bad input gets one line that says what, the value found, and the way out."""

import ast
import builtins
import inspect
import re
import shlex
from pathlib import Path

import pytest

import odomcorrupt as oc
from odomcorrupt.api.bag_options import BagOptions
from odomcorrupt.api.batch import BatchOptions
from odomcorrupt.cli import run
from odomcorrupt.errors import COMMAND_LINE_ONLY, BagError, TopicError
from odomcorrupt.mapping.conditioned import read_condition
from recordings import FIXTURES, ROOT

OFFICE = str(FIXTURES / "office.mcap")
NOISE = "--alpha 0.05 0.02 0.05 0.01 --seed 7"

ROBOT = """schema = 1
[noise]
law = "diffusion"
rot_rot = 0.05
rot_trans = 0.02
trans_trans = 0.05
trans_rot = 0.01
"""
REFUSED = {
    f"sample {OFFICE} --start 0,0,0": "--start: the motion is that of",
    f"sample {OFFICE} --end 1,0,0": "--end: the motion is that of",
    f"sample {OFFICE} --example article": "--example: the motion is that of",
    "sample --start 0,0": "'0,0' is not a pose; write x,y,heading as in 0.2,0.35,10deg",
    "sample --start 10deg,0,0": "is not a pose",
    "sample --start 0,0,90": "write 90deg",
    "sample --start a,b,c": "is not a pose",
    f"map {OFFICE} -o out.yaml": "out.yaml: --method laser writes a map for nav2; name it .yaml",
    f"map {OFFICE} -o out.txt": "ends in .txt; write .png, .svg or .pdf",
    f"integrate {OFFICE} --plot out.txt": "ends in .txt; write .png, .svg or .pdf",
    f"integrate {OFFICE} --runs 3": "--runs 3: without --twist-noise all runs are the same",
    f"integrate {OFFICE} --twist-noise -1 0": "twist noise: -1.0 m/s, 0.0 rad/s; both must be zero or more",
    f"{OFFICE} out.mcap --tf correction": "--tf correction and --new-odom-frame FRAME go together",
    f"{OFFICE} out.mcap --tf subtraction": "--tf subtraction and --new-odom-frame FRAME go together",
    f"batch {OFFICE} runs --runs 2 --layout split --output trajectories {NOISE}": "is for whole bags",
    f"batch {OFFICE} runs --runs 2 --shard 1/2 --dask tcp://x:1 {NOISE}": "--shard and --dask: both spread the runs",
    f"batch {OFFICE} runs --runs 2 --shard 1/2 --alpha 0 0 0 0": "--shard: all shards need the same --seed; give one",
    **{
        f"batch {OFFICE} runs --runs 2 --shard {bad} {NOISE}": f"'{bad}'; write which of how many, counted from 1"
        for bad in ("3/2", "0/3", "3", "1/0")
    },
    f"batch {OFFICE} runs --runs 2 --tf correction {NOISE}": "--tf correction and --new-odom-frame FRAME go together",
    f"batch {OFFICE} runs --runs 2 --keep-truth /t --output overlay {NOISE}": "--keep-truth: adds messages",
    f"batch {OFFICE} runs --runs 2 --exclude-topic /none {NOISE}": "--exclude-topic /none: the input has no such topic",
    "spread . -o out.txt": "ends in .txt; write .png, .svg or .pdf",
    "simulate out.mcap --effect hidden --effect wheel_scale": "--effect hidden: cannot be combined",
    "simulate out.mcap --effect none --effect wheel_scale": "--effect none: cannot be combined",
    "simulate out.mcap --effect wheel_scale:0.01": "'0.01' is not key=value; write as in wheel_scale:e=0.01",
    "simulate out.mcap --effect wheel_scale:e=nan": "e is nan; write a number, as in wheel_scale:e=0.01",
    "simulate out.mcap --size huge": "--size huge: give weak, medium, strong or a number",
    **{f"learn {OFFICE} --track {bad}": f"{bad}; write metres between the wheels" for bad in ("0", "-1", "nan", "inf")},
    **{f"learn {OFFICE} --truth-shift {bad}": f"{bad}; write seconds" for bad in ("nan", "-inf", "soon")},
    f"sample {OFFICE} --every nan": "nan; write metres, more than 0",
    f"map {OFFICE} --resolution inf": "inf; write metres, more than 0",
    f"map {OFFICE} --max-yaw-rate nan": "nan; write rad/s, 0 or more",
    f"map {OFFICE} --method laser --max-yaw-rate 1": "takes no --max-yaw-rate; leave it out",
    f"preview {OFFICE} --robot-radius inf": "inf; write metres, 0 or more",
    "export robot.toml --to nav2 --update-min-d inf": "inf; write metres, more than 0",
    "export robot.toml --to robot_localization --rate inf": "inf; write messages per second",
    "export robot.toml --to robot_localization --turn-rate nan": "nan; write rad/s, 0 or more",
    "simulate out.mcap --duration nan": "nan; write seconds, 10 or more",
    "simulate out.mcap --size nan": "--size nan: give weak, medium, strong or a number of more than 0",
    "simulate out.mcap --size -1": "--size -1: give weak",
    f"learn {OFFICE} --truth /odom": "--truth /odom is the odometry itself",
    f"fit {OFFICE} --odom /odom --truth odom": "is the odometry itself",
    f"learn {OFFICE} --track 42.3": "42.3 cm are 0.423",
    f"{OFFICE} out.mcap --track 42.3": "42.3 cm are 0.423",
    "export robot.toml": "give --to ros2_control, nav2, robot_localization or gazebo",
    "presets ideal": "no preset is called 'ideal'; there are typical, turtlebot3-burger",
    "nosuch": "nosuch: no such file, and no such command; name a command, or INPUT and OUTPUT",
    OFFICE: "Missing argument 'OUTPUT'",
    f"{OFFICE} a.bga": "a.bga: .bga is not a bag format (did you mean .bag?)",
    "presest": "did you mean presets?",
    "presets turtlbot4": "did you mean turtlebot4?",
    "info mine.csv": "mine.csv: is text, not a bag; learn, fit, compare, diagnose and score read trajectories",
    "presets burger": "did you mean turtlebot3-burger?",
    f"{OFFICE} out.mcap --preset husk": "did you mean husky?",
    "sample -o mine.csv": "mine.csv: exists already; choose another name or pass --overwrite",
    "sample -o gone/out.csv": "gone/out.csv: the directory gone does not exist; create it first\n",
    "fit robot.toml": "no recording given; name a bag with odometry and truth",
}
PIPES = {
    "sample -": "-: the whole drive is read first, which is impossible on a pipe; name a file",
    "map -": "-: the whole drive is read first, which is impossible on a pipe; name a file",
    "integrate -": "-: the whole drive is read first, which is impossible on a pipe; name a file",
    "info -": "INPUT is - but stdin is a terminal; redirect a bag to it",
    "- out.mcap": "INPUT is - but stdin is a terminal; redirect a bag to it",
    "correct - out.mcap --effect gyro_bias:b=0.1": "correction reads a bag twice",
}


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "robot.toml").write_text(ROBOT)
    (tmp_path / "mine.csv").write_text("mine")
    return tmp_path


def refused(words, capsys):
    """Run what must fail; return the line that says why."""
    before = {path: path.stat().st_mtime_ns for path in Path.cwd().rglob("*")}
    assert run(shlex.split(words)) in (1, 2)
    err = capsys.readouterr().err
    assert err.startswith("odomcorrupt: ")
    assert err.count("\n") == 1
    assert {path: path.stat().st_mtime_ns for path in Path.cwd().rglob("*")} == before
    return err


@pytest.mark.parametrize("words", REFUSED)
def test_what_makes_no_sense_is_refused(words, here, capsys):
    assert REFUSED[words] in refused(words, capsys)


def test_ends_that_only_an_impossible_track_explains_are_refused(here, capsys):
    """This drive is open, and its ends come a little closer with a track of five times the real one."""
    assert run([OFFICE, "noisy.mcap", "--alpha", "0.05", "0.02", "0.05", "0.01", "--seed", "1", "-q"]) == 0
    capsys.readouterr()
    assert "ends 1.84 m and 173 deg from the first pose" in refused("fit noisy.mcap --returns", capsys)


@pytest.mark.parametrize("words", PIPES)
def test_a_pipe_is_refused_where_none_can_be_and_so_is_a_terminal(words, here, capsys, monkeypatch):
    monkeypatch.setattr("sys.stdin.isatty", lambda: True, raising=False)
    assert PIPES[words] in refused(words, capsys)


@pytest.mark.parametrize(
    ("library", "words", "said"),
    [
        ("matplotlib", f"sample {OFFICE} -o out.png", "pictures need it"),
        ("matplotlib", "density -o out.png", "pictures need it"),
        ("matplotlib", f"map {OFFICE} -o out.png", "pictures need it"),
        ("matplotlib", f"preview {OFFICE} -o fan.png", "pictures need it"),
        ("scipy", "score . --estimate /odom", "the study needs it"),
        ("scipy", "simulate out.mcap", "the study needs it"),
        ("scipy", f"fit {OFFICE}", "the study needs it"),
        ("scipy", f"learn {OFFICE}", "the study needs it"),
        ("scipy", f"map {OFFICE} --method laser", "the study needs it"),
    ],
)
def test_a_library_that_is_missing_is_named_with_what_to_install(library, words, said, here, capsys, monkeypatch):
    real = builtins.__import__

    def without(name, *args, **named):
        if name.partition(".")[0] == library:
            raise ModuleNotFoundError(name, name=library)
        return real(name, *args, **named)

    monkeypatch.setattr(builtins, "__import__", without)
    line = refused(words, capsys)
    assert f"{library} is not installed; {said}" in line
    assert 'in a copy of the repository, pip install ".[study]"' in line


@pytest.mark.parametrize("words", ["{} out.mcap --model", "preview {} --model", "compare {}", "sample --model",
                                   "density --model", "export --to nav2"])  # fmt: skip
def test_a_model_file_is_refused_by_its_name_and_is_no_wrong_usage(words, here, capsys):
    Path("bad.toml").write_text(ROBOT.replace("diffusion", "cubic"))
    assert run(f"{words} bad.toml".format(OFFICE).split()) == 1
    assert capsys.readouterr().err.startswith("odomcorrupt: bad.toml: no law is called 'cubic'; there are ")


BAG = ROOT / "fixtures" / "office.mcap"
NOT_IN_ERRORS = {"--covariance", "--drive", "--json", "--plot", "--preset", "--report", "--tf", "--twist", "--validate"}
"""Options that only notes and recorded commands name."""


def named():
    """Return all options in texts of the modules below the command line, without docstrings and reports."""
    found = set()
    for file in (ROOT / "odomcorrupt").rglob("*.py"):
        if {"commands", "report"} & set(file.parts) or file.name == "cli.py":
            continue
        texts = [node.value for node in ast.walk(ast.parse(file.read_text())) if isinstance(node, ast.Constant)]
        found |= {
            word
            for text in texts if isinstance(text, str) and "\n" not in text
            for word in re.findall(r"(?<![\w/.-])--[a-z][a-z-]*[a-z]", text)
        }  # fmt: skip
    return sorted(found - NOT_IN_ERRORS - COMMAND_LINE_ONLY)


def test_every_option_in_a_text_is_an_argument_in_python():
    functions = [one for name in oc.__all__ if callable(one := getattr(oc, name)) and name != "OdomCorruptError"]
    arguments = {name for one in (*functions, read_condition) for name in inspect.signature(one).parameters}
    arguments |= {"ODOMCORRUPT_MAX_UNPACKED", *BagOptions.__annotations__, *BatchOptions.__annotations__}
    arguments |= set(inspect.signature(oc.Score.check).parameters)
    words = named()
    assert len(words) > 40
    said = {word: re.split("[= ]", str(TopicError(f"give {word} 3")))[1] for word in words}
    assert {word: name for word, name in said.items() if name not in arguments} == {}


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("name one with --odom-topic", "name one with odom_topic"),
        ("damaged; --recover saves the intact part", "damaged; recover=True saves the intact part"),
        ("--max-unpacked 4GiB allows it", "ODOMCORRUPT_MAX_UNPACKED=4GiB allows it"),
        ("correct it, with --tf odometry", "correct it, without new_odom_frame"),
        ("--odd.bag: no such file; a--b, /--overwrite", "--odd.bag: no such file; a--b, /--overwrite"),
        ("see `odomcorrupt effects --help`", "see `odomcorrupt effects --help`"),
    ],
)
def test_options_are_replaced_and_names_of_files_are_not(text, said):
    assert (str(BagError(text)), BagError(text).message) == (said, text)


def test_the_same_error_names_the_option_on_the_command_line(tmp_path, invoke):
    with pytest.raises(TopicError, match=r"name another one with odom_topic$"):
        oc.corrupt(BAG, tmp_path / "a.mcap", odom_topic="/none")
    assert "name another one with --odom-topic\n" in invoke([BAG, tmp_path / "a.mcap", "--odom-topic", "/none"], 1).err
    with pytest.raises(TopicError, match=r"name another one with odom_topic$"):
        oc.corrupt(BAG, tmp_path / "a.mcap", odom_topic="/none")
