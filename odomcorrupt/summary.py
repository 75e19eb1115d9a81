"""A result in at most eight aligned lines of 80 columns: the verdict first, the suggested next command last."""

from __future__ import annotations

import re
import shlex
import textwrap
from typing import TYPE_CHECKING, Literal, NamedTuple

from odomcorrupt.standard_streams import visible

if TYPE_CHECKING:
    from collections.abc import Container, Sequence

MOST_LINES = 8
"""Lines of a summary, read without scrolling; one more if it is the only one left, others before a long command."""
_COMMAND_LINES = 2  # of a long command that count
WIDTH = 80
"""Columns of a summary, if the terminal has as many."""

Tone = Literal["plain", "good", "warning", "bad", "command"]
"""Meaning of a line, for colours; a command is never shortened."""

_COLOURS = {"good": "\x1b[32m", "warning": "\x1b[33m", "bad": "\x1b[31m", "command": "\x1b[36m", "plain": "\x1b[1m"}
_RESET = "\x1b[0m"

ALWAYS, FIRST, FOUND, USUAL, SPARE = 4, 3, 2, 1, 0
"""Weights of lines: those of less weight are left out first, and those of weight ALWAYS never. FOUND is the weight of
what was identified and is in the model."""


class Line(NamedTuple):
    """A label and its text; the label may be empty below another one.

    weight : see `ALWAYS`; lines of equal weight are left out from the end
    short : text in place of one for which there is no room, "" for none
    part : name of a part of the model that is printed if there is no room for the line, "" for none
    full : text in its place in the full report, "" for the same; a line without `text` is only there
    """

    label: str
    text: str
    tone: Tone = "plain"
    weight: int = USUAL
    short: str = ""
    part: str = ""
    full: str = ""


class Summary(NamedTuple):
    """Lines of a summary: the verdict is the first one, a command the last one.

    most : largest number of rows; a list of names is always printed completely
    """

    lines: tuple[Line, ...]
    most: int = MOST_LINES

    def text(self, width: int = WIDTH) -> str:
        """Return the summary within a width and `most` lines, or one more; a line counts the findings left out."""
        return "\n".join(part for part in self.parts(width) if part)

    def parts(self, width: int = WIDTH, *, colour: bool = False) -> tuple[str, str]:
        """Return the findings and the suggested next command, "" without one, together at most `most` lines.

        width : columns; a command is folded with backslashes, so that it can be pasted
        colour : whether labels have the ANSI colour of their tone
        """
        indent = max((len(line.label) for line in self._shown), default=0) + 2
        findings: list[str] = []
        commands: list[str] = []
        for line, parts in _within(self._shown, max(width - indent, 24), self.most):
            rows = commands if line.tone == "command" else findings
            for number, part in enumerate(parts):
                label = f"{line.label if not number else '':<{indent}}"
                if colour and not number and line.label:
                    label = f"{_COLOURS[line.tone]}{label}{_RESET}"
                rows.append(f"{label}{part}".rstrip())
        return "\n".join(findings), "\n".join(commands)

    def full(self) -> str:
        """Return all lines but the command with their full texts, a row each."""
        lines = [line for line in self.lines if line.tone != "command"]
        indent = max((len(line.label) for line in lines), default=0) + 2
        return "\n".join(f"{line.label:<{indent}}{visible(line.full or line.text)}".rstrip() for line in lines)

    def below(self, report: str) -> Summary:
        """Return what ends a full report: the verdict and what has to be said first, if not in it; the next command."""
        first, *others = self.lines if self.lines[0].tone != "plain" else [Line("", "")]  # a list has no verdict
        said = [one for one in (first, *others) if one is first or one.tone == "command" or one.weight >= FIRST]
        new = (one for one in said if one.tone == "command" or one.text.split(" (")[0] not in report)
        return Summary(tuple(new), len(report))

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
        return [line for line in self.lines if line.text or not (line.full or line.tone == "command")]


def aligned(rows: Sequence[Sequence[str]], right: Container[int]) -> list[str]:
    """Return rows of a table with their columns aligned, to the right those whose numbers are given."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    sides = [">" if i in right else "<" for i in range(len(widths))]
    cells = ([f"{c:{side}{w}}" for c, side, w in zip(row, sides, widths, strict=True)] for row in rows)
    return ["  ".join(row).rstrip() for row in cells]


def wrapped(text: str, width: int) -> str:
    """Return a text with its prose wrapped to this many columns, beside its label; rows of tables are unchanged."""
    lines: list[str] = []
    for line in text.splitlines():
        label = re.match(r"\S+(?: \S+)* {2,}|\s*", line)[0]  # type: ignore[index]  # it matches at least nothing
        prose = textwrap.wrap(line, width, subsequent_indent=" " * len(label), break_on_hyphens=False)
        lines += [line] if "  " in line[len(label) :] else prose or [""]
    return "\n".join(lines)


def _folded(tone: Tone, text: str, width: int) -> list[str]:
    if tone != "command":  # an option is not divided
        return textwrap.wrap(text, width, break_on_hyphens="--" not in text) or [""]
    quoted = re.sub(r"'[^']*'", lambda word: word[0].replace(" ", "\0"), text)
    parts = textwrap.wrap(quoted, width - 2, break_long_words=False, break_on_hyphens=False)
    return " \\\n".join(parts).replace("\0", " ").split("\n")


_Block = tuple[Line, list[str]]


def _within(lines: Sequence[Line], width: int, most: int) -> list[_Block]:
    """Return the lines that fit into a number of rows, folded: the first line, the command, others by their weight.

    All of them have one row more, which is better than a mention of one line.
    """
    blocks = [(line, _folded(line.tone, visible(line.text), width)) for line in lines]
    if _rows(blocks) <= most:
        return blocks
    commands = [block for block in blocks if block[0].tone == "command"]
    others = [block for block in blocks if block[0].tone != "command"]
    shorter = [(line, _folded(line.tone, visible(line.short or line.text), width)) for line, _ in others]
    first = _rows([one for i, one in enumerate(shorter) if not i or one[0].weight >= FIRST]) + 1
    room = max(most - _rows(commands), min(first, most - _COMMAND_LINES))
    if _rows(shorter) <= room + 1:
        return [*shorter, *commands]
    most_kept: list[_Block] = []
    for rows in range(1, room + 1):
        # a text is only shortened where the rows do not suffice, or another line that is not spare gets a place
        choices = [_heaviest(blocks, room - rows) for blocks in (others, shorter)]
        kept = max(choices, key=lambda kept: (_rows(kept) <= room - rows, sum(line.weight > SPARE for line, _ in kept)))
        most_kept = most_kept or kept
        # names never take the place of what has to be said first
        if sum(line.weight >= FIRST for line, _ in kept) < sum(line.weight >= FIRST for line, _ in most_kept):
            break
        more = _folded("plain", visible(_rest(others, kept)), width)
        if len(more) <= rows:
            return [*kept, (Line("", " ".join(more)), more), *commands]
    more = _folded("plain", _rest(others, most_kept, named=False), width)
    return [*most_kept, (Line("", " ".join(more)), more), *commands]


def _rows(blocks: Sequence[_Block]) -> int:
    return sum(len(parts) for _, parts in blocks)


def _rest(blocks: Sequence[_Block], kept: Sequence[_Block], *, named: bool = True) -> str:
    """Return the text in place of lines that were not kept: their number, and the parts of the model in them.

    named : whether the parts are named, not only counted
    """
    left = len(blocks) - len(kept)
    more = f"{left} more {'line' if left == 1 else 'lines'}"
    parts = [line.part for line, _ in blocks if line.part and all(line is not one for one, _ in kept)]
    if parts and not named:
        more += f", {len(parts)} of them with parts of the model"
    more += ": -v shows all"
    return f"also {', '.join(parts)}; {more}" if parts and named else more


def _heaviest(blocks: Sequence[_Block], room: int) -> list[_Block]:
    """Return the first block and those of the largest weight that fit into this number of rows, in their order."""
    kept = []
    for i in sorted(range(len(blocks)), key=lambda i: (i > 0, -blocks[i][0].weight)):
        line, parts = blocks[i]
        if i and line.weight < ALWAYS and len(parts) > room:
            break
        kept.append(i)
        room -= len(parts)
    return [blocks[i] for i in sorted(kept)]


def command_line(words: Sequence[object] | str) -> Line:
    """Return the line of the suggested next command, given as words or as a string; nothing is shown for ""."""
    return Line("next", words if isinstance(words, str) else shlex.join(map(str, words)), "command")
