"""An output gets its name once, at once, over nothing that it may not replace, and leftovers of the dead are swept."""

import errno
import os
import subprocess
import sys
from pathlib import Path

import pytest
from oracles import OFFICE, OFFICE_DB, OFFICE_MCAP, copy

from odomcorrupt.bags import output
from odomcorrupt.bags.output import beside, place, sweep
from odomcorrupt.errors import BagError

BAGS = {"file": OFFICE_MCAP, "sqlite": OFFICE_DB, "directory": OFFICE}


def target_of(kind, tmp_path):
    return tmp_path / ("out" + BAGS[kind].suffix)


def existing(path, *, directory):
    if directory:
        path.mkdir()
        (path / "other.db3").write_text("a stranger's")
    else:
        path.write_text("a stranger's")


@pytest.fixture(params=[True, False], ids=["renameat2", "without"])
def _both_ways(request, monkeypatch):
    """Rename as Linux can, and as any system can."""
    if not request.param:
        monkeypatch.setattr(output, "_rename_flagged", lambda *_: False)


@pytest.mark.usefixtures("_both_ways")
@pytest.mark.parametrize("kind", BAGS)
def test_what_appeared_meanwhile_stays_and_nothing_is_left(kind, tmp_path):
    out = target_of(kind, tmp_path)

    def appear(_reader, _writer, block):
        if len(block.table) and not out.exists():
            existing(out, directory=kind == "directory")

    with pytest.raises(BagError, match="was written by another program in the meantime"):
        copy(BAGS[kind], out, appear)
    assert [one.name for one in tmp_path.iterdir()] == [out.name]
    assert (out / "other.db3" if out.is_dir() else out).read_text() == "a stranger's"


@pytest.mark.usefixtures("_both_ways")
@pytest.mark.parametrize("directory", [False, True])
@pytest.mark.parametrize("there", [False, True])
def test_a_complete_output_is_placed_and_what_it_replaces_hands_on_its_permissions(directory, there, tmp_path):
    out, partial = tmp_path / "out", tmp_path / "partial"
    if there:
        existing(out, directory=directory)
        out.chmod(0o750 if directory else 0o640)
    if directory:
        partial.mkdir()
        (partial / "new.db3").write_text("ours")
    else:
        partial.write_text("ours")
    place(partial, out, overwrite=True)
    assert [one.name for one in tmp_path.iterdir()] == ["out"]
    assert [one.read_text() for one in (out.iterdir() if directory else [out])] == ["ours"]
    assert not there or out.stat().st_mode & 0o777 == (0o750 if directory else 0o640)


def test_of_many_programs_with_one_new_output_one_succeeds(tmp_path):
    program = (
        "import sys, time, pathlib\nfrom odomcorrupt.bags.output import beside, place\n"
        "out = pathlib.Path(sys.argv[1]); mine = beside(out); mine.write_text(sys.argv[2]); print(flush=True)\n"
        "sys.stdin.readline()\nplace(mine, out, overwrite=False)\n"
    )
    words = [sys.executable, "-c", program, str(tmp_path / "out.mcap")]
    programs = [
        subprocess.Popen([*words, str(number)], stdin=-1, stdout=-1, stderr=subprocess.DEVNULL, text=True)
        for number in range(8)
    ]
    for one in programs:
        one.stdout.readline()
    for one in programs:
        one.stdin.write("\n")
        one.stdin.flush()
    won = [number for number, one in enumerate(programs) if one.wait() == 0]
    for one in programs:
        one.communicate()
    assert len(won) == 1
    assert (tmp_path / "out.mcap").read_text() == str(won[0])


def test_leftovers_of_dead_processes_of_this_machine_are_swept_and_only_those(tmp_path, dead):
    host = beside(tmp_path / "out.mcap").name.split(".")[3]
    left = [f".out.mcap.{host}.{dead}.0123abcd.partial", f".out.mcap.{host}.{dead}.89abcdef.partial-journal"]
    stay = [
        f".out.mcap.{host}.{os.getpid()}.0123abcd.partial",
        f".out.mcap.{'0' * 8}.{dead}.0123abcd.partial",
        f".other.mcap.{host}.{dead}.0123abcd.partial",
        f".out.mcap.{host}.{dead}.0123abcd.partially",
        ".out.mcap.partial",
        "out.partial",
    ]
    for name in (*left, *stay):
        (tmp_path / name).write_text("half")
    (tmp_path / f".out.mcap.{host}.{dead}.00000000.partial").mkdir()
    copy(OFFICE_MCAP, tmp_path / "out.mcap")
    assert sorted(one.name for one in tmp_path.iterdir()) == sorted([*stay, "out.mcap"])
    sweep(tmp_path / "nowhere")


@pytest.mark.parametrize("name", ["n" * 250 + ".mcap", "ü" * 120 + ".mcap", "[a]*?.mcap", "x.db3"])
def test_any_name_that_the_file_system_takes_can_be_written(name, tmp_path):
    source = BAGS["sqlite"] if name.endswith("db3") else OFFICE_MCAP
    copy(source, tmp_path / name)
    assert [one.name for one in tmp_path.iterdir()] == [name]


@pytest.mark.parametrize("name", ["out.mcap", "out", "deeper/out.mcap", "office_ros2.db3"])
def test_an_output_inside_of_the_input_is_refused(name, tmp_path):
    source = tmp_path / "bag"
    (source / "deeper").mkdir(parents=True)
    for file in BAGS["directory"].iterdir():
        (source / file.name).write_bytes(file.read_bytes())
    (tmp_path / "link").symlink_to(source)
    before = sorted(source.rglob("*"))
    for path in (source, tmp_path / "link"):
        with pytest.raises(BagError, match=r"(lies in|is) the input"):
            copy(source, path / name, overwrite=True)
    assert sorted(source.rglob("*")) == before


def test_an_error_of_the_file_system_is_reported_and_nothing_is_left(tmp_path, monkeypatch):
    def fail(*_args):
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    monkeypatch.setattr(output, "_rename_flagged", fail)
    with pytest.raises(BagError, match="Read-only file system"):
        copy(OFFICE_MCAP, tmp_path / "out.mcap")
    assert list(tmp_path.iterdir()) == []


def test_a_link_is_written_through(tmp_path):
    (tmp_path / "real").mkdir()
    (tmp_path / "out.mcap").symlink_to(Path("real") / "out.mcap")
    for _ in ("to nothing", "to what is replaced"):
        copy(OFFICE_MCAP, tmp_path / "out.mcap", overwrite=True)
        assert (tmp_path / "out.mcap").is_symlink()
        assert (tmp_path / "real" / "out.mcap").read_bytes().startswith(b"\x89MCAP")
        (tmp_path / "real" / "out.mcap").write_text("older")
