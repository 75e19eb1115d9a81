"""Recordings of a robot that was changed between them: reported, with the estimates of each."""

from dataclasses import replace

import numpy as np
import pytest
from wandering import noisy_path, recording, wander

from odomcorrupt.geometry.se2 import Increments
from odomcorrupt.model.noise_laws import Coefficients
from odomcorrupt.report.diagnosis import found_text
from odomcorrupt.study.design.advise import advise
from odomcorrupt.study.select.selection import learn

NOISE = Coefficients(0.01, 0.01, 0.01, 0.005)


def run(seed, *, scale=0.0, bias=0.0):
    """Return the same drive with other noise: true wheels larger than said, and an odometry that turns too fast."""
    reported = wander(801, 200.0)
    driven = Increments(
        reported.ds_m * (1.0 + scale),
        reported.dl_m,
        reported.dtheta_rad * (1.0 + scale) - bias / 50.0 * np.ones(len(reported)),
    )
    return replace(recording(driven, noisy_path(reported, NOISE, seed), truth_mm=1.0, seed=seed), track_m=0.4)


@pytest.mark.slow
def test_a_load_that_was_put_on_is_said_and_not_only_called_noise():
    # breaks where what is constant in each recording is left to the slow noise that it looks like
    learned = learn([run(801), run(802, scale=-0.012)])
    reported = {one.effect: one for one in learned.disagreements}
    assert set(reported) == {"wheel_scale"}
    assert reported["wheel_scale"].values == pytest.approx((0.0, -0.012), abs=0.002)
    text = found_text(learned, advise(learned))
    assert "the recordings disagree about wheel_scale: " in text
    assert "in drive 802. The robot changed between them" in text


@pytest.mark.slow
def test_a_gyro_that_was_switched_on_again_is_said():
    learned = learn([run(803, bias=0.004), run(804, bias=-0.004)])
    assert learned.disagreements[0].effect == "gyro_bias"
    assert learned.disagreements[0].values == pytest.approx((0.004, -0.004), abs=0.001)


@pytest.mark.slow
def test_recordings_of_one_robot_agree():
    assert learn([run(seed, scale=0.01) for seed in (805, 806)]).disagreements == ()
