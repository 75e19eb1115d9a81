"""Sentences of a summary and its JSON."""

import json
import re
from dataclasses import replace
from html import unescape
from types import SimpleNamespace

import numpy as np
import pytest
from test_report import parsed_page, shown

from odomcorrupt.cli import run
from odomcorrupt.effects import effect_from_values
from odomcorrupt.effects.expression import user_effect
from odomcorrupt.report import findings as texts
from odomcorrupt.report.comparison import comparison_text, rejection, within
from odomcorrupt.report.findings import (
    Found,
    _found_lines,
    _mounting_words,
    dependences_found,
    effects_found,
    findings_brief,
    foremost,
    is_unexplained,
)
from odomcorrupt.report.html import found_html
from odomcorrupt.report.plain import finite
from odomcorrupt.report.plots.comparison import draw_candidates, draw_plan, draw_unknown
from odomcorrupt.report.plots.figure import rendered
from odomcorrupt.study.design.advise import Advice, Ambiguity, DetectionLimit, UntestableEffect
from odomcorrupt.study.design.plan import MANOEUVRES, Limits, plan_of
from odomcorrupt.study.estimate.calibrate import fit_robot
from odomcorrupt.study.estimate.drive_type import DriveType
from odomcorrupt.study.io.clock import Clock
from odomcorrupt.study.select.candidates import Dependence
from odomcorrupt.study.select.evidence import Score
from odomcorrupt.study.select.random_effects import DetectedRandomEffect
from odomcorrupt.study.select.result import Learned
from odomcorrupt.study.terms.basis import BasisFunction
from odomcorrupt.study.terms.channels import Action
from odomcorrupt.study.terms.term import BasisTerm
from odomcorrupt.study.validate.held_out import without_parts
from odomcorrupt.study.validate.lack_of_fit import Failure
from odomcorrupt.summary import Line, Summary, command_line
from recordings import ROOT

PLANS = {one.name: plan_of(one, Limits(0.5, 0.8), 60.0) for one in MANOEUVRES}
PLAN = next(plan for plan in PLANS.values() if plan.fastest_mps > 0.0)
SPINS = next(plan for plan in PLANS.values() if plan.fastest_mps == 0.0)
CHOICES = (
    Ambiguity(("side_slip", "turn_asymmetry"), "it never turned to the left", PLAN, 12.0),
    Ambiguity(("gyro_bias", "scale_drift"), "", SPINS, 3.0),
    Ambiguity(("wheel_scale", "speed_scale"), "", None, 0.0, "measure a wheel"),
    Ambiguity(("lever_arm", "mount_yaw"), "", None, 0.0),
)
UNTESTABLE = (
    *(UntestableEffect(name, "never reversed", PLAN) for name in ("backlash", "accel_slip")),
    UntestableEffect("slope", "no map", None, "give a map"),
    UntestableEffect("time_offset", "it stood still", None),
)
LIMITS = (
    DetectionLimit("wheel_scale", "e", 0.0012, ""),
    *(DetectionLimit("lever_arm", axis, size, "m") for axis, size in (("x", 0.0034), ("y", 0.005))),
)
ADVICE = Advice(CHOICES, UNTESTABLE, LIMITS, PLAN)
NONE = Advice((), (), (), None)


def unknown(channel, regressor, *, per="m"):
    """Say that a basis function explains 40 nats of a channel's error."""
    places = {"position": np.array([[0.0, 0.0], [1.0, 0.5], [2.0, -1.0]]), "heading": np.arange(3.0)}
    centres = places.get(regressor, np.linspace(-1.0, 1.0, 9))
    function = BasisFunction(regressor, f"k * cos({regressor})", 1)
    term = BasisTerm(function, Action(channel, "v" if per == "m" else "omega"))
    score = Score(
        estimate=np.array([0.01]), standard_error=np.array([0.001]), inflation=1.0, p=1e-6,
        separable=True, held_out_nats=50.0, held_out_error=3.0, term=term, cost=10.0,
    )  # fmt: skip
    return Dependence(
        centres=centres, curve=0.01 * np.sin(np.arange(len(centres))),
        curve_error=np.full(len(centres), 0.002), nats=40.0, term=term, score=score,
    )  # fmt: skip


UNKNOWNS = (
    unknown("yaw", "speed"),
    unknown("along", "heading"),
    unknown("yaw", "yaw_rate", per="rad"),
    unknown("across", "position"),
    unknown("along", "acceleration"),
)


@pytest.fixture(scope="session")
def searched(diagnosed):
    return diagnosed.search


@pytest.fixture(scope="session")
def sequence(diagnosed):
    return diagnosed.sequence


@pytest.fixture(scope="session")
def rich(searched):
    """Say that the search also found noise and unknowns, the first of which is in the model."""
    wandering = effect_from_values("gauss_markov", {"sigma": 0.02, "tau": 4.0, "channel": "yaw"})
    return replace(searched, noise=(DetectedRandomEffect(wandering, 25.0),), unknown=UNKNOWNS, laws=UNKNOWNS[:1])


@pytest.fixture(scope="session")
def poor(searched):
    """Say that the search found nothing."""
    first = searched.rounds[0]
    return replace(searched, rounds=(replace(first, added=None),), fit=first.before, noise=(), unknown=(), laws=())


def test_the_text_tells_effects_noise_unknowns_and_what_is_open(rich):
    text = texts.found_text(rich, ADVICE)
    assert "missing, in the order of evidence" in text
    assert re.search(r"  \+ unequal_wheels .* mm after 10 s   confidence 0\.\d\d", text)
    # 40 nats of what depends on something look like a gain that wanders, too, and are more than its 25
    varies = "the gain of travel, of turns or of one wheel varies slowly"
    assert f"noise: gauss_markov (yaw), sigma 2 %, tau 4 s (confidence 0.38): {varies}" in text
    assert "unknown: the yaw error depends on speed (40 nats), and no known effect explains it" in text
    assert f"fitted: {UNKNOWNS[0].expression}" in text
    assert f"suggested: {UNKNOWNS[1].expression}" in text
    assert "the yaw error per radian turned depends on yaw rate" in text


def test_the_headline_says_which_dependences_are_not_in_the_model(rich):
    over_time = unknown("yaw", "time", per="s")
    lines, _ = _found_lines(replace(rich, unknown=(UNKNOWNS[0], over_time)), rich.fit, set())
    fast, late = (next(line.text for line in lines if name in line.text) for name in ("speed", "time"))
    assert "not in the model" not in fast
    assert late.endswith("(not in the model; to decide, learn from a second drive as well)")


def test_a_dependence_of_the_model_is_reported_as_such_though_another_part_was_dropped(rich, sequence):
    """What is dropped changes what others may replace, and a changed copy of a dependence was taken for another one."""
    law, name = UNKNOWNS[-1], "along_over_acceleration"
    fit = rich.fit.refit((*rich.fit.effects, user_effect(name, "along += v * (k * cos(a))", {"k": 0.01})))
    rivals = [replace(one, instead_of=("unequal_wheels",)) for one in (UNKNOWNS[0], law)]
    both = replace(rich, fit=fit, unknown=(law, *rivals), laws=(law,), noise=())
    kept = without_parts(both, {"unequal_wheels": "the error grows with it"})
    assert [effect.name for effect in kept.fit.effects if effect.kind == "effect"] == [name]
    # a rival of what was dropped is not reported beside a dependence of its name
    included, other = dependences_found(kept)
    assert (included.fitted, included.part, list(included.numbers)) == (True, name, ["k"])
    assert (other.fitted, other.part, other.law.instead_of) == (False, "", ())
    printed = texts.learned_json(kept, sequence.evaluations, NONE)["unknown"]
    assert [one["in_model"] for one in printed] == [True, False]
    assert [one["expression"] for one in printed] == [included.expression, other.expression]
    text = texts.found_text(kept, NONE)
    assert f"fitted: {included.expression}" in text
    assert f"suggested: {other.expression}" in text
    lines, _ = _found_lines(kept, kept.fit, set())
    remarks = {line.part: line.text.endswith("(not in the model)") for line in lines if "depends" in line.text}
    assert remarks == {name: False, "": True}


def test_why_a_dependence_was_left_out_is_said_on_its_line_and_not_on_others_of_its_name(rich):
    law = unknown("yaw", "time", per="s")
    why = "the other drive does not support it: -1 +- 25 nats"
    learned = replace(rich, unknown=(law, replace(law, nats=12.0)), laws=(), left_out={law.name: why})
    lines, _ = _found_lines(learned, rich.fit, set())
    (said, other) = (line.text for line in lines if "time" in line.text)
    assert said.endswith(f" (left out of the model: {why})")
    assert "second drive" not in said
    assert " (not in the model" in other
    lines, _ = _found_lines(replace(learned, unknown=(law,), left_out={}), rich.fit, set())
    (line,) = (line for line in lines if " (not in the model; to decide, learn from a second drive" in line.text)
    assert law.expression not in line.short
    assert line.short.endswith(": a second drive decides")


def test_all_parts_of_the_model_are_named_and_other_dependences_as_far_as_there_is_room(rich):
    laws = tuple(replace(UNKNOWNS[i], nats=10.0 + i) for i in (0, 2, 3))
    both = replace(rich, unknown=(UNKNOWNS[1], *laws), laws=laws)
    shown = foremost(dependences_found(both), 2)
    assert [one.law for one in shown] == [*laws]
    assert [one.law for one in foremost(dependences_found(replace(both, laws=())), 2)] == [UNKNOWNS[1], laws[0]]
    lines, _ = _found_lines(both, rich.fit, set())
    assert all(any(law.expression in line.text for line in lines) for law in laws)


def test_a_dependence_that_is_negligible_is_in_the_model_only_if_it_is(rich, monkeypatch):
    monkeypatch.setattr(Learned, "hardly_moves", lambda *_: True)
    for laws, said in ((UNKNOWNS[:1], "in the model, but negligible"), ((), "negligible, and not in the model")):
        _, (line,) = _found_lines(replace(rich, unknown=UNKNOWNS[:1], laws=laws), rich.fit, set())
        assert line.text == f"{UNKNOWNS[0].expression}: {said}"


def doubted(confidence):
    return lambda *given: [one._replace(confidence=confidence) for one in effects_found(*given)]


def test_a_part_that_is_hardly_a_cause_is_no_finding_beside_others(rich, sequence, monkeypatch):
    monkeypatch.setattr("odomcorrupt.report.findings.effects_found", doubted(0.02))
    known = replace(rich, unknown=UNKNOWNS[:1], laws=UNKNOWNS[:1])
    lines = findings_brief(known, NONE, sequence).lines
    assert not any(line.label == "perhaps" or line.text.startswith("unequal_wheels  ") for line in lines)
    (beside,) = (line for line in lines if "unequal_wheels" in line.text)
    assert beside[:2] == ("included", "also unequal_wheels (confidence 0.02)")
    assert beside.part == "unequal_wheels (confidence 0.02)"


def test_a_rejected_model_is_shown_with_its_errors_however_long_the_rest_is(rich, sequence):
    first = sequence.evaluations[0]
    rejected = replace(sequence, evaluations=(first, replace(first, name="with all")))
    following = f"odomcorrupt compare {'/data/recordings/' * 5}judge --truth /vrpn/pose {'/data/models/' * 5}robot.toml"
    brief = findings_brief(rich, ADVICE, rejected, notes=("a", "b"))
    text = brief._replace(lines=(*brief.lines, command_line(following))).text().splitlines()
    assert {"errors", "rejected"} <= {row.split()[0] for row in text}
    assert len(text) <= 8


def test_a_name_below_even_odds_follows_dependences_and_noise_with_perhaps(rich, sequence, monkeypatch):
    monkeypatch.setattr("odomcorrupt.report.findings.effects_found", doubted(0.27))
    known = replace(rich, unknown=UNKNOWNS[:1], laws=UNKNOWNS[:1])
    lines = findings_brief(known, NONE, sequence).lines
    assert lines[0].text.startswith("the yaw error depends on speed")
    assert lines[0].label == "MISSING"
    (doubtful,) = (line for line in lines if line.text.startswith("unequal_wheels"))
    assert doubtful.label == "perhaps"
    reported = findings_brief(replace(known, laws=()), NONE, sequence).lines
    assert (reported[0].label, reported[0].text) == ("UNKNOWN", f"{lines[0].text} (not in the model)")
    alone = findings_brief(replace(rich, unknown=(), laws=(), noise=()), NONE, sequence).lines
    assert alone[0].label == "PERHAPS"
    assert alone[0].text.startswith("unequal_wheels")


def test_names_and_dependences_of_the_model_are_in_order_of_their_evidence(rich):
    (gain,) = (step.candidates[0].gain for step in rich.steps if step.added)
    for nats, last in ((gain - 1.0, True), (gain + 1.0, False)):
        one = replace(UNKNOWNS[0], nats=nats)
        lines, _ = _found_lines(replace(rich, unknown=(one,), laws=(one,), noise=()), rich.fit, set())
        # what the final model leaves unexplained would otherwise make the name doubtful
        shown = [line.text for line in lines if not line.label]
        assert shown[-1].startswith("the yaw error") == (last or len(shown) == 1)


def test_an_impossible_sign_contradicts_physics_unless_a_dependence_is_unexplained(searched):
    first = searched.rounds[0]
    forbidden = replace(first.candidates[0], refused="of a physically impossible sign")
    against = replace(searched, fit=first.before, contradictions=(forbidden,), noise=(), unknown=(), laws=())
    assert "the data contradict physics: unequal_wheels" in texts.found_text(against, NONE)
    # a dependence only approximates an unknown cause, and its misfit may have any sign
    assert "contradict" not in texts.found_text(replace(against, unknown=UNKNOWNS[:1]), NONE)


def test_what_explains_about_as_much_as_a_name_is_said_beside_it(rich):
    rival = replace(UNKNOWNS[0], instead_of=("unequal_wheels",))
    both = replace(rich, unknown=(rival,), laws=())
    text = texts.found_text(both, ADVICE)
    assert "or instead of unequal_wheels: the yaw error depends on speed (40 nats), and these data do not" in text
    assert both.unexplained == ()
    assert both.left_nats == 0.0
    assert "nan" not in text
    alone = texts.found_text(replace(rich, unknown=UNKNOWNS[4:]), NONE)
    assert "the along error depends on acceleration" in alone


def test_advice_is_a_sentence_for_each_choice_and_one_for_all_that_share_a_drive():
    lines = texts.advice_sentences(ADVICE)
    assert len(lines) == len(CHOICES) + 3
    assert lines[0].startswith("side_slip or turn_asymmetry: these data do not separate them (it never turned to the ")
    assert lines[0].endswith("that is expected to separate them by 12 nats")
    assert "up to 46 deg/s" in lines[1]
    assert lines[2] == "wheel_scale or speed_scale: identical on every drive: measure a wheel"
    assert "no drive of ten minutes would" in lines[3]
    assert lines[4].startswith("backlash, accel_slip: not testable here: never reversed; drive ")
    assert lines[5] == "slope: not testable here: no map; give a map"
    assert lines[6] == "time_offset: not testable here: it stood still"
    assert (texts.advice_sentences(NONE), texts.limits_sentence(())) == ([], "")
    sizes = "wheel_scale 0.12 %, lever_arm x 3.4 mm, lever_arm y 5 mm"
    assert texts.limits_sentence(LIMITS) == f"smallest detectable sizes: {sizes}"


@pytest.mark.slow
def test_the_page_shows_everything_at_once_and_stays_whole(rich, sequence):
    summary = Summary((Line("change", "set wheel_separation to 0.97 of its value"),))
    page = found_html(rich, sequence, ADVICE, "odomcorrupt fit run.mcap -o robot.toml", summary)
    assert "set wheel_separation to 0.97 of its value." in page
    parsed = parsed_page(page)
    assert parsed.tags.count("img") == 5
    text = unescape(page)
    for sentence in texts.advice_sentences(ADVICE):
        assert sentence.partition(": ")[0] in text
    for one in UNKNOWNS[:3]:
        assert one.expression in text
    assert "gauss_markov (yaw)" in text
    assert "odomcorrupt fit run.mcap -o robot.toml" in text


def test_the_page_of_a_search_that_found_nothing_is_whole_and_names_the_recording_that_judges(poor, sequence):
    good = replace(sequence, evaluations=(kept(sequence.evaluations[0]),))
    page = found_html(poor, replace(good, recordings=("other.mcap",)), NONE, "", Summary(()))
    assert ", evaluated on other.mcap</h1>" in page
    parsed_page(page)
    assert texts.found_text(poor, NONE) == texts.NOTHING
    assert texts.NOTHING[1:] in unescape(page)
    assert "rejected" not in page.split("</h1>", 1)[1].split("</p>", 1)[0]


def kept(evaluation):
    """Return an evaluation that rejects nothing."""
    return replace(evaluation, verdict=replace(evaluation.verdict, checks=()))


@pytest.mark.slow
def test_a_model_that_is_rejected_is_not_said_to_miss_nothing(poor, rich, sequence):
    first = sequence.evaluations[0]
    text = texts.found_text(poor, NONE, evaluated=first)
    assert text == f"no known effect is missing, but the model is rejected: {rejection(first)}"
    assert "times the predicted ones (NEES " in text
    assert "an effect that is not in the model remains" in text
    assert texts.found_text(poor, NONE, evaluated=kept(first)) == texts.NOTHING
    beside = texts.found_text(replace(rich, unknown=(), laws=()), NONE, evaluated=first)
    assert "no further known effect is missing, but" in beside
    page = found_html(poor, replace(sequence, evaluations=(first,)), NONE, "", Summary(()))
    assert "but the model is rejected" in page.split("</h1>", 1)[1].split("</p>", 1)[0]
    for one, why in ((first, rejection(first)), (kept(first), None)):
        assert texts.learned_json(poor, sequence.evaluations[:1], NONE, evaluated=one)["rejected"] == why


def test_a_rejected_model_with_negligible_laws_alone_is_not_complete(poor, sequence, monkeypatch):
    monkeypatch.setattr(Learned, "hardly_moves", lambda *_: True)
    small = replace(poor, unknown=UNKNOWNS[:1], laws=UNKNOWNS[:1])
    brief = findings_brief(small, NONE, replace(sequence, evaluations=sequence.evaluations[:1]))
    assert brief.lines[0].label == "UNKNOWN"


def test_what_happened_at_once_is_no_effect_that_a_model_lacks(sequence):
    first = sequence.evaluations[0]
    push = Failure(
        kind="moment", channel="across", where="within 0.5 s at 59.8 s", per="", measured=-0.14, expected=0.001,
        amount=1.0, log_p=-90.0,
    )  # fmt: skip
    said = rejection(replace(first, failures=(*first.failures, push)))
    assert said.endswith("a single event remains (a push, a slip or a jump of the truth: within 0.5 s at 59.8 s)")
    slowly = replace(push, kind="time", where="in the first minute", per="s", log_p=-900.0)
    for less in ((), (slowly, push)):
        assert rejection(replace(first, failures=less)).endswith("an effect that is not in the model remains")


def test_a_model_that_holds_is_not_said_to_be_right_about_errors_that_only_its_uncertainty_allows(sequence):
    first = sequence.evaluations[0]
    wide = tuple(replace(h, nees=9.0, nees_bounds=(0.5, 400.0)) for h in first.horizons)
    held = replace(first, horizons=wide, verdict=replace(first.verdict, misfit=1.0))
    assert within(held).startswith("errors are up to 3.0 times the predicted ones, which the standard errors of its")
    right = tuple(replace(h, nees=1.0) for h in wide)
    assert within(replace(held, horizons=right)).startswith("errors are as large as the predicted ones;")


def test_errors_too_small_reject_a_model_and_leave_nothing_to_name(sequence):
    first = sequence.evaluations[0]
    small = tuple(replace(h, nees=0.25, nees_bounds=(0.5, 1.5)) for h in first.horizons)
    assert "0.5 times the predicted ones (NEES 0.25): it predicts" in rejection(replace(first, horizons=small))
    right = tuple(replace(h, nees=1.0, nees_bounds=(0.5, 1.5)) for h in first.horizons)
    assert rejection(replace(first, horizons=right)).endswith("the size of its errors is as predicted")


def test_an_included_law_is_reported_with_the_numbers_of_the_model(searched):
    function = BasisFunction("acceleration", "k * a")
    found = replace(UNKNOWNS[0], term=BasisTerm(function, Action("yaw", "v")))
    effect = user_effect("yaw_over_acceleration", "yaw += v * (k * a)", {"k": 0.0123})
    fit = SimpleNamespace(effects=(effect,), standard_errors=np.array([0.001]))
    learned = replace(searched, unknown=(found,), laws=(found,))
    text = texts.found_text(learned, NONE, fit=fit)
    assert "fitted: yaw += v * (0.0123 * a)  (k 0.7047 +- 0.057 deg s^2/m^2)" in text
    (included,) = dependences_found(learned, fit)
    assert included.numbers == {"k": (0.0123, 0.001, "rad s^2/m^2")}
    (suggested,) = dependences_found(replace(learned, laws=()), fit)
    assert suggested.expression == found.expression
    assert suggested.numbers == {}


def test_a_clock_is_no_reason_to_say_that_nothing_is_missing(poor):
    off = replace(poor.clocks, clocks=(Clock(-9e-5, 1.5e-4),), free=((True, True),), errors=((2e-4, 5e-7),))
    text = texts.found_text(replace(poor, clocks=off), NONE)
    # the offset is free beside a skew, and not there itself
    assert text.endswith("the odometry's clock is off: skew 150 +- 0.5 ppm (confidence 0.99)")
    assert texts.NOTHING not in text


def test_names_too_long_for_their_column_stand_above_their_row(sequence):
    long = replace(sequence.evaluations[-1], name="with mount_yaw, region_slip and one more")
    lines = comparison_text(replace(sequence, evaluations=(sequence.evaluations[0], long))).splitlines()
    assert lines.count(f"  {long.name}") == 2
    assert len({line.index("ATE") for line in lines if "RPE over" in line}) == 1
    assert len({line.index(" mm  #") for line in lines if " mm  #" in line}) == 1


def test_json_has_no_number_that_is_none(rich, poor, sequence):
    printed = finite(texts.learned_json(rich, sequence.evaluations, ADVICE))
    assert json.loads(json.dumps(printed, allow_nan=False))["verdict"] == "unknown"
    assert len(printed["unknown"]) == len(UNKNOWNS)
    assert [one["effect"] for one in printed["not_testable"]] == [one.effect for one in UNTESTABLE]
    assert texts.learned_json(poor, sequence.evaluations[:1], NONE)["verdict"] == "complete"


@pytest.mark.slow
@pytest.mark.parametrize(
    "draw", [lambda: draw_unknown(UNKNOWNS[:3]), lambda: draw_unknown(UNKNOWNS[3:]), lambda: draw_plan(SPINS)]
)
def test_a_picture_is_the_same_file_every_time(draw):
    first = rendered(draw(), "svg")
    assert rendered(draw(), "svg") == first
    assert b"nan" not in first.lower().split()


def test_candidates_that_were_refused_are_drawn_with_their_reason(rich):
    first = rich.rounds[0]
    refused = replace(first.candidates[-1], gain=30.0, refused="it says nothing held out")
    look = replace(first, candidates=(*first.candidates[:3], refused))
    assert b"it says nothing" in rendered(draw_candidates(replace(rich, rounds=(look,))), "svg")


def test_a_step_that_included_a_dependence_is_drawn_with_its_title(rich):
    step = replace(rich.rounds[0], added=None, dependence=UNKNOWNS[0])
    picture = rendered(draw_candidates(replace(rich, rounds=(step,))), "svg")
    assert f"added {UNKNOWNS[0].title}".encode() in picture
    assert b"nothing more to add" not in picture


def test_the_fall_of_the_error_is_reported_for_ladders_alone(sequence):
    text = texts.shares_text(sequence.evaluations)
    assert text.startswith("held-out position error (RMS):\n  + unequal_wheels")
    assert "10 s: " in text
    assert "-" in text.partition("10 m: ")[2]
    assert texts.shares_text(sequence.evaluations[:1]) == ""


def test_values_have_units_that_a_person_thinks_in():
    values = (0.1, 0.01, "rad/m"), (0.002, None, "m"), (0.05, 0.001, "s"), (4.0, None, "s"), (0.01, 0.002, "")
    said = ["5.73 +- 0.57 deg/m", "2 mm", "50 +- 1 ms", "4 s", "1 +- 0.2 %"]
    assert [texts.value_text(*value) for value in values] == said


def test_clocks_that_are_off_have_a_line_and_others_none(searched, sequence):
    off = tuple(replace(clock, offset_s=0.05, rate=2e-5) for clock in searched.clocks.clocks)
    clocks = replace(searched.clocks, clocks=off, free=((True, True),), errors=((0.001, 1e-6),))
    said = "a: the odometry's clock is off: offset 50 +- 1 ms (confidence 0.99), skew 20 +- 1 ppm (confidence 0.99)"
    assert texts.clock_lines(["a"], clocks) == [said]
    assert texts.clock_lines(["a"], replace(clocks, free=((False, False),))) == []
    late = findings_brief(replace(searched, clocks=clocks), NONE, replace(sequence, raw_error_m=9.0)).lines[0].text
    assert "the odometry is stamped 50 ms later than the truth; unequal_wheels  " in late


@pytest.fixture(scope="session")
def fitted(searched, case):
    return fit_robot([case.recording], searched.fit.effects, law_name="quadratic", clocks=searched.clocks)


def test_a_fit_is_reported_with_its_coefficients_as_the_law_has_them(fitted):
    assert (text := texts.fit_text(fitted)).startswith("law quadratic, coefficients with 95 % intervals:")
    assert "as the law has it" in text
    assert "  unequal_wheels: curvature -0." in text
    table = texts.laws_table({"quadratic": fitted, "other": fitted}).splitlines()
    assert table[1].split() == ["quadratic", "0.0", str(len(fitted.fit.components.active)), "yes"]


@pytest.fixture
def found(monkeypatch, rich):
    """Let the commands find everything at once, without a search."""
    monkeypatch.setattr("odomcorrupt.study.pipeline.learn", lambda *_args, **_named: rich)
    monkeypatch.setattr("odomcorrupt.study.pipeline.advise", lambda _learned: ADVICE)


def test_diagnose_says_in_the_terminal_what_to_type_next(found, rich, case, tmp_path, invoke, monkeypatch):
    monkeypatch.setattr("odomcorrupt.study.pipeline.learn", lambda *_args, **_named: replace(rich, laws=()))
    words = ["diagnose", "-v", str(case.bag), "--track", str(case.recording.track_m)]
    words += ["--drive", str(tmp_path / "next.mcap")]
    out, err = invoke(words)
    assert "held-out position error (RMS):" in out
    _, _, following = " ".join(out.replace("\\\n", " ").split()).rpartition(" next")
    assert following.lstrip(": ").startswith("odomcorrupt fit ")
    assert following.endswith("--add unequal_wheels -o robot.toml")
    assert f"wrote {tmp_path / 'next.mcap'}: " in err
    assert "--overwrite" in invoke(words, 1).err


def test_where_a_law_is_included_learn_comes_next_because_it_alone_writes_laws(found, case, invoke):
    out = invoke(["diagnose", "-v", case.bag, "--track", case.recording.track_m]).out
    _, _, following = " ".join(out.replace("\\\n", " ").split()).rpartition(" next")
    assert following.lstrip(": ").startswith(f"odomcorrupt learn {case.bag} ")
    assert following.endswith(f"--track {case.recording.track_m:g} -o robot.toml")


@pytest.mark.parametrize(
    ("words", "said"),
    [("learn {bag} {model}", "`fit --start` and `diagnose` take models"),
     ("diagnose {bag} {model} {other}", "2 models given; diagnose one at a time"),
     ("diagnose {bag} --drive next.bag", "next.bag: ends in .bag; write .mcap"),
     ("fit {bag} {model}", "is a model; pass it with --start")],
)  # fmt: skip
def test_what_cannot_be_meant_is_refused_before_any_work(words, said, case, invoke):
    typed = [word.format(bag=case.bag, model=case.base, other=case.robot) for word in words.split()]
    err = invoke(typed, 2).err
    assert said in err
    assert err.count("\n") == 1


@pytest.mark.slow
def test_learn_writes_model_page_picture_and_drive(found, case, sequence, fitted, tmp_path, invoke, monkeypatch):
    asked = []
    monkeypatch.setattr("odomcorrupt.study.pipeline.fit_robot", lambda *_args, **_named: fitted)
    module = "odomcorrupt.study.pipeline"
    monkeypatch.setattr(f"{module}.compare", lambda _runs, models, **_named: asked.append(models) or sequence)
    monkeypatch.setattr("odomcorrupt.api.findings.compare_models", lambda _runs, _models, **_clocks: sequence)
    monkeypatch.setattr("odomcorrupt.report.html.found_html", lambda *_found: _found[3])
    monkeypatch.chdir(tmp_path)
    words = ["learn", "-v", str(case.bag), "--track", str(case.recording.track_m)]
    files = {"-o": "robot.toml", "--report": "all.html", "--plot": "fall.svg", "--drive": "next.mcap"}
    out, err = invoke([*words, *(word for pair in files.items() for word in pair)])
    assert all((tmp_path / name).stat().st_size > 0 for name in files.values())
    assert all(f"wrote {name}" in err for name in files.values())
    assert "missing, in the order of evidence" in out
    assert list(asked[0]) == ["without effects", "with unequal_wheels, yaw over speed, gauss_markov"]
    assert (tmp_path / "all.html").read_text().endswith("odomcorrupt sim.bag noisy.bag --model robot.toml")
    printed = json.loads(invoke([*words, "--json", "--force"]).out, parse_constant=pytest.fail)
    assert printed["comparison"]["models"][0]["name"] == sequence.evaluations[0].name


def test_a_drive_that_settles_nothing_is_not_written(monkeypatch, searched, case, tmp_path, capsys):
    monkeypatch.setattr("odomcorrupt.study.pipeline.learn", lambda *_args, **_named: searched)
    monkeypatch.setattr("odomcorrupt.study.pipeline.advise", lambda _learned: NONE)
    drive = tmp_path / "next.mcap"
    assert run(["diagnose", str(case.bag), "--json", "--drive", str(drive)]) == 0
    assert f"{drive} is not written: there is no open question that another drive" in capsys.readouterr().err
    assert not drive.exists()


BACK = SimpleNamespace(manoeuvre=SimpleNamespace(sentence="straights"), duration_s=180.0)
TWINS = {"wheelbase": ("gyro_scale",)}


def said(*choices, best=BACK):
    return texts.inseparable_sentence(Advice(choices, (), (), best), lambda name: TWINS.get(name, ()))


def choice(*names, plan=BACK):
    return Ambiguity(names, "", plan, 100.0)


@pytest.mark.parametrize(
    ("choices", "sentence"),
    [((), ""),
     # two names of one error: nothing is open between them
     ((choice("wheelbase", "gyro_scale", plan=None),), ""),
     ((choice("gyro_bias", "unequal_wheels"),), "gyro_bias from unequal_wheels: drive straights"),
     ((choice("side_slip", "mount_yaw"), choice("side_slip", "icr_shift"), choice("a", "b")),
      "side_slip from mount_yaw or icr_shift, nor a from b: drive straights"),
     ((choice("lever_arm", "icr_shift", plan=None),), "lever_arm from icr_shift; no drive of ten minutes would")],
)  # fmt: skip
def test_one_sentence_names_every_pair_once_and_the_drive(choices, sentence):
    invoke = said(*choices).removesuffix(", for 3 minutes").removeprefix("These data cannot separate ")
    assert invoke == sentence
    assert said(*choices).endswith(", for 3 minutes") == ("drive straight" in sentence)


PAGE = (ROOT / "docs" / "json.md").read_text(encoding="utf8")


@pytest.fixture(scope="module")
def printed(case, diagnosed, tmp_path_factory):
    """What `diagnose --json` prints of a short office drive with one wheel larger, and what it writes beside it."""
    folder = tmp_path_factory.mktemp("printed")
    files = {"drive": folder / "next.mcap", "report": folder / "found.html"}
    words = [w for flag, path in files.items() for w in (f"--{flag}", str(path))]
    out = folder / "out.json"
    with pytest.MonkeyPatch.context() as patch, out.open("w") as stream:
        patch.setattr("sys.stdout", stream)
        patch.setattr("odomcorrupt.study.pipeline.learn", lambda *_args, **_named: diagnosed.search)
        patch.setattr("odomcorrupt.study.pipeline.sequence_comparison", lambda *_args, **_clocks: diagnosed.sequence)
        assert run(["diagnose", str(case.bag), "--track", str(case.recording.track_m), "--json", *words]) == 0
    return json.loads(out.read_text(), parse_constant=pytest.fail), files


def test_the_schema_is_that_of_the_page(printed):
    found, _ = printed
    section = PAGE.split("## `diagnose --json`", 1)[1].split("\n## ", 1)[0]
    rows = [re.findall(r"`([^`]+)`", line.split("|")[1]) for line in section.splitlines() if line.startswith("| `")]
    named = {code for codes in rows for code in codes}
    assert set(found) - {"schema"} == {code for code in named if "[" not in code and "." not in code}
    assert found["schema"] == 2
    entry = found["found"][0]
    assert {f"found[].{key}" for key in entry} <= named | {"found[].effect", "found[].kind"}


def test_the_cause_is_found_with_its_numbers(printed, case):
    found, _ = printed
    assert found["verdict"] == "missing"
    entry = found["found"][0]
    assert (entry["effect"], entry["kind"]) == ("unequal_wheels", "effect")
    curvature = entry["parameters"]["curvature"]
    assert curvature["unit"] == "rad/m"
    assert abs(curvature["value"] + 0.0133) < 4.0 * curvature["standard_error"]
    assert 0.9 < entry["confidence"] < 1.0
    for key in ("rmse_10m", "rmse_10s"):
        before, after = entry["held_out"][key]
        assert after < before
    # half of this drive is no 50 m
    assert entry["held_out"]["rmse_50m"] == [None, None]
    assert entry["held_out"]["nats_per_m"][1] > entry["held_out"]["nats_per_m"][0]
    assert found["ladder"][0]["rmse_10s"] == entry["held_out"]["rmse_10s"][0]
    assert found["ladder"][1]["model"] == "+ unequal_wheels"
    assert found["candidates"][0]["effect"] == "unequal_wheels"


def test_what_is_open_is_reported_with_a_drive(printed):
    found, files = printed
    for one in found["not_testable"]:
        assert one["why"]
        assert one["drive"]
    assert all(one["size"] > 0.0 for one in found["detectable"])
    seen = {one["effect"] for one in found["detectable"]}
    assert not seen & {one["effect"] for one in found["not_testable"]}
    assert files["drive"].exists() == (found["next_drive"] is not None)


def test_the_report_is_whole_small_and_says_what_is_missing(printed):
    found, files = printed
    page = files["report"].read_text(encoding="utf8")
    parsed = parsed_page(page)
    assert parsed.tags.count("script") == 2  # the data, and the one script that the policy admits
    text = unescape(page)
    assert "missing: unequal_wheels" in text.lower()
    assert "--add unequal_wheels" in text
    for one in found["not_testable"]:
        assert one["why"] in text
    assert parsed.tags.count("img") == 3 + bool(found["unknown"]) + bool(found["next_drive"])
    assert "nan" not in unescape(re.sub(r'src="[^"]*"', "", page)).lower().split()


@pytest.mark.slow
def test_a_real_browser_shows_the_report(printed, tab, tmp_path):
    (page := tmp_path / "found.html").write_bytes(printed[1]["report"].read_bytes())
    assert shown(tab, page) > 1500


def words(name, values, errors):
    run = SimpleNamespace(matched=True)
    problem = SimpleNamespace(recordings=[run])
    fit = SimpleNamespace(effects=[effect_from_values(name, values)], standard_errors=np.array(errors), problem=problem)
    return _mounting_words(SimpleNamespace(added=(), drive_type=DRIVE), fit)


DRIVE = DriveType("differential", "", "")


@pytest.mark.parametrize(("yaw", "error"), [(2e-4, 1.5e-4), (2e-4, 1e-6), (0.02, 0.01)])
def test_an_insignificant_or_tiny_yaw_is_not_reported(yaw, error):
    assert words("mount_yaw", {"yaw": yaw}, [error]) == ""


def test_a_yaw_is_a_turn_and_a_lever_arm_a_point():
    assert words("mount_yaw", {"yaw": 0.0052}, [2e-4]) == "the truth is turned by 0.3 deg against TF"
    said = words("lever_arm", {"x": 0.06, "y": -0.001}, [1e-3, 1e-3])
    assert said.startswith("the truth follows a point 6 cm ahead of the base (lever_arm")


def test_a_region_is_given_by_its_full_size():
    patch = effect_from_values("region_slip", {"slip": 0.1, "x": 1.0, "y": 2.0, "radius": 2.483, "width": 3.455})
    said = ", ".join(texts.numbers_text(patch, [0.01]))
    assert said.endswith("5.0 m x 6.9 m")
    assert "radius" not in said


def test_an_effect_with_evidence_is_not_called_untestable():
    advice = Advice((), (UntestableEffect("backlash", "never reversed", None, "reverse"),), (), None)
    assert texts.advice_sentences(advice) == ["backlash: not testable here: never reversed; reverse"]
    (said,) = texts.advice_sentences(advice, {"backlash": "wheelbase"})
    assert said == "backlash: not separated from wheelbase; reverse"


@pytest.mark.parametrize(
    ("misfit", "noisy", "ratios", "expected"),
    [(0.5, False, "", False), (1.4, False, "", True), (1.4, True, "", False), (3.0, True, "", True),
     (1.0, False, "in 1 s, truth over odometry: travel not comparable, turns 1", True)],
)  # fmt: skip
def test_errors_larger_than_predicted_and_travel_alone_lack_a_cause(poor, rich, misfit, noisy, ratios, expected):
    problem = replace(poor.fit.problem, recordings=[replace(one, ratios=ratios) for one in poor.fit.problem.recordings])
    learned = replace(poor, noise=rich.noise if noisy else (), fit=replace(poor.fit, problem=problem))
    last = SimpleNamespace(verdict=SimpleNamespace(fails=True, misfit=misfit))
    assert is_unexplained(learned, last) == expected
    assert is_unexplained(replace(learned, unknown=UNKNOWNS[:1]), last) == bool(ratios)


def test_noise_is_no_headline_beside_doubtful_effects_that_leave_errors(rich, sequence, monkeypatch):
    known, last = replace(rich, unknown=(), laws=()), sequence.evaluations[0]
    only = replace(sequence, evaluations=(replace(last, verdict=replace(last.verdict, misfit=3.0)),))
    assert findings_brief(known, NONE, only).lines[0].label == "PROBABLY"
    sure = [Found(rich.noise[0].effect, (), 0.9, 25.0)]
    monkeypatch.setattr("odomcorrupt.report.findings.effects_found", doubted(0.27))
    monkeypatch.setattr("odomcorrupt.report.findings.noise_found", lambda _: sure)
    assert findings_brief(known, NONE, only).lines[0].label == "UNKNOWN"
