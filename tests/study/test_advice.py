"""Following the advice resolves the ambiguity of the first drive, for either cause."""

import numpy as np
import pytest
from hidden import as_recording

from odomcorrupt.bags.messages import write_twists
from odomcorrupt.effects import registry
from odomcorrupt.geometry.motion import motion_of
from odomcorrupt.geometry.se2 import Increments, accumulate
from odomcorrupt.report.diagnosis import advice_sentences
from odomcorrupt.simulation import Commands, read_commands, simulate
from odomcorrupt.study.design.advise import advise
from odomcorrupt.study.design.drives import excitation, missing_excitations
from odomcorrupt.study.design.information import planned_field, recorded_field, separation
from odomcorrupt.study.design.manoeuvres import MANOEUVRES, Limits
from odomcorrupt.study.design.plan import STEP_S, plan_of
from odomcorrupt.study.estimate.config import Approach
from odomcorrupt.study.estimate.gauss_newton import fit
from odomcorrupt.study.select.selection import learn


def steady(v: float, omega: float, seconds: float = 240.0) -> Commands:
    """Drive that tells nothing apart: one speed, one turn rate."""
    times_s = np.arange(0.0, seconds, STEP_S)
    return Commands(times_s, np.full(len(times_s), v), np.full(len(times_s), omega))


def as_commands(plan) -> Commands:
    return Commands(np.arange(len(plan.v_mps)) * STEP_S, plan.v_mps, plan.omega_radps)


def met(cause, route, seed, path=None):
    """Return the recording of robot 3 with a flaw on a drive; the drive goes through a bag where a path is given."""
    if path is not None:
        times_s = np.arange(len(route.v_mps)) * STEP_S
        with path.open("wb") as file:
            write_twists(file, times_s, np.stack((route.v_mps, 0.0 * times_s, route.omega_radps), axis=1))
        route = read_commands(path)
    run = simulate(seed, cause, route=route, duration_s=route.duration_s, robot_seed=3)
    return as_recording(run, f"drive {seed}")


PAIRS = [
    ("wheel_scale", "speed_scale", steady(0.5, 0.0)),
    ("side_slip", "mount_yaw", steady(0.5, 0.5)),
    pytest.param(
        *("mount_yaw", "lever_arm", steady(0.5, 0.5)),
        marks=pytest.mark.xfail(reason="the second number of a lever arm takes the scale of the wheels, too: 11 nats"),
    ),
]


@pytest.mark.slow
@pytest.mark.parametrize(("cause", "rival", "first"), PAIRS)
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
    said = [why for why, _ in missing_excitations(excitation([ideal_motion(steady(v, omega))]))]
    assert set(there) <= set(said)
    assert not set(not_there) & set(said)


def test_a_mixed_drive_lacks_nothing():
    plan = plan_of(next(m for m in MANOEUVRES if m.name == "everything"), Limits(0.8, 0.8), 600.0)
    assert missing_excitations(excitation([ideal_motion(plan)])) == []


def ideal_motion(route):
    steps = Increments(route.v_mps * STEP_S, 0.0 * route.v_mps, route.omega_radps * STEP_S)
    path = accumulate(np.zeros(3), steps)
    return motion_of(np.arange(len(path)) * STEP_S, path)


def test_expected_nats_are_those_that_a_drive_then_gives():
    """The forecast for two names is the log likelihood ratio that the drive itself shows, within its scatter."""
    kinds = registry()
    one, other = kinds["wheel_scale"](e=0.01), kinds["speed_scale"]()
    recordings = [met("wheel_scale", steady(0.5, 0.0, 120.0), 3)]
    fitted = fit(recordings, [one], approach=Approach())
    plan = plan_of(next(m for m in MANOEUVRES if m.name == "two_speeds"), Limits(0.5, 0.5), 120.0)
    alone = separation((one,), (other,), [], [recorded_field(fitted)])
    expected = separation((one,), (other,), [], [planned_field(fitted, plan)])
    assert alone < 0.1 * expected
    run = as_recording(
        simulate(4, "wheel_scale", route=as_commands(plan), duration_s=120.0, robot_seed=3, parameters={"e": 0.01})
    )
    right, wrong = (fit([run], [kinds[name]()], approach=Approach()).log_likelihood for name in (one.name, other.name))
    # a ratio with expectation N scatters by sqrt(2 N)
    assert abs(right - wrong - expected) < 3.0 * np.sqrt(2.0 * expected) + 0.2 * expected
