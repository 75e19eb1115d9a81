"""Benchmarks: ordinary recordings keep to docs/effects.md, their judge to its protocol, the price list to its list."""

import ast
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

sys.path.append(str(Path(__file__).parents[1] / "benchmarks"))

import price_list
from ordinary import verdicts
from ordinary.bags import read_odometry, write_bag
from ordinary.cases import FIRST_SEED, SITUATIONS, cases
from ordinary.causes import CAUSES
from ordinary.machine import Rig, body_motion, odometry_of, stream
from ordinary.page import page
from ordinary.platforms import PLATFORMS
from ordinary.routes import Route, driven
from ordinary.truths import TRUTHS, make_truth

ROUTE = Route("rooms", 6.0, 5.0)


def _made(robot, flaw=None, heading="wheels", seed=3, seconds=90.0):
    """Return body and odometry of a robot without chance and counts, its gyro's white noise apart."""
    platform = replace(PLATFORMS[robot], noise_m=0.0, ticks=0.0)
    rig = Rig(heading)
    motion = driven(ROUTE, platform, seconds, stream(seed, "driver"), np.zeros(3))
    body = body_motion(motion, flaw, platform, rig, seed, np.zeros(3))
    return body, odometry_of(body, flaw, platform, rig, seed, (3.0, 2.5, 1.0))


@pytest.mark.parametrize(("robot", "heading"), [("cart", "wheels"), ("burger", "gyro"), ("racer", "steering")])
def test_odometry_without_a_flaw_is_the_truth(robot, heading):
    body, odometry = _made(robot, heading=heading)
    true = body.at(odometry.time_s)
    departs = odometry.xyt - (true - true[0])
    assert np.max(np.hypot(*departs.T[:2])) < {"wheels": 0.001, "gyro": 0.01, "steering": 0.3}[heading]


@pytest.mark.parametrize(
    ("name", "sizes", "expected"),
    [
        ("wheel_scale", {"e": 0.02}, lambda v, w: (0.02 * v, 0.02 * w)),
        ("unequal_wheels", {"e": 0.01}, lambda v, w: (0.01 * 0.45 * w / 4, 0.01 * v / 0.45)),
        ("wheelbase", {"e": 0.05}, lambda v, w: (0.0 * v, -0.05 / 1.05 * w)),
        ("turn_asymmetry", {"k": 0.03}, lambda v, w: (0.0 * v, 0.03 * abs(w))),
    ],
)
def test_truth_minus_odometry_is_as_the_documents_define(name, sizes, expected):
    body, odometry = _made("cart", (name, sizes))
    v, w = odometry.twist.T
    for true, said, effect in zip((body.v, body.true_w), (v, w), expected(v, w), strict=True):
        way = np.interp(odometry.time_s, body.time_s, np.cumsum(true) / 200.0)
        departs = np.abs(way - way[0] - np.cumsum(said + effect) / 50.0)
        assert np.max(departs) < 0.01


def test_a_late_stamp_is_later_by_the_offset_alone():
    _, clean = _made("cart")
    _, late = _made("cart", ("time_offset", {"offset": 0.02}))
    assert np.allclose(late.stamp_s - clean.stamp_s, 0.02)
    assert np.array_equal(late.xyt, clean.xyt)


def test_play_costs_its_travel_at_each_reversal_and_nothing_else():
    _, clean = _made("cart")
    _, play = _made("cart", ("backlash", {"travel": 0.01}))
    way = np.abs(np.cumsum(play.twist[:, 0] - clean.twist[:, 0])) / 50.0
    # the middle of the axle moves by half of what one wheel loses
    assert way.max() >= 0.005
    assert np.median(np.abs(way / 0.005 - np.round(way / 0.005))) < 0.02


def test_the_same_seed_gives_the_same_drive_and_a_flaw_changes_no_chance():
    first, again = _made("skid", seed=5), _made("skid", seed=5)
    assert np.array_equal(first[1].xyt, again[1].xyt)
    flawed = _made("skid", ("wheel_scale", {"e": 0.02}), seed=5)
    assert np.array_equal(first[0].xyt, flawed[0].xyt)


@pytest.mark.parametrize("kind", list(TRUTHS))
def test_every_truth_tells_where_the_robot_is(kind, tmp_path):
    body, odometry = _made("cart", heading="gyro")
    truth = make_truth(kind, body, (0.0, 0.0, 0.0), odometry, 3, np.zeros(3))
    write_bag(tmp_path / "run.mcap", odometry, truth.messages)
    stamps, xyt = read_odometry(tmp_path / "run.mcap")
    assert np.allclose(stamps, odometry.stamp_s, atol=1e-6)
    assert np.allclose(xyt, odometry.xyt, atol=1e-9)
    pose = truth.messages[0]
    if pose.kind in ("pose", "pose_cov"):
        assert np.median(np.abs(pose.rows - body.at(pose.stamp_s))[:, :2]) < 0.05


def test_pilots_and_the_frozen_run_share_no_seed_and_every_cause_is_planted():
    frozen, pilot = cases(), cases(pilot=True)
    assert min(case.seed for case in frozen) >= FIRST_SEED > max(case.seed for case in pilot)
    assert len({case.seed for case in frozen}) == len(frozen) >= 300
    assert {case.cause for case in frozen} == {"", *CAUSES}
    assert {case.situation for case in frozen[:10]} == set(SITUATIONS)
    assert 0.35 < np.mean([not case.cause for case in frozen]) < 0.45


def _row(cause, found, **more):
    case = {"situation": "clock", "number": 1, "seed": 20_001, "setting": 1, "cause": cause}
    answer = {"found": [{"effect": name, "confidence": told} for name, told in found], "unknown": []}
    expected = {"before_m": 0.05, "floor_m": 0.01, "attainable_m": 0.011, "nats": 99.0, "excited": bool(cause)}
    return {"key": "clock/1", "case": case, "answer": answer, "expected": expected, "after_m": 0.012} | more


def test_verdicts_follow_the_protocol():
    assert verdicts.false_alarms(_row("", [("backlash", 0.3)]))
    assert verdicts.wrong_and_sure(_row("time_offset", [("accel_slip", 0.99)]))
    assert not verdicts.wrong_and_sure(_row("time_offset", [("accel_slip", 0.89), ("time_offset", 0.99)]))
    assert not verdicts.wrong_and_sure(_row("channel_lag", [("time_offset", 0.99)]))
    assert not verdicts.right(_row("channel_lag", [("time_offset", 0.99)]))
    assert verdicts.right(_row("channel_lag", [("turn_lag", 0.5)]))
    assert verdicts.harmed(_row("time_offset", [], after_m=0.06))
    row = _row("time_offset", [], uses={"batch": "exit 1: no", "correct": ""})
    assert verdicts.refusals(row) == ["batch: exit 1: no"]


def test_an_event_is_found_by_its_time():
    case = _row("push", [], event={"start_s": 100.0, "end_s": 102.0, "angle": 0.2, "way": 0.1})
    assert not verdicts.right(case)
    case["answer"]["events"] = [{"time_s": 99.0}]
    assert verdicts.right(case)


def test_the_page_lists_every_miss():
    text = page([_row("time_offset", [("accel_slip", 0.99)], flaw=["time_offset", {"offset": 0.01}], uses={})])
    assert "accel_slip 0.990" in text
    assert "planted `time_offset` offset=0.01" in text
    assert "--pilot --key clock/1" in text


SOURCE = """
_LEVEL, _COUNT = 0.01, 5
GRID = (0.5, 2.0)
class Limits:
    share: float = 0.985
    def far(self):
        return self.share
def is_odd(value):
    return value % 2 == 1
"""


def changed(*changes):
    """Return the names of the source with some changes made."""
    made = price_list._Changed([price_list.Change(f"a:{target}", how) for target, how in changes])
    tree, names = made.module(ast.parse(SOURCE)), {}
    exec(compile(tree, "a", "exec"), names)  # noqa: S102 - the source above
    return names


@pytest.mark.parametrize("value", [1e-4, 0.3, 0.97, 0.985, 1.02, 1.15, 3.0, 40.0, -2.5])
def test_a_number_lies_between_its_half_and_its_double_and_both_are_on_its_side_of_one(value):
    half, double = (price_list.scaled(value, double=double) for double in (False, True))
    assert min(half, double) < value < max(half, double)
    assert (half < 1.0) == (double < 1.0) == (value < 1.0)
    assert price_list.scaled(half, double=True) == pytest.approx(value)


@pytest.mark.parametrize("count", [1, 2, 3, 60])
def test_a_whole_number_stays_whole_and_above_zero(count):
    others = [price_list.scaled(count, double=double) for double in (False, True)]
    assert all(isinstance(other, int) and other > 0 for other in others)


def test_only_what_is_named_is_changed():
    names = changed(("_COUNT", "* 2"), ("Limits.share", "/ 2"), ("is_odd", "= None"), ("GRID", "* 2"))
    assert (names["_LEVEL"], names["_COUNT"], names["GRID"]) == (0.01, 10, (1.0, 4.0))
    assert names["Limits"]().far() == pytest.approx(0.9925)
    assert names["is_odd"](3) is None


def test_a_name_that_is_not_there_is_an_error():
    with pytest.raises(KeyError, match="no such name: gone"):
        changed(("gone", "* 2"))


def test_every_rule_and_every_number_of_the_study_is_there():
    targets = [*price_list.RULES, *price_list.numbers("study/estimate")]
    assert len(set(targets)) == len(targets)
    modules = {}
    for target in targets:
        module, _, name = target.partition(":")
        modules.setdefault(module, []).append(name)
    root = price_list.ROOT / "odomcorrupt"
    for module, names in modules.items():
        tree = ast.parse((root / f"{module.replace('.', '/')}.py").read_text(encoding="utf-8"))
        how = [price_list.Change(f"{module}:{name}", price_list.RULES.get(f"{module}:{name}", "* 2")) for name in names]
        price_list._Changed(how).module(tree)  # raises for a name that is gone


class Rows(price_list.PriceList):
    """Rows of which some change if all changes of a set are made together."""

    def __init__(self, sets, names):
        self.sets, self.names, self.asked = sets, names, 0

    def rows(self, changes, names):
        for name in names:
            self.asked += 1
            row = {key: [] for key in ("names", "noise", "dependences", "sure", "sure_wrong")}
            yield name, row | {"error": 1.0 + sum(own <= set(changes) for own in self.sets.get(name, ()))}


def test_the_fewest_changes_that_change_a_row_are_found_and_the_others_are_free(capsys):
    all_changes = [price_list.Change(f"a:N{i}", "* 2") for i in range(64)]
    one, two, three = all_changes[7], all_changes[20], all_changes[50]
    rows = Rows({"x": [{one}], "z": [{two, three}]}, ["w", "x", "y", "z"])
    free = rows.priced(all_changes)
    assert set(all_changes) - set(free) == {one, two, three}
    said = capsys.readouterr().out
    assert f"{one}: 1 row(s)" in said
    assert f"{two} AND {three}" in said
    assert rows.asked < 64
