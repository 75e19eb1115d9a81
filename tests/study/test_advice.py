"""Advice: drives that resolve what the first one leaves open, and its words."""

from types import SimpleNamespace

import numpy as np
import pytest
from hidden import as_recording

from odomcorrupt.bags.messages import write_twists
from odomcorrupt.effects import effect_from_values, registry
from odomcorrupt.geometry.motion import motion_of
from odomcorrupt.geometry.se2 import Increments, accumulate
from odomcorrupt.report.findings import advice_sentences
from odomcorrupt.simulation import Commands, read_commands, simulate
from odomcorrupt.study.design.advise import advise, open_ambiguities, untried
from odomcorrupt.study.design.drives import missing_excitations, most_useful
from odomcorrupt.study.design.information import planned_field, recorded_field, separation
from odomcorrupt.study.design.plan import MANOEUVRES, STEP_S, Limits, plan_of
from odomcorrupt.study.estimate.config import Approach
from odomcorrupt.study.estimate.drive_type import DriveType
from odomcorrupt.study.estimate.gauss_newton import fit
from odomcorrupt.study.select.selection import learn


def steady(v: float, omega: float, seconds: float = 240.0) -> Commands:
    """Drive that tells nothing apart: one speed, one turn rate."""
    times_s = np.arange(0.0, seconds, STEP_S)
    return Commands(times_s, np.full(len(times_s), v), np.full(len(times_s), omega))


def met(cause, route, seed, path=None):
    """Return the recording of robot 3 with a flaw on a drive; the drive goes through a bag where a path is given."""
    if path is not None:
        times_s = np.arange(len(route.v_mps)) * STEP_S
        with path.open("wb") as file:
            write_twists(file, times_s, np.stack((route.v_mps, 0.0 * times_s, route.omega_radps), axis=1))
        route = read_commands(path)
    run = simulate(seed, cause, route=route, duration_s=route.duration_s, robot_seed=3)
    return as_recording(run, f"drive {seed}")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("cause", "rival", "first"),
    # a lever arm in the place of a yawed mounting stays open: its second number takes the scale of the wheels, too
    [("wheel_scale", "speed_scale", steady(0.5, 0.0)), ("side_slip", "mount_yaw", steady(0.5, 0.5))],
)
def test_following_the_advice_settles_a_or_b(cause, rival, first, tmp_path):
    before = met(cause, first, 3)
    open_ = learn([before])
    advice = advise(open_)
    choice = next(c for c in advice.choices if {cause, rival} & set(c.names))
    assert choice.plan is not None
    assert choice.nats > 10.0
    assert advice.best is not None
    assert "these data do not separate them" in " ".join(advice_sentences(advice))

    after = met(cause, advice.best, 4, tmp_path / "next.mcap")
    settled = learn([before, after])
    assert settled.added[0] == cause
    assert rival not in settled.rounds[0].alternatives
    assert rival not in settled.added


@pytest.mark.parametrize("manoeuvre", MANOEUVRES, ids=[m.name for m in MANOEUVRES])
@pytest.mark.parametrize("limits", [Limits(0.3, 0.5), Limits(1.0, 0.5), Limits(1.0, 1.0)])
def test_a_plan_begins_and_ends_at_rest_keeps_its_limits_and_stays_in_a_hall(manoeuvre, limits):
    plan = plan_of(manoeuvre, limits, 180.0)
    for speed, limit in ((plan.v_mps, limits.v_mps), (plan.omega_radps, limits.omega_radps)):
        assert not speed[:20].any()
        assert not speed[-20:].any()
        assert np.abs(speed).max() <= limit + 1e-12
    assert np.abs(np.diff(plan.v_mps)).max() <= 2.0 * STEP_S + 1e-9
    assert np.abs(np.diff(plan.omega_radps)).max() <= 4.0 * STEP_S + 1e-9
    assert manoeuvre.least_s <= plan.duration_s + 5.0
    assert plan.duration_s < max(180.0, manoeuvre.least_s) + 90.0
    assert max(plan.floor_m) < 10.0


def test_commands_come_back_from_the_bag_as_they_were_planned(tmp_path):
    plan = plan_of(MANOEUVRES[0], Limits(0.7, 0.9), 100.0)
    times_s = np.arange(len(plan.v_mps)) * STEP_S
    with (tmp_path / "next.mcap").open("wb") as file:
        write_twists(file, times_s, np.stack((plan.v_mps, 0.0 * times_s, plan.omega_radps), axis=1))
    again = read_commands(tmp_path / "next.mcap")
    np.testing.assert_allclose(again.times_s, times_s, atol=1e-9)
    np.testing.assert_array_equal(again.v_mps, plan.v_mps)
    np.testing.assert_array_equal(again.omega_radps, plan.omega_radps)


@pytest.mark.parametrize(
    ("v", "omega", "there", "not_there"),
    [
        (0.5, 0.0, ["never reversed", "never turned", "always near 0.5 m/s"], []),
        (-0.5, 0.3, ["never turned right"], ["never reversed", "never turned left"]),
        (0.5, -0.3, ["never turned left", "never turned on the spot"], ["never turned right"]),
        (0.0, 0.5, ["hardly drove"], ["never turned on the spot"]),
    ],
)
def test_what_a_drive_never_did_is_reported(v, omega, there, not_there):
    said = [why for why, _ in missing_excitations([ideal_motion(steady(v, omega))])]
    assert set(there) <= set(said)
    assert not set(not_there) & set(said)
    everything = plan_of(next(m for m in MANOEUVRES if m.name == "everything"), Limits(0.8, 0.8), 600.0)
    assert missing_excitations([ideal_motion(everything)]) == []


def ideal_motion(route):
    steps = Increments(route.v_mps * STEP_S, 0.0 * route.v_mps, route.omega_radps * STEP_S)
    path = accumulate(np.zeros(3), steps)
    return motion_of(np.arange(len(path)) * STEP_S, path)


def test_expected_nats_are_those_that_a_drive_then_gives():
    kinds = registry()
    one, other = kinds["wheel_scale"](e=0.01), kinds["speed_scale"]()
    recordings = [met("wheel_scale", steady(0.5, 0.0, 120.0), 3)]
    fitted = fit(recordings, [one], approach=Approach())
    plan = plan_of(next(m for m in MANOEUVRES if m.name == "two_speeds"), Limits(0.5, 0.5), 120.0)
    alone = separation((one,), (other,), [], [recorded_field(fitted)])
    expected = separation((one,), (other,), [], [planned_field(fitted, plan)])
    assert alone < 0.1 * expected
    route = Commands(np.arange(len(plan.v_mps)) * STEP_S, plan.v_mps, plan.omega_radps)
    run = as_recording(simulate(4, "wheel_scale", route=route, duration_s=120.0, robot_seed=3, parameters={"e": 0.01}))
    right, wrong = (fit([run], [kinds[name]()], approach=Approach()).log_likelihood for name in (one.name, other.name))
    # a ratio with expectation N scatters by sqrt(2 N)
    assert abs(right - wrong - expected) < 3.0 * np.sqrt(2.0 * expected) + 0.2 * expected


class Told:
    """Drives whose fields are their own names and lengths, so that a test can say what each would tell."""

    def planned(self, name, duration_s):
        plan = SimpleNamespace(manoeuvre=SimpleNamespace(name=name), duration_s=duration_s)
        return plan, (name, duration_s)


def telling(**nats):
    """Return what tells the nats of each manoeuvre, three times as much in ten minutes as in three."""
    return lambda drive: nats.get(drive[0], 0.0) * drive[1] / 180.0


def most_useful_of(*first, beside=()):
    plan = most_useful(Told(), first, beside)
    return plan.manoeuvre.name, plan.duration_s


def test_the_most_useful_drive_answers_most_questions_the_second_ones_on_the_way_and_is_longer_for_one_more():
    spun, bent = telling(spins=5000.0, turns_apart=40.0), telling(eights=500.0, turns_apart=40.0)
    assert most_useful_of(spun, bent) == ("turns_apart", 180.0)
    first, second = telling(spins=1000.0, turns_apart=100.0, star=3.0), telling(turns_apart=100.0, star=1000.0)
    assert most_useful_of(first) == ("spins", 180.0)
    assert most_useful_of(first, beside=[second]) == ("turns_apart", 180.0)
    short, weak = telling(squares=100.0), telling(squares=4.0)
    assert most_useful_of(short, weak) == ("squares", 600.0)
    assert most_useful_of(short, telling(squares=1.0)) == ("squares", 180.0)
    assert most_useful_of(beside=[short, weak]) == ("squares", 180.0)
    assert most_useful_of(beside=[weak, weak]) == ("squares", 600.0)


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
    choices = open_ambiguities(SimpleNamespace(learned=learned(effect)), look)
    return next(choice.hint for choice in choices if name in choice.names)


def test_a_twin_of_the_set_up_comes_with_the_words_that_accept_it(monkeypatch):
    hint = twin_hint("lever_arm", {"x": 0.0735, "y": 0.01}, monkeypatch)
    assert "move the marker" in hint
    assert hint.endswith("removes it only as icr_shift: give `correct` --effect icr_shift:x=0.0735")


class Loose(registry()["wheel_scale"]):
    """An effect of single wheels that brings no track of its own."""

    name = "loose"
    needs_track = True
    __slots__ = ()


@pytest.mark.parametrize(("track_m", "said"), [(None, True), (0.4, False)])
def test_a_track_is_asked_for_where_an_effect_cannot_be_tried_without(track_m, said, monkeypatch):
    both = {"loose": Loose, "backlash": registry()["backlash"]}
    monkeypatch.setattr("odomcorrupt.study.design.advise.registry", lambda: both)
    why = {one.effect: one.why for one in untried(learned(track_m=track_m))}
    assert ("give --track where the robot has two" in why["loose"]) is said
    assert "--track" not in why["backlash"]


def test_of_a_car_no_effect_of_two_wheels_is_open():
    steered = learned()
    steered.drive_type = DriveType("car", gyro=False)
    names = {one.effect for one in untried(steered)}
    assert "steering_offset" in names
    assert names.isdisjoint({"unequal_wheels", "wheelbase", "gyro_bias", "backlash", "flat_spot"})
