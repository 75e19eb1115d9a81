"""A basis function that is the same as a known effect on any drive is not its rival; one that is so only here, is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hidden import as_recording
from wandering import RATE_HZ, recording, wander

from odomcorrupt.geometry.increments import Increments, accumulate
from odomcorrupt.simulation import simulate
from odomcorrupt.study.design.advise import advise
from odomcorrupt.study.select.confidence import confidence, evidence_of
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


def squares(rates, duration_s=400.0):
    """Return straights of 2 s and turns of 90 degrees on the spot, each turn at the next of these yaw rates, rad/s."""
    omega, side = [], np.zeros(int(2.0 * RATE_HZ))
    for i in range(int(duration_s / 5.0)):
        rate = rates[i % len(rates)]
        omega += [side, np.full(int(0.5 * np.pi / abs(rate) * RATE_HZ), rate)]
    omega = np.concatenate(omega)
    return Increments(np.where(omega == 0.0, 0.5, 0.0) / RATE_HZ, np.zeros(len(omega)), omega / RATE_HZ)


@pytest.mark.slow
@pytest.mark.parametrize(("rates", "alike"), [((0.6, -0.6), True), ((0.3, -0.6, 1.2), False)])
def test_a_track_and_scrub_in_fast_turns_are_rivals_only_where_all_turns_are_equally_fast(rates, alike):
    # breaks where a function of the yaw rate that equals a constant on this drive alone counts as a copy of the track
    reported = squares(rates)
    noise = np.random.default_rng(5).standard_normal(len(reported))
    driven = Increments(
        reported.ds_m,
        reported.dl_m,
        reported.dtheta_rad / 0.97 + 0.01 * noise * np.sqrt(np.abs(reported.ds_m) + np.abs(reported.dtheta_rad)),
    )
    run = recording(driven, accumulate(np.zeros(3), reported), truth_mm=1.0, truth_rad=0.002, seed=5)
    learned = learn([replace(run, track_m=0.4)])
    assert learned.added == ("wheelbase",)
    (step,) = learned.steps
    rivals = [one for one in learned.unknown if one.instead_of == ("wheelbase",) and one.regressor == "yaw_rate"]
    assert bool(rivals) == alike
    assert (confidence(evidence_of(step, learned)) < 0.95) == alike
    named = [choice for choice in advise(learned).choices if "a dependence of yaw on yaw rate" in choice.names]
    assert all(choice.plan is not None for choice in named)
    assert bool(named) == alike


@pytest.mark.slow
def test_a_strip_of_floor_is_a_patch_that_slips():
    # breaks where only a grid of discs leads to rectangles
    learned = learn([as_recording(simulate(
        9_735, "wet_strip", duration_s=300.0, route="yard", yaw_from="gyro", drive_type="skid", size=2.0
    ))])  # fmt: skip
    assert learned.added == ("region_slip",)
    assert not learned.unexplained
