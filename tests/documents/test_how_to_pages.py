"""The workflow of the how-to pages gates as it says, and the test of replay_testing judges a recording."""

import os
import re
import shutil
import subprocess
import sys
from importlib.util import find_spec
from math import cos, sin
from pathlib import Path
from types import SimpleNamespace as Names
from unittest import TestCase

import numpy as np
import yaml

import odomcorrupt as oc

DOCS = Path(__file__).parents[2] / "docs"
OFFICE = DOCS.parent / "fixtures" / "office.mcap"
NOISE = "schema = 1\n[noise]\nlaw = 'diffusion'\nrot_rot = 0.1\nrot_trans = 0.05\ntrans_trans = 0.1\ntrans_rot = 0\n"
LOCALISER = """
import shutil, sys
from pathlib import Path
import numpy as np
from odomcorrupt.batching.sinks import format_tum, read_tum
import odomcorrupt as oc
runs, estimates = map(Path, sys.argv[1:])
estimates.mkdir(exist_ok=True)
clean = read_tum(runs / "clean.tum")
for bag in sorted(runs.glob("run_*.mcap"))[len(list(Path().glob("crash"))):]:
    own = oc.read_estimate(bag, "/odom").trajectory
    (estimates / f"{bag.stem}.tum").write_bytes(format_tum(clean.stamps_ns, clean.xyt + 0.1 * (own.xyt - clean.xyt)))
"""


def test_the_workflow_passes_and_fails_as_its_steps_run_in_a_shell(tmp_path):
    workflow = yaml.safe_load((DOCS / "how-to" / "drift.yml").read_text())
    assert set(workflow) == {"name", True, "permissions", "env", "jobs"}  # YAML 1.1 reads `on` as true
    (job,) = workflow["jobs"].values()
    schema = ["check_jsonschema", "--builtin-schema", "vendor.github-workflows", DOCS / "how-to" / "drift.yml"]
    assert find_spec(schema[0]) is None or not subprocess.run([sys.executable, "-m", *schema], check=False).returncode
    steps = [step["run"].replace("/ground_truth", "/odom") for step in job["steps"] if "run" in step]
    shutil.copy(OFFICE, tmp_path / "drive.mcap")
    (tmp_path / "robot.toml").write_text(NOISE)
    (tmp_path / "localise.py").write_text(LOCALISER)
    (tmp_path / "localise_all.sh").write_text(f'#!/bin/sh\n{sys.executable} localise.py "$@"\n')
    (tmp_path / "localise_all.sh").chmod(0o755)
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    env = {**os.environ, "PATH": path, "RUNS": "8", "GITHUB_STEP_SUMMARY": "summary.md"}

    def shell(step):
        words = ["bash", "-e", "-o", "pipefail", "-c", step]  # as GitHub runs it
        return subprocess.run(words, cwd=tmp_path, env=env, capture_output=True, text=True, check=False)

    _, batch, localise, gate = steps
    base = re.sub(r"--baseline .*", "--save last.json", gate, flags=re.DOTALL)
    for step in (batch, localise, base, batch, localise, gate):
        done = shell(step)
        assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("PASSED")
    (tmp_path / "crash").touch()
    shutil.rmtree(tmp_path / "estimates")
    (tmp_path / "summary.md").write_text("")
    assert shell(localise).returncode == 0
    failed = shell(gate)
    assert failed.returncode == 1
    assert failed.stdout.startswith("FAILED")
    assert "run_000000, seed 7" in failed.stdout
    for file in ("summary.md", "drift.xml"):
        assert "run" in (tmp_path / file).read_text()
        assert "missing" in (tmp_path / file).read_text()


def test_the_test_of_replay_testing_judges_messages_of_a_recording(tmp_path, monkeypatch):
    """The names of replay_testing are those of its version 0.0.4; a stand-in calls the test as its runner does."""
    text = (DOCS / "how-to" / "replay_testing.md").read_text().replace('"/ground_truth"', '"/odom"')
    (code,) = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "runs").mkdir()
    shutil.copy(OFFICE, tmp_path / "runs" / "run_000000.mcap")
    given = oc.read_estimate(OFFICE, "/odom").trajectory

    def messages(reader, topics):
        assert topics == ["/amcl_pose"]
        for stamp, (x, y, t) in zip(given.stamps_ns.tolist(), (given.xyt + reader).tolist(), strict=True):
            header = Names(stamp=Names(sec=stamp // 10**9, nanosec=stamp % 10**9))
            pose = Names(position=Names(x=x, y=y, z=0.0), orientation=Names(x=0.0, y=0.0, z=sin(t / 2), w=cos(t / 2)))
            yield "/amcl_pose", Names(header=header, pose=Names(pose=pose)), stamp

    decorators = Names(
        LocalFixture=lambda path: path, read_messages=messages, analyze=lambda cls: type("A", (cls, TestCase), {}),
        fixtures=Names(parameterize=lambda found: lambda cls: cls if found else None),
        run=Names(default=lambda: lambda cls: cls),
    )  # fmt: skip
    others = {"launch": Names(LaunchDescription=list), "launch_ros": Names(), "launch_ros.actions": Names(Node=dict)}
    for name, module in ({"replay_testing": decorators} | others).items():
        monkeypatch.setitem(sys.modules, name, module)
    space = {}
    exec(code, space)  # noqa: S102 - our own page
    assert space["Fixtures"].required_input_topics == ["/odom", "/scan", "/tf"]
    for offset_m, fine in ((0.1, True), (0.5, False)):
        test = space["Analyze"]("test_the_robot_is_found")
        test.reader = np.array([offset_m, 0.0, 0.0])
        assert test.run().wasSuccessful() is fine
