"""README's and docs/corrupt.md's sessions of corruption run as they stand; options that the text names exist."""

import os
import re
import subprocess
import sys
from pathlib import Path

import click
import pytest

from odomcorrupt.cli import cli
from odomcorrupt.model.motion_model import parse_alpha
from odomcorrupt.model.presets import PRESETS

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf8").split("## Corrupt\n", 1)[1].split("\n## ", 1)[0]
PAGE = (ROOT / "docs" / "corrupt.md").read_text(encoding="utf8").split("## How the correction works", 1)[0]


def session_of(text):
    return [line[2:] for line in re.search(r"```console\n(.*?)```", text, re.DOTALL)[1].splitlines()]


SESSION = list(dict.fromkeys(line.split("  ")[0] for line in (*session_of(README), *session_of(PAGE))))
PROSE = re.sub(r"```.*?```", "", PAGE, flags=re.DOTALL)
CODE = re.findall(r"`([^`]+)`", PROSE)


def with_our_command(tools):
    """Return an environment in which `odomcorrupt` is this one, by a script in a new folder."""
    tools.mkdir()
    (tools / "odomcorrupt").write_text(f'#!/bin/sh\nexec "{sys.executable}" -m odomcorrupt "$@"\n')
    (tools / "odomcorrupt").chmod(0o755)
    return os.environ | {"PATH": f"{tools}{os.pathsep}{os.environ['PATH']}", "PYTHONPATH": str(ROOT)}


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    """Type the session beside a bag of that name; return what each line said, and the folder."""
    work = tmp_path_factory.mktemp("session")
    (work / "in.bag").write_bytes((ROOT / "fixtures" / "office.bag").read_bytes())
    environment = with_our_command(work / "tools")
    done = [
        subprocess.run(["bash", "-c", line], cwd=work, env=environment, capture_output=True, text=True, check=False)
        for line in SESSION
    ]
    return dict(zip(SESSION, done, strict=True)), work


@pytest.mark.parametrize("line", SESSION)
def test_the_line_runs_and_makes_the_file_it_names(session, line):
    done, work = session
    assert done[line].returncode == 0, done[line].stderr
    words = line.split("#")[0].split()
    for word in words[2:]:
        if word.endswith((".bag", ".mcap", ".png", ".toml")):
            assert (work / word).stat().st_size > 0


def test_the_session_says_what_the_text_beside_it_promises(session):
    done, _ = session
    info, preview, first, slipping, batch, _, last = [done[line] for line in SESSION]
    assert batch.returncode == 0
    assert "leaks     /imu, /tf base_link -> wheel_left_link" in info.stdout
    assert "does not depend on the message rate" in preview.stdout
    assert "/odom 3000, TF odom -> base_link 3000" in first.stderr
    assert "3000 messages of clean odometry on /odom_true added" in " ".join(slipping.stderr.split())
    assert "once per 0.25m,0.2rad" in last.stderr
    assert "run 3" in last.stderr


def test_every_option_and_number_of_the_text_is_understood():
    known = {name for option in cli.get_command(click.Context(cli), "corrupt").params for name in option.opts}
    known |= {"--json"}
    named = {word for code in CODE for word in re.findall(r"--[a-z-]+", code)}
    assert named >= {"--law", "--step", "--effect", "--model", "--run", "--preset", "--covariance", "--twist"}
    assert named <= known
    degrees = [code for code in CODE if re.fullmatch(r"\d+deg(/m)?", code)]
    assert [parse_alpha(code) for code in degrees] == pytest.approx([0.0872664626, 0.174532925])


def test_every_preset_is_named():
    assert {name for name in PRESETS if f"`{name}`" in PROSE or f"--preset {name}`" in PROSE} == set(PRESETS)
