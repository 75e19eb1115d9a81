"""Standard streams that may be closed, full, or disconnected from their reader.

Text for people is printed through `TextStream`. Names of topics and frames are untrusted, so control characters in
them are escaped. The first failure to print is recorded and later text is dropped, so that a file written by the
command is still completed; `leave` then ends the program as `cat` would.
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

_ERASE = "\r\x1b[K"
"""Prefix of a progress line, printed unescaped."""
_CONTROLS = re.compile("[\x00-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069]")
"""C0, C1, separators, and characters that change the direction of writing."""
_COLOUR = r"\x1b\[(?:0|1|3[1236])m"
"""Colour codes of a summary, printed unescaped; text between them is escaped before it is coloured."""
_CONTROLS_IN_TEXT = re.compile(f"(?![\n\t])(?!{_COLOUR}){_CONTROLS.pattern}")


def visible(text: str) -> str:
    r"""Return a name with its control characters escaped, as in "\x1b"; line breaks, too."""
    return _CONTROLS.sub(_escaped, text)


def _escaped(found: re.Match[str]) -> str:
    return found[0].encode("unicode_escape").decode()


class TextStream(io.TextIOWrapper):
    """Text output for people, with control characters escaped.

    failure : error of the first failure to print, None before it
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
        """Print buffered text."""
        if self.failure is None:
            try:
                super().flush()
            except OSError as error:
                self.failure = error


def install() -> None:
    """Replace stdout and stderr by text streams, and open substitutes for closed streams.

    Otherwise the next file opened would get the number of a closed stream, and printed text would end up in a bag.
    """
    for number, mode in enumerate((os.O_WRONLY, os.O_RDONLY, os.O_WRONLY)):
        try:
            os.fstat(number)
        except OSError:
            # stdin and stdout then fail on use, stderr does not
            opened = os.open(os.devnull, mode)
            if opened != number:
                os.dup2(opened, number)
                os.close(opened)
    if sys.stdin is None:
        sys.stdin = io.TextIOWrapper(io.BufferedReader(io.FileIO(0, closefd=False)))
    # shutil.get_terminal_size queries sys.__stdout__ for the width
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
    """Flush and exit: with 1 if stdout could not take all output, or by SIGPIPE as `cat` does."""
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
    # otherwise the interpreter would report unwritten buffers of a failed stream at its end
    unused = os.open(os.devnull, os.O_WRONLY)
    for number in (1, 2):
        os.dup2(unused, number)
    sys.exit(code)
