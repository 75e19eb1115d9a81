"""The interactive part of a report: its data agree with the recordings, and a real browser works it."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.image import imread
from scipy.stats import chi2

from odomcorrupt.report.html import prose, report_html
from odomcorrupt.report.plots.comparison import draw_errors, rms_interval
from odomcorrupt.report.plots.paths import draw_paths
from odomcorrupt.study.validate.compare import compare


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
