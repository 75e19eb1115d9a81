"""Wording of advice about twins in the set-up, and about effects that need an unknown track."""

from types import SimpleNamespace

import pytest

from odomcorrupt.effects import effect_from_values, registry
from odomcorrupt.study.design.ambiguities import open_ambiguities
from odomcorrupt.study.design.identifiability import untried
from odomcorrupt.study.estimate.drive_type import DriveType


def learned(*effects, track_m=None):
    problem = SimpleNamespace(recordings=(SimpleNamespace(track_m=track_m),))
    return SimpleNamespace(
        fit=SimpleNamespace(effects=effects, by_name={e.name: e for e in effects}, problem=problem),
        rounds=(SimpleNamespace(candidates=()),),
        drive_type=DriveType("differential"),
        may_be_losses=lambda _: False,
    )


def twin_hint(name, values, monkeypatch):
    effect = effect_from_values(name, values)
    look = SimpleNamespace(
        added=name,
        alternatives=(),
        candidates=(SimpleNamespace(score=SimpleNamespace(effect=effect), fitted=None, refused=""),),
    )
    monkeypatch.setattr("odomcorrupt.study.design.ambiguities._equivalents", lambda *_: [])
    choices, _ = open_ambiguities(SimpleNamespace(learned=learned(effect)), look)
    return next(choice.hint for choice in choices if name in choice.names)


def test_a_twin_of_the_set_up_comes_with_the_words_that_accept_it(monkeypatch):
    """`correct` passes the set-up by, so a robot that turns elsewhere is mended only as icr_shift."""
    hint = twin_hint("lever_arm", {"x": 0.0735, "y": 0.01}, monkeypatch)
    assert "move the marker" in hint
    assert hint.endswith("removes it only as icr_shift: give `correct` --effect icr_shift:x=0.0735")


def test_twins_that_are_both_the_robots_need_no_such_words(monkeypatch):
    assert "mends it" not in twin_hint("wheelbase", {"e": 0.01}, monkeypatch)


class Loose(registry()["wheel_scale"]):
    """An effect of single wheels that brings no track of its own."""

    name = "loose"
    needs_track = True
    __slots__ = ()


@pytest.mark.parametrize(("track_m", "said"), [(None, True), (0.4, False)])
def test_a_track_is_asked_for_where_an_effect_cannot_be_tried_without(track_m, said, monkeypatch):
    both = {"loose": Loose, "backlash": registry()["backlash"]}
    monkeypatch.setattr("odomcorrupt.study.design.identifiability.registry", lambda: both)
    why = {one.effect: one.why for one in untried(learned(track_m=track_m))}
    assert ("give --track where the robot has two" in why["loose"]) is said
    assert "--track" not in why["backlash"]


def test_of_a_car_no_effect_of_two_wheels_is_open():
    steered = learned()
    steered.drive_type = DriveType("car", gyro=False)
    names = {one.effect for one in untried(steered)}
    assert "steering_offset" in names
    assert names.isdisjoint({"unequal_wheels", "wheelbase", "gyro_bias", "backlash", "flat_spot"})
