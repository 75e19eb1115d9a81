"""Acceleration slip by various simulators: named, with the right size, and without a clock offset."""

from dataclasses import replace

import numpy as np
import pytest
from hidden import ten_second_error
from wandering import RATE_HZ, noisy_path, recording, wander

from odomcorrupt.geometry.se2 import Increments
from odomcorrupt.model.noise_laws import Coefficients
from odomcorrupt.study.select.selection import learn

TRACK_M, K = 0.4, 0.03
QUIET = Coefficients(0.006, 0.006, 0.004, 0.002)


def slipping(steps, own):
    """Return what is truly driven where wheels turn so: each slips by k times an acceleration, `own` of it its own."""
    half = TRACK_M / 2.0 * steps.dtheta_rad
    rims = [(steps.ds_m + half) * RATE_HZ, (steps.ds_m - half) * RATE_HZ]
    body = np.gradient((rims[0] + rims[1]) / 2.0, 1.0 / RATE_HZ)
    faster = [body + own * (np.gradient(rim, 1.0 / RATE_HZ) - body) for rim in rims]
    right, left = (rim * (1.0 - K * a * np.sign(rim)) / RATE_HZ for rim, a in zip(rims, faster, strict=True))
    return Increments((right + left) / 2.0, steps.dl_m, (right - left) / TRACK_M)


@pytest.mark.slow
@pytest.mark.parametrize(("own", "contact"), [(0.0, "axle"), (1.0, "wheels")])
def test_slip_has_its_name_size_and_contact_and_leaves_no_clock(own, contact):
    # breaks where clocks are found beside a slip of the body alone: what it does not explain became an offset of 4 ms
    reported = wander(400, 300.0)
    driven = slipping(reported, own)
    run = recording(driven, noisy_path(reported, QUIET, 400), truth_mm=1.0, truth_rad=0.002, seed=400)
    learned = learn([replace(run, track_m=TRACK_M)])
    (effect,) = learned.fit.effects
    assert (effect.name, effect.contact) == ("accel_slip", contact)
    assert effect.k == pytest.approx(K, rel=0.1)
    assert not any(any(free) for free in learned.clocks.free)
    assert not learned.unknown


def belted(seed):
    """Return a recording of a robot whose right wheel slips on its belt, both when it speeds up and when it brakes."""
    reported = wander(seed, 200.0)
    half = TRACK_M / 2.0 * reported.dtheta_rad
    right, left = reported.ds_m + half, reported.ds_m - half
    right = right * np.where(np.abs(np.gradient(right) * RATE_HZ**2) > 0.5, 0.9, 1.0)
    driven = Increments((right + left) / 2.0, reported.dl_m, (right - left) / TRACK_M)
    run = recording(driven, noisy_path(reported, QUIET, seed), truth_mm=1.0, truth_rad=0.002, seed=seed)
    return replace(run, track_m=TRACK_M)


@pytest.mark.slow
def test_a_belt_of_one_wheel_that_slips_under_acceleration_of_either_sign_is_corrected_on_another_drive():
    learned = learn([belted(401)])
    (law,) = learned.laws
    assert law.wheels == "right"
    # the threshold is likeliest 5 cm/s2 lower, by 7 nats, and the mean slip above it is less
    assert law.score.estimate[0] == pytest.approx(-0.1, rel=0.15)
    assert "abs(a) >" in law.expression
    assert law.term.shape[0] == pytest.approx(0.5, abs=0.05)
    assert ten_second_error([belted(402)], learned.fit.effects) < 0.4 * ten_second_error([belted(402)])
