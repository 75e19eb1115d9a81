"""Each systematic cause of the laboratory is the first name, or a twin of it; noise is named as noise."""

from __future__ import annotations

import pytest
from hidden import as_recording

from odomcorrupt.effects import registry
from odomcorrupt.simulation import simulate
from odomcorrupt.study.select.stepwise import learn

SYSTEMATIC = (
    "accel_slip", "backlash", "gyro_bias", "gyro_scale", "icr_shift", "lever_arm", "mount_yaw", "region_slip",
    "scale_drift", "side_slip", "slope", "speed_scale", "turn_asymmetry", "unequal_wheels", "wheel_scale", "wheelbase",
)  # fmt: skip
RANDOM = ("gauss_markov", "gyro_bias_walk", "lost_increments", "quantization", "slip_burst")


@pytest.mark.slow
@pytest.mark.parametrize("cause", SYSTEMATIC)
def test_a_systematic_cause_is_named_first(cause):
    learned = learn([as_recording(simulate(1, cause))])
    assert learned.added[:1] == (registry()[cause].twin_of or cause,)
    if registry()[cause].twin_of is not None:
        assert cause in learned.rounds[0].alternatives


@pytest.mark.slow
@pytest.mark.parametrize("cause", RANDOM)
def test_a_random_cause_is_named_as_noise_and_nothing_else_is(cause):
    learned = learn([as_recording(simulate(1, cause))])
    assert [gain.effect.name for gain in learned.noise] == [cause]
    assert learned.added == ()


@pytest.mark.slow
@pytest.mark.parametrize("cause", ["time_offset", "clock_skew"])
def test_a_clock_is_named_before_anything_else(cause):
    learned = learn([as_recording(simulate(1, cause))])
    assert learned.clocks.free[0][cause == "clock_skew"]
    assert learned.added == ()
    assert learned.noise == ()
