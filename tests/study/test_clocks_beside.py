"""Clocks of validation recordings are estimated beside the model's effects; the clock of a laser is free."""

from dataclasses import replace

import numpy as np
from hidden import as_recording

from odomcorrupt.effects import effect_from_values
from odomcorrupt.model.motion_model import MotionModel
from odomcorrupt.model.presets import preset_named
from odomcorrupt.simulation import simulate
from odomcorrupt.study.estimate.clocks import find_clocks
from odomcorrupt.study.estimate.config import choose_approach
from odomcorrupt.study.validate.evaluation_clocks import clocks_beside


def test_an_effect_of_the_heading_in_the_world_is_taken_out_of_a_recording_whose_truth_has_none():
    recording = as_recording(simulate(93, "slope", duration_s=60.0))
    xyt = recording.truth.xyt.copy()
    xyt[:, 2] = np.nan
    recording = replace(recording, truth=replace(recording.truth, xyt=xyt))
    slope = effect_from_values("slope", {"creep": 0.01, "direction": 0.5})
    model = MotionModel(preset_named("typical").noise, effects=(slope,))
    clocks = clocks_beside([recording], choose_approach([recording]), model)
    assert abs(clocks.clocks[0].offset_s) < 0.05


def test_the_clock_of_a_laser_is_free_even_if_slip_pulls_it_to_where_it_increases_the_drift(monkeypatch):
    """Slip while speeding up is late travel; with turns in time and a fixed clock it was a lag of the turns, sure."""
    monkeypatch.setattr("odomcorrupt.study.estimate.clocks._harmless", lambda *_: False)
    recording = as_recording(simulate(93, "accel_slip", duration_s=120.0))
    approach = choose_approach([recording])
    assert find_clocks([recording], approach).free == ((False, False),)
    covariance = np.broadcast_to(np.diag([4e-6, 4e-6, 1e-5]), (len(recording.truth), 3, 3))
    seen = replace(recording, truth=replace(recording.truth, covariance=covariance), truth_scale_error=0.003)
    found = find_clocks([seen], approach)
    assert (found.free, found.clocks[0].offset_s) == (((True, False),), 0.0)
