"""The commands of docs/pipelines.md do what is said beside them."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from odomcorrupt.cli import run

ROOT = Path(__file__).parents[2]
COMMANDS = re.findall(r"```sh\n(.*?)\n```", (ROOT / "docs" / "pipelines.md").read_text(encoding="utf8"), re.DOTALL)


@pytest.fixture
def shell(tmp_path):
    """Run a command where the fixtures are and `odomcorrupt` is this one."""
    work = tmp_path / "work"
    work.mkdir()
    (work / "fixtures").symlink_to(ROOT / "fixtures")
    (tmp_path / "odomcorrupt").write_text(f'#!/bin/sh\nexec "{sys.executable}" -m odomcorrupt "$@"\n')
    (tmp_path / "odomcorrupt").chmod(0o755)
    environment = os.environ | {"PATH": f"{tmp_path}{os.pathsep}{os.environ['PATH']}", "PYTHONPATH": str(ROOT)}

    def call(command):
        done = subprocess.run(["bash", "-c", command], cwd=work, env=environment, capture_output=True, check=False)
        return done.returncode, done.stderr.decode(), work

    return call


@pytest.fixture(scope="module")
def expected(tmp_path_factory):
    target = tmp_path_factory.mktemp("file") / "noisy.mcap"
    assert run([str(ROOT / "fixtures" / "office.mcap"), str(target), "--seed", "7"]) == 0
    return target.read_bytes()


def command(word):
    (found,) = [one for one in COMMANDS if word in one]
    return found


def test_cat_gives_the_bytes_that_a_file_has(shell, expected):
    code, said, work = shell(command("cat "))
    assert (code, said[:7]) == (0, "MOVED  ")
    assert (work / "noisy.mcap").read_bytes() == expected


@pytest.mark.skipif(shutil.which("zstd") is None, reason="no zstd installed")
def test_zstd_on_both_sides(shell, expected):
    code, _, work = shell(f"set -o pipefail; {command('zstd ')}")
    assert code == 0
    packed = subprocess.run(["zstd", "-dc", work / "noisy.mcap.zst"], capture_output=True, check=True)
    assert packed.stdout == expected


def test_a_consumer_that_closes_early_gets_no_complaint(shell, expected):
    code, said, work = shell(command("beginning.bin"))
    assert (code, said) == (0, "")
    assert (work / "beginning.bin").read_bytes() == expected[:1000]


def test_a_producer_that_dies_is_one_line_and_leaves_nothing(shell):
    code, said, work = shell(command("truncated.mcap"))
    assert code == 1
    assert said.startswith("odomcorrupt: stdin: ")
    assert said.count("\n") == 1
    assert [path.name for path in work.iterdir()] == ["fixtures"]


def test_the_line_for_shell_completion_defines_one(shell):
    page = (ROOT / "docs" / "completion.md").read_text(encoding="utf8")
    code, said, _ = shell(re.findall(r"`(eval .*bash_source.*)`", page)[0] + " && complete -p odomcorrupt")
    assert (code, said) == (0, "")
    assert len(COMMANDS) == 4
