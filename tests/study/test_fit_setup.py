"""A fit finds the mounting of the truth's tracked point, and none if there is no offset."""

from dataclasses import replace

import numpy as np
import pytest
from hidden import as_recording
from wandering import noisy_path, recording, wander

from odomcorrupt.geometry.se2 import compose
from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.model.noise_laws import LAWS, Coefficients
from odomcorrupt.simulation import simulate
from odomcorrupt.study.estimate.calibrate import effects_to_fit, fit_every_law, fit_robot

MOUNTED = (0.08, -0.03, 0.02)
"""Where the truth's marker sits on the base: x, y (m), yaw (rad)."""


@pytest.fixture(scope="module")
def clean():
    return as_recording(simulate(3, None, duration_s=240.0))


@pytest.fixture(scope="module")
def mounted(clean):
    xyt = compose(clean.truth.xyt, np.broadcast_to(MOUNTED, clean.truth.xyt.shape))
    return replace(clean, truth=Trajectory(clean.truth.stamps_ns, xyt))


def test_a_marker_beside_the_base_frame_is_found_in_the_setup_and_not_in_the_robot(mounted):
    result = fit_robot([mounted], (), law_name="diffusion")
    found = {effect.name: effect for effect in result.model.setup.effects}
    errors = result.model.standard_errors
    assert found.keys() == {"lever_arm", "mount_yaw"}
    assert abs(found["lever_arm"].x - MOUNTED[0]) < 4.0 * errors["lever_arm.x"] < 0.01
    assert abs(found["lever_arm"].y - MOUNTED[1]) < 4.0 * errors["lever_arm.y"] < 0.01
    assert abs(found["mount_yaw"].yaw - MOUNTED[2]) < 4.0 * errors["mount_yaw.yaw"] < 0.01
    assert result.model.effects == ()


def test_a_marker_on_the_base_frame_leaves_the_setup_empty(clean):
    assert fit_robot([clean], (), law_name="diffusion").model.setup.effects == ()


def test_what_cannot_be_separated_from_an_effect_that_is_asked_for_is_not_searched(mounted):
    result = fit_robot([mounted], effects_to_fit(None, ["icr_shift"]), law_name="diffusion")
    assert "lever_arm" not in {effect.name for effect in result.model.setup.effects}


@pytest.mark.slow
def test_of_all_laws_the_one_that_made_the_noise_is_the_likeliest():
    steps = wander(5, 300.0)
    run = recording(steps, noisy_path(steps, Coefficients(0.05, 0.02, 0.05, 0.01), 5), seed=5)
    results = fit_every_law([run], ())
    assert set(results) == {name for name, law in LAWS.items() if law.fitted}
    assert next(iter(results)) == "diffusion"
    nats = [result.information_nats for result in results.values()]
    assert nats == sorted(nats, reverse=True)
    assert nats[0] > nats[1]


@pytest.mark.slow
def test_stretches_of_one_run_share_their_clock(clean):
    late = Trajectory(clean.odometry.stamps_ns + 40_000_000, clean.odometry.xyt)
    middle = len(clean.odometry) // 2
    parts = [
        replace(clean, name=f"part {i}", odometry=Trajectory(late.stamps_ns[s], late.xyt[s]), clock="one")
        for i, s in enumerate((slice(0, middle), slice(middle, None)))
    ]
    shared = fit_robot(parts, (), law_name="diffusion").clocks
    assert shared.clocks[0] == shared.clocks[1]
    assert abs(shared.clocks[0].offset_s - 0.04) < 4.0 * shared.errors[0][0] < 0.01
    own = fit_robot([replace(part, clock="") for part in parts], (), law_name="diffusion").clocks
    assert own.clocks[0] != own.clocks[1]
    assert shared.errors[0][0] < 0.9 * own.errors[0][0]
