"""Acceleration slip by various simulators: named, with the right size, and without a clock offset."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from wandering import RATE_HZ, noisy_path, recording, wander

from odomcorrupt.geometry.increments import Increments
from odomcorrupt.model.noise_laws import Coefficients
from odomcorrupt.study.select.stepwise import learn

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
    told = wander(400, 300.0)
    driven = slipping(told, own)
    run = recording(driven, noisy_path(told, QUIET, 400), truth_mm=1.0, truth_rad=0.002, seed=400)
    learned = learn([replace(run, track_m=TRACK_M)])
    (effect,) = learned.fit.effects
    assert (effect.name, effect.contact) == ("accel_slip", contact)
    assert effect.k == pytest.approx(K, rel=0.1)
    assert not any(any(free) for free in learned.clocks.free)
    assert not learned.unknown
