"""Choice of the advised drive: it resolves all ambiguities, with any heading source, including clocks."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hidden import as_recording

from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.simulation import Commands, simulate
from odomcorrupt.study.design.advise import advise
from odomcorrupt.study.design.ambiguities import open_ambiguities
from odomcorrupt.study.design.drives import Drives, most_useful
from odomcorrupt.study.design.plan import STEP_S
from odomcorrupt.study.select.selection import learn


class Told:
    """Drives whose fields are their own names and lengths, so that a test can say what each would tell."""

    def planned(self, name, duration_s):
        plan = SimpleNamespace(manoeuvre=SimpleNamespace(name=name), duration_s=duration_s)
        return plan, (name, duration_s)


def telling(**nats):
    """Return what tells the nats of each manoeuvre, three times as much in ten minutes as in three."""
    return lambda drive: nats.get(drive[0], 0.0) * drive[1] / 180.0


def advised(*first, beside=()):
    plan = most_useful(Told(), first, beside)
    return plan.manoeuvre.name, plan.duration_s


def test_a_drive_that_answers_both_questions_is_better_than_one_that_answers_one_a_hundred_times():
    spun, bent = telling(spins=5000.0, turns_apart=40.0), telling(eights=500.0, turns_apart=40.0)
    assert advised(spun, bent) == ("turns_apart", 180.0)


def test_what_comes_second_is_answered_on_the_way_but_not_instead():
    first, second = telling(spins=1000.0, turns_apart=100.0, star=3.0), telling(turns_apart=100.0, star=1000.0)
    assert advised(first) == ("spins", 180.0)
    assert advised(first, beside=[second]) == ("turns_apart", 180.0)


def test_a_drive_is_made_longer_where_that_answers_one_more():
    short, weak = telling(squares=100.0), telling(squares=4.0)
    assert advised(short, weak) == ("squares", 600.0)
    assert advised(short, telling(squares=1.0)) == ("squares", 180.0)
    assert advised(beside=[short, weak]) == ("squares", 180.0)
    assert advised(beside=[weak, weak]) == ("squares", 600.0)


def steadily(v, omega, seconds):
    n = round(seconds / STEP_S)
    return Commands(np.arange(n) * STEP_S, np.full(n, v), np.full(n, omega))


def on_the_way(recording, edge_s=5.0):
    """Return the recording without how it began and ended."""
    first_s, last_s = recording.odometry_s[[0, -1]] + (edge_s, -edge_s)

    def within(trajectory):
        kept = np.abs(trajectory.seconds_since(recording.origin_ns) - 0.5 * (first_s + last_s)) < 0.5 * (
            last_s - first_s
        )
        return Trajectory(trajectory.stamps_ns[kept], trajectory.xyt[kept])

    odometry = within(recording.odometry)
    return replace(recording, odometry=odometry, truth=within(recording.truth), origin_ns=int(odometry.stamps_ns[0]))


def learned_from(cause, route, **options):
    return learn([as_recording(simulate(3, cause, route=route, duration_s=route.duration_s, **options))])


@pytest.mark.slow
def test_spins_do_not_settle_what_only_a_heading_from_the_wheels_would_show():
    """On a straight, the wheels and a gyro give the same heading: advice that hangs on which of them is no good."""
    route = steadily(0.5, 0.0, 150.0)
    advice = advise(learned_from("wheel_scale", route, yaw_from="gyro", parameters={"e": 0.01}))
    (choice,) = (c for c in advice.choices if set(c.names) == {"wheel_scale", "speed_scale"})
    for plan in (choice.plan, advice.best):
        assert plan is not None
        assert plan.manoeuvre.name != "spins"


@pytest.mark.slow
def test_a_clock_that_was_not_put_to_the_test_is_reported():
    route = steadily(0.5, 0.0, 120.0)
    run = as_recording(simulate(3, None, route=route, duration_s=route.duration_s))
    steady = advise(learn([on_the_way(run)]))
    (clock,) = (one for one in steady.untestable if one.effect == "time_offset")
    assert clock.plan is not None
    mixed = advise(learn([as_recording(simulate(3, None, duration_s=120.0))]))
    assert "time_offset" not in {one.effect for one in mixed.untestable}


@pytest.mark.slow
def test_a_name_that_does_the_same_with_one_number_more_is_a_choice_too():
    """On a circle, a lever arm is the same as slip or a turned mount; that it has two numbers is no evidence."""
    route = steadily(0.5, 0.5, 120.0)
    options = {"parameters": {"x": -0.024}, "robot_seed": 3}
    learned = learn([on_the_way(as_recording(simulate(3, "icr_shift", route=route, duration_s=124.0, **options)))])
    (named,) = learned.added
    assert named in {"side_slip", "mount_yaw", "lever_arm"}
    look = learned.rounds[0]
    dear = [replace(c, gain=look.candidates[0].gain - 5.0) if c.gain > 0.0 else c for c in look.candidates[1:]]
    look = replace(look, candidates=(look.candidates[0], *dear))
    assert set(look.alternatives) <= {"icr_shift"}  # another name of the lever arm
    choices = {choice.names: choice.plan for choice in open_ambiguities(Drives(learned), look)[0]}
    other = "side_slip" if named == "lever_arm" else "lever_arm"
    assert choices[named, other] is not None
    assert ("lever_arm", "icr_shift") in choices


@pytest.mark.slow
def test_slip_that_a_late_clock_would_explain_as_well_is_a_choice_and_the_drive_settles_it():
    """With one way of starting and braking, slip and a late clock are alike; turns on the spot tell them apart."""
    hold = round(5.0 / STEP_S), round(2.0 / STEP_S)
    v = np.tile(np.repeat((0.5, 0.0), hold), 20)
    route = Commands(np.arange(len(v)) * STEP_S, v, np.zeros(len(v)))
    options = {"robot_seed": 3, "parameters": {"k": 0.05}}
    before = as_recording(simulate(3, "accel_slip", route=route, duration_s=route.duration_s, **options))
    open_ = learn([before])
    advice = advise(open_)
    (choice,) = (c for c in advice.choices if set(c.names) == {"accel_slip", "time_offset"})
    assert choice.plan is not None
    times_s = np.arange(len(advice.best.v_mps)) * STEP_S
    following = Commands(times_s, advice.best.v_mps, advice.best.omega_radps)
    after = as_recording(simulate(4, "accel_slip", route=following, duration_s=following.duration_s, **options))
    settled = learn([before, after])
    assert settled.added == ("accel_slip",)
    assert not [c for c in advise(settled).choices if "time_offset" in c.names]
