"""Without the extras all commands on bags work; the others name the library and the command that installs it."""

import subprocess
import sys
from pathlib import Path

import pytest

from test_refusals import ROBOT as NOISE

ROOT = Path(__file__).parents[1]
OFFICE = str(ROOT / "fixtures" / "office.mcap")
BARE = """
import sys
for library in ("scipy", "matplotlib", "pandas"):
    sys.modules[library] = None
from odomcorrupt.cli import run
sys.exit(run(sys.argv[1:]))
"""
ROBOT = NOISE + '[[effect]]\nname = "wheelbase"\ne = 0.02\n'


def typed(words, folder):
    (folder / "robot.toml").write_text(ROBOT)
    return subprocess.run(
        [sys.executable, "-c", BARE, *words.replace("OFFICE", OFFICE).split()],
        cwd=folder, env={"PYTHONPATH": str(ROOT)}, capture_output=True, text=True, check=False,
    )  # fmt: skip


@pytest.mark.parametrize(
    "words",
    [
        "OFFICE out.mcap --effect gyro_dead_band --effect slip_burst --seed 1",
        "OFFICE out.mcap --model robot.toml --seed 1",
        "batch OFFICE runs --runs 2 --model robot.toml",
        "correct OFFICE out.mcap --model robot.toml",
        "export robot.toml --to ros2_control",
        "effects wheelbase",
        "preview OFFICE --model robot.toml --runs 2",
    ],
)
def test_bags_are_corrupted_with_effects(words, tmp_path):
    done = typed(words, tmp_path)
    assert (done.returncode, "Traceback" in done.stderr) == (0, False), done.stderr


def test_python_names_it_too(tmp_path):
    code = """
import sys
sys.modules["scipy"] = None
import odomcorrupt as oc
for call in (lambda: oc.score("runs"), lambda: oc.simulate(), lambda: oc.fit("a.mcap")):
    try:
        call()
    except oc.OdomCorruptError as error:
        print(error)
"""
    environment = {"PYTHONPATH": str(ROOT)}
    said = subprocess.check_output([sys.executable, "-c", code], cwd=tmp_path, env=environment, text=True)
    assert said.count("scipy is not installed; the study needs it") == 3
