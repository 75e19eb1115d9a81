"""One thread of linear algebra a process, as the command line sets it.

Tests run side by side, a worker a core, and threads of OpenBLAS spin while they wait for a core: a decomposition that
takes milliseconds then takes minutes. The variable has to be there before numpy is imported; workers inherit it.
"""

import os
import signal
import subprocess
import sys

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import pytest

from recordings import RECORDINGS


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Skip a test that needs the recordings of others where they are absent."""
    if item.get_closest_marker("recordings") and not RECORDINGS.is_dir():
        pytest.skip(f"no recordings of others in {RECORDINGS}")


@pytest.fixture
def interruptible():
    """Hear SIGINT and SIGHUP, which a shell's background jobs and those of nohup, and all that they begin, ignore."""
    before = [
        signal.signal(*one) for one in ((signal.SIGINT, signal.default_int_handler), (signal.SIGHUP, signal.SIG_DFL))
    ]
    yield
    for number, handler in zip((signal.SIGINT, signal.SIGHUP), before, strict=True):
        signal.signal(number, handler)


@pytest.fixture
def invoke(capsys):
    """Return a function of a command line: what it prints on stdout and stderr; it has to end with the given code."""
    from odomcorrupt.cli import run

    def call(words, code=0):
        capsys.readouterr()
        ended, printed = run([*map(str, words)]), capsys.readouterr()
        assert ended == code, printed
        return printed

    return call


@pytest.fixture
def dead():
    """Return the number of a process that is no more."""
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()
    return process.pid
