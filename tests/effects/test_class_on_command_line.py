"""Effects of one's own, as Python classes that the command line names."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from odomcorrupt.bags.open import open_reader
from odomcorrupt.cli import run
from odomcorrupt.inspection.scan import scan_bag

OFFICE = str(Path(__file__).parent.parent.parent / "fixtures" / "office.mcap")

WOBBLE = """
from dataclasses import dataclass
from typing import ClassVar

from odomcorrupt.effects.effect import Effect, Kind, TwistError, parameter, stacked


@dataclass(frozen=True, slots=True)
class Wobble(Effect):
    name: ClassVar[str] = "wobble"
    kind: ClassVar[Kind] = "effect"
    summary: ClassVar[str] = "the robot sways"

    k: float = parameter("", "of the speed", low=-0.1, high=0.1, typical=0.01)

    def twist_error(self, motion, state):
        return TwistError(stacked(0.0, self.k * motion.v, 0.0, motion.v), state)


class Plain:
    pass
"""


NONE = "rot_rot = 0\nrot_trans = 0\ntrans_trans = 0\ntrans_rot = 0"
WORDS = 'expression = "across += k * v"\nk = 0.05\n'


def drive_of(path):
    """Return the odometry's poses (n, 3)."""
    with open_reader(path) as reader:
        return scan_bag(reader).odometry[0].xyt


@pytest.fixture
def folder(tmp_path, monkeypatch):
    (tmp_path / "sway_in_folder.py").write_text(WOBBLE)
    (tmp_path / "sway_broken.py").write_text("1 / 0\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    return tmp_path


def test_a_class_of_this_folder_acts_as_the_same_words_in_a_model_file_do(folder, capsys):
    assert run([OFFICE, "own.mcap", "-v", "--seed", "1", "--effect", "sway_in_folder.Wobble:k=0.05"]) == 0
    assert "effects wobble (k 0.05)" in capsys.readouterr().err
    Path("robot.toml").write_text(f'schema = 1\n[noise]\n{NONE}\n[[effect]]\nname = "words"\n{WORDS}')
    assert run([OFFICE, "words.mcap", "-v", "--seed", "1", "--model", "robot.toml"]) == 0
    own, words, clean = (drive_of(Path(name)) for name in ("own.mcap", "words.mcap", OFFICE))
    assert np.abs(own - words).max() < 1e-9
    assert np.abs(own - clean).max() > 0.01


@pytest.mark.parametrize(
    ("effect", "sentence"),
    [
        ("sway_in_folder.Wobble:k=7", "effect wobble, k: 7; it must lie in"),
        ("sway_in_folder.Wobble:q=7", "effect wobble has no parameter 'q'"),
        ("sway_in_folder.Plain", "sway_in_folder.Plain: is not an effect class"),
        ("sway_in_folder.Missing", "sway_in_folder.Missing: is not an effect class"),
        ("sway_nowhere.Wobble", "sway_nowhere cannot be imported (ModuleNotFoundError"),
        ("sway_broken.Wobble", "sway_broken cannot be imported (ZeroDivisionError: division by zero)"),
        (".Wobble", "cannot be imported"),
    ],
)
def test_what_is_no_effect_is_one_line_of_wrong_usage(folder, capsys, effect, sentence):
    assert run([OFFICE, "out.mcap", "--effect", effect]) == 2
    said = capsys.readouterr().err
    assert sentence in said
    assert said.count("\n") == 1


def test_a_model_file_names_no_code(folder, capsys):
    Path("robot.toml").write_text(
        f'schema = 1\n[noise]\n{NONE}\n[[effect]]\nname = "sway_in_folder.Wobble"\nk = 0.01\n'
    )
    assert run([OFFICE, "out.mcap", "--model", "robot.toml"]) == 1
    assert "no effect is called 'sway_in_folder.Wobble'" in capsys.readouterr().err


@pytest.mark.usefixtures("folder")
def test_workers_of_a_batch_find_the_class_too(capsys):
    words = ["batch", OFFICE, "runs", "--runs", "2", "--jobs", "2", "--seed", "1", "--output", "trajectories"]
    assert run([*words, "--effect", "sway_in_folder.Wobble:k=0.05"]) == 0, capsys.readouterr().err
