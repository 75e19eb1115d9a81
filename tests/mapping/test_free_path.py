"""The path of one run within a map, against the many runs of `FreeRuns` and against the path without a map."""

import numpy as np
import pytest
from rooms import MODEL, drive, room

from odomcorrupt.corruption.path import NoisyPath
from odomcorrupt.effects import effect_from_values
from odomcorrupt.errors import MapError, ModelError
from odomcorrupt.mapping.conditioned_runs import FreeRuns
from odomcorrupt.mapping.constrained_path import FreePath
from odomcorrupt.mapping.free_space import free_space
from odomcorrupt.model.motion_model import MotionModel, Noise, Step
from odomcorrupt.model.presets import preset_named

CORRIDOR = ((1.5, 0.3, 4.5, 0.5), (1.5, -0.5, 4.5, -0.3))
BOOK = MotionModel(Noise("linear", preset_named("article").noise.coefficients, Step(0.25, 0.2)))


@pytest.mark.parametrize("model", [MODEL, BOOK])
@pytest.mark.parametrize("check", ["endpoint", "path"])
def test_run_is_the_one_that_sampling_draws(model, check):
    stamps, xyt = drive()
    space = free_space(room(*CORRIDOR), 0.15)
    runs = FreeRuns(model, space, seed=1, runs=range(8), check=check).feed(stamps, xyt)
    redrawn = 0
    for run, sampled in enumerate(runs):
        path = FreePath(model, space, seed=1, run=run, check=check)
        noisy = xyt + path.feed(stamps, xyt).error_xyt
        np.testing.assert_allclose(noisy, sampled, atol=1e-9)
        assert space.free(noisy[:, :2]).all()
        redrawn += path.redrawn
    assert redrawn > 0


def test_cut_into_batches_changes_no_bit():
    stamps, xyt = drive()
    xyt[150:] += [0.4, 0.1, 1.0]  # a jump
    space = free_space(room(*CORRIDOR), 0.2, unknown="free")
    whole_path, path = (FreePath(MODEL, space, seed=1, tries=5) for _ in range(2))
    whole = whole_path.feed(stamps, xyt)
    parts = [path.feed(stamps[i : i + 37], xyt[i : i + 37]) for i in range(0, 300, 37)]
    np.testing.assert_array_equal(np.concatenate([part.error_xyt for part in parts]), whole.error_xyt)
    np.testing.assert_array_equal(np.concatenate([part.sums for part in parts], axis=1), whole.sums)
    assert whole_path.account() == path.account()
    assert path.redrawn > 0


def test_open_space_changes_no_bit():
    stamps, xyt = drive()
    space = free_space(room(), 0.2, unknown="free")
    ours, plain = FreePath(MODEL, space, seed=1, run=2).feed(stamps, xyt), NoisyPath(MODEL, 1, 2).feed(stamps, xyt)
    np.testing.assert_array_equal(ours.error_xyt, plain.error_xyt)
    np.testing.assert_array_equal(ours.sums, plain.sums)


def test_robot_before_a_wall_stays_turns_and_it_is_counted():
    stamps, xyt = drive()
    space = free_space(room((2.0, -5.0, 2.2, 5.0)), 0.1)
    path = FreePath(MODEL, space, seed=1, check="path", tries=20)
    noisy = xyt + path.feed(stamps, xyt).error_xyt
    assert space.free(noisy[:, :2]).all()
    assert 1.5 < noisy[-1, 0] < 1.9
    still = np.flatnonzero((np.abs(np.diff(noisy[:, :2], axis=0)) < 1e-12).all(axis=1))
    assert len(still) == path.blocked > 50
    assert (np.abs(np.diff(noisy[:, 2])[still]) > 0.0).all()
    astray = int((~space.free(xyt[:, :2])).sum())
    said = f"for {path.blocked} none of 20 tries was free: there the robot stayed where it was."
    assert said in path.account()
    assert f"not free at {astray} poses; is --map-pose right?" in path.account()


def test_robot_whose_pose_was_set_into_a_wall_is_let_out_of_it():
    stamps, xyt = drive()
    xyt[150:, 0] += 30.0
    xyt[150:, 1] = np.linspace(0.0, 1.0, 150)
    space = free_space(room(), 0.0)  # 30 m ahead is beyond the map, which blocks
    path = FreePath(MODEL, space, seed=1)
    noisy = xyt + path.feed(stamps, xyt).error_xyt
    assert not space.free(noisy[150:, :2]).any()
    assert np.ptp(noisy[150:, 1]) > 0.8
    assert path.blocked == 0


def test_drive_that_begins_in_a_wall_and_effects_are_refused():
    stamps, xyt = drive()
    inside = free_space(room((-0.5, -0.5, 0.5, 0.5)), 0.1)
    with pytest.raises(MapError, match=r"begins at \(0.000 m"):
        FreePath(MODEL, inside, seed=1).feed(stamps, xyt)
    wide = MotionModel(MODEL.noise, (effect_from_values("wheel_scale", {"e": 0.01}),))
    with pytest.raises(ModelError, match="wheel_scale is no noise"):
        FreePath(wide, inside, seed=1)
