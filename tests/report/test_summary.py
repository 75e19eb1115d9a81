"""Summaries fit: at most eight lines of the width, the verdict first, the command last and whole."""

import shlex
from itertools import product

import pytest

from odomcorrupt.summary import ALWAYS, FIRST, FOUND, MOST_LINES, SPARE, Line, Summary, command_line, wrapped


@pytest.mark.parametrize(("count", "width", "words"), [*product((1, 7, 12), (40, 80), (3, 60))])
def test_it_fits_whatever_is_in_it(count, width, words):
    lines = [Line("VERDICT", "it is so"), *(Line(f"label {i}", "word " * words) for i in range(count))]
    text = Summary((*lines, command_line(["odomcorrupt", "info", "a.mcap"]))).text(width)
    rows = text.splitlines()
    assert len(rows) <= MOST_LINES + ("more line" not in text)
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
    few = [Line("V", "v"), lines[-1], *(Line("spare", "s", weight=SPARE),) * 9]
    assert Summary(tuple(few)).text().count("e e") == 30  # nothing but spare lines makes room
    tight = [Line("V", "v " * 100), few[1], Line("usual", "u"), command_line(["command"] * 20)]
    assert len(Summary(tuple(tight)).text().splitlines()) == MOST_LINES
    long = [Line("V", "v " * 200), Line("errors", "e", weight=ALWAYS)]
    assert Summary(tuple(long)).text().splitlines()[-1].split() == ["errors", "e"]


def test_a_long_command_can_be_pasted():
    words = ["odomcorrupt", "fit", *(f"/data/recordings/run_{i}.mcap" for i in range(6)), "--fail-if", "lost > 0"]
    rows = Summary((Line("V", "v"), command_line(words))).text().splitlines()
    command = "\n".join(row[6:] for row in rows[1:])
    assert shlex.split(command.replace("\\\n", "")) == words


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


def test_parts_of_the_model_are_named_though_their_lines_are_left_out():
    parts = [Line("", f"part {i} " * 12, weight=FOUND if i < 3 else SPARE, part=f"part_{i}") for i in range(6)]
    text = Summary((Line("V", "v"), *parts, Line("errors", "e " * 60, weight=ALWAYS, short="e"))).text()
    rows = text.splitlines()
    assert len(rows) <= MOST_LINES
    assert "part 0" in text
    unseen = [line.part for line in parts if line.text.strip() not in " ".join(text.split())]
    assert unseen
    assert f"also {', '.join(unseen)}; {len(unseen)} more lines: -v shows all" in " ".join(text.split())
    assert "also" not in Summary((Line("V", "v"), *parts[:2])).text()


def test_what_was_identified_precedes_other_lines_and_names_take_no_room_from_warnings():
    wide = Line("or", "o " * 90, part="")
    found = Line("", "second effect", weight=FOUND, part="second_effect")
    lines = (Line("V", "v"), wide, wide, found, Line("rejected", "r " * 60, weight=FIRST), command_line(["go"]))
    assert "second effect" in Summary(lines).text()
    many = [Line("spare", "s", weight=SPARE, part=f"effect_number_{i}") for i in range(30)]
    tight = (Line("V", "v"), *(Line(f"warning {i}", "w", weight=FIRST) for i in range(6)), *many)
    rows = Summary(tight).text().splitlines()
    assert rows[-1].strip() == "30 more lines, 30 of them with parts of the model: -v shows all"
    assert len(rows) == MOST_LINES


def test_a_long_command_does_not_take_the_place_of_what_has_to_be_said_first():
    command = Line("next", " ".join(["command"] * 60), "command")
    lines = (Line("COMPLETE", "the model is complete"), Line("outliers", "two stretches " * 6, weight=FIRST), command)
    more = (Line("clock", "late"), *[Line("rate", "50 Hz")] * 2)
    text = Summary((*lines[:2], Line("errors", "10 s error", weight=ALWAYS), *more, command)).text()
    assert "outliers" in text
    assert "errors" in text
    assert "clock" not in text
    assert "3 more lines: -v shows all" in text
    # one line alone is not only mentioned
    text = Summary((*lines[:2], Line("errors", "10 s error", weight=ALWAYS), more[0], command)).text()
    assert "clock" in text
    assert "more line" not in text
