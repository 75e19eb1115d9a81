"""Pitfalls shown by a wheel-level simulation: drifting truths, controllers, second-order artefacts, scans, stamps."""

from dataclasses import replace

import numpy as np
import pytest
from hidden import as_recording, library_candidates, ten_second_error
from wandering import RATE_HZ

from odomcorrupt.effects import registry
from odomcorrupt.geometry.se2 import Increments, accumulate
from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.simulation import simulate, simulate_without
from odomcorrupt.study.estimate.config import choose_approach
from odomcorrupt.study.estimate.gauss_newton import fit
from odomcorrupt.study.io.encoders import encoder_effects, restore_lost
from odomcorrupt.study.io.recording import Recording
from odomcorrupt.study.select.candidates import score_terms
from odomcorrupt.study.select.decisions import DECISIONS, penalty
from odomcorrupt.study.select.dictionary import Dictionary, families
from odomcorrupt.study.select.selection import learn
from odomcorrupt.study.select.shape_search import ShapeSearch


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(40, 46))
def test_1_a_truth_by_satellites_raises_no_false_alarm(seed):
    # breaks where the truth's noise is assumed and not estimated, or its wander is left out
    learned = learn([as_recording(simulate(seed, None, truth="rtk"))])
    assert learned.added == ()
    assert learned.noise == ()


@pytest.mark.slow
def test_1_a_strong_cause_is_named_beneath_a_truth_by_satellites():
    # breaks where the truth's noise is so large in the model that everything hides in it
    run = as_recording(simulate(40, "wheelbase", truth="rtk", parameters={"e": 0.06}))
    learned = learn([run])
    assert learned.added == ("wheelbase",)
    assert learned.fit.noise.truth.xy_m > 0.006


def steered_on_the_truth(seed: int, seconds: float = 300.0) -> Recording:
    """Return a drive whose controller sees where the truth is at once, so that contact noise acts on the wheels."""
    rng = np.random.default_rng((6, seed))
    n, dt = int(seconds * RATE_HZ), 1.0 / RATE_HZ
    wanted = 0.5 + 0.3 * np.sign(np.sin(2 * np.pi * np.arange(n) * dt / 17.0))
    turn = 0.3 * np.sin(2 * np.pi * np.arange(n) * dt / 11.0)
    wheels, body = np.zeros((n, 2)), np.zeros((n, 2))
    way = goal = heading = goal_heading = speed = 0.0
    for i in range(n):
        goal, goal_heading = goal + wanted[i] * dt, goal_heading + turn[i] * dt
        speed += np.clip(wanted[i] + 2.0 * (goal - way) - speed, -dt, dt)
        wheels[i] = speed * dt, (turn[i] + 2.0 * (goal_heading - heading)) * dt
        slip = rng.standard_normal(2) * np.array([0.004, 0.006]) * np.sqrt(np.abs(wheels[i, 0]))
        body[i] = wheels[i] + slip
        way, heading = way + body[i, 0], heading + body[i, 1]
    paths = [accumulate(np.zeros(3), Increments(p[:, 0].copy(), np.zeros(n), p[:, 1].copy())) for p in (wheels, body)]
    seen = paths[1] + rng.standard_normal((n + 1, 3)) * [0.002, 0.002, 0.003]
    stamps = (np.arange(n + 1) * 1e9 * dt).astype(np.int64)
    return Recording("steered", Trajectory(stamps, paths[0]), Trajectory(stamps, seen), 0, 0.4)


def test_2_a_controller_that_steers_on_the_truth_is_no_slip():
    # breaks where regressors take the truth's side, on which the noise acts before the wheels answer it
    learned = learn([steered_on_the_truth(0)])
    assert "accel_slip" not in learned.added
    assert learned.added == ()


@pytest.mark.slow
@pytest.mark.parametrize("route", ["yard", "umbmark"])
def test_3_noise_of_the_heading_is_no_wandering_gain_where_a_drive_stops_and_goes(route):
    # breaks where the covariance of an interval forgets that a turn on the way swings its end
    for seed in (46, 47, 48):
        assert learn([as_recording(simulate(seed, None, route=route))]).noise == ()


@pytest.mark.slow
def test_4_a_deterministic_cause_is_not_called_noise_and_noise_no_cause():
    # breaks where a stochastic name is given before the best cause was tried, or the other way round
    wet = learn([as_recording(simulate(49, "region_slip"))])
    assert wet.added[:1] == ("region_slip",)
    assert wet.noise == ()
    wobbling = learn([as_recording(simulate(49, "gauss_markov", parameters={"sigma": 0.04, "tau": 5.0}))])
    assert wobbling.added == ()
    assert [gain.effect.name for gain in wobbling.noise] == ["gauss_markov"]


@pytest.mark.slow
def test_5_a_strong_cause_leaves_no_ghost_of_second_order():
    # breaks where the second look is linear in what the first one found: 3 degrees are 0.14 % of scale
    turned = as_recording(simulate(51, "mount_yaw", duration_s=300.0, parameters={"yaw": np.radians(3.0)}))
    assert learn([turned]).added == ("mount_yaw",)


def test_7_lost_increments_are_filled_and_not_corrected_as_a_scale():
    # breaks where they are left to the regression, whose mean is a scale error
    run = as_recording(simulate(52, "lost_increments", parameters={"fraction": 0.02}))
    floor = as_recording(simulate_without(52, "lost_increments"))
    found = encoder_effects(run)
    assert [effect.name for effect in found] == ["lost_increments"]
    scaled = fit([run], [registry()["wheel_scale"]()], approach=choose_approach([run])).effects
    filled, corrected = ten_second_error([restore_lost(run, found)]), ten_second_error([run], scaled)
    assert filled < 1.15 * ten_second_error([floor])
    assert corrected > 1.4 * filled


def test_7_coarse_ticks_are_seen_in_the_odometry_alone():
    # breaks where they are left to the likelihood, which takes them for noise of the truth
    run = as_recording(simulate(53, "quantization", duration_s=120.0, parameters={"step": 0.005}))
    assert [effect.name for effect in encoder_effects(run)] == ["quantization"]


def test_8_who_scans_many_shapes_is_charged_for_them():
    # breaks where a disc is judged as if it had been the only one looked at
    run = as_recording(simulate(54, None, duration_s=300.0))
    fitted = fit([run], approach=choose_approach([run]))
    family = next(f for f in families(fitted) if f[0].name == "region_slip")
    best = ShapeSearch(fitted, DECISIONS).located(family)[0]
    (alone,) = score_terms(fitted, [replace(best, trials=1)], Dictionary(DECISIONS))
    charged = next(c for c in library_candidates(fitted) if c.name == "region_slip")
    assert len(family) > 10
    assert charged.score.p >= min(1.0, len(family) * alone.p)
    assert charged.refused
    one = replace(family[0], trials=1)
    more = penalty(family[0], 1000, DECISIONS) - penalty(one, 1000, DECISIONS)
    assert more == pytest.approx(np.log(len(family)))


def test_9_stamps_since_1970_keep_their_nanoseconds_and_a_truth_may_have_holes():
    # breaks where stamps become floats before the origin is taken off (256 ns are lost), or a rate is assumed
    stamps = 1_750_000_000_000_000_000 + np.arange(0, 1000, 100, dtype=np.int64) ** 2
    path = Trajectory(stamps, np.zeros((10, 3)))
    np.testing.assert_allclose(path.seconds_since(int(stamps[0])) * 1e9, stamps - stamps[0], atol=1e-3)
    run = as_recording(simulate(55, "wheelbase", duration_s=300.0, parameters={"e": 0.04}))
    t = run.truth.seconds_since(run.origin_ns)
    keep = ~((t > 50.0) & (t < 80.0)) & ~((t > 200.0) & (t < 203.0)) & (np.arange(len(t)) % 7 != 3)
    holed = Recording("holed", run.odometry, Trajectory(run.truth.stamps_ns[keep], run.truth.xyt[keep]),
                      run.origin_ns, run.track_m)  # fmt: skip
    approach = choose_approach([run])
    kind = next(f[0].start for f in families(fit([run], approach=approach)) if f[0].name == "wheelbase")
    values = [fit([r], [kind], approach=approach).effects[0].e for r in (run, holed)]
    assert values == pytest.approx([0.04, 0.04], rel=0.1)


def test_a_robot_that_keeps_one_speed_has_no_ticks():
    # breaks where increments that are all alike count as a lattice
    n = 3000
    steps = Increments(np.full(n, 0.01), np.zeros(n), np.full(n, 0.002))
    rng = np.random.default_rng(0)
    jitter = rng.normal(0.0, 2e-5, n)
    xyt = accumulate(np.zeros(3), Increments(steps.ds_m + jitter, steps.dl_m, steps.dtheta_rad))
    stamps = 1_700_000_000_000_000_000 + 20_000_000 * np.arange(n + 1)
    path = Trajectory(stamps, xyt)
    assert encoder_effects(Recording("constant", path, path, int(stamps[0]), 0.4)) == []
