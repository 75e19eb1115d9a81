"""A basis function that is almost the same as a known effect is not its rival and does not lower its confidence."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from wandering import recording, wander

from odomcorrupt.geometry.increments import Increments, accumulate
from odomcorrupt.study.select.stepwise import learn


@pytest.mark.slow
def test_a_track_that_is_wrong_is_not_doubted_for_turns_that_hardly_turn():
    # breaks where "yaw += omega * k * where(abs(omega) > 0.06, 1, 0)" counts as another cause than the track
    seed = 903
    reported = wander(seed, 300.0)
    noise = np.random.default_rng(seed).standard_normal((2, len(reported)))
    driven = Increments(
        reported.ds_m + 0.005 * noise[0] * np.sqrt(np.abs(reported.ds_m)),
        reported.dl_m,
        reported.dtheta_rad / 0.97 + 0.01 * noise[1] * np.sqrt(np.abs(reported.ds_m) + np.abs(reported.dtheta_rad)),
    )
    run = recording(driven, accumulate(np.zeros(3), reported), truth_mm=1.0, truth_rad=0.002, seed=seed)
    learned = learn([replace(run, track_m=0.4)])
    assert learned.added == ("wheelbase",)
    assert learned.margins["wheelbase"] > 8.2
