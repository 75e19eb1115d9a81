"""Errors name arguments in Python, and options while the command line runs."""

import ast
import inspect
import re
from pathlib import Path

import pytest

import odomcorrupt as oc
from odomcorrupt.api.bag_options import BagOptions
from odomcorrupt.api.batch import BatchOptions
from odomcorrupt.cli import run
from odomcorrupt.errors import COMMAND_LINE_ONLY, BagError, TopicError
from odomcorrupt.mapping.conditioned import read_condition

ROOT = Path(__file__).parents[1]
OFFICE = ROOT / "fixtures" / "office.mcap"
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


def test_the_same_error_names_the_option_on_the_command_line(tmp_path, capsys):
    with pytest.raises(TopicError, match=r"name another one with odom_topic$"):
        oc.corrupt(OFFICE, tmp_path / "a.mcap", odom_topic="/none")
    assert run([str(OFFICE), str(tmp_path / "a.mcap"), "--odom-topic", "/none"]) == 1
    assert "name another one with --odom-topic\n" in capsys.readouterr().err
    with pytest.raises(TopicError, match=r"name another one with odom_topic$"):
        oc.corrupt(OFFICE, tmp_path / "a.mcap", odom_topic="/none")
