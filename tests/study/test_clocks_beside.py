"""Clocks of validation recordings are estimated after the model's effects are removed."""

from dataclasses import replace

import numpy as np
from hidden import as_recording

from odomcorrupt.effects import effect_from_values
from odomcorrupt.model.motion_model import MotionModel
from odomcorrupt.model.presets import preset_named
from odomcorrupt.simulation import simulate
from odomcorrupt.study.estimate.config import choose_approach
from odomcorrupt.study.validate.compare import clocks_beside


def test_an_effect_of_the_heading_in_the_world_is_taken_out_of_a_recording_whose_truth_has_none():
    recording = as_recording(simulate(93, "slope", duration_s=60.0))
    xyt = recording.truth.xyt.copy()
    xyt[:, 2] = np.nan
    recording = replace(recording, truth=replace(recording.truth, xyt=xyt))
    slope = effect_from_values("slope", {"creep": 0.01, "direction": 0.5})
    model = MotionModel(preset_named("typical").noise, effects=(slope,))
    clocks = clocks_beside([recording], choose_approach([recording]), model)
    assert abs(clocks.clocks[0].offset_s) < 0.05
