"""Pages, with a browser, their interactive part, summaries and the texts of `compare`."""

import base64
import json
import re
import shlex
from dataclasses import replace
from hashlib import sha256
from html import unescape
from html.parser import HTMLParser
from itertools import product

import numpy as np
import pytest
from matplotlib.image import imread
from scipy.stats import chi2

from odomcorrupt.api.findings import Comparison
from odomcorrupt.cli import run
from odomcorrupt.effects import effect_from_values
from odomcorrupt.effects.expression import user_effect
from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.report.comparison import MOST, comparison_brief, evaluation_sentence, sentence
from odomcorrupt.report.findings import noise_text
from odomcorrupt.report.html import prose, report_html
from odomcorrupt.report.plain import finite
from odomcorrupt.report.plots.comparison import PICTURES, draw_errors, rms_interval
from odomcorrupt.report.plots.paths import draw_paths
from odomcorrupt.study.validate.compare import compare
from odomcorrupt.summary import ALWAYS, FIRST, FOUND, MOST_LINES, SPARE, Line, Summary, command_line, wrapped

VOID = {"meta", "img", "link", "br", "hr"}


class Balanced(HTMLParser):
    def __init__(self):
        super().__init__()
        self.open, self.tags, self.sources = [], [], []

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.sources += [value for key, value in attrs if key in {"src", "href"}]
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def parsed_page(page):
    """Return a page's tags and sources; it is whole, small, and asks for nothing but itself."""
    parsed = Balanced()
    parsed.feed(page)
    assert not parsed.open
    assert len(page.encode()) <= 3_000_000
    assert all(source.startswith("data:") for source in parsed.sources)
    return parsed


def test_a_rejection_without_a_direction_names_the_failed_test(comparison):
    base = replace(comparison.evaluations[0], failures=())
    assert base.verdict.fails

    def reason(evaluation):
        lines = comparison_brief(replace(comparison, evaluations=(evaluation,))).lines
        (found,) = [line.text for line in lines if line.label == "fails"]
        return found

    sized = next(check for check in base.verdict.checks if "NEES" in check.question)
    path = re.search(r"over (\S+ m) of path", sized.question)[1]
    said = reason(replace(base, verdict=replace(base.verdict, checks=(replace(sized, p=1e-4),))))
    assert re.fullmatch(
        rf"errors over {path} of path are \S+ times .* \(NEES \S+, by chance \S+ to \S+; \d+ windows\)", said
    )
    drawn = next(check for check in base.verdict.checks if "PIT" in check.question)
    said = reason(replace(base, verdict=replace(base.verdict, checks=(replace(drawn, p=2e-3), sized))))
    assert said.startswith(f"{drawn.question}: p 0.002, below the 0.025")


def test_the_page_is_whole_small_and_needs_nothing_but_itself(page):
    parsed = parsed_page(page)
    assert "@import" not in page
    assert "url(" not in page
    assert "@media print" in page
    assert parsed.tags.count("img") == len(PICTURES)
    # one script, admitted by its hash, and one block of data
    assert parsed.tags.count("script") == 2
    script = re.search(r"<script>(.*?)</script>", page, re.DOTALL).group(1)
    assert f"sha256-{base64.b64encode(sha256(script.encode()).digest()).decode()}" in page


def test_pictures_in_the_page_load_nothing_either(page):
    for kind, data in re.findall(r'src="data:image/([a-z+]+);base64,([^"]+)"', page):
        raw = base64.b64decode(data)
        if kind == "svg+xml":
            links = re.findall(r'href="([^"]{0,20})', raw.decode())
            assert all(link.startswith(("#", "data:")) for link in links)
        else:
            assert raw.startswith(b"\x89PNG")


def test_the_page_says_what_the_terminal_and_the_json_say(page, comparison):
    text = unescape(page)
    for evaluation in comparison.evaluations:
        assert evaluation_sentence(evaluation) in text
        for failure in evaluation.failures[:MOST]:
            assert sentence(failure) in text
    printed = [f["sentence"] for model in Comparison(comparison).to_dict()["models"] for f in model["fails"][:MOST]]
    assert printed
    assert all(s in text for s in printed)
    json.dumps(Comparison(comparison).to_dict(), allow_nan=False)


def test_the_cause_is_seen_in_the_first_model_and_gone_in_the_second(comparison):
    base, robot = comparison.evaluations
    assert base.verdict.rejected
    assert any(f.channel == "yaw" and f.kind == "motion" for f in base.failures)
    assert not any(f.kind in {"motion", "drift"} and f.channel == "yaw" for f in robot.failures)
    assert robot.ten_second_error_m < 0.6 * base.ten_second_error_m
    assert robot.nats.gain_per_m > 2.0 * robot.nats.gain_error
    assert robot.trajectory.ate_m < 0.3 * base.trajectory.ate_m


def test_a_model_that_no_odometry_obeys_has_a_panel_that_says_so(comparison):
    base, robot = comparison.evaluations
    swallows = user_effect("swallows", "along += -3 * v * abs(v)", {})
    pieces = tuple(replace(p, model=replace(p.model, effects=(swallows,))) for p in robot.pieces)
    figure = draw_paths(replace(comparison, evaluations=(base, replace(robot, pieces=pieces))))
    titles = [axes.get_title(loc="left") for axes in figure.axes]
    assert "no odometry of this drive satisfies it" in titles[1]
    assert "90 % region" in titles[0]


@pytest.mark.slow
def test_the_page_and_every_picture_in_it_are_the_same_every_time(page, comparison):
    assert report_html(comparison) == page
    assert all(len(data) < 1_000_000 for data in re.findall(r'src="data:image/[a-z+]+;base64,([^"]+)"', page))


@pytest.mark.slow
def test_a_truth_of_positions_alone_gets_its_page_without_a_word_on_yaw(case, base_model):
    blind = case.recording.truth.xyt.copy()
    blind[:, 2] = np.nan
    truth = Trajectory(case.recording.truth.stamps_ns[::10], blind[::10])
    found = compare([replace(case.recording, truth=truth)], {"base.toml": base_model})
    assert np.isfinite(found.raw_error_m)
    evaluation = found.evaluations[0]
    assert set(evaluation.pits) == {"along", "across"}
    assert not any(f.channel == "yaw" for f in evaluation.failures)
    assert np.isnan(evaluation.horizons[0].measured[2])
    assert (
        json.loads(json.dumps(Comparison(found).to_dict(), allow_nan=False))["models"][0]["trajectory"]["rpe_1m_rmse_m"]
        is None
    )
    page = report_html(found)
    assert "positions only" in page
    shown = re.sub(r"<script.*?</script>", "", page, flags=re.DOTALL)
    assert "nan" not in unescape(re.sub(r'src="[^"]*"', "", shown)).lower().split()


@pytest.mark.slow
def test_a_real_browser_shows_the_page_without_complaint_and_without_a_network(page, tab, tmp_path):
    # a page that does what ours must not: what is looked for can be seen
    (tmp_path / "bad.html").write_text("<img src='http://127.0.0.1:9/x.png'><script>console.error('heard')</script>")
    tab.show(tmp_path / "bad.html", 1150)
    assert any("heard" in line for line in tab.complaints)
    assert tab.asked == ["http://127.0.0.1:9/x.png"]
    (tmp_path / "report.html").write_text(page)
    # words, tables and six pictures fill most of a long page
    assert shown(tab, tmp_path / "report.html") > 2500


def shown(tab, page):
    """Return how many rows of pixels of a page are not empty; it neither complains nor asks for anything."""
    tab.show(page, 1150, 6000)
    assert (tab.complaints, tab.asked) == ([], [])
    tab.screenshot(page.with_suffix(".png"))
    return (np.mean(imread(page.with_suffix(".png"))[:, :, :3] < 0.95, axis=(1, 2)) > 0.0).sum()


@pytest.mark.parametrize(("channel", "said"), [("along", "sigma 4 %"), ("wheels", "sigma 2.292 deg/m")])
def test_a_difference_of_the_wheels_gains_is_a_turn_for_each_metre(channel, said):
    effect = effect_from_values("gauss_markov", {"sigma": 0.04, "tau": 5.0, "channel": channel})
    assert noise_text(effect) == [said, "tau 5 s"]


def test_what_is_not_finite_becomes_null_at_any_depth_and_numpy_becomes_plain():
    printed = {
        "log_p": -np.inf,
        "rows": [(1.5, float("nan")), {"size": np.float64("inf"), "count": np.int64(3), "kept": np.bool_(True)}],
        "curve": np.array([[0.5, np.nan], [np.inf, 2.0]]),
        "name": "slip",
        "none": None,
    }
    assert json.loads(json.dumps(finite(printed), allow_nan=False)) == {
        "log_p": None,
        "rows": [[1.5, None], {"size": None, "count": 3, "kept": True}],
        "curve": [[0.5, None], [None, 2.0]],
        "name": "slip",
        "none": None,
    }


@pytest.fixture
def compared(invoke, case):
    """Return a function of what follows the bag of the case: what `compare` prints; see `invoke`."""
    return lambda *more, code=0: invoke(["compare", case.bag, *more], code)


def test_it_prints_horizons_verdicts_and_sentences(case, compared):
    out = compared("-v", case.base, case.robot).out
    said = ("NEES", "base.toml is rejected", "the odometry turns too far left", "nats/m", "RPE over 1 m", "Signs")
    assert [words for words in said if words not in out] == []


def test_a_preset_is_a_model_of_compare_diagnose_and_fit(case, compared):
    said = compared("bad").out
    assert said.replace("\\\n", " ").split()[-3:] in (
        ["noisy.bag", "--preset", "bad"],
        ["diagnose", str(case.bag), "bad"],
    )
    assert run(["diagnose", str(case.bag), "bad", "-q"]) == 0
    assert run(["fit", str(case.bag), "--start", "bad", "-q"]) == 0


def test_json_has_the_numbers_behind_and_a_rejected_model_fails_where_that_is_asked_for(case, compared):
    model = json.loads(compared(case.base, "--json", "--fail-if-rejected", code=4).out)["models"][0]
    assert model["verdict"]["rejected"] is True
    assert model["verdict"]["threshold"] == pytest.approx(model["verdict"]["level"] / len(model["verdict"]["checks"]))
    assert [h["distance_m"] for h in model["horizons"]][:4] == [1.0, 2.0, 5.0, 10.0]
    first = model["horizons"][0]
    assert set(first["coverage_50"]) == {"along", "across", "yaw"}
    assert first["crps"]["yaw_rad"] > 0.0
    grows = next(f for f in model["fails"] if f["kind"] == "motion")
    assert (grows["channel"], grows["unit"]) == ("yaw", "rad/m")
    assert grows["measured"] > grows["expected"] > 0.0


@pytest.mark.slow
def test_report_and_pictures_are_written_once(case, tmp_path, compared):
    report, error, where = tmp_path / "out.html", tmp_path / "error.png", tmp_path / "map.svg"
    compared(case.robot, "--report", report, "--plot", error, "--plot", f"map={where}")
    assert report.read_text().startswith("<!DOCTYPE html>")
    assert error.read_bytes().startswith(b"\x89PNG")
    assert b"<svg" in where.read_bytes()[:1000]
    before = report.stat().st_mtime_ns
    for again in (("--report", report), ("--plot", f"nees={error}")):
        assert "--overwrite" in compared(case.robot, *again, code=1).err
    assert report.stat().st_mtime_ns == before
    compared(case.robot, "--plot", error, "--overwrite", "--fail-if-rejected")


@pytest.mark.parametrize(
    ("plots", "words"),
    [
        (["cloud=a.png"], "there are error, path"),
        (["error=a.bmp"], "a.bmp: ends in .bmp; write .png"),
        (["a"], "a: ends in nothing; write .png"),
        (["a.png", "nees=a.png"], "another picture"),
    ],
)
def test_a_picture_that_is_not_there_is_named_and_two_do_not_share_a_file(
    case, tmp_path, compared, monkeypatch, plots, words
):
    monkeypatch.chdir(tmp_path)
    assert words in compared(case.robot, *(word for plot in plots for word in ("--plot", plot)), code=2).err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("name", "word"), [("base", "diagnose"), ("robot", "sim.bag")])
def test_a_verdict_ends_with_what_to_type_next(case, compared, name, word):
    """A rejected model is to be diagnosed, and one that holds to be used."""
    lines = compared(getattr(case, name)).out.splitlines()
    (first,) = [i for i, line in enumerate(lines) if line.startswith("next")]
    assert lines[first].split()[:3] == ["next", "odomcorrupt", word]
    assert lines[-1].split()[-1] == str(getattr(case, name))


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


@pytest.fixture(scope="module")
def data(page):
    return json.loads(re.search(r'id="explorer-data">(.*?)</script>', page, re.DOTALL).group(1))


@pytest.mark.slow
def test_path_and_residuals_are_those_of_the_recording(data, comparison):
    (piece,), (shown,) = comparison.evaluations[0].pieces, data["pieces"]
    intervals = piece.problem.intervals
    at = np.searchsorted(intervals.start_s, np.array(shown["t"]) - 0.006)
    truth = np.column_stack([shown["truth"][k] for k in ("x", "y", "yaw")])
    np.testing.assert_allclose(truth, intervals.truth_xyt[at], atol=1e-3)
    assert shown["measured"]["x"][0] == shown["truth"]["x"][0]
    for evaluation, model in zip(comparison.evaluations, data["models"], strict=True):
        own = evaluation.pieces[0]
        summed = np.concatenate(([0.0], np.cumsum(own.problem.intervals.residual[:, 2])))[at]
        np.testing.assert_allclose(model["pieces"][0]["residuals"][2], np.degrees(summed), atol=2e-3)
        worst = np.sqrt(np.mean(own.innovations.reshape(-1, 3) ** 2, axis=1)).max()
        assert max(model["pieces"][0]["residuals"][3]) == pytest.approx(worst, abs=0.01)
    off = [np.abs(model["pieces"][0]["residuals"][2]).max() for model in data["models"]]
    assert off[1] < 0.3 * off[0]  # the second model knows the cause


def test_sentence_marks_the_part_of_the_drive_that_it_names(data, comparison):
    piece = comparison.evaluations[0].pieces[0]
    failures = comparison.evaluations[0].failures
    turning = next(i for i, f in enumerate(failures) if f.kind == "motion")
    spans = data["models"][0]["failures"][turning]["spans"]
    w = np.array(data["pieces"][0]["w"])
    marked = np.concatenate([np.arange(a, b + 1) for _, a, b in spans])
    assert len(marked) < len(w)
    where = failures[turning].where
    if "left" in where or "right" in where:
        assert np.mean(np.sign(w[marked]) == (1.0 if "left" in where else -1.0)) > 0.95
    assert piece.recording.name in comparison.recordings[0]


def test_interval_of_a_measured_value_holds_the_true_one_nine_times_of_ten():
    rng = np.random.default_rng(2)
    for windows in (3, 30):
        measured = np.sqrt(np.mean(rng.standard_normal((2000, windows)) ** 2, axis=1))
        inside = [low <= 1.0 <= high for low, high in (rms_interval(float(m), windows) for m in measured)]
        assert np.mean(inside) == pytest.approx(0.9, abs=0.03)
    low, high = rms_interval(2.0, 3)
    assert (low, high) == (
        pytest.approx(2.0 * np.sqrt(3 / chi2.ppf(0.95, 3))),
        pytest.approx(2.0 * np.sqrt(3 / chi2.ppf(0.05, 3))),
    )


def test_code_between_backticks_and_nothing_else_is_marked_up():
    assert prose("`--drive <a>` writes") == "<code>--drive &lt;a&gt;</code> writes"
    assert prose("one ` alone") == "one ` alone"


@pytest.mark.slow
def test_every_panel_has_tick_labels_and_models_without_one_are_named(comparison):
    base, robot = comparison.evaluations
    five = replace(comparison, evaluations=(base, *(replace(robot, name=f"{n}.toml") for n in "bcde")))
    figure = draw_paths(five)
    assert [panel.get_title(loc="left").split("\n")[0] for panel in figure.axes] == [
        "base.toml",
        "c.toml",
        "d.toml",
        "e.toml",
    ]
    assert figure.get_supxlabel() == "not drawn: b.toml"
    for panel in figure.axes:
        ticks = panel.xaxis.get_tick_params(which="major"), panel.yaxis.get_tick_params(which="major")
        assert (ticks[0]["labelbottom"], ticks[1]["labelleft"]) == (True, True)
    three = replace(comparison, evaluations=(base, robot, replace(robot, name="a/very/long/name/of/a/model/file.toml")))
    assert len(draw_paths(three).axes) == 3
    assert draw_paths(three).get_supxlabel() == ""
    names = [text.get_text() for text in draw_errors(three).subfigs[0].legends[0].get_texts()]
    assert any("…" in name and len(name) < 40 for name in names)


@pytest.mark.slow
def test_real_browser_shows_and_works_the_page_at_every_width(page, comparison, case, base_model, tab, tmp_path):
    long = "a_recording_with_a_name_that_has_no_place_to_break_020120212354_run1_of_many_more.mcap"
    two = [case.recording, replace(case.recording, name=long)]
    found = compare(two, {"base.toml": base_model, long: base_model, "c": base_model})
    (tmp_path / "long.html").write_text(report_html(found))
    (tmp_path / "page.html").write_text(page)
    for name, width, phone, dark in (
        ("page", 1280, False, False), ("page", 1280, False, True), ("page", 390, True, False),
        ("long", 360, True, True),
    ):  # fmt: skip
        tab.show(tmp_path / f"{name}.html", width, phone=phone, dark=dark)
        assert tab.run("document.documentElement.scrollWidth") <= width, (name, width)
        assert tab.run("document.querySelectorAll('#plane path').length") > 20
        assert tab.run("getComputedStyle(document.body).backgroundColor === 'rgb(255, 255, 255)'") is not dark
        assert tab.complaints == []
        tab.screenshot(tmp_path / f"{name}_{width}.png")
        assert imread(tmp_path / f"{name}_{width}.png").shape[1] == width
    tab.show(tmp_path / "page.html", 1280)
    drawn = tab.run("document.querySelectorAll('#plane path.run').length")
    tab.run("document.querySelectorAll('.controls input')[0].click()")
    assert 0 < tab.run("document.querySelectorAll('#plane path.run').length") < drawn
    assert tab.run("document.querySelector('[data-model=\"0\"]').hidden") is True
    assert tab.run("document.querySelectorAll('.span').length") == 0
    motion = next(i for i, f in enumerate(comparison.evaluations[0].failures) if f.kind == "motion")
    tab.run(f"document.querySelector('[data-look=\"0,{motion}\"]').click()")
    marked = tab.run("[document.querySelectorAll('path.mark').length, document.querySelectorAll('.span').length]")
    assert marked[0] == marked[1] > 0
    before = tab.run("document.querySelector('#plane g').getAttribute('transform')")
    tab.run("document.querySelector('[aria-label=\"zoom in\"]').click()")
    assert tab.run("document.querySelector('#plane g').getAttribute('transform')") != before
    tab.run("document.querySelector('[aria-label=\"show all\"]').click()")
    box = tab.run("(() => { const b = document.querySelector('.start').getBoundingClientRect(); "
                  "return [b.x + 4, b.y + 4]; })()")  # fmt: skip
    tab.ask("Input.dispatchMouseEvent", type="mouseMoved", x=box[0], y=box[1])
    assert "0.00 m driven" in tab.run("document.querySelector('.tip').textContent")
    before = tab.run("document.querySelector('#plane g').getAttribute('transform')")
    for kind, x in (("mousePressed", box[0]), ("mouseMoved", box[0] + 80), ("mouseReleased", box[0] + 80)):
        tab.ask("Input.dispatchMouseEvent", type=kind, x=x, y=box[1], button="left", buttons=1, clickCount=1)
    after = tab.run("document.querySelector('#plane g').getAttribute('transform')")
    moved = [float(at.strip(")").split()[4]) for at in (before, after)]
    assert moved[1] - moved[0] == pytest.approx(80.0, abs=0.5)
    rows = "document.querySelectorAll('[data-model=\"1\"] tbody tr:not([hidden])').length"
    shown = tab.run(rows)
    tab.run("document.querySelectorAll('fieldset')[2].querySelector('input').click()")
    assert tab.run(rows) == shown - 1
    assert tab.complaints == []
    tab.show(tmp_path / "page.html", 1280, scripts=False)
    assert tab.run("[...document.images].every((one) => one.complete && one.clientHeight > 100)")
    shown = "document.querySelector('noscript p').clientHeight > 0"
    assert tab.run(f"document.querySelector('#explorer').hidden && {shown}")
