"""Coefficients that a drive does not excite are reported as unknown, neither omitted nor zero."""

import warnings
from dataclasses import replace

import numpy as np
from wandering import recording, wander

from odomcorrupt.geometry.se2 import accumulate
from odomcorrupt.report.diagnosis import fit_text
from odomcorrupt.study.estimate.calibrate import fit_robot


def test_noise_of_turns_is_not_identifiable_where_nothing_turned():
    drive = wander(8, 120.0)
    straight = replace(drive, dtheta_rad=np.zeros(len(drive)))
    # encoders are smooth; a truth that drives would seem to turn by its own noise
    run = recording(straight, accumulate(np.zeros(3), straight), seed=8)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = fit_robot([run], [], law_name="diffusion")
    known = {interval.name: interval.identifiable for interval in found.intervals}
    assert list(known) == ["rot_rot", "rot_trans", "trans_trans", "trans_rot", "across_trans"]
    assert not known["rot_rot"]
    assert not known["trans_rot"]
    assert known["trans_trans"]
    lines = [line for line in fit_text(found).splitlines() if line.strip().startswith("rot_rot")]
    assert "not identifiable from this drive" in lines[0]
