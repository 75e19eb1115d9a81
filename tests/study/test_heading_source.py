"""With a gyro as heading source, wheel errors occur along only, and are named all the same."""

from dataclasses import replace

import numpy as np
import pytest
from hidden import as_recording
from wandering import RATE_HZ, recording

from odomcorrupt.effects import registry
from odomcorrupt.effects.compensation import error_of
from odomcorrupt.effects.effect import choices
from odomcorrupt.geometry.se2 import Increments, accumulate
from odomcorrupt.simulation import simulate
from odomcorrupt.study.estimate.heading_source import turns_at_rest
from odomcorrupt.study.select.selection import learn
from odomcorrupt.testing import contract_drive

OF_WHEELS = ["accel_slip", "backlash", "battery_sag", "region_slip", "scale_drift", "speed_scale", "wheel_scale"]


def test_effects_of_the_wheels_know_where_a_heading_comes_from():
    assert [name for name, kind in registry().items() if "heading" in choices(kind)] == sorted(
        [*OF_WHEELS, "slip_burst", "slip_event"]
    )


@pytest.mark.parametrize("name", OF_WHEELS)
def test_with_a_gyro_the_error_along_is_the_same_and_none_is_in_the_heading(name):
    kind, motion = registry()[name], contract_drive().motion
    size = {
        "accel_slip": "k",
        "backlash": "travel",
        "battery_sag": "rate",
        "region_slip": "slip",
        "scale_drift": "rate",
        "wheel_scale": "e",
    }
    sized = kind(**{size.get(name, "k"): 1e-4})
    each = replace(sized, contact="wheels") if "contact" in choices(kind) else sized
    wheels, gyro = (error_of(replace(each, heading=h), motion) for h in ("wheels", "gyro"))
    assert np.array_equal(wheels[:, :2], gyro[:, :2])
    assert wheels[:, 2].any()
    assert not gyro[:, 2].any()


def laps(noise_rad=0.0, lag_s=0.0):
    """Return a recording of a robot that drives straight over a patch of slip, turns on the spot elsewhere, and rests.

    noise_rad : of the heading that its odometry measures in each step; lag_s : of the filter of that heading
    """
    rng = np.random.default_rng(6)
    leg_s = np.arange(15 * RATE_HZ) / RATE_HZ  # 6 m, a quarter turn, and a rest; four legs are a lap
    v = np.tile(np.where(leg_s < 6.0, 1.0, 0.0), 16)
    omega = np.tile(np.where((leg_s >= 7.0) & (leg_s < 9.0), np.pi / 4.0, 0.0), 16)
    steps = Increments(v / RATE_HZ, 0.0 * v, omega / RATE_HZ)
    x, y, _ = accumulate(np.zeros(3), steps)[:-1].T
    slips = np.hypot(x - 3.0, y) < 1.5
    measured = steps.dtheta_rad + noise_rad * rng.standard_normal(len(v))
    if lag_s:
        kept = np.exp(-1.0 / RATE_HZ / lag_s)
        measured = np.convolve(measured, (1.0 - kept) * kept ** np.arange(int(5 * RATE_HZ)))[: len(v)]
    ground = 0.002 * rng.standard_normal(len(v)) * np.sqrt(steps.ds_m)
    odometry = Increments(steps.ds_m / (1.0 - 0.07 * slips) + ground, steps.dl_m, measured)
    return recording(steps, accumulate(np.zeros(3), odometry))


@pytest.mark.parametrize(("noise_rad", "lag_s", "gyro"), [(1.4e-5, 0.0, True), (0.0, 0.0, False), (0.0, 0.1, False)])
def test_a_heading_that_goes_on_changing_at_rest_is_measured_by_a_gyro(noise_rad, lag_s, gyro):
    assert turns_at_rest(laps(noise_rad, lag_s)) is gyro


@pytest.mark.slow
@pytest.mark.parametrize(("source", "word"), [("gyro", "gyro"), ("encoders", "wheels")])
def test_a_scale_of_the_wheels_is_named_whatever_gives_the_heading(source, word):
    run = as_recording(simulate(91, "wheel_scale", parameters={"e": 0.02}, duration_s=300.0, yaw_from=source))
    learned = learn([run])
    (effect,) = learned.fit.effects
    assert (effect.name, effect.heading) == ("wheel_scale", word)
    assert effect.e == pytest.approx(0.02, rel=0.15)


@pytest.mark.slow
def test_two_causes_that_share_the_heading_are_not_taken_for_a_gyro():
    # the wheels' scale and the track turn the robot together; a gyro and a track could say the same with other numbers
    causes = {"wheel_scale": {"e": 0.02}, "wheelbase": {"e": -0.02}}
    run = as_recording(simulate(92, tuple(causes), parameters=causes, duration_s=300.0, yaw_from="encoders"))
    found = {e.name: e for e in learn([run]).fit.effects}
    assert set(found) == set(causes)
    assert found["wheel_scale"].heading == "wheels"
    assert found["wheelbase"].e == pytest.approx(-0.02, rel=0.15)


@pytest.mark.slow
def test_where_a_gyro_drifts_the_wheels_have_no_say_in_the_heading():
    # the residuals have two stories: wheels turn the robot and a track undoes it, or the gyro has a scale of its own
    causes = {"wheel_scale": {"e": 0.01}, "gyro_scale": {"e": 0.012}, "gyro_bias": {"bias": 0.002}}
    run = as_recording(simulate(93, tuple(causes), parameters=causes, duration_s=300.0, yaw_from="gyro"))
    found = {e.name: e for e in learn([run]).fit.effects}
    assert set(found) == {"wheel_scale", "wheelbase", "gyro_bias"}
    assert found["wheel_scale"].heading == "gyro"
    assert found["wheelbase"].e == pytest.approx(0.012, rel=0.15)
