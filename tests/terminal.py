"""A pseudo-terminal for commands that behave otherwise on one."""

import contextlib
import os
import pty
import subprocess
import sys
import termios


def on_a_terminal(columns, *words):
    """Return what Python writes to a terminal of so many columns; it ends well within a minute."""
    master, slave = pty.openpty()
    termios.tcsetwinsize(slave, (24, columns))
    process = subprocess.Popen(
        [sys.executable, *words],
        **dict.fromkeys(("stdin", "stdout", "stderr"), slave),
        env={name: value for name, value in os.environ.items() if name != "COLUMNS"},
    )
    os.close(slave)
    said = b""
    with contextlib.suppress(OSError):
        while piece := os.read(master, 65536):
            said += piece
    os.close(master)
    assert process.wait(60) == 0
    return said.decode()
