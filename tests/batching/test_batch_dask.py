"""A real Dask cluster of two workers, of which one is killed half-way, makes the bytes of a local run."""

import importlib.util
import json
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

import odomcorrupt
from odomcorrupt.cli import run

RUNS = 48

absent = pytest.mark.skipif(
    importlib.util.find_spec("distributed") is None,
    reason='dask is not installed: pip install ".[dask]" to have this tested',
)


def start(*words, cwd):
    env = os.environ | {"PYTHONPATH": str(Path(odomcorrupt.__file__).parent.parent)}
    return subprocess.Popen(
        [sys.executable, "-m", *words], cwd=cwd, env=env, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )


def wait_for(what, seconds=60.0):
    deadline = time.monotonic() + seconds
    while not (found := what()):
        assert time.monotonic() < deadline, "waited in vain"
        time.sleep(0.01)
    return found


@pytest.fixture
def cluster(tmp_path):
    """Yield the scheduler's address, and its two workers."""
    file = tmp_path / "scheduler.json"
    processes = [
        start("dask", "scheduler", "--host", "127.0.0.1", "--port", "0", "--scheduler-file", file.name,
              "--dashboard-address", "127.0.0.1:0", "--no-dashboard", cwd=tmp_path)
    ]  # fmt: skip
    try:
        wait_for(file.exists)
        time.sleep(0.2)
        address = json.loads(file.read_text())["address"]
        words = ("dask", "worker", address, "--nthreads", "1", "--nworkers", "1", "--no-nanny", "--no-dashboard")
        processes += [start(*words, "--name", name, cwd=tmp_path) for name in ("first", "second")]
        yield address, processes[1:]
    finally:
        for process in processes:
            process.kill()
            process.wait()


@absent
@pytest.mark.slow
def test_a_worker_killed_half_way_changes_no_byte(cluster, here):
    typed = ["--runs", str(RUNS), "--alpha", "0.05", "0.02", "0.05", "0.01", "--seed", "7"]
    address, workers = cluster
    ready = "import sys; from distributed import Client; Client(sys.argv[1]).wait_for_workers(2, timeout=60)"
    subprocess.run([sys.executable, "-c", ready, address], check=True, capture_output=True)
    batch = start("odomcorrupt", "batch", "in.mcap", "far", *typed, "--dask", address, cwd=here)
    wait_for(lambda: len(list(here.glob("far/run_*"))) >= RUNS // 4)
    parts_before = {path.name for path in here.glob("far/.parts/*.jsonl")}
    workers[0].kill()
    made = len(list(here.glob("far/run_*")))
    assert batch.wait(timeout=120) == 0
    assert made < RUNS, "the worker was killed too late to matter"
    assert len(parts_before) == 2, "both workers had work"
    assert run(["batch", "in.mcap", "near", *typed]) == 0
    near, far = (
        {path.name: path.read_bytes() for path in (here / name).iterdir() if path.is_file()} for name in ("near", "far")
    )
    assert set(near) == {*(f"run_{k:06d}.mcap" for k in range(RUNS)), "manifest.jsonl", "batch.json", "model.toml",
                         "clean.tum"}  # fmt: skip
    assert {name: data for name, data in far.items() if not name.startswith(".")} == near


def test_without_dask_the_extra_is_named(here, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "distributed", None)
    assert run(["batch", "in.mcap", "runs", "--runs", "1", "--seed", "1", "--dask", "tcp://127.0.0.1:1"]) == 1
    assert 'pip install ".[dask]"' in capsys.readouterr().err
