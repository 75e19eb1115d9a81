"""Systematic causes that test_hidden_effect.py does not draw are the first name; noise is named as noise."""

import pytest
from hidden import as_recording

from odomcorrupt.effects import registry
from odomcorrupt.simulation import simulate
from odomcorrupt.study.select.selection import learn

SYSTEMATIC = (
    "accel_slip", "backlash", "gyro_scale", "icr_shift", "region_slip", "scale_drift", "slope", "speed_scale",
    "turn_asymmetry", "unequal_wheels",
)  # fmt: skip
RANDOM = ("gauss_markov", "gyro_bias_walk", "lost_increments", "quantization", "slip_burst")


@pytest.mark.slow
@pytest.mark.parametrize("cause", SYSTEMATIC)
def test_a_systematic_cause_is_named_first(cause):
    learned = learn([as_recording(simulate(1, cause))])
    assert learned.added[:1] == (registry()[cause].aliased_with or cause,)
    if registry()[cause].aliased_with is not None:
        assert cause in learned.rounds[0].alternatives


@pytest.mark.slow
@pytest.mark.parametrize("cause", RANDOM)
def test_a_random_cause_is_named_as_noise_and_nothing_else_is(cause):
    learned = learn([as_recording(simulate(1, cause))])
    assert [gain.effect.name for gain in learned.noise] == [cause]
    assert learned.added == ()


@pytest.mark.slow
def test_a_clock_that_runs_fast_is_named_before_anything_else():
    learned = learn([as_recording(simulate(1, "clock_skew"))])
    assert learned.clocks.free[0][1]
    assert learned.added == ()
    assert learned.noise == ()
