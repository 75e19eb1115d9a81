"""What is read beside bags is a regular file; a pipe, device, socket or directory in its place is one line at once."""

import os
import shutil
import signal
import socket
from pathlib import Path

import pytest

from odomcorrupt.cli import run
from odomcorrupt.errors import MapError, OdomCorruptError
from odomcorrupt.input_files import open_input, read_input
from recordings import FIXTURES

PGM = b"P5\n2 2\n255\n\xfe\xfe\xfe\xfe"
YAML = "image: map.pgm\nresolution: 0.05\norigin: [0, 0, 0]\noccupied_thresh: 0.65\nfree_thresh: 0.196\nnegate: 0\n"


def as_socket(path):
    bound = socket.socket(socket.AF_UNIX)
    here = Path.cwd()
    os.chdir(path.parent)  # a socket's name has at most 108 bytes
    try:
        bound.bind(path.name)
    finally:
        os.chdir(here)
        bound.close()


KINDS = {
    "a pipe": os.mkfifo, "a device": lambda path: path.symlink_to("/dev/zero"), "a socket": as_socket,
    "a directory": Path.mkdir,
}  # fmt: skip


@pytest.mark.parametrize("kind", KINDS)
def test_only_a_regular_file_is_opened(kind, tmp_path):
    path = tmp_path / "in"
    KINDS[kind](path)
    with pytest.raises(MapError, match=f"in: is {kind}; name a regular file"):
        open_input(path, MapError)
    link = tmp_path / "link"
    link.symlink_to(path)
    with pytest.raises(OdomCorruptError, match=kind):
        read_input(link, 10, "file")


def test_what_is_no_file_or_too_large_is_a_line(tmp_path):
    path = tmp_path / "in"
    path.write_bytes(b"12345")
    assert read_input(path, 5, "file") == read_input(path, 1 << 50, "file") == b"12345"  # allocates what is there
    with pytest.raises(OdomCorruptError, match="in: more than 4 bytes; that is not a table"):
        read_input(path, 4, "table")
    with pytest.raises(OdomCorruptError, match="none: cannot be read: No such file or directory"):
        open_input(tmp_path / "none")
    with pytest.raises(OdomCorruptError, match="cannot be read"):
        open_input(Path("a\0b"))
    path.chmod(0)
    if os.geteuid():
        with pytest.raises(OdomCorruptError, match="Permission denied"):
            open_input(path)


OFFICE, MYSTERY = (FIXTURES / f"{name}.mcap" for name in ("office", "mystery"))
NOISY = ("--alpha", "0.1", "0.1", "0.1", "0.1", "--seed", "1")
PLACES = {
    "model": ("in.toml", (OFFICE, "out.mcap", "--model", "in.toml")),
    "model of a batch": ("in.toml", ("batch", OFFICE, "o", "--runs", "2", "--model", "in.toml")),
    "defaults": ("odomcorrupt.toml", (OFFICE, "out.mcap", *NOISY)),
    "config": ("in.toml", (OFFICE, "out.mcap", *NOISY, "--config", "in.toml")),
    "map": ("map.yaml", (OFFICE, "out.mcap", *NOISY, "--map", "map.yaml")),
    "image": ("map.pgm", (OFFICE, "out.mcap", *NOISY, "--map", "map.yaml")),
    "recording": ("run.csv", ("fit", "run.csv", "--truth-bag", "truth.tum")),
    "truth": ("truth.tum", ("fit", MYSTERY, "--truth-bag", "truth.tum")),
    "compared model": ("in.toml", ("compare", MYSTERY, "in.toml")),
    "exported model": ("in.toml", ("export", "in.toml", "--to", "nav2")),
    "baseline": ("base.json", ("score", ".", "--baseline", "base.json", "--fail-if", "ate_p90 +20%")),
    "batch.json": ("batch.json", ("spread", ".")),
    "metadata.yaml": ("bag/metadata.yaml", ("bag", "out", *NOISY)),
}


@pytest.fixture
def impatient():
    """Interrupt what waits for a minute, as the opening of a pipe does."""

    def late(*_):
        pytest.fail("it waits")  # no error of the system, which a command would report

    before = signal.signal(signal.SIGALRM, late)
    signal.alarm(60)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


@pytest.mark.usefixtures("impatient")
@pytest.mark.parametrize("name", PLACES)
def test_no_command_waits_for_a_pipe(name, tmp_path, monkeypatch, capsys):
    # what opens its file by open_input refuses every other kind, too
    monkeypatch.chdir(tmp_path)
    Path("map.yaml").write_text(YAML)
    Path("map.pgm").write_bytes(PGM)
    Path("bag").mkdir()
    shutil.copyfile(OFFICE, "bag/bag_0.mcap")
    place, words = PLACES[name]
    Path(place).unlink(missing_ok=True)
    os.mkfifo(place)
    assert run([str(word) for word in words]) in (1, 2)
    said = capsys.readouterr().err
    assert said.count("\n") == 1, said
    assert Path(place).name in said
    assert not Path("out.mcap").exists()
