"""The pytest plugin: bags of a model kept by content, and an assertion with the gate's statistics."""

import shutil
import subprocess
import sys

import numpy as np
import pytest

from odomcorrupt.errors import OdomCorruptError
from pytest_odomcorrupt.bags import corrupted
from pytest_odomcorrupt.gate import ErrorGate
from recordings import OFFICE, ROOT


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    return tmp_path_factory.mktemp("cache")


def test_bags_are_made_once_and_by_content(cache, tmp_path):
    first = corrupted(OFFICE, "typical", runs=2, seed=7, cache=cache)
    made = [bag.path.stat().st_mtime_ns for bag in first]
    shutil.copy(OFFICE, tmp_path / "office.mcap")
    again = corrupted(tmp_path / "office.mcap", "typical", runs=3, seed=7, cache=cache)
    assert [bag.path for bag in again][:2] == [bag.path for bag in first]
    assert [bag.path.stat().st_mtime_ns for bag in again][:2] == made
    assert [bag.name for bag in again] == [f"run {k}, seed 7, run_00000{k}.mcap" for k in range(3)]
    other = corrupted(OFFICE, "article", runs=1, seed=7, cache=cache)
    assert other[0].path.parent != first[0].path.parent


def test_errors_of_a_run_are_reported_against_the_odometry_before(cache):
    bag = corrupted(OFFICE, "typical", runs=2, seed=7, cache=cache)[1]
    assert bag.errors(bag.clean_tum, truth=bag.clean_tum).metrics()["ate_m"] < 1e-9
    drifted = bag.errors(bag.path, "/odom", align="origin").metrics()
    assert bag.errors((bag.path, "/odom"), align="origin").metrics() == drifted
    assert drifted["end_m"] == pytest.approx(bag.drift["end_drawn_m"], rel=1e-3)


def test_what_cannot_be_made_is_said(cache):
    with pytest.raises(OdomCorruptError, match="no such bag"):
        corrupted("nowhere.mcap", cache=cache)
    with pytest.raises(OdomCorruptError, match="one or more"):
        corrupted(OFFICE, runs=0, cache=cache)


def errors_of(scale, seed=1):
    rng = np.random.default_rng(seed)
    level = np.exp(0.5 * np.random.default_rng(0).standard_normal(40))
    return {f"run {i}, seed 7": float(scale * v * np.exp(0.1 * rng.standard_normal())) for i, v in enumerate(level)}


def test_the_gate_asserts_against_the_baseline_that_it_wrote(tmp_path):
    path = tmp_path / "baselines" / "one.json"
    assert ErrorGate(path, update=True)(errors_of(0.1)) is None
    gate = ErrorGate(path, update=False)
    assert gate(errors_of(0.1, seed=2)).ratio == pytest.approx(1.0, abs=0.1)
    with pytest.raises(
        AssertionError,
        match=r"(?s)the p90 of errors: .* m -> .* m .*run \d+, seed 7.*: .* m -> .* m\n.*--odomcorrupt-update",
    ):
        gate(errors_of(0.13, seed=2))
    crashed = errors_of(0.1, seed=2) | {"run 3, seed 7": float("inf")}
    with pytest.raises(AssertionError, match=r"1 of 40 runs have no result that had one .*\n  run 3, seed 7: "):
        gate(crashed)
    assert gate(crashed, crashes=1).ratio == pytest.approx(1.0, abs=0.1)
    with pytest.raises(AssertionError, match=r"more than 0\.1"):
        gate(errors_of(0.1), most=0.1)


def test_a_failing_gate_shows_its_lines_and_no_source_of_the_plugin(tmp_path):
    (tmp_path / "test_it.py").write_text(
        "def test_it(error_gate):\n"
        "    errors = {f'run {i}': 1.0 + i for i in range(9)} | {'run 9': float('inf')}\n"
        "    error_gate(errors, statistic='median', most=2.0)\n"
        "def test_other(corrupted_bags):\n"
        "    corrupted_bags('nowhere.bag')\n"
    )
    words = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "test_it.py"]
    said = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert said.returncode == 1
    assert "AssertionError: the median of 10 errors is 5.5 m, more than 2 m" in said.stdout
    assert "run 9: infinite" in said.stdout
    assert "OdomCorruptError: nowhere.bag: there is no such bag" in said.stdout
    assert not any(word in said.stdout for word in ("pytest_odomcorrupt/", "_require"))


def test_the_gate_says_what_it_lacks(tmp_path):
    gate = ErrorGate(tmp_path / "none.json", update=False)
    with pytest.raises(AssertionError, match="no baseline yet"):
        gate(errors_of(0.1))
    (tmp_path / "none.json").write_text("[]")
    with pytest.raises(AssertionError, match="is not a baseline"):
        gate(errors_of(0.1))
    with pytest.raises(AssertionError, match="numbers of at least 0"):
        gate({"run 0, seed 7": float("nan")})


@pytest.mark.slow
def test_the_example_of_the_page_runs_and_turns_red(tmp_path):
    for name in ("test_odometry_drift.py", "localise.py"):
        shutil.copy(ROOT / "examples" / name, tmp_path / name)
    (tmp_path / "fixtures").symlink_to(ROOT / "fixtures")
    words = [sys.executable, "-m", "pytest", "-q", "--odomcorrupt-cache", "bags", "test_odometry_drift.py"]
    assert subprocess.run([*words, "--odomcorrupt-update"], cwd=tmp_path, check=False).returncode == 0
    assert subprocess.run(words, cwd=tmp_path, check=False).returncode == 0
    text = (tmp_path / "localise.py").read_text()
    (tmp_path / "localise.py").write_text(text.replace("SIGMA_M, RANDOM = 0.1, 0.1", "SIGMA_M, RANDOM = 2.0, 0.9"))
    worse = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert worse.returncode == 1
    assert "the p90 of errors: " in worse.stdout
    assert "pytest_odomcorrupt/" not in worse.stdout
