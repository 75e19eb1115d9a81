"""Steps of a filter towards poses are found in its odometry alone, and free odometry is left as it is."""

from dataclasses import replace

import numpy as np
import pytest
from test_undo import SILENT, drive

from odomcorrupt.correction.run import corrected_samples
from odomcorrupt.correction.undo import pose_corrections
from odomcorrupt.effects import effect_from_values
from odomcorrupt.geometry.se2 import accumulate, increments, wrap
from odomcorrupt.model.model_file import format_model, parse_model
from odomcorrupt.model.motion_model import MotionModel, Setup

STEPPED = MotionModel(SILENT, setup=Setup(pose_corrections=True))


def stepped(xyt, every=50, scatter=(0.006, 0.006, 0.002)):
    """Return poses (n, 3) with a step added at every so many of them, and the rows of the steps."""
    at = np.arange(every, len(xyt) - 1, every)
    steps = increments(xyt)
    for column, sigma in zip((steps.ds_m, steps.dl_m, steps.dtheta_rad), scatter, strict=True):
        column[at - 1] += np.random.default_rng(3).choice([-1.0, 1.0], len(at)) * sigma
    return accumulate(xyt[0], steps), at


@pytest.mark.parametrize("sideways", [False, True])
def test_free_odometry_has_no_steps(sideways):
    stamps_ns, xyt = drive(sideways=sideways)
    found = pose_corrections(stamps_ns * 1e-9, xyt)
    assert found.steps == 0
    assert not found.error_xyt.any()


@pytest.mark.parametrize("sideways", [False, True])
def test_odometry_between_steps_is_found_again(sideways):
    stamps_ns, xyt = drive(sideways=sideways)
    measured, at = stepped(xyt)
    measured[:, 2] = wrap(measured[:, 2])  # as quaternions give it
    found = pose_corrections(stamps_ns * 1e-9, measured)
    assert found.steps == len(at)
    left = measured + found.error_xyt - xyt
    left[:, 2] = wrap(left[:, 2])
    assert np.abs(left).max() < 1e-3
    assert np.abs(measured - xyt)[:, :2].max() > 0.02


def test_a_reset_of_the_pose_stays():
    stamps_ns, xyt = drive()
    xyt[1000:, :2] += [3.0, -4.0]
    assert pose_corrections(stamps_ns * 1e-9, xyt).steps == 0


def test_a_model_of_what_lies_between_steps_takes_them_out_with_its_effects():
    stamps_ns, xyt = drive()
    measured, _ = stepped(xyt)
    model = replace(STEPPED, effects=(effect_from_values("wheel_scale", {"e": 0.02}),), track_m=0.4)
    first_ns = int(stamps_ns[0])

    def corrected(chosen, poses):
        return poses + corrected_samples(chosen, stamps_ns, poses, first_ns=first_ns).error_xyt

    free = corrected(replace(model, setup=Setup()), xyt)
    assert corrected(model, measured) == pytest.approx(free, abs=1e-3)
    assert np.abs(corrected(replace(model, setup=Setup()), measured) - free).max() > 0.02


def test_model_files_say_so():
    assert parse_model(format_model(STEPPED)).setup.pose_corrections
    assert "pose_corrections" not in format_model(replace(STEPPED, setup=Setup()))
