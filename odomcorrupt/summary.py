"""A result in at most eight aligned lines of 80 columns: the verdict first, the suggested next command last."""

from __future__ import annotations

import shlex
import textwrap
from typing import TYPE_CHECKING, Literal, NamedTuple

from odomcorrupt.standard_streams import visible

if TYPE_CHECKING:
    from collections.abc import Sequence

MOST_LINES = 8
"""Largest number of lines of a summary, so that it is read without scrolling."""
WIDTH = 80
"""Columns of a summary, if the terminal has as many."""

Tone = Literal["plain", "good", "warning", "bad", "command"]
"""Meaning of a line, for colours; a command is never shortened."""

_COLOURS = {"good": "\x1b[32m", "warning": "\x1b[33m", "bad": "\x1b[31m", "command": "\x1b[36m", "plain": "\x1b[1m"}
_RESET = "\x1b[0m"


class Line(NamedTuple):
    """A label and its text; the label may be empty below another one."""

    label: str
    text: str
    tone: Tone = "plain"


class Summary(NamedTuple):
    """Lines of a summary: the verdict is the first one, a command the last one.

    most : largest number of rows; a list of names is always printed completely
    """

    lines: tuple[Line, ...]
    most: int = MOST_LINES

    def text(self, width: int = WIDTH) -> str:
        """Return the summary within a width and at most `most` lines; a line notes any findings left out."""
        return "\n".join(part for part in self.parts(width) if part)

    def parts(self, width: int = WIDTH, *, colour: bool = False) -> tuple[str, str]:
        """Return the findings and the suggested next command, "" without one, together at most `most` lines.

        width : columns; a command is folded with backslashes, so that it can be pasted
        colour : whether labels have the ANSI colour of their tone
        """
        indent = max((len(line.label) for line in self._shown), default=0) + 2
        blocks = [(line, _folded(line.tone, visible(line.text), max(width - indent, 24))) for line in self._shown]
        findings: list[str] = []
        commands: list[str] = []
        for line, parts in _within(blocks, self.most):
            rows = commands if line.tone == "command" else findings
            for number, part in enumerate(parts):
                label = f"{line.label if not number else '':<{indent}}"
                if colour and not number and line.label:
                    label = f"{_COLOURS[line.tone]}{label}{_RESET}"
                rows.append(f"{label}{part}".rstrip())
        return "\n".join(findings), "\n".join(commands)

    def html(self) -> str:
        """Return the summary as a table for a notebook."""
        import html  # noqa: PLC0415 - needed by notebooks only

        rows = "".join(
            f"<tr><th style='text-align:left'>{html.escape(line.label)}</th>"
            f"<td style='text-align:left'>{html.escape(line.text)}</td></tr>"
            for line in self._shown
        )
        return f"<table>{rows}</table>"

    @property
    def _shown(self) -> list[Line]:
        return [line for line in self.lines if line.text or line.tone != "command"]

    @property
    def headline(self) -> str:
        """The verdict in one line, for a repr."""
        first = self.lines[0]
        return f"{first.label} {first.text}".strip()


def wrapped(text: str, width: int) -> str:
    """Return a text with its prose wrapped to this many columns; rows of tables are unchanged."""
    lines: list[str] = []
    for line in text.splitlines():
        start = line[: len(line) - len(line.lstrip())]
        is_row = "  " in line.strip()
        lines += (
            [line] if is_row else textwrap.wrap(line, width, subsequent_indent=start, break_on_hyphens=False) or [""]
        )
    return "\n".join(lines)


def _folded(tone: Tone, text: str, width: int) -> list[str]:
    if tone != "command":
        return textwrap.wrap(text, width) or [""]
    parts = textwrap.wrap(text, width - 2, break_long_words=False, break_on_hyphens=False)
    return [*(f"{part} \\" for part in parts[:-1]), parts[-1]]


def _within(blocks: Sequence[tuple[Line, list[str]]], most: int) -> list[tuple[Line, list[str]]]:
    """Keep the lines that fit into a number: the first line, the command at the end, and the others in order."""
    if sum(len(parts) for _, parts in blocks) <= most:
        return list(blocks)
    commands = [block for block in blocks if block[0].tone == "command"]
    others = [block for block in blocks if block[0].tone != "command"]
    room = most - sum(len(parts) for _, parts in commands) - 1
    kept = []
    for line, parts in others:
        if len(parts) > room:
            break
        kept.append((line, parts))
        room -= len(parts)
    left = len(others) - len(kept)
    more = Line("", f"{left} more {'line' if left == 1 else 'lines'}: -v shows all")
    return [*kept, (more, [more.text]), *commands]


def command_line(words: Sequence[object] | str) -> Line:
    """Return the line of the suggested next command, given as words or as a string; nothing is shown for ""."""
    return Line("next", words if isinstance(words, str) else shlex.join(map(str, words)), "command")
