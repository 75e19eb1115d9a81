"""Steered, commanded and sideways robots: each fault is found by name and size. Turns on the spot alone are refused."""

from dataclasses import replace

import numpy as np
import pytest
from hidden import basis_dependences, ten_second_error
from wandering import RATE_HZ, drive, noisy_path, recording, wander
from wheel_models import AXLES_M, GRID_HZ, HOBBY_TRACK_M, Flaw, car, forklift, hobby, lagged, loose

import odomcorrupt as oc
from odomcorrupt.api.recordings import Recordings
from odomcorrupt.errors import RecordingError
from odomcorrupt.geometry.se2 import Increments, accumulate
from odomcorrupt.model.model_file import format_model, parse_model
from odomcorrupt.model.noise_laws import Coefficients
from odomcorrupt.study.design.advise import untried
from odomcorrupt.study.estimate.calibrate import fit_robot
from odomcorrupt.study.estimate.config import Approach
from odomcorrupt.study.estimate.drive_type import drive_type_of, readings_of
from odomcorrupt.study.estimate.gauss_newton import fit
from odomcorrupt.study.estimate.regressors import MotionSmoother
from odomcorrupt.study.io import Source
from odomcorrupt.study.select.decisions import DECISIONS
from odomcorrupt.study.select.random_effects import random_coefficients
from odomcorrupt.study.select.selection import learn
from odomcorrupt.study.select.shape_search import CoarseDesign
from odomcorrupt.study.terms.term import library_families

OFFSET_RAD, BAND_MPS, SAG_PER_S, LIMIT_MPS, PLAY_M, TICK_MPS = 0.02, 0.03, 2.5e-4, 0.2, 0.008, 0.03
QUIET = Coefficients(0.006, 0.006, 0.004, 0.002)
SURE = 3.5
"""Standard errors of an amplitude; a shape's own error is in them, the simulator's rounding of corners is not."""


def dead_band(u, _t_s):
    return np.sign(u) * np.maximum(np.abs(u) - BAND_MPS, 0.0)


def sagging(u, t_s):
    return u * (1.0 - SAG_PER_S * t_s)


def half_lost(u, _t_s):
    return np.sign(u) * np.where(np.abs(u) > LIMIT_MPS, (LIMIT_MPS + np.abs(u)) / 2.0, np.abs(u))


def in_whole_ticks(u, _t_s):  # of readings that shake by a tick
    return TICK_MPS * np.trunc(u / TICK_MPS + np.random.default_rng(3).uniform(-0.5, 0.5, len(u)))


def through_play(u, _t_s):
    """Return the speed of a wheel that its motor turns through play: it stays where it is until it is pushed."""
    wheel = loose(np.concatenate(([0.0], np.cumsum(u) / GRID_HZ)), PLAY_M)[1:]
    return np.diff(wheel, prepend=wheel[0]) * GRID_HZ


def as_commanded(u, _t_s):
    return u


def only(learned):
    """Return the one effect that was found, and the standard error of its first amplitude; nothing else was."""
    assert [effect.name for effect in learned.fit.effects] == list(learned.added)
    assert not learned.unknown
    assert not learned.noise
    assert not any(any(free) for free in learned.clocks.free)
    (effect,) = learned.fit.effects
    return effect, float(learned.fit.standard_errors[0])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("flaw", "name", "parameter", "size"),
    [
        (Flaw(ratio=0.05), "steering_scale", "e", 0.05),
        (Flaw(offset=OFFSET_RAD), "steering_offset", "curvature", OFFSET_RAD / AXLES_M),
        (Flaw(lag_s=0.15), "steering_lag", "tau", 0.15),
        (Flaw(ahead_m=0.15), "rear_axle_shift", "x", 0.15),
    ],
)
def test_what_is_wrong_with_a_car_has_its_name_and_size(flaw, name, parameter, size):
    learned = learn([car(1, flaw, 160.0)])
    assert learned.drive_type.name == "car"
    effect, error = only(learned)
    assert effect.name == name
    assert abs(getattr(effect, parameter) - size) < SURE * error
    assert error < 0.1 * size


@pytest.mark.slow
def test_an_angle_of_a_driven_front_wheel_changes_the_travel_too():
    flaw = Flaw(offset=OFFSET_RAD, wheel=-0.012)
    learned = learn([replace(forklift(1, flaw, 160.0), drive_type="tricycle")])
    assert {effect.name for effect in learned.fit.effects} == {"steering_offset", "wheel_scale"}
    assert not learned.unknown
    steering = next(effect for effect in learned.fit.effects if effect.name == "steering_offset")
    assert steering.driven == "front"
    assert steering.axles == pytest.approx(AXLES_M, rel=0.1)
    assert steering.curvature == pytest.approx(OFFSET_RAD / AXLES_M, rel=0.05)
    before, after = (ten_second_error([forklift(2, flaw)], effects) for effects in ((), learned.fit.effects))
    assert after < 1.1 * ten_second_error([forklift(2)]) < 0.5 * before


@pytest.mark.slow
def test_play_in_the_steering_has_its_name_and_size():
    effect, _ = only(learn([car(1, Flaw(play_rad=0.04), 160.0)]))
    assert effect.name == "steering_play"
    # play is in the angle, and a curvature grows with its tangent: 6 % more at 0.25 rad
    assert effect.play == pytest.approx(0.04 / AXLES_M, rel=0.1)


@pytest.mark.slow
def test_a_car_and_a_commanded_robot_with_nothing_wrong_have_no_name():
    for run in (car(1, seconds=160.0), hobby(1, as_commanded, 160.0)):
        learned = learn([run])
        assert not learned.fit.effects
        assert not learned.unknown
        assert not learned.noise


@pytest.mark.slow
@pytest.mark.parametrize(
    ("true_of", "reported_of", "name", "values"),
    [
        (dead_band, None, "dead_band", {"loss": 1.0, "speed": BAND_MPS}),
        (sagging, None, "scale_drift", {"rate": -SAG_PER_S}),
        (as_commanded, half_lost, "counts_lost", {"part": 1.0, "speed": LIMIT_MPS}),
        (as_commanded, in_whole_ticks, "truncated_counts", {"step": TICK_MPS}),
        (through_play, None, "backlash", {"travel": PLAY_M}),
    ],
)
def test_wheels_show_their_flaw_and_their_track_where_nobody_said_it(true_of, reported_of, name, values):
    seconds = 240.0 if name in ("scale_drift", "counts_lost") else 160.0
    learned = learn([hobby(1, true_of, seconds, reported_of=reported_of)])
    effect, error = only(learned)
    assert effect.name == name
    for parameter, value in values.items():
        assert getattr(effect, parameter) == pytest.approx(value, abs=SURE * error if parameter != "speed" else 0.003)
    if name != "scale_drift":
        assert effect.track == pytest.approx(HOBBY_TRACK_M, rel=0.1)
    else:
        assert learned.steps[0].alternatives == ("battery_sag",)


@pytest.mark.slow
def test_motors_that_follow_commands_late_are_no_late_clock():
    tau_s = 0.2
    learned = learn([hobby(1, lambda u, _t_s: lagged(u, tau_s), 160.0)])
    effect, error = only(learned)
    assert effect.name == "motor_lag"
    assert effect.tau == pytest.approx(tau_s, abs=max(SURE * error, 0.01))


@pytest.mark.slow
def test_a_flat_side_of_one_wheel_has_its_name_and_circumference():
    turn_m, sides = 0.204, iter((0.12, 0.0))

    def flat_on_the_right(u, _t_s):
        """Return the speeds of the right wheel, asked first, which loses 12 % over a sixth of each turn."""
        turned = np.cumsum(u) / GRID_HZ / turn_m * 2.0 * np.pi
        return u * (1.0 - next(sides) * (np.abs((turned + 1.0 + np.pi) % (2.0 * np.pi) - np.pi) < 0.5))

    learned = learn([replace(hobby(1, flat_on_the_right, 200.0), track_m=HOBBY_TRACK_M)])
    (effect,) = (effect for effect in learned.fit.effects if effect.name == "flat_spot")
    # what the wheel loses on average, 12 % of a sixth of its way, is the flat side's own and no smaller radius
    assert list(learned.added) == ["flat_spot"]
    assert (effect.wheel, effect.form) == ("right", "flat")
    assert effect.circumference == pytest.approx(turn_m, rel=0.003)


def names_of(run):
    motion = MotionSmoother([run], "odometry").recorded
    return {family[0].name for family in library_families([run], [motion], ())}


def test_a_car_has_no_second_wheel_and_no_gyro_and_a_robot_with_two_wheels_no_steering():
    steered = {"steering_scale", "steering_offset", "steering_lag", "steering_play", "rear_axle_shift"}
    wheeled = {"wheelbase", "unequal_wheels", "backlash"}
    of_a_car = names_of(car(1, seconds=90.0))
    assert steered < of_a_car
    assert of_a_car.isdisjoint(wheeled | {"gyro_bias", "gyro_scale", "icr_shift"})
    of_two_wheels = names_of(replace(car(1, seconds=90.0), drive_type="differential"))
    assert wheeled | {"gyro_bias"} < of_two_wheels
    assert of_two_wheels.isdisjoint(steered)


def test_a_track_that_is_given_leaves_no_other_to_be_tried():
    run = hobby(1, as_commanded, seconds=60.0)
    for known, track_m in ((False, None), (True, HOBBY_TRACK_M)):
        motion = MotionSmoother([replace(run, track_m=track_m)], "odometry").recorded
        families = {f[0].name: f for f in library_families([replace(run, track_m=track_m)], [motion], ())}
        assert {term.start.track == 0.0 for term in families["backlash"]} == {known}
        assert families["backlash"][0].charged == (1 if known else 2)


def test_the_drive_type_is_guessed_from_slow_curves():
    steered = car(1, seconds=120.0)
    guessed = drive_type_of([steered])
    assert guessed.sentence.startswith("car (steers up to a stop, never turned on the spot; smallest radius 1.")
    assert not guessed.gyro  # its heading stands while its wheels do
    assert drive_type_of([hobby(1, as_commanded, seconds=120.0)]).name == "differential"
    assert drive_type_of([drive(1, 120.0, QUIET)]).name == "differential"
    # a steered robot that a user takes for a differential one is one, a track says that there are two wheels,
    # and too short a drive says nothing
    for run in (replace(steered, drive_type="differential"), replace(steered, track_m=0.4), car(1, seconds=15.0)):
        assert drive_type_of([run]).sentence == "differential"


def slow_in_bends(seconds, curvature_of):
    """Return a car that slows down for tight bends in each 20 s; `curvature_of` the time since the start, s."""
    t_s = np.arange(seconds * 50) / 50.0
    v = np.interp(t_s % 20.0, [0.0, 2.0, 8.0, 10.0, 20.0], [0.25, 1.0, 1.0, 0.25, 0.25])
    steps = Increments(v / 50.0, 0.0 * v, v * curvature_of(t_s) / 50.0)
    return recording(steps, accumulate(np.zeros(3), steps))


def test_a_car_that_slows_down_for_tight_bends_is_guessed_too():
    # at speed its curvature is 0.15 per metre at most; at its stop, in slow bends, 0.55
    knots_s = [0.0, 2.0, 5.0, 8.0, 10.0, 11.5, 18.5, 20.0]
    run = slow_in_bends(200, lambda t_s: np.interp(t_s % 20.0, knots_s, [0.0, 0.0, 0.15, 0.0, 0.0, 0.55, 0.55, 0.0]))
    said = "car (steers up to a stop, never turned on the spot; smallest radius 1.8 m)"
    assert drive_type_of([run]).sentence == said


def test_a_car_whose_steering_is_not_straight_at_zero_has_another_stop_on_each_side():
    def curvature(t_s):
        bend = np.interp(t_s % 20.0, [10.0, 11.5, 18.5, 20.0], [0.0, 1.0, 1.0, 0.0])
        return bend * np.choose((t_s // 20.0).astype(int) % 4, [0.55, -0.45, -0.45, -0.2])

    assert drive_type_of([slow_in_bends(320, curvature)]).name == "car"


def test_a_robot_that_its_planner_never_turns_on_the_spot_is_no_car():
    for seed in range(4):
        assert drive_type_of([car(seed, seconds=200.0, planned=True)]).sentence == "differential"


def test_other_readings_are_those_that_the_robot_can_have_and_of_a_guessed_one_those_of_the_other_type():
    robot, guessed = drive_type_of([hobby(1, as_commanded, seconds=30.0)]), drive_type_of([car(1, seconds=120.0)])
    stated = replace(guessed, stated=True)
    assert readings_of("lever_arm", robot) == ("icr_shift",)
    assert readings_of("lever_arm", stated) == ("rear_axle_shift",)
    assert readings_of("rear_axle_shift", stated) == ("lever_arm",)
    assert guessed.name == "car"
    assert "unequal_wheels" in readings_of("steering_offset", guessed)
    assert "unequal_wheels" not in readings_of("steering_offset", stated)


def test_the_drive_type_goes_with_the_model(tmp_path):
    run = replace(car(1, seconds=60.0), drive_type="tricycle")
    model = fit_robot([run], (), law_name="diffusion").model
    assert parse_model(format_model(model)).setup.drive_type == "tricycle"
    runs = Recordings((replace(run, drive_type="auto"),), (Source(tmp_path / "run.mcap"),))
    assert runs.of_drive_type("tricycle")[0].drive_type == "tricycle"
    assert runs.of_drive_type("omni").of_drive_type("car")[0].drive_type == "omni"


@pytest.fixture(scope="module")
def sideways_wander():
    along = wander(311, 300.0)
    pace = np.arange(len(along)) / RATE_HZ
    return Increments(along.ds_m, 0.3 * np.sin(0.4 * pace) / RATE_HZ, along.dtheta_rad)


@pytest.mark.slow
def test_rollers_that_slip_have_a_name_and_the_right_size(sideways_wander):
    # the odometry says more than was driven: the truth is e = -6 % of it shorter
    reported = accumulate(
        np.zeros(3), Increments(sideways_wander.ds_m, sideways_wander.dl_m / 0.94, sideways_wander.dtheta_rad)
    )
    learned = learn([recording(sideways_wander, reported, truth_mm=1.0, truth_rad=0.001, seed=311)])
    assert learned.added == ("sideways_scale",)
    assert learned.fit.effects[0].e == pytest.approx(-0.06, abs=0.002)
    assert learned.error_m < 0.1 * learned.rounds[0].candidates[0].rmse[0]


@pytest.mark.slow
def test_a_wheel_of_another_size_turns_the_robot_as_it_drives_sideways(sideways_wander):
    k = 0.05
    reported = accumulate(
        np.zeros(3),
        Increments(sideways_wander.ds_m, sideways_wander.dl_m, sideways_wander.dtheta_rad - k * sideways_wander.dl_m),
    )
    learned = learn([recording(sideways_wander, reported, truth_mm=1.0, truth_rad=0.001, seed=313)])
    assert learned.added == ("sideways_turn",)
    assert learned.fit.effects[0].k == pytest.approx(k, abs=0.001)
    assert learned.error_m < 0.1 * learned.rounds[0].candidates[0].rmse[0]


def test_a_robot_that_cannot_is_not_asked_and_not_advised_to():
    steps = wander(312, 120.0)
    learned = learn([recording(steps, noisy_path(steps, Coefficients(0.004, 0.004, 0.008, 0.004), 312), seed=312)])
    assert learned.added == ()
    asked = {c.score.effect.name for c in learned.rounds[0].candidates} | {one.effect for one in untried(learned)}
    assert "region_slip" in asked
    assert asked.isdisjoint({"sideways_scale", "sideways_turn"})


LOST = 0.04
"""Fraction of the sideways travel by which rollers that sag push a robot back."""


def sideways_drive(lost: float, seconds: float = 200.0):
    """Return a recording of a robot that drives forwards and sideways, and is pushed back as it drives sideways."""
    along, across = wander(1, seconds), wander(2, seconds)
    reported = Increments(along.ds_m, across.ds_m, along.dtheta_rad)
    slipped = 1e-3 * np.sqrt(np.hypot(along.ds_m, across.ds_m)) * np.random.default_rng(3).standard_normal(len(along))
    driven = replace(reported, ds_m=along.ds_m - lost * np.abs(across.ds_m) + slipped)
    return recording(driven, accumulate(np.zeros(3), reported), truth_mm=1.0, truth_rad=1e-3)


def fitted(run):
    return fit([run], approach=Approach())


def test_what_rollers_lose_sideways_is_an_error_over_the_sideways_speed():
    (found, *_) = basis_dependences(fitted(sideways_drive(LOST)))
    assert (found.channel, found.regressor, found.per) == ("along", "sideways_speed", "m")
    assert found.expression.startswith("along += abs(vy) * (-0.0")
    assert found.score.estimate[0] == pytest.approx(-LOST, rel=0.05)


def test_without_an_error_nothing_depends_on_the_sideways_speed():
    bare = fitted(sideways_drive(0.0))
    assert basis_dependences(bare) == []


def of_sideways(run):
    """Return the actions and basis functions of sideways motion that are tried on a recording."""
    design = CoarseDesign(fitted(run).problem)
    actions = {(a.target, a.move) for a in design.actions if "vy" in a.move}
    return actions, {f.text for f in design.functions if "vy" in f.text or f.regressor == "sideways_speed"}


def test_only_a_robot_that_can_and_does_drive_sideways_has_the_regressor():
    run = sideways_drive(0.0, 60.0)
    actions, functions = of_sideways(run)
    assert actions == {(channel, move) for channel in ("along", "across", "yaw") for move in ("vy", "abs(vy)")}
    assert {"k", "k * abs(vy)", "k * where(vy < -0.02, 1, 0)"} < functions
    assert of_sideways(replace(run, drive_type="differential")) == (set(), set())
    steps = wander(1, 60.0)
    unicycle = recording(steps, accumulate(np.zeros(3), steps))
    assert of_sideways(replace(unicycle, drive_type="omni")) == (set(), set())


def turning(noise_m=0.0, duration_s=36.0, travel_m=0.0):
    """Return a recording of turns to the left, 2 % too far, with noise of travel in each step of the odometry."""
    n = int(duration_s * RATE_HZ)
    along, none = np.full(n, travel_m / n), np.zeros(n)
    turns = np.full(n, 1.2 / RATE_HZ)
    noise = noise_m * np.random.default_rng(1).standard_normal(n)
    odometry = accumulate(np.zeros(3), Increments(along + noise, none, 1.02 * turns))
    return recording(Increments(along, none, turns), odometry)


@pytest.mark.parametrize("noise_m", [0.0, 0.003])
@pytest.mark.parametrize("study", [oc.learn, oc.fit, oc.diagnose])
def test_turns_alone_are_refused_in_one_line_whatever_the_truth(study, noise_m):
    with pytest.raises(RecordingError, match=r"travels 0\.\d\d m only, .*turns on the spot.*some metres") as refused:
        study(Recordings((turning(noise_m),), ()))
    assert "\n" not in str(refused.value)


def test_turns_beside_a_drive_that_travels_are_not_refused():
    steps = wander(3, 60.0)
    drive = recording(steps, accumulate(np.zeros(3), steps))
    assert oc.fit(Recordings((turning(0.003), drive), ())).model


def test_gains_of_travel_without_travel_are_tested_for_every_correlation_time():
    found = fitted(turning())
    assert not np.concatenate([m.v for m in found.problem.motions]).any()
    assert "along" not in {getattr(one.effect, "channel", "") for one in random_coefficients(found, DECISIONS)}
