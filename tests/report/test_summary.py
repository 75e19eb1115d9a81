"""Summaries fit: at most eight lines of the width, the verdict first, the command last and whole."""

from __future__ import annotations

from itertools import product

import pytest

from odomcorrupt.summary import ALWAYS, FIRST, MOST_LINES, SPARE, Line, Summary, command_line, wrapped


@pytest.mark.parametrize(("count", "width", "words"), [*product((1, 7, 12), (40, 80), (3, 60))])
def test_it_fits_whatever_is_in_it(count, width, words):
    lines = [Line("VERDICT", "it is so"), *(Line(f"label {i}", "word " * words) for i in range(count))]
    text = Summary((*lines, command_line(["odomcorrupt", "info", "a.mcap"]))).text(width)
    rows = text.splitlines()
    assert len(rows) <= MOST_LINES
    assert max(map(len, rows)) <= width
    assert rows[0].split() == ["VERDICT", "it", "is", "so"]
    assert rows[-1].split()[-1] == "a.mcap"


def test_what_is_left_out_is_counted():
    lines = [Line(str(i), "finding") for i in range(20)]
    assert Summary(tuple(lines)).text().splitlines()[-1].strip() == "13 more lines: -v shows all"


def test_lines_of_less_weight_are_left_out_first_and_those_of_the_largest_never():
    lines = [
        Line("V", "v"), Line("doubtful", "d", weight=SPARE), *(Line("usual", "u") for _ in range(6)),
        Line("rejected", "r", weight=FIRST), Line("errors", "e " * 60, weight=ALWAYS, short="e"),
    ]  # fmt: skip
    shown = [row.split()[0] for row in Summary(tuple(lines)).text().splitlines()]
    assert shown == ["V", *["usual"] * 4, "rejected", "errors", "3"]
    few = [
        Line("V", "v"),
        Line("errors", "e " * 60, weight=ALWAYS, short="e"),
        *(Line("spare", "s", weight=SPARE),) * 9,
    ]
    assert Summary(tuple(few)).text().count("e e") == 30  # nothing but spare lines makes room
    tight = [Line("V", "v " * 100), few[1], Line("usual", "u"), command_line(["command"] * 20)]
    assert len(Summary(tuple(tight)).text().splitlines()) == MOST_LINES
    long = [Line("V", "v " * 200), Line("errors", "e", weight=ALWAYS)]
    assert Summary(tuple(long)).text().splitlines()[-1].split() == ["errors", "e"]


def test_a_long_command_can_be_pasted():
    words = ["odomcorrupt", "fit", *(f"/data/recordings/run_{i}.mcap" for i in range(6)), "--add", "wheelbase"]
    text = Summary((Line("V", "v"), command_line(words))).text()
    command = "\n".join(row[6:] for row in text.splitlines()[1:])
    assert command.replace("\\\n", "").split() == words


def test_labels_are_aligned_and_html_is_escaped():
    summary = Summary((Line("A", "<b>"), Line("longer", "text")))
    assert [row.index(word) for row, word in zip(summary.text().splitlines(), ("<b>", "text"), strict=True)] == [8, 8]
    assert "&lt;b&gt;" in summary.html()


def test_prose_is_wrapped_at_the_width_of_a_terminal_and_rows_of_tables_are_not():
    row = "model      " + "12.3   " * 12
    text = wrapped("\n".join(["  " + "some words " * 12, "", row]), 40).splitlines()
    assert text[-2:] == ["", row]
    assert len(text) > 4
    assert all(line.startswith("  ") and len(line) <= 40 for line in text[:-2])
