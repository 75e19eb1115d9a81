"""Standard streams that are closed, full or left, and the line of progress on a terminal."""

import io
import os
import re
import signal
import subprocess
import sys
import time
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import Writer

from odomcorrupt.bags.block import TABLE, Block
from odomcorrupt.cli import run
from odomcorrupt.commands import _progress
from odomcorrupt.standard_streams import TextStream, visible
from odomcorrupt.study.select.selection import stages
from recordings import FIXTURES
from terminal import on_a_terminal

OFFICE = str(FIXTURES / "office.mcap")
OFFICE1 = str(FIXTURES / "office.bag")
OURS = [sys.executable, "-m", "odomcorrupt"]
WITHOUT = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}
WORDS = {"info": ["info", OFFICE], "help": ["--help"], "json": ["info", OFFICE, "--json"], "bag": [OFFICE, "-"]}


def called(words, *, redirected="", env=None):
    """Run a command, its streams redirected; return exit code (negative for a signal), stdout and stderr."""
    line = [*OURS, *words]
    if redirected:
        line = ["bash", "-c", f'exec "$@" {redirected}', "bash", *line]
    done = subprocess.run(line, capture_output=True, check=False, env=WITHOUT if env is None else env)
    return done.returncode, done.stdout.decode(), done.stderr.decode()


@pytest.mark.parametrize(
    ("redirected", "reason", "kind", "more"),
    [
        *(("> /dev/full", "No space left", kind, {}) for kind in WORDS),
        ("> /dev/full", "No space left", "bag", {"PYTHONUNBUFFERED": "1"}),
        *((">&-", "Bad file descriptor", kind, {}) for kind in ("info", "bag")),
    ],
)
def test_a_stdout_that_takes_nothing_is_said_in_a_line(redirected, reason, kind, more):
    code, _, said = called(WORDS[kind], redirected=redirected, env=WITHOUT | more)
    assert code == 1
    assert said.startswith(f"odomcorrupt: stdout: cannot be written: {reason}")
    assert said.count("\n") == 1, said


@pytest.mark.parametrize("redirected", ["2> /dev/full", "2>&-"])
@pytest.mark.parametrize(("words", "expected"), [(["info", OFFICE], 0), (["info", "/nowhere"], 1), (["info"], 2)])
def test_a_stderr_that_takes_nothing_changes_no_exit_code(words, expected, redirected):
    assert called(words, redirected=redirected)[0] == expected


def test_what_is_written_does_not_end_up_in_a_closed_stream_s_place(tmp_path):
    out = tmp_path / "out.mcap"
    assert called([OFFICE, str(out), "--seed", "7"], redirected=">&- 2>&- <&-")[0] == 0
    again = tmp_path / "again.mcap"
    assert called([OFFICE, str(again), "--seed", "7"])[0] == 0
    assert out.read_bytes() == again.read_bytes()


def test_a_closed_stdin_is_said():
    code, _, said = called(["info", "-"], redirected="<&-")
    assert (code, said.count("\n")) == (1, 1)
    assert "stdin: cannot be read" in said


@pytest.mark.parametrize("words", [WORDS["info"], WORDS["bag"]], ids=["text", "bag"])
def test_a_pipe_that_is_closed_early_ends_as_cat_does(words):
    read, write = os.pipe()
    os.close(read)
    done = subprocess.run([*OURS, *words], stdout=write, stderr=subprocess.PIPE, check=False, env=WITHOUT)
    os.close(write)
    assert (done.returncode, done.stderr) == (-signal.SIGPIPE, b"")


def test_what_a_command_writes_is_written_though_nobody_reads_its_words(tmp_path):
    out = tmp_path / "out.mcap"
    read, write = os.pipe()
    os.close(read)
    line = [*OURS, "integrate", OFFICE, str(out)]
    done = subprocess.run(line, stdout=write, stderr=subprocess.PIPE, check=False, env=WITHOUT)
    os.close(write)
    assert done.returncode == -signal.SIGPIPE
    assert b"Traceback" not in done.stderr
    assert out.read_bytes().startswith(b"\x89MCAP")


@pytest.mark.parametrize("delay_s", [0.03, 0.2])
@pytest.mark.usefixtures("interruptible")
def test_an_interrupt_while_it_begins_is_no_traceback(delay_s):
    program = f"import sys; sys.argv[1:] = ['info', {OFFICE!r}]\n"
    program += "from odomcorrupt.__main__ import main; print(flush=True); main()"
    process = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    process.stdout.readline()
    time.sleep(delay_s)
    process.send_signal(signal.SIGINT)
    _, said = process.communicate()
    assert process.returncode in {-signal.SIGINT, 130, 0}
    assert b"Traceback" not in said


@pytest.mark.usefixtures("interruptible")
def test_an_interrupt_is_quiet_as_soon_as_the_console_script_has_imported_it():
    """What the script of an installation does between the import and the call takes a while."""
    program = "from odomcorrupt.__main__ import main; print(flush=True); import time; time.sleep(60); main()"
    process = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    process.stdout.readline()
    process.send_signal(signal.SIGINT)
    assert (process.communicate(), process.returncode) == ((b"", b""), -signal.SIGINT)


def test_an_interrupt_that_the_shell_has_it_ignore_stays_ignored():
    """As in the background of a shell."""
    program = f"import sys; sys.argv[1:] = ['info', {OFFICE!r}]; import os, signal\n"
    program += "signal.signal(signal.SIGINT, signal.SIG_IGN)\n"
    program += "from odomcorrupt.__main__ import main; os.kill(os.getpid(), signal.SIGINT); print(flush=True); main()"
    process = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE)
    process.stdout.readline()
    time.sleep(0.2)
    process.send_signal(signal.SIGINT)
    process.communicate()
    assert process.returncode == 0


EVIL = "/odom\x1b]0;title\x07\r\x1b[2K\x9b31m\u202eabc\nNote: all is well"


def evil_bag(path):
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        channel = writer.register_channel(EVIL, "json", 0)
        writer.add_message(channel, 1, b"{}", 1)
        writer.finish()
    return path


@pytest.mark.parametrize("more", [["-v"], ["--json"]])
def test_control_characters_of_names_are_shown_escaped(more, tmp_path):
    _, out, said = called(["info", str(evil_bag(tmp_path / "in.mcap")), *more])
    both = out + said
    assert not set(both) & {"\x1b", "\x07", "\r", "\x9b", "\u202e"}
    assert "\nNote: all is well" not in both
    assert "x1b" in both or "u001b" in both
    _, out, said = called([str(tmp_path / "in.mcap"), str(tmp_path / "\x1b[31mout.mcap")])
    assert "\x1b" not in out + said
    assert said.count("\n") == 1


def test_names_are_shown_as_they_are_but_for_controls():
    assert visible("/odöm \N{ROBOT FACE}\t\n\x1b") == "/odöm \N{ROBOT FACE}\\t\\n\\x1b"


def test_a_line_of_progress_still_erases_the_one_before():
    buffer = io.BytesIO()
    stream = TextStream(buffer, "utf8")
    stream.write("\r\x1b[K5 s\r\x1b[K\n\tx")
    stream.flush()
    assert buffer.getvalue() == b"\r\x1b[K5 s\\r\\x1b[K\n\tx"


def console(*args, **more):
    return subprocess.run([*OURS, *args], capture_output=True, check=False, **more)


@pytest.mark.parametrize(("source", "more"), [(OFFICE, {}), (OFFICE, {"PYTHONUNBUFFERED": "1"}), (OFFICE1, {})])
def test_a_pipe_carries_bytes_only_and_the_same_as_a_file(tmp_path, source, more):
    with Path(source).open("rb") as file:
        done = console("-", "-", "--odom-topic", "/odom", "--seed", "5", stdin=file, env=WITHOUT | more)
    assert done.returncode == 0
    assert done.stderr.startswith(b"MOVED ")
    # a pipe leaves the messages' generation of ROS alone, a name in .mcap makes it 2
    same = ["--ros", "1"] if source == OFFICE1 else []
    assert run([source, str(tmp_path / "out.mcap"), "--seed", "5", *same]) == 0
    assert done.stdout == (tmp_path / "out.mcap").read_bytes()


def test_a_pipe_without_a_topic_or_cut_short_fails_in_one_line():
    with Path(OFFICE).open("rb") as file:
        done = console("-", "-", stdin=file)
    assert (done.returncode, done.stdout) == (1, b"")
    assert b"on a pipe topics are not known beforehand; name the odometry with --odom-topic" in done.stderr
    half = console("-", "-", "--odom", "odom", input=Path(OFFICE).read_bytes()[:200_000])
    assert half.returncode == 1
    assert half.stderr.count(b"\n") == 1
    database = console("-", "-", input=(FIXTURES / "office_ros2" / "office_ros2.db3").read_bytes())
    line = b"odomcorrupt: stdin: a sqlite3 bag cannot come through a pipe; name the file or directory\n"
    assert (database.returncode, database.stdout, database.stderr) == (1, b"", line)


def block(log_s):
    table = np.array([(1, int(log_s * 1e9), 0, 0)], dtype=TABLE)
    return Block(np.zeros(3_000_000, dtype=np.uint8), table)


def test_a_terminal_gets_seconds_and_megabytes_and_wiped(monkeypatch, capsys):
    monkeypatch.setattr(_progress, "PAUSE_S", 0.0)
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    with _progress.Progress() as progress:
        progress(block(100.0))
        progress(block(112.4))
    captured = capsys.readouterr()
    assert not captured.out
    assert captured.err.endswith("\r\x1b[K12 s of the bag, 6 MB\r\x1b[K")


def test_what_is_no_terminal_gets_nothing(monkeypatch, capsys):
    monkeypatch.setattr(_progress, "PAUSE_S", 0.0)
    with _progress.Progress() as progress:
        progress(block(100.0))
    assert capsys.readouterr().err == ""


def test_progress_is_reported_on_terminals_only_and_wiped_away(tmp_path):
    """Run under a pseudo-terminal of 60 columns: the last thing on it is the folded summary."""
    said = on_a_terminal(60, "-m", "odomcorrupt", OFFICE, str(tmp_path / "out.mcap"), "--seed", "1")
    assert "\r\x1b[K" in said
    lines = said.rsplit("\x1b[K", 1)[1].splitlines()
    assert lines[0].startswith("\x1b[32mMOVED")
    plain = [re.sub(r"\x1b\[\d+m", "", line) for line in lines if str(tmp_path) not in line]
    assert 50 < max(map(len, plain)) <= 60


def test_what_reading_took_is_no_estimate_of_what_follows_it(monkeypatch):
    now_s = 100.0
    monkeypatch.setattr(_progress.time, "monotonic", lambda: now_s)
    stages, said = _progress.Stages(), []
    monkeypatch.setattr(stages, "_say", said.append)
    ticks = iter([False, True])
    monkeypatch.setattr(stages._ended, "wait", lambda _: next(ticks))
    stages.reading("matching scans", 0.5)
    now_s = 160.0
    stages("search", 0.0)
    now_s = 170.0
    stages("fit", 0.25)
    now_s = 174.0
    stages._tick()
    assert said == ["fit, 74 s, 43 % done, about 26 s left"]


@pytest.mark.slow
def test_a_search_says_its_stage_and_the_share_done():
    """The share never falls, never reaches the end before it, and takes several values."""
    recordings = [str(FIXTURES / name) for name in ("mystery.mcap", "mystery_other.mcap")]
    *lines, verdict = on_a_terminal(
        100, "-m", "odomcorrupt", "learn", recordings[0], "--validate", recordings[1]
    ).split("\r\x1b[K")
    seconds = [int(found[1]) for line in lines if (found := re.search(r", (\d+) s\b", line))]
    shares = [int(found[1]) for line in lines if (found := re.search(r"(\d+) % done", line))]
    assert seconds == sorted(seconds)
    assert shares == sorted(shares)
    assert 0 < shares[0] < shares[-1] < 100
    assert len(set(shares)) >= 3
    # a stage that is shorter than a tick is not shown
    assert any(re.search(r"search: \w+", line) for line in lines)
    assert "MISSING" in verdict


def test_the_share_done_never_falls_and_stays_below_one_however_long_the_search():
    said = []
    begin = stages(lambda stage, share: said.append((stage, share)))
    for _ in range(40):
        begin("refits")
    assert said[0] == ("refits", 0.0)
    assert all(0.0 < later[1] - before[1] < 0.5 for before, later in pairwise(said))
    assert said[-1][1] < 1.0
