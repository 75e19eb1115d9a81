"""The noise that is found is the likelihood's top, not a shelf on the way."""

from __future__ import annotations

import numpy as np
import pytest
from hidden import as_recording

from odomcorrupt.simulate import simulate
from odomcorrupt.study.fitting.approach import choose_approach
from odomcorrupt.study.fitting.gauss_newton import fit


@pytest.mark.parametrize(("seed", "route"), [(50018, "office"), (50021, "slalom")])
def test_noise_of_the_wheels_is_not_left_to_a_wander_of_the_truth(seed, route):
    # 64 and 45 nats were left on the way where headings come from a gyro, and a wandering gain was named for them
    run = as_recording(simulate(seed, None, route=route, yaw_from="gyro"))
    approach = choose_approach([run])
    found = fit([run], approach=approach)
    start = found.noise.free.copy()
    names = found.pieces.active
    start[names.index(2)], start[-1] = np.log(0.002), np.log(1e-6)
    assert found.log_likelihood == pytest.approx(fit([run], approach=approach, start=start).log_likelihood, abs=0.5)
    assert found.noise.coefficients.trans_trans == pytest.approx(0.0018, rel=0.2)
