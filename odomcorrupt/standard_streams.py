"""stdin, stdout and stderr of a program that may be closed, full, or read by nobody any more.

What is printed for people goes through `TextStream`: names of topics and frames are a stranger's, so control
characters in them are shown escaped. The first failure to print is kept and what follows is dropped, so that a file
which a command writes beside its words is written all the same; `leave` then ends the program as `cat` would.
"""

from __future__ import annotations

import errno
import io
import os
import re
import signal
import sys
from contextlib import suppress
from typing import BinaryIO, NoReturn

__all__ = ["TextStream", "install", "leave", "visible"]

_ERASE = "\r\x1b[K"
"""What a line of progress begins with; it stays as it is."""
_CONTROLS = re.compile("[\x00-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069]")
"""C0, C1, separators, and what turns the direction of writing."""
_COLOUR = r"\x1b\[(?:0|1|3[1236])m"
"""The colours of a summary; text within them is escaped before it is coloured."""
_CONTROLS_IN_TEXT = re.compile(f"(?![\n\t])(?!{_COLOUR}){_CONTROLS.pattern}")


def visible(text: str) -> str:
    r"""Return a name with its control characters escaped, as in "\x1b"; line breaks, too."""
    return _CONTROLS.sub(_escaped, text)


def _escaped(found: re.Match[str]) -> str:
    return found[0].encode("unicode_escape").decode()


class TextStream(io.TextIOWrapper):
    """Text for people.

    failure : why no more can be printed, None as long as it can
    """

    failure: OSError | None = None

    def write(self, text: str) -> int:
        """Print text with its control characters escaped, but for line breaks, tabs and the colours of summaries."""
        erase = _ERASE if text.startswith(_ERASE) else ""
        if self.failure is None:
            try:
                super().write(erase + _CONTROLS_IN_TEXT.sub(_escaped, text[len(erase) :]))
            except OSError as error:
                self.failure = error
        return len(text)

    def flush(self) -> None:
        """Print what was held back."""
        if self.failure is None:
            try:
                super().flush()
            except OSError as error:
                self.failure = error


def install() -> None:
    """Put text streams in the place of stdout and stderr, and something in that of those that are closed.

    Without it the next file that is opened would get their numbers: what is printed would end up in a bag.
    """
    for number, mode in enumerate((os.O_WRONLY, os.O_RDONLY, os.O_WRONLY)):
        try:
            os.fstat(number)
        except OSError:
            # stdin and stdout fail when they are used, stderr does not
            opened = os.open(os.devnull, mode)
            if opened != number:
                os.dup2(opened, number)
                os.close(opened)
    if sys.stdin is None:
        sys.stdin = io.TextIOWrapper(io.BufferedReader(io.FileIO(0, closefd=False)))
    # shutil.get_terminal_size asks sys.__stdout__ for the width
    sys.stdout = sys.__stdout__ = _text_stream(sys.stdout, 1)  # type: ignore[misc]
    sys.stderr = _text_stream(sys.stderr, 2)


def _text_stream(stream: object, number: int) -> TextStream:
    if not isinstance(stream, io.TextIOWrapper):
        return TextStream(io.BufferedWriter(io.FileIO(number, "w", closefd=False)), "utf8", "backslashreplace")
    encoding = "utf8" if "ascii" in stream.encoding.lower() or "646" in stream.encoding else stream.encoding
    lines, through = stream.line_buffering, stream.write_through
    buffer: BinaryIO = stream.detach()
    return TextStream(buffer, encoding, "backslashreplace", line_buffering=lines, write_through=through)


def leave(code: int) -> NoReturn:
    """End the program: printed out, and where stdout could not take it all with 1, or by SIGPIPE as `cat` ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):
            stream.flush()
    failure = getattr(sys.stdout, "failure", None)
    if code == 128 + signal.SIGPIPE or (failure is not None and failure.errno == errno.EPIPE):
        signal.signal(signal.SIGPIPE, signal.SIG_DFL)
        os.kill(os.getpid(), signal.SIGPIPE)
    if failure is not None and code == 0:
        code = 1
        sys.stderr.write(f"odomcorrupt: stdout: cannot be written: {failure.strerror}\n")
        sys.stderr.flush()
    # what the buffers of a stream still hold that takes no more would be complained about at the interpreter's end
    unused = os.open(os.devnull, os.O_WRONLY)
    for number in (1, 2):
        os.dup2(unused, number)
    sys.exit(code)
