"""The path of one run within a map, against the many runs of `FreeRuns` and against the path without a map."""

import numpy as np
import pytest
from rooms import MODEL, drive, room

from odomcorrupt.corruption.path import NoisyPath
from odomcorrupt.effects import effect_from_values
from odomcorrupt.errors import MapError, ModelError
from odomcorrupt.mapping.conditioned import FreePath, FreeRuns, whole_path
from odomcorrupt.mapping.occupancy_grid import Constraint, free_space
from odomcorrupt.model.motion_model import MotionModel, Noise, Step
from odomcorrupt.model.noise_laws import Coefficients

CORRIDOR = ((1.5, 0.3, 4.5, 0.5), (1.5, -0.5, 4.5, -0.3))
LOUD = MotionModel(Noise("diffusion", Coefficients(0.6, 0.6, 0.2, 0.3)))
BOOK = MotionModel(Noise("linear", Coefficients(0.3, 0.6, 0.4, 0.2), Step(0.25, 0.2)))


@pytest.mark.slow
@pytest.mark.parametrize("model", [LOUD, BOOK])
@pytest.mark.parametrize("check", ["endpoint", "path"])
def test_run_is_the_one_that_sampling_draws(model, check):
    stamps, xyt = drive()
    space = free_space(room(*CORRIDOR), 0.15)
    runs = FreeRuns(model, Constraint(space, check), seed=1, runs=range(8)).feed(stamps, xyt).xyt
    redrawn = same = 0
    for run, sampled in enumerate(runs):
        path = FreePath(model, Constraint(space, check), 1, run)
        try:
            noisy = xyt + path.feed(stamps, xyt).error_xyt
        except MapError:  # stuck, so that sampling copied another run
            continue
        same += 1
        np.testing.assert_allclose(noisy, sampled, atol=1e-9)
        assert space.free(noisy[:, :2]).all()
        redrawn += path.redrawn
    assert redrawn > 0
    assert same > 3


def test_cut_into_batches_changes_no_bit():
    stamps, xyt = drive()
    xyt[150:] += [0.4, 0.1, 1.0]  # a jump
    within = Constraint(free_space(room(*CORRIDOR), 0.2, unknown="free"))
    one, path = (FreePath(LOUD, within, 1, 5) for _ in range(2))
    whole = one.feed(stamps, xyt)
    parts = [path.feed(stamps[i : i + 37], xyt[i : i + 37]) for i in range(0, 300, 37)]
    np.testing.assert_array_equal(np.concatenate([part.error_xyt for part in parts]), whole.error_xyt)
    np.testing.assert_array_equal(np.concatenate([part.sums for part in parts], axis=1), whole.sums)
    assert one.account() == path.account()
    assert path.redrawn > 0


def test_open_space_changes_no_bit():
    stamps, xyt = drive()
    within = Constraint(free_space(room(), 0.2, unknown="free"))
    ours, plain = FreePath(MODEL, within, 1, 2).feed(stamps, xyt), NoisyPath(MODEL, 1, 2).feed(stamps, xyt)
    np.testing.assert_array_equal(ours.error_xyt, plain.error_xyt)
    np.testing.assert_array_equal(ours.sums, plain.sums)


def pocket():
    """A corridor whose upper half ends in a pocket: who drifts up is stuck, who stays low passes below it."""
    return room((2.0, 0.05, 2.2, 5.0), (0.5, 0.35, 2.1, 0.5), (0.5, -0.5, 4.5, -0.4))


@pytest.mark.slow
def test_path_through_a_pocket_is_drawn_as_a_whole_and_free():
    stamps, xyt = drive()
    within = Constraint(free_space(pocket(), 0.0), "path", 5)
    stuck = []
    for run in range(20):
        try:
            FreePath(MODEL, within, 1, run).feed(stamps, xyt)
        except MapError:
            stuck.append(run)
    assert 0 < len(stuck) < 20
    ends = []
    for run in range(20):
        path = whole_path(stamps, xyt, MODEL, within, 1, run)
        noisy = xyt + path.feed(stamps, xyt).error_xyt
        assert within.allows(noisy[:-1, :2], noisy[1:, :2]).all()
        assert ("one of 64 paths" in path.account()) is (run in stuck)
        ends.append(noisy[-1])
    assert min(end[0] for end in ends) > 3.5
    assert len({tuple(end) for end in ends}) == 20


def test_path_that_is_never_stuck_has_the_bits_of_the_single_increments():
    stamps, xyt = drive()
    within = Constraint(free_space(room(*CORRIDOR), 0.15))
    plain = FreePath(LOUD, within, 1, 3).feed(stamps, xyt)
    whole = whole_path(stamps, xyt, LOUD, within, 1, 3).feed(stamps, xyt)
    np.testing.assert_array_equal(whole.error_xyt, plain.error_xyt)


def test_drive_through_a_wall_is_refused():
    stamps, xyt = drive()
    within = Constraint(free_space(room((2.0, -5.0, 2.2, 5.0)), 0.1), "path", 20)
    with pytest.raises(MapError, match="the map and the drive do not match"):
        FreePath(MODEL, within, 1).feed(stamps, xyt)
    with pytest.raises(MapError, match="the map and the drive do not match"):
        whole_path(stamps, xyt, MODEL, within, 1)


def test_odometry_that_is_not_free_itself_is_refused():
    stamps, xyt = drive()
    space = free_space(room((2.0, -0.5, 4.0, 0.5)), 0.0)
    share = 1.0 - np.mean(space.free(xyt[:, :2]))
    assert share > 0.25
    with pytest.raises(MapError, match=f"{share:.0%} of the odometry's own poses are not free; check map_pose"):
        whole_path(stamps, xyt, MODEL, Constraint(space), 1)


def test_robot_whose_pose_was_set_into_a_wall_is_let_out_of_it():
    stamps, xyt = drive()
    xyt[150:, 0] += 30.0
    xyt[150:, 1] = np.linspace(0.0, 1.0, 150)
    space = free_space(room(), 0.0)  # 30 m ahead is beyond the map, which blocks
    path = FreePath(MODEL, Constraint(space), 1)
    noisy = xyt + path.feed(stamps, xyt).error_xyt
    assert not space.free(noisy[150:, :2]).any()
    assert np.ptp(noisy[150:, 1]) > 0.8


def test_drive_that_begins_in_a_wall_and_effects_are_refused():
    stamps, xyt = drive()
    inside = Constraint(free_space(room((-0.5, -0.5, 0.5, 0.5)), 0.1))
    with pytest.raises(MapError, match=r"begins at \(0.000 m"):
        FreePath(MODEL, inside, 1).feed(stamps, xyt)
    wide = MotionModel(MODEL.noise, (effect_from_values("wheel_scale", {"e": 0.01}),))
    with pytest.raises(ModelError, match="wheel_scale is not noise"):
        FreePath(wide, inside, 1)
