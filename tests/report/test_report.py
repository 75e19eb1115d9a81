"""The HTML report, and numbers in text and JSON."""

import base64
import json
import re
from dataclasses import replace
from hashlib import sha256
from html import unescape
from html.parser import HTMLParser

import numpy as np
import pytest
from matplotlib.image import imread

from odomcorrupt.api.findings import Comparison
from odomcorrupt.effects import effect_from_values
from odomcorrupt.effects.expression import user_effect
from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.report.comparison import MOST, comparison_brief, evaluation_sentence, sentence
from odomcorrupt.report.findings import noise_text
from odomcorrupt.report.html import report_html
from odomcorrupt.report.plain import finite
from odomcorrupt.report.plots.comparison import PICTURES
from odomcorrupt.report.plots.figure import rendered
from odomcorrupt.report.plots.paths import draw_paths
from odomcorrupt.study.validate.compare import compare

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
@pytest.mark.parametrize("name", PICTURES)
def test_every_picture_is_the_same_file_every_time(comparison, name):
    first = rendered(PICTURES[name].draw(comparison), "svg")
    assert rendered(PICTURES[name].draw(comparison), "svg") == first
    assert len(first) < 1_000_000


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
