"""A batch goes on where it was killed, refuses what it was not begun with, and tells what failed."""

import fcntl
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from test_batch_bytes import records

from odomcorrupt.bags.output import beside
from odomcorrupt.batching import engine as making
from odomcorrupt.batching import manifest
from odomcorrupt.cli import run
from recordings import FIXTURES

TYPED = ["--alpha", "0.05", "0.02", "0.05", "0.01", "--seed", "7"]


def files_of(directory):
    return {path.name: path.read_bytes() for path in directory.iterdir() if path.is_file()}


@pytest.fixture
def batch(invoke):
    """Return a function that makes runs of a bag; see `invoke`."""
    return lambda count, *more, target="runs", code=0: invoke(
        ["batch", "in.mcap", target, "--runs", count, *TYPED, *more], code
    )


def test_killed_at_any_moment_it_leaves_whole_files_and_goes_on(here, monkeypatch, batch):
    monkeypatch.setattr("odomcorrupt.batching.engine.GROUP", 2)
    batch(12, target="whole")
    program = "import odomcorrupt.batching.engine as e; e.GROUP = 2; from odomcorrupt.cli import run; import sys; "
    program += "sys.exit(run(sys.argv[1:]))"
    words = [sys.executable, "-c", program, "batch", "in.mcap", "runs", "--runs", "12", *TYPED]
    made = 0
    for number in range(3):
        process = subprocess.Popen(words, stderr=subprocess.DEVNULL)
        # a kill while some pass is under way: when two more files have come
        deadline = time.monotonic() + 30
        while len(list(here.glob("runs/run_*"))) < made + 2 and time.monotonic() < deadline:
            time.sleep(0.002)
        process.send_signal(signal.SIGKILL)
        process.wait()
        found = {path.name: path.read_bytes() for path in here.glob("runs/run_*")}
        assert all(data == (here / "whole" / name).read_bytes() for name, data in found.items())
        assert made < len(found) < 12, number
        made = len(found)
        before = {name: (here / "runs" / name).stat().st_mtime_ns for name in found}
    batch(12)
    assert files_of(here / "runs") == files_of(here / "whole") | {
        name: data for name, data in files_of(here / "runs").items() if name in {"manifest.jsonl", "batch.json"}
    }
    assert [record["run"] for record in records(here / "runs")] == list(range(12))
    assert all((here / "runs" / name).stat().st_mtime_ns == then for name, then in before.items())
    assert not list(here.glob("runs/.*.partial"))


@pytest.mark.skipif(sys.platform != "linux", reason="processes are looked up in /proc")
@pytest.mark.parametrize("threads", ["1", pytest.param("2", marks=pytest.mark.slow)], ids=["copied", "started"])
def test_workers_of_a_killed_batch_end_and_leave_nothing(here, threads, batch):
    words = [sys.executable, "-m", "odomcorrupt", "batch", "in.mcap", "runs", "--runs", "400", "--jobs", "2", *TYPED]
    # threads of a linear algebra library forbid that a worker is a copy of the batch
    process = subprocess.Popen(words, stderr=subprocess.DEVNULL, env={**os.environ, "OPENBLAS_NUM_THREADS": threads})
    deadline = time.monotonic() + 30
    while not list(here.glob("runs/.making*")) and time.monotonic() < deadline:
        time.sleep(0.002)
    workers = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
    process.kill()
    process.wait()
    assert len(workers) >= 2
    while any(_runs(pid) for pid in workers) and time.monotonic() < deadline:
        time.sleep(0.01)
    assert not any(_runs(pid) for pid in workers)
    batch(1)
    assert not list(here.glob("runs/.*.partial"))


def _runs(pid):
    """Tell whether a process runs; one that nobody has asked how it ended does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False


HOST = beside(Path("any")).name.split(".")[2]
LEFT = ("run_000001.mcap", "run_000007.mcap", "clean.tum", "manifest.jsonl", "batch.json", "robots/000002.toml")


def test_leftovers_of_made_runs_and_of_the_batch_itself_are_swept(here, dead):
    noise = {"rot_rot": "0.03", "rot_trans": '"0.02 +- 0.008"', "trans_trans": "0.02", "trans_rot": "0.0"}
    lines = ["schema = 1", "[noise]", *(f"{name} = {value}" for name, value in noise.items())]
    (here / "robot.toml").write_text("\n".join(lines))
    words = ["batch", "in.mcap", "runs", "--runs", "3", "--model", "robot.toml", "--seed", "7"]
    assert run(words) == 0
    whole = files_of(here / "runs")
    for name in LEFT:
        (here / "runs" / name).with_name(f".{Path(name).name}.{HOST}.{dead}.0123abcd.partial").write_bytes(b"half")
    (here / "runs" / f".run_000000.db3.{HOST}.{dead}.0123abcd.partial-journal").write_bytes(b"half")
    (here / "runs" / f".making.{HOST}.{dead}.0123abcd.partial").mkdir()
    (here / "runs" / f".making.{HOST}.{dead}.0123abcd.partial" / "run_000000.mcap").write_bytes(b"half")
    others = [here / "runs" / f".run_000001.mcap.{HOST}.{os.getpid()}.0123abcd.partial"]
    others += [here / "runs" / f".run_000001.mcap.{'0' * 8}.{dead}.0123abcd.partial", here / "runs" / ".mine.partial"]
    for other in others:
        other.write_bytes(b"somebody is at it")
    assert run(words) == 0
    assert sorted((here / "runs").rglob(".*.partial*")) == sorted(others)
    assert {name: data for name, data in files_of(here / "runs").items() if "partial" not in name} == whole


def test_a_batch_that_was_killed_before_it_began_is_begun(here, dead, batch):
    (here / "runs" / ".parts").mkdir(parents=True)
    (here / "runs" / f".batch.json.{HOST}.{dead}.0123abcd.partial").write_bytes(b"{")
    batch(1)
    assert not list((here / "runs").glob(".*.partial"))


def test_what_is_made_is_not_made_again_and_what_is_gone_is(here, batch):
    batch(3)
    times = {path.name: path.stat().st_mtime_ns for path in here.glob("runs/run_*")}
    gone = here / "runs" / "run_000001.mcap"
    data = gone.read_bytes()
    gone.unlink()
    batch(5)
    assert gone.read_bytes() == data
    assert all((here / "runs" / name).stat().st_mtime_ns == then for name, then in times.items() if name != gone.name)
    assert len(records(here / "runs")) == 5


def test_a_batch_without_a_seed_goes_on_with_its_own(here):
    assert run(["batch", "in.mcap", "runs", "--runs", "1"]) == 0
    first = records(here / "runs")[0]["seed"]
    assert run(["batch", "in.mcap", "runs", "--runs", "2"]) == 0
    assert {record["seed"] for record in records(here / "runs")} == {first}


OTHERWISE = {
    "another model": "--effect=wheel_scale:e=0.01", "another --output": "--output=overlay",
    "other options": "--twist=keep", "another seed": "--seed=8",
}  # fmt: skip


def test_what_was_begun_otherwise_is_refused_with_the_way_out(here, batch):
    assert "odomcorrupt spread" not in batch(1).err  # of one run
    for named, more in OTHERWISE.items():
        said = batch(2, more, code=1).err
        assert named in said
        assert "name another directory" in said
    assert len(list(here.glob("runs/run_*"))) == 1


def test_a_changed_input_is_noticed_by_one_byte(here, batch):
    batch(1)
    data = bytearray((here / "in.mcap").read_bytes())
    data[len(data) // 2] ^= 1
    stat = (here / "in.mcap").stat()
    (here / "in.mcap").write_bytes(data)
    os.utime("in.mcap", ns=(stat.st_atime_ns, stat.st_mtime_ns))
    assert "another input" in batch(2, code=1).err


def test_a_directory_of_other_things_is_refused(here, batch):
    (here / "runs").mkdir()
    (here / "runs" / "precious").touch()
    assert "holds files, but no batch" in batch(1, code=1).err
    assert [path.name for path in (here / "runs").iterdir()] == ["precious"]


def test_a_run_that_fails_once_is_made_the_second_time_and_one_that_fails_always_is_reported(here, monkeypatch, batch):
    failed = {2: 1, 3: 99}
    begin = making._begin

    def failing(job, number, *rest):
        if failed.get(number, 0) > 0:
            failed[number] -= 1
            raise OSError(f"no luck with {number}")
        return begin(job, number, *rest)

    monkeypatch.setattr(making, "_begin", failing)
    said = batch(5, code=1).err
    assert "4 runs made now" in said
    assert "1 runs, tried twice; run 3: no luck with 3" in said
    assert sorted(path.name for path in here.glob("runs/run_*")) == [f"run_{k:06d}.mcap" for k in (0, 1, 2, 4)]
    monkeypatch.setattr(making, "_begin", begin)
    batch(5)
    assert len(records(here / "runs")) == 5


@pytest.mark.slow
def test_processes_and_shards_make_the_same_files_as_one(here, batch):
    batch(7, target="one")
    batch(7, "--jobs", "2", target="jobs")
    for shard in ("3/3", "1/3", "2/3"):
        batch(7, "--shard", shard, target="shards")
    one = files_of(here / "one")
    assert {name for name in one if name.startswith("run_")} == {f"run_{k:06d}.mcap" for k in range(7)}
    assert files_of(here / "jobs") == one
    assert files_of(here / "shards") == one


def test_a_dry_run_foretells_the_bytes_and_makes_nothing(here, batch):
    said = batch(200, "--dry-run").out
    assert not (here / "runs").exists()
    assert said.startswith("NEEDS  200 runs to make, about ")
    batch(4)
    real = sum(path.stat().st_size for path in here.glob("runs/run_*")) / 4 * 200 / 1e9
    assert float(said.split("about ")[1].split(" GB")[0]) == pytest.approx(real, rel=0.02)
    assert "less" in said


def test_a_full_disk_is_refused_before_anything_is_made(here, monkeypatch, batch):
    monkeypatch.setattr("odomcorrupt.batching.engine.free_bytes", lambda _: 3_000_000)
    said = batch(10, code=1).err
    assert "10 runs need about" in said
    assert "0.003 GB are free" in said
    assert "--output overlay would need" in said
    assert "900000000 runs need about" in batch(900_000_000, code=1).err
    assert not (here / "runs").exists()
    batch(1)


@pytest.mark.parametrize("flag", ["--odom-topic", "--also"])
def test_no_odometry_fails_at_once_and_leaves_nothing(flag, here, batch):
    said = batch(3, flag, "/nowhere", code=1).err
    assert "no topic /nowhere" in said
    assert "tried twice" not in said
    assert not (here / "runs").exists()


BROKEN = ["[1]", "5", "null", '"run"', "{}", '{"run": 0}', "\xff\xfe", '{"run": 1e400}', '{"run": 1, "file": 5}']
BROKEN.append("[" * 100_000)


def test_lines_of_the_manifest_that_are_none_are_passed_over(here, batch):
    batch(2)
    whole = files_of(here / "runs")
    for path in (here / "runs" / "manifest.jsonl", here / "runs" / ".parts" / "elsewhere-1.jsonl"):
        with path.open("a", encoding="latin1") as stream:
            stream.write("\n".join(BROKEN) + "\n")
    assert "0 runs made now" in batch(2).err
    assert files_of(here / "runs") == whole


def test_a_beginning_that_is_none_is_reported_in_a_line(here, invoke, batch):
    batch(1)
    again = ["batch", "in.mcap", "runs", "--runs", "1"]
    for text in ("[]", "5", "{}", "[" * 100_000, '{"seed": "x"}', "\xff", '{"seed": -1}', "null", ""):
        (here / "runs" / "batch.json").write_text(text, encoding="latin1")
        for words in ([*again, *TYPED], [*again, *TYPED[:5]], ["spread", "runs"]):
            said = invoke(words, 1).err
            assert "batch.json: is not as batch writes it" in said
            assert said.count("\n") == 1


def test_parts_that_is_no_directory_is_reported_in_a_line(here, batch):
    batch(1)
    shutil.rmtree(here / "runs" / ".parts")
    (here / "runs" / ".parts").touch()
    assert ".parts: cannot be made a directory" in batch(1, code=1).err


def test_a_run_that_is_not_as_large_as_noted_is_made_again(here, batch):
    batch(2)
    path = here / "runs" / "run_000001.mcap"
    data = path.read_bytes()
    for harm in ("cut", "link"):
        if harm == "link":
            (here / "elsewhere").write_bytes(data)
            path.unlink()
            path.symlink_to(here / "elsewhere")
        else:
            os.truncate(path, 1000)
        batch(2)
        assert path.read_bytes() == data
        assert not path.is_symlink()


@pytest.mark.parametrize("kind", ["in.mcap", "office_ros2"])
def test_a_changed_byte_is_found_where_sums_are_asked_for(kind, here, invoke):
    words = ["batch", kind, "runs", "--runs", "2", *TYPED]
    assert run(words) == 0
    run_1 = here / "runs" / ("run_000001.mcap" if kind == "in.mcap" else "run_000001")
    path = run_1 if run_1.is_file() else next(run_1.glob("*.db3"))
    data = path.read_bytes()
    path.write_bytes(data[:5000] + bytes([data[5000] ^ 1]) + data[5001:])
    assert "0 runs made now" in invoke(words).err
    assert "1 runs made now" in invoke([*words, "--verify"]).err
    assert path.read_bytes() == data


def test_a_record_of_a_file_elsewhere_counts_for_nothing(here, batch):
    batch(2)
    path = here / "runs" / "manifest.jsonl"
    first, second = path.read_text().splitlines()
    for name in ("../b0/run_000001.mcap", "/etc/hostname", "run_000002.mcap", "."):
        shutil.rmtree(here / "runs" / ".parts")
        path.write_text(first + "\n" + json.dumps(json.loads(second) | {"file": name}) + "\n")
        assert "1 runs made now, 2 in" in batch(2).err


def test_a_folder_has_one_batch_at_a_time_but_many_shards(here, batch):
    batch(1)
    with (here / "runs" / "batch.json").open("rb") as stream:
        fcntl.flock(stream, fcntl.LOCK_SH)
        batch(2, "--shard", "1/2")
        assert "another batch is running in it" in batch(2, code=1).err
    batch(2)


def test_of_two_that_begin_at_once_one_is_refused(here, monkeypatch, batch):
    assert run(["batch", "in.mcap", "other", "--runs", "1", "--seed", "8"]) == 0
    write = manifest.write_file

    def late(path, data, *, overwrite=True):
        if path.name == "batch.json" and not path.exists():
            shutil.copyfile(here / "other" / "batch.json", path)
        write(path, data, overwrite=overwrite)

    monkeypatch.setattr(manifest, "write_file", late)
    assert "another seed" in batch(1, code=1).err
    assert not list(here.glob("runs/run_*"))


def test_runs_are_not_made_inside_of_their_input(here, invoke):
    shutil.copytree(FIXTURES / "office_ros2", here / "bag")
    assert "lies in the input" in invoke(["batch", "bag", "bag/runs", "--runs", "1", *TYPED], 1).err
    assert sorted(path.name for path in (here / "bag").iterdir()) == sorted(
        path.name for path in (FIXTURES / "office_ros2").iterdir()
    )
